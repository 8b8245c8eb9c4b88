"""What a step leaves out, and when."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from monoloc.step_budget import Level, StepBudget, StepPlan, plan_of

PARTICLES, POINTS = 300, 200


class Computer:
    """A clock, and the time that a step takes: so many ms for each stage, the weighing's by the root of its size."""

    def __init__(self, depth_ms: float = 5.0, landmarks_ms: float = 6.0, weighing_ms: float = 4.0) -> None:
        self.depth_ms, self.landmarks_ms, self.weighing_ms, self.rest_ms = depth_ms, landmarks_ms, weighing_ms, 8.0
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def step(self, budget: StepBudget, index: int) -> float:
        """Milliseconds of one step, which follows the budget's plan."""
        plan = plan_of(budget.level, index, PARTICLES, POINTS, is_tracking=True)
        began_s = self.now_s
        budget.begin()
        self.now_s += 1e-3 * self.rest_ms
        stages = {"depth": self.depth_ms * plan.has_depth, "landmarks": self.landmarks_ms * plan.has_landmarks}
        share = np.sqrt(plan.particles / PARTICLES * plan.scan_points / POINTS) * plan.has_depth
        for name, taken_ms in {**stages, "weighing": share * self.weighing_ms}.items():
            with budget.stage(name):  # type: ignore[arg-type]
                self.now_s += 1e-3 * taken_ms
        budget.end(plan)
        return 1e3 * (self.now_s - began_s)


def budget_on(computer: Computer, budget_ms: float) -> StepBudget:
    return StepBudget(budget_ms, PARTICLES, POINTS, clock=computer)


def test_each_level_leaves_out_what_those_before_it_do() -> None:
    plans = [[plan_of(level, index, PARTICLES, POINTS, is_tracking=True) for index in (0, 1)] for level in Level]
    full, fewer_particles, fewer_points, in_turn = plans
    assert full == [StepPlan(PARTICLES, POINTS)] * 2
    assert fewer_particles == [StepPlan(100, POINTS)] * 2
    assert fewer_points == [StepPlan(100, 100)] * 2
    assert in_turn == [StepPlan(100, 100, has_landmarks=False), StepPlan(100, 100, has_depth=False)]


def test_nothing_grows_and_a_camera_that_is_not_followed_is_measured_in_every_frame() -> None:
    assert plan_of(Level.IN_TURN, 1, 50, 60, is_tracking=False) == StepPlan(50, 60)


@pytest.mark.parametrize(
    ("budget_ms", "level"),
    [
        (30.0, Level.FULL),
        (24.5, Level.FEWER_PARTICLES),
        (23.2, Level.FEWER_SCAN_POINTS),
        (17.0, Level.IN_TURN),
        (5.0, Level.IN_TURN),
    ],
)
def test_the_level_is_the_first_that_keeps_the_budget_with_a_tenth_to_spare(budget_ms: float, level: Level) -> None:
    computer = Computer()
    budget = budget_on(computer, budget_ms)
    taken_ms = [computer.step(budget, index) for index in range(200)]
    assert budget.level is level
    if budget_ms > 15.0:
        assert max(taken_ms[20:]) <= budget_ms


def test_single_slow_steps_change_nothing() -> None:
    computer = Computer()
    budget = budget_on(computer, 26.0)
    for index in range(200):
        computer.rest_ms = 60.0 if index % 60 == 30 else 8.0
        computer.step(budget, index)
        assert budget.level is Level.FULL or index < 3


def test_no_first_step_exceeds_the_budget_and_the_fourth_gives_the_level() -> None:
    for budget_ms in (16.0, 30.0):
        computer = Computer()
        budget = budget_on(computer, budget_ms)
        assert max(computer.step(budget, index) for index in range(4)) <= budget_ms
        assert budget.level is (Level.FULL if budget_ms == 30.0 else Level.IN_TURN)


def test_a_computer_that_is_fast_again_does_more_again_one_level_after_the_other() -> None:
    computer = Computer()
    budget = budget_on(computer, 22.0)
    levels = []
    for index in range(600):
        computer.rest_ms = 14.0 if index < 100 else 1.0
        computer.step(budget, index)
        levels.append(budget.level)
    assert levels[99] is Level.IN_TURN
    later = levels[100:]
    changes = [at for at, (before, after) in enumerate(pairwise(later)) if before != after]
    assert later[-1] is Level.FULL and np.all(np.diff([int(level) for level in later]) <= 0)
    assert len(changes) == 3 and min(np.diff([0, *changes])) >= 50


def test_calm_frames_before_a_level_rose_do_not_bring_it_back() -> None:
    """Three slow steps within fifty raise it, at the end of nearly fifty calm ones; the next frame is calm again."""
    computer = Computer()
    budget = budget_on(computer, 30.0)
    levels = []
    for index in range(150):
        computer.rest_ms = 60.0 if index in (51, 75, 100) else 8.0
        computer.step(budget, index)
        levels.append(budget.level)
    assert levels[3:100] == [Level.FULL] * 97 and levels[100:] == [Level.IN_TURN] * 50
