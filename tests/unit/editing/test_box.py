"""Boxes: what they hold, turned or not, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.editing.box import Box, parse_box
from refusals import refuses_setting

UP_IS_Z = np.array([0.0, 0.0, -1.0])  # down
LOWER, UPPER = np.array([0.0, 0.0, 0.0]), np.array([2.0, 1.0, 1.0])


def test_box_along_the_axes() -> None:
    box = Box.between(LOWER, UPPER, UP_IS_Z)
    points = np.array([[1.9, 0.9, 0.1], [2.1, 0.5, 0.5], [1.0, 0.5, -0.1]])
    assert box.contains(points).tolist() == [True, False, False]
    assert box.corners.min(axis=0) == pytest.approx(LOWER) and box.corners.max(axis=0) == pytest.approx(UPPER)


def test_yaw_turns_about_the_vertical_right_handed() -> None:
    """A quarter turn exchanges length and width; an eighth turns the length from x towards y."""
    quarter = Box.between(LOWER, UPPER, UP_IS_Z, np.pi / 2.0)
    points = np.array([[1.0, 1.4, 0.5], [1.9, 0.5, 0.5], [1.0, 0.5, 0.99], [1.0, 0.5, 1.01]])
    assert quarter.contains(points).tolist() == [True, False, True, False]
    eighth = Box.between(LOWER, UPPER, UP_IS_Z, np.pi / 4.0)
    ends = np.array([[1.6, 1.1, 0.5], [1.6, -0.1, 0.5]])
    assert eighth.contains(ends).tolist() == [True, False]


def test_corners_may_be_given_in_any_order() -> None:
    lower, upper = parse_box("2,0,1,0,1,0")
    assert lower.tolist() == LOWER.tolist() and upper.tolist() == UPPER.tolist()


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d,e,f", "0,0,0,1,1,nan", ""])
def test_box_that_is_no_six_numbers_is_refused(text: str) -> None:
    refuses_setting(lambda: parse_box(text), "--box", "is", "write X0,Y0,Z0,X1,Y1,Z1 in metres")


def test_flat_box_is_refused() -> None:
    refuses_setting(lambda: parse_box("0,0,0,1,1,0"), "--box", "without volume", "two opposite corners")
