"""Flights in the rendered room of the package with propeller guards or drops of water in view."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.step import Step
from monoloc_lab.bench.hidden_view import flown

FRAMES = 100


def flown_steps(fault: str) -> list[Step]:
    return [step for _, step in flown(fault, FRAMES)]


@pytest.mark.parametrize(("fault", "share"), [("propeller-guards", 0.2), ("drops", 0.3)])
def test_what_is_in_view_is_left_out_and_is_no_change_of_the_room(fault: str, share: float) -> None:
    steps = flown_steps(fault)
    assert steps[-1].standing_share == pytest.approx(share, abs=0.15)
    assert all(step.state in ("tracking", "uncertain") for step in steps)
    (last,) = steps[-1:]
    assert last.depth is not None and last.standing is not None
    assert last.depth.depth_m.all(), "an obstacle that stands still in view remains one"
    pixels = last.depth.camera.project(last.scan.points)
    size = np.array(last.standing.shape[::-1]) / [last.depth.camera.width, last.depth.camera.height]
    x, y = ((pixels + 0.5) * size).astype(np.int64).T
    # A fifth to a third of the image stands still. What is left of it in the scan lies on its border.
    assert last.standing[y, x].mean() < 0.05


def test_undisturbed_flight_marks_nothing() -> None:
    assert {step.standing_share for step in flown_steps("none")} == {0.0}
