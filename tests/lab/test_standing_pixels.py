"""Flights in the rendered room of the package with propeller guards or drops of water in view."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from monoloc.bundle import Bundle, read_bundle
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording
from monoloc.localizer import Localizer
from monoloc.start import Start
from monoloc.step import Step
from monoloc_lab.bench.fault_flights import with_fault
from monoloc_lab.bench.faults import FAULTS
from monoloc_lab.bench.judged_flight import FlightFrame
from monoloc_lab.rooms import BUILD, BUNDLE, TESTS

FRAMES = 100


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return read_bundle(BUNDLE)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return open_recording(f"folder:{TESTS['L1']}")


@pytest.fixture(scope="module")
def flown(bundle: Bundle, recording: Recording) -> Callable[[str], list[Step]]:
    build = open_recording(f"folder:{BUILD}")

    def fly(fault: str) -> list[Step]:
        assert recording.poses is not None
        frames = [
            FlightFrame(partial(recording.color, index), float(recording.timestamps_s[index]), recording.poses[index])
            for index in range(FRAMES)
        ]
        changed, _ = with_fault(FAULTS[fault], frames, build.color, np.random.default_rng(0))
        localizer = Localizer(bundle, recording.camera, Start(recording.poses[0], 0.05, 0.02))
        times_s = [frame.time_s for frame in changed]
        elapsed_s = np.diff(times_s, prepend=times_s[0])
        return [localizer.step(frame.image(), float(s)) for frame, s in zip(changed, elapsed_s, strict=True)]

    return fly


@pytest.mark.parametrize(("fault", "share"), [("propeller-guards", 0.2), ("drops", 0.3)])
def test_what_is_in_view_is_left_out_and_is_no_change_of_the_room(
    flown: Callable[[str], list[Step]], fault: str, share: float
) -> None:
    steps = flown(fault)
    assert steps[-1].standing_share == pytest.approx(share, abs=0.15)
    assert all(step.state in ("tracking", "uncertain") for step in steps)
    (last,) = steps[-1:]
    assert last.depth is not None and last.standing is not None
    assert last.depth.depth_m.all(), "an obstacle that stands still in view remains one"
    pixels = last.depth.camera.project(last.scan.points)
    size = np.array(last.standing.shape[::-1]) / [last.depth.camera.width, last.depth.camera.height]
    x, y = ((pixels + 0.5) * size).astype(np.int64).T
    assert last.standing[y, x].mean() < 0.02


def test_undisturbed_flight_marks_nothing(flown: Callable[[str], list[Step]]) -> None:
    assert {step.standing_share for step in flown("none")} == {0.0}
