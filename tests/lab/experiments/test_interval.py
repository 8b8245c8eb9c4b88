"""Intervals over builds, and what they decide."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc_lab.experiments.interval import Verdict, all_of, interval_of, is_below, of_builds, step_of


def test_few_builds_have_no_interval_and_decide_nothing() -> None:
    interval = interval_of([0.1, 0.2])
    assert (interval.median, interval.low, interval.high) == (pytest.approx(0.15), None, None)
    assert interval.text(100.0) == "15.0" and step_of(interval) == "undecided"


@pytest.mark.parametrize(
    ("ratios", "expected"),
    [((0.5, 0.6, 0.7, 0.8, 0.9), "better"), ((1.2, 1.3, 1.4, 1.5, 1.6), "worse"), ((0.5, 0.9, 1.1), "undecided")],
)
def test_ratio_is_decided_where_its_interval_excludes_one(ratios: tuple[float, ...], expected: str) -> None:
    assert step_of(interval_of(ratios)) == expected


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        (("holds", "holds"), "holds"),
        (("holds", "undecided"), "undecided"),
        (("undecided", "fails"), "fails"),
    ],
)
def test_claim_with_several_conditions(verdicts: tuple[Verdict, ...], expected: Verdict) -> None:
    assert all_of(*verdicts) == expected


def test_bound_is_decided_where_the_interval_excludes_it() -> None:
    interval = interval_of([1.0, 1.1, 1.2])
    assert [is_below(interval, bound) for bound in (1.15, 1.3, 0.9)] == ["undecided", "holds", "fails"]


def test_seeds_share_builds_in_turn() -> None:
    assert of_builds([1.0, 2.0, 3.0, 4.0, 5.0], 2) == [3.0, 3.0]
    assert of_builds([1.0, 2.0], 2) == [1.0, 2.0] and of_builds([1.0], 2) == []


def test_interval_contains_the_true_median_about_as_often_as_stated() -> None:
    """Of medians of fifteen draws; the percentile bootstrap of few draws is a little too narrow."""
    rng = np.random.default_rng(0)
    intervals = [interval_of(rng.normal(size=15)) for _ in range(200)]
    share = np.mean([each.low is not None and each.low <= 0.0 <= (each.high or 0.0) for each in intervals])
    assert 0.8 < share < 0.97


def test_text_has_the_interval_in_brackets() -> None:
    assert interval_of([0.02, 0.02, 0.02]).text(100.0) == "2.0 (2.0 to 2.0)"
