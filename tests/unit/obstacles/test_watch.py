"""Obstacles of a flight: when the map is believed, and when nothing is remembered."""

from __future__ import annotations

import re
import textwrap
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavlink_helpers import step_at
from monoloc import obstacles
from monoloc.bundle import Bundle
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import make_pose
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.obstacles import DepthError, Knowledge, ObstacleWatch
from monoloc.obstacles.local_occupancy import FreeSpace
from synthetic_room import room_bundle

LEVEL = Mount().T_body_camera
# In the room, y points down: a level vehicle that looks along z, with x to its right.
T_WORLD_LEVEL = make_pose(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), [0.0, 0.0, 0.0])
POSE = T_WORLD_LEVEL @ LEVEL


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(120)


def test_map_tells_what_live_depth_misses_unless_the_camera_is_lost(bundle: Bundle) -> None:
    watch = ObstacleWatch.of(bundle)
    for state in ("tracking", "map-changed", "uncertain"):
        around = watch.update(1.0, step_at(POSE, state, depth_m=4.5), LEVEL)
        assert isinstance(around, Knowledge)
        assert around.distances_m[0] == pytest.approx(3.0, abs=0.15) and np.isfinite(around.distances_m[36])
        assert around.is_gone[0]
    lost = watch.update(1.1, step_at(POSE, "lost", depth_m=4.5), LEVEL)
    assert not isinstance(lost, Knowledge)
    assert lost.distances_m[0] == pytest.approx(4.5, rel=0.02) and np.isnan(lost.distances_m[36])


def test_a_room_that_was_entered_in_flight_brings_its_map_two_seconds_later(bundle: Bundle) -> None:
    watch, step = ObstacleWatch.entered(bundle), step_at(POSE, depth_m=4.5)
    kinds = [isinstance(watch.update(time_s, step, LEVEL), Knowledge) for time_s in (1.0, 2.9, 3.0, 3.1)]
    assert kinds == [False, False, True, True]


def test_code_in_the_docstring_brakes_where_steps_leave_out_depth_for_long(bundle: Bundle) -> None:
    """And not for a single step that leaves it out, to keep its budget."""
    code = textwrap.dedent(re.findall(r"(?:    .*\n)+", obstacles.__doc__ or "")[-1])
    begin, each_frame = code.split("...\n", 1)
    braked: list[float] = []
    names: dict[str, Any] = {
        "AutopilotFrames": AutopilotFrames,
        "ObstacleWatch": ObstacleWatch,
        "bundle": bundle,
        "mount": Mount(),
    }
    exec(begin, names)
    for time_s, free_m in ((1.0, None), (1.1, 2.0), (1.2, None), (1.3, 0.5), (2.0, 2.0), (2.2, None), (2.4, None)):
        seen = None if free_m is None else SimpleNamespace(free_ahead=lambda _, free_m=free_m: FreeSpace(free_m, 0.0))
        names |= {
            "localizer": SimpleNamespace(step=lambda *_: step_at(POSE)),
            "watch": SimpleNamespace(update=lambda *_, seen=seen: seen),
            "brake": lambda time_s=time_s: braked.append(time_s),
        }
        names |= {"color": None, "elapsed_s": 0.1, "captured_s": time_s, "stopping_distance_m": 1.0}
        exec(each_frame, names)
    assert braked == [1.0, 1.3, 2.4]


@pytest.mark.parametrize("jump", ["restarted", "lost", "cleared", "none"])
def test_jump_is_forgotten(jump: str) -> None:
    watch = ObstacleWatch(DepthError(0.05, 0.0, True), None)
    watch.update(1.0, step_at(POSE, depth_m=1.0), LEVEL)
    if jump == "cleared":
        watch.clear()
    step = step_at(POSE, "lost" if jump == "lost" else "tracking", restarted=jump == "restarted", depth_m=4.0)
    expected_m = 1.0 if jump == "none" else 4.0
    assert watch.update(1.1, step, LEVEL).distances_m[0] == pytest.approx(expected_m, abs=0.1)
