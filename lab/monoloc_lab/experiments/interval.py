"""Medians over builds with bootstrap intervals. Builds differ more than starts do, so they are the unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

CONFIDENCE = 0.9
LEAST_BUILDS = 3
"""Number of builds below which there is no interval, and nothing is decided."""
_RESAMPLINGS = 5000

Step = Literal["better", "worse", "undecided"]
Verdict = Literal["holds", "fails", "undecided"]


@dataclass(frozen=True)
class Interval:
    """A median over builds, and its bootstrap interval; None with fewer than :data:`LEAST_BUILDS`.

    Source of the interval: Efron 1979, percentiles of the medians of resampled builds. Of three or five builds they
    are the smallest and the largest, which hold the true median with a probability of 75 and 94 %.
    """

    median: float
    builds: int
    low: float | None = None
    high: float | None = None

    def numbers(self) -> dict[str, Any]:
        """Ready for JSON."""
        return asdict(self)

    def text(self, factor: float = 1.0, digits: int = 1) -> str:
        """The median and, in brackets, the interval."""
        middle = f"{factor * self.median:.{digits}f}"
        if self.low is None or self.high is None:
            return middle
        return f"{middle} ({factor * self.low:.{digits}f} to {factor * self.high:.{digits}f})"


def interval_of(values: Sequence[float]) -> Interval:
    """Of one value a build, at least one."""
    median, builds = float(np.median(values)), len(values)
    if builds < LEAST_BUILDS:
        return Interval(median, builds)
    chosen = np.random.default_rng(0).integers(builds, size=(_RESAMPLINGS, builds))
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(np.median(np.asarray(values)[chosen], axis=1), [tail, 100.0 - tail])
    return Interval(median, builds, float(low), float(high))


def of_builds(seeds: Sequence[float], builds: int) -> list[float]:
    """Medians of the builds, of values of seeds; seed s has build s modulo their number."""
    if len(seeds) < builds:
        return []  # some run has no value, so which build each belongs to is unknown
    return [float(np.median(seeds[build::builds])) for build in range(builds)]


def medians_of_builds(rows: Sequence[Mapping[str, Any]], column: str, **wanted: Any) -> dict[int, float]:
    """Median of a column over the flights of each build, by ``build_seed``, of the rows with the wanted values."""
    values: dict[int, list[float]] = {}
    for row in rows:
        if row[column] is not None and all(row[name] == value for name, value in wanted.items()):
            values.setdefault(row["build_seed"], []).append(row[column])
    return {build: float(np.median(each)) for build, each in values.items()}


def ratios_of_builds(errors: Mapping[int, float], others: Mapping[int, float]) -> list[float]:
    """An error over another, of the builds that both have."""
    return [errors[build] / others[build] for build in errors if build in others]


def step_of(ratio: Interval) -> Step:
    """Of an error divided by that of another method, build by build: decided where the interval excludes 1."""
    found: dict[Verdict, Step] = {"holds": "better", "fails": "worse", "undecided": "undecided"}
    return found[is_below(ratio, 1.0)]


def is_below(interval: Interval, bound: float) -> Verdict:
    """Whether a number lies below a bound, decided where its interval excludes the bound."""
    if interval.low is None or interval.high is None:
        return "undecided"
    return "holds" if interval.high < bound else "fails" if interval.low > bound else "undecided"


def all_of(*verdicts: Verdict) -> Verdict:
    """Of a claim with several conditions."""
    if "fails" in verdicts:
        return "fails"
    return "undecided" if "undecided" in verdicts else "holds"
