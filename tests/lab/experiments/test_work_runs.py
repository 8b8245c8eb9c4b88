"""Localisation, depth and clouds of a given bundle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from map_helpers import make_mixture
from monoloc.bundle import Bundle, fingerprint, write_bundle
from monoloc.errors import DataError
from monoloc_lab.experiments import tasks, work_runs
from monoloc_lab.experiments.gather import trajectory
from monoloc_lab.experiments.study import EvalRecording, Split, Study
from monoloc_lab.experiments.task import Result, Task
from study_helpers import NETWORK, execute, small_study, write_room
from synthetic_room import Room, RoomRecording, make_bundle, room_mixture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def recording(folder: Path) -> RoomRecording:
    return write_room(folder / "room")


@pytest.fixture(scope="module")
def study(folder: Path, recording: RoomRecording) -> Study:
    return small_study(folder / "room")


@pytest.fixture(scope="module")
def split(folder: Path, study: Study) -> Split:
    """Every fourth frame builds; the first eight frames are evaluated."""
    source = f"folder:{folder / 'room'}"
    lights = {"as recorded": None, "L3": "L3"}
    return Split("one", source, "::4", {name: EvalRecording(source, "0:8", light) for name, light in lights.items()})


@pytest.fixture(scope="module")
def room(recording: RoomRecording) -> Bundle:
    bundle = make_bundle(room_mixture(Room()), recording, range(0, 48, 4))
    down = (0.0, 1.0, 0.0)
    return replace(bundle, provenance=bundle.provenance.model_copy(update={"down_world": down}))


@pytest.fixture(scope="module")
def bundle(study: Study, split: Split) -> Task:
    return tasks.bundle(study, split, NETWORK, "unadapted")


@pytest.fixture(scope="module")
def done(folder: Path, room: Bundle, bundle: Task) -> dict[str, Result]:
    """Results by key; the bundle is the exact one of the room."""
    (folder / "bundle").mkdir()
    write_bundle(folder / "bundle" / "room.monoloc", room)
    return {bundle.key: Result(folder / "bundle", {})}


def test_run_writes_the_trajectory_of_its_figures(
    split: Split, bundle: Task, folder: Path, done: dict[str, Result]
) -> None:
    run = execute(tasks.run(bundle, split.recordings["as recorded"], 3), folder, done)
    arrays = trajectory(run)
    assert set(arrays) == set(tasks.TRAJECTORY_ARRAYS)
    assert arrays["covariances"].shape == (8, 6, 6)
    np.testing.assert_array_equal(arrays["unseen"], np.arange(8) % 4 != 0)
    errors = np.linalg.norm(arrays["poses"][:, :3, 3] - arrays["truth"][:, :3, 3], axis=1)[arrays["unseen"]]
    assert run.figures["unseen_ate_rmse_m"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert run.figures["unseen_frames"] == 6


def test_random_walk_has_no_odometry_and_sensor_depth_is_exact(
    split: Split, bundle: Task, folder: Path, done: dict[str, Result]
) -> None:
    task = tasks.run(bundle, split.recordings["as recorded"], 3, motion="random-walk", sensor=True)
    run = execute(task, folder, done)
    assert "odometry" not in trajectory(run) and run.figures["motion"] == "random-walk"
    assert run.figures["depth_absrel"] < 0.01


def test_room_that_cannot_be_searched_is_refused_without_a_start(
    split: Split, bundle: Task, folder: Path, room: Bundle
) -> None:
    blind = replace(room, settings=room.settings.model_copy(update={"without": ("relocalization",)}))
    (folder / "blind").mkdir()
    write_bundle(folder / "blind" / "room.monoloc", blind)
    task = tasks.run(bundle, split.recordings["as recorded"], 0, start_is_known=False)
    needed = {bundle.key: Result(folder / "blind", {})}
    with pytest.raises(DataError, match="is flown without a start, and neither scans"):
        execute(task, folder, needed)


def test_simulated_gravity_has_a_constant_and_a_new_error(recording: RoomRecording, room: Bundle) -> None:
    assert recording.poses is not None and room.down is not None
    measured = work_runs._simulated_down(room, recording, 0)
    true = room.down @ recording.poses[:, :3, :3]
    errors = np.rad2deg(np.arccos(np.clip(np.sum(measured * true, axis=1), -1.0, 1.0)))
    assert 0.1 < np.median(errors) < 2.0
    assert np.abs(np.diff(measured - true, axis=0)).max() < np.deg2rad(3.0)
    np.testing.assert_array_equal(measured, work_runs._simulated_down(room, recording, 0))


def test_room_without_gravity_is_refused(recording: RoomRecording, room: Bundle) -> None:
    floating = replace(room, original=make_mixture(20))
    with pytest.raises(DataError, match="does not show which way is down; give one with a floor or a ceiling"):
        work_runs._simulated_down(floating, recording, 0)


def test_depth_compares_every_stride_th_frame(
    split: Split, bundle: Task, folder: Path, done: dict[str, Result]
) -> None:
    depth = execute(tasks.depth(bundle, split.recordings["as recorded"], stride=4, shown=(1, 4)), folder, done)
    per_frame = depth.figures["per_frame"]
    assert per_frame["index"] == [0, 4] and depth.figures["frames"] == 2
    for name in ("absrel", "delta1", "ssim"):
        assert depth.figures[name] == pytest.approx(np.mean(per_frame[name]))
    with np.load(depth.folder / "depth.npz") as pictures:
        assert pictures["index"].tolist() == [1, 4] and pictures["color"].shape == (2, 128, 160, 3)
        predicted, truth = pictures["predicted"][1], pictures["truth"][1]
        valid = truth > 0.0
        absrel = np.mean(np.abs(predicted[valid] - truth[valid]) / truth[valid])
        assert per_frame["absrel"][1] == pytest.approx(absrel, rel=1e-5)


def test_light_is_simulated_after_build_frames_are_recognised(
    study: Study, split: Split, folder: Path, done: dict[str, Result]
) -> None:
    dark, bright = (
        execute(tasks.depth(NETWORK, split.recordings[light], stride=8, shown=(0,)), folder, done)
        for light in ("L3", "as recorded")
    )
    colours = []
    for result in (dark, bright):
        with np.load(result.folder / "depth.npz") as pictures:
            colours.append(pictures["color"][0])
    assert colours[0].mean() < 0.5 * colours[1].mean()
    keypoints = execute(tasks.keypoints_run(study, split, split.recordings["L3"], "orb"), folder, done)
    np.testing.assert_array_equal(trajectory(keypoints)["unseen"], np.arange(8) % 4 != 0)
    assert keypoints.figures["map_bytes"] > 0


def test_recording_without_depth_is_refused(folder: Path, tmp_path: Path) -> None:
    recording = write_room(tmp_path / "bare", 2)
    description = tmp_path / "bare" / "dataset.toml"
    lines = [line for line in description.read_text().splitlines() if not line.startswith("depth")]
    description.write_text("\n".join(lines))
    task = tasks.depth(NETWORK, EvalRecording(f"folder:{tmp_path / 'bare'}", "::", None))
    assert fingerprint(recording.color(0)) in task.settings["evaluation"]["images"]
    with pytest.raises(DataError, match="has no depth; give a recording whose depth can be compared"):
        execute(task, tmp_path, {})


def test_clouds_of_equal_maps_have_no_distance(bundle: Task, folder: Path, done: dict[str, Result]) -> None:
    clouds = execute(tasks.clouds(bundle), folder, done)
    assert clouds.figures["c2c_max_m"] < 1e-8  # rounding
    with np.load(clouds.folder / "clouds.npz") as arrays:
        assert arrays["original"].shape == arrays["adapted"].shape == (50_000, 3)
        np.testing.assert_allclose(arrays["distances_m"], 0.0, atol=1e-8)
        assert np.linalg.norm(arrays["down_world"]) == pytest.approx(1.0)
