"""The budget of a step: what is left out, in a stated order, so that a slow computer keeps up with its camera."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

_FEW_PARTICLES, _FEW_POINTS = 100, 100
# Times of a stage that its cost is estimated from, the least number of each with which a level is chosen, and the
# percentile that counts: of many times, single ones, in which the system did something else, do not.
_KEPT, _LEAST_KEPT, _SLOW = 50, 2, 0.95
# The level falls where it would have kept the budget with this share of it for so many frames, and rises at once. The
# first one keeps it with this share, too.
_CALM_SHARE, _CALM_FRAMES = 0.9, 50
# A part of a weighing's time does not depend on how many particles and points there are: with a sixth of their
# product, it takes 0.43 times as long.
_WEIGHING_POWER = 0.5


class Level(IntEnum):
    """How much of a step is left out; each level leaves out what those before it do."""

    FULL = 0
    FEWER_PARTICLES = 1
    FEWER_SCAN_POINTS = 2
    IN_TURN = 3

    @property
    def words(self) -> str:
        return _WORDS[self]


_WORDS = {
    Level.FULL: "full",
    Level.FEWER_PARTICLES: "fewer particles",
    Level.FEWER_SCAN_POINTS: "fewer scan points",
    Level.IN_TURN: "landmarks and depth in turn",
}


@dataclass(frozen=True)
class StepPlan:
    """What one step does.

    Attributes:
        particles, scan_points: numbers of both.
        has_depth, has_landmarks: whether depth is predicted, and whether landmarks are measured.
    """

    particles: int
    scan_points: int
    has_depth: bool = True
    has_landmarks: bool = True


def plan_of(level: Level, index: int, particles: int, scan_points: int, is_tracking: bool) -> StepPlan:
    """What a step does at a level.

    Args:
        index: of the frame. Depth has its turn at even frames and landmarks at odd ones: with either alone in every
            second frame, the frames that have both would be as slow as before.
        particles, scan_points: of a step that leaves nothing out.
        is_tracking: whether pose and motion are known; if not, neither depth nor landmarks are left out.
    """
    is_even = index % 2 == 0
    return StepPlan(
        particles if level < Level.FEWER_PARTICLES else min(particles, _FEW_PARTICLES),
        scan_points if level < Level.FEWER_SCAN_POINTS else min(scan_points, _FEW_POINTS),
        has_depth=level < Level.IN_TURN or is_even or not is_tracking,
        has_landmarks=level < Level.IN_TURN or not is_even or not is_tracking,
    )


Stage = Literal["depth", "landmarks", "weighing"]


class StepBudget:
    """Chooses the level of each step by what the stages of the last ones took.

    A step is :meth:`begin`, its stages each in :meth:`stage`, and :meth:`end`.

    Args:
        budget_ms: that a step may take.
        particles, scan_points: of a step that leaves nothing out.
        clock: seconds.
    """

    def __init__(
        self, budget_ms: float, particles: int, scan_points: int, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._budget_ms, self._clock = budget_ms, clock
        self._particles, self._scan_points = particles, scan_points
        self._stage_ms: dict[Stage, float] = {}
        self._began_s = 0.0
        self._depth_ms, self._landmarks_ms, self._rest_ms, self._unit_ms = (
            deque[float](maxlen=_KEPT) for _ in range(4)
        )
        self._calm_frames = 0
        self._is_chosen = False
        self.level = max(Level)  # until it is known what the stages cost

    def begin(self) -> None:
        self._stage_ms = {}
        self._began_s = self._clock()

    @contextmanager
    def stage(self, name: Stage) -> Iterator[None]:
        """Times a stage; one that is entered again adds to its time."""
        began_s = self._clock()
        yield
        self._stage_ms[name] = self._stage_ms.get(name, 0.0) + 1e3 * (self._clock() - began_s)

    def end(self, plan: StepPlan) -> None:
        """Take in the times of a step that followed a plan, and choose the level of the next.

        Args:
            plan: with the number of particles that were weighed.
        """
        taken = self._stage_ms
        self._rest_ms.append(1e3 * (self._clock() - self._began_s) - sum(taken.values()))
        if plan.has_depth:
            self._depth_ms.append(taken.get("depth", 0.0))
            self._unit_ms.append(taken.get("weighing", 0.0) / _weighing_units(plan))
        if plan.has_landmarks:
            self._landmarks_ms.append(taken.get("landmarks", 0.0))
        if min(len(self._depth_ms), len(self._landmarks_ms)) >= _LEAST_KEPT:
            self._choose()

    def _choose(self) -> None:
        if not self._is_chosen or self._expected_ms(self.level) > self._budget_ms:
            possible = [level for level in Level if level > self.level or not self._is_chosen]
            share = 1.0 if self._is_chosen else _CALM_SHARE
            kept = (level for level in possible if self._expected_ms(level) <= share * self._budget_ms)
            self.level = next(kept, max(Level))
            self._is_chosen, self._calm_frames = True, 0
            return
        lighter = Level(max(0, self.level - 1))
        is_calm = self._expected_ms(lighter) <= _CALM_SHARE * self._budget_ms
        self._calm_frames = self._calm_frames + 1 if is_calm else 0
        if self._calm_frames >= _CALM_FRAMES:
            self.level, self._calm_frames = lighter, 0

    def _expected_ms(self, level: Level) -> float:
        """Time of the slowest steps at a level; the times of their stages vary independently."""
        stages = (self._rest_ms, self._depth_ms, self._landmarks_ms, self._unit_ms)
        median, slow = (np.array([_percentile(times, share) for times in stages]) for share in (0.5, _SLOW))
        slowest = 0.0
        for index in range(2):
            plan = plan_of(level, index, self._particles, self._scan_points, is_tracking=True)
            parts = np.array([1.0, plan.has_depth, plan.has_landmarks, plan.has_depth * _weighing_units(plan)])
            slowest = max(slowest, float(parts @ median + np.linalg.norm(parts * (slow - median))))
        return slowest


def _percentile(times_ms: deque[float], share: float) -> float:
    """The time at a share of the sorted times; ten times as fast as NumPy's."""
    return sorted(times_ms)[round(share * (len(times_ms) - 1))] if times_ms else 0.0


def _weighing_units(plan: StepPlan) -> float:
    """To which the time of a plan's weighing is taken to be proportional."""
    return float((plan.particles * plan.scan_points) ** _WEIGHING_POWER)


def level_counts(counts: Mapping[Level, int]) -> dict[str, int]:
    """Number of steps at each level that occurs, by its words, in order."""
    return {level.words: counts[level] for level in Level if level in counts}


def budget_line(counts: Mapping[str, int]) -> str:
    """What :func:`level_counts` counted, in a line for a person."""
    return "steps under the budget: " + ", ".join(f"{words} ({count})" for words, count in counts.items())
