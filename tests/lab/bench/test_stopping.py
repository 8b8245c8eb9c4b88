"""A drone before a wall of the synthetic room: it stops by map and live depth, also where the map lacks the wall."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import refused
from monoloc.bundle import Bundle, write_bundle
from monoloc.geometry import make_pose
from monoloc.obstacles import DepthError
from monoloc.progress import NoProgress
from monoloc_lab.bench.stopping import Sectors, Stop, bench_stops, distance_figures, stop_figures
from monoloc_lab.synth.approaches import Approach
from monoloc_lab.synth.rooms import Room as RenderedRoom
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, room_mixture, write_recording

CONTACT_M = 2.75  # from z = 0 to a quarter of a metre before the wall at z = 3
WAYS_M = np.arange(0.0, CONTACT_M, 0.16)
PLACES = np.stack([0.0 * WAYS_M, -0.2 + 0.0 * WAYS_M, WAYS_M], axis=1)
RECORDING = RoomRecording(Room(), make_pose(np.tile(np.eye(3), (len(PLACES), 1, 1)), PLACES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return make_bundle(room_mixture(Room(), 250), RECORDING, range(len(RECORDING)))


@pytest.mark.parametrize("is_new", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_drone_stops_before_the_wall(bundle: Bundle, tmp_path: Path, is_new: bool) -> None:
    write_recording(tmp_path / "L2", RECORDING)
    if is_new:  # the map of obstacles lacks the wall, that of the localizer has it
        means = bundle.original.means
        away = (means[:, 2] > 2.5)[:, None] * np.array([0.0, 0.0, 4.0])
        bundle = replace(bundle, original=replace(bundle.original, means=means + away))
    approach = Approach(RenderedRoom((5.0, 5.0, 2.6)), is_new, RECORDING.poses, WAYS_M / 0.8, CONTACT_M)
    figures = bench_stops(bundle, [(approach, {"L2": tmp_path / "L2"})], 0, NoProgress()).lights["L2"]
    stops, errors = (figures.new, figures.new_errors) if is_new else (figures.mapped, figures.mapped_errors)
    assert stops is not None and (stops.stops, stops.approaches, stops.stops_by_distance) == (1, 1, 1)
    assert 0.0 < stops.gap_least_m < 0.5
    # The nearest sectors err by 0.10; processors differ in the third digit.
    assert all(abs(each.live.median) < 0.12 and each.live.missed_rate < 0.1 for each in errors.values())
    assert (figures.mapped if is_new else figures.new) is None


def test_figures_count_contacts_and_misses() -> None:
    stops = [Stop(False, True, False, 0.3, "uncertain"), Stop(False, False, False, -0.1, "map")]
    summary = stop_figures(stops)
    assert summary is not None and (summary.stops, summary.approaches, summary.gap_least_m) == (1, 2, -0.1)
    assert summary.why == {"uncertain": 1, "map": 1} and stop_figures([]) is None
    true_m = np.array([1.0, 1.0, 1.0, 4.0])
    told_m = np.array([1.1, 1.5, np.inf, 4.0])
    figures = distance_figures(Sectors([true_m], [told_m], [told_m], [true_m]), DepthError(0.05, 0.0, True))
    assert set(figures) == {"0.75-1.5", "2.5-5"} and figures["0.75-1.5"].sectors == 3
    live = figures["0.75-1.5"].live
    assert live.missed_rate == pytest.approx(2.0 / 3.0) and live.within_2_sd == pytest.approx(1.0 / 3.0)
    assert live.median == pytest.approx(0.5) and figures["0.75-1.5"].joined.missed_rate == 0.0
    assert distance_figures(Sectors(), DepthError(0.05, 0.0, True)) == {}


def test_bundle_of_another_room_is_refused(
    bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_bundle(tmp_path / "room.monoloc", bundle)
    command = ("bench", "stop", "room.monoloc", "--out", "approaches")
    refused(capfd, tmp_path, command, "room.monoloc", "is not of the rendered living room", "--out living.monoloc")
