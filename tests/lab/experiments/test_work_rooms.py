"""Bundles of an experiment, and the same with other maps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monoloc.builder.build_config import BuildConfig
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.depth.models import shipped_models
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.io.recording import Recording
from monoloc.map.mixture import BYTES_PER_COMPONENT
from monoloc_lab.baselines.posenet import PoseNet, posenet_config
from monoloc_lab.experiments import tasks, work_rooms
from monoloc_lab.experiments.gather import trajectory
from monoloc_lab.experiments.study import EvalRecording, Split, Study
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.work_rooms import octree_bytes
from study_helpers import NETWORK, execute, small_study, write_room
from synthetic_room import Room, make_bundle, room_mixture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("work")
    write_room(path / "room")
    return path


@pytest.fixture(scope="module")
def study(folder: Path) -> Study:
    return small_study(folder / "room")


@pytest.fixture(scope="module")
def split(study: Study) -> Split:
    return study.splits[0]


@pytest.fixture(scope="module")
def done() -> dict[str, Result]:
    return {}


@pytest.fixture(scope="module")
def room(folder: Path) -> Bundle:
    return make_bundle(room_mixture(Room(), 50), write_room(folder / "room"))


@dataclass(frozen=True)
class Report:
    frames: int


def test_build_has_the_settings_of_its_task(
    study: Study, split: Split, room: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    builds: list[tuple[int, BuildConfig, int, str]] = []

    def build(recording: Recording, config: BuildConfig, seed: int, _: Any, network: str) -> tuple[Bundle, Report]:
        builds.append((len(recording), config, seed, network))
        return room, Report(len(recording))

    monkeypatch.setattr(work_rooms, "build_bundle", build)
    built = execute(tasks.bundle(study, split, NETWORK, "last+map", seed=2, frames=7), tmp_path, {})
    assert built.figures == {
        "frames": 7,
        "network_bytes": len(room.depth_model.content),
        "map_bytes": 50 * BYTES_PER_COMPONENT,
    }
    ((frames, config, seed, network),) = builds
    assert (frames, seed, network) == (7, 2, NETWORK)
    assert (config.adapt.tune, config.adapt.map_transform, config.adapt.steps) == ("last", True, 4)
    assert read_bundle(built.folder / "room.monoloc").depth_model == room.depth_model


def test_other_maps_have_the_stated_components(
    study: Study, split: Split, room: Bundle, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the measurement of the bias, which the slow test has."""
    bundle = tasks.bundle(study, split, NETWORK, "network")
    (folder / "given").mkdir()
    write_bundle(folder / "given" / "room.monoloc", room)
    done = {bundle.key: Result(folder / "given", {})}
    measured = room.settings.particle_bias.model_copy(update={"sd_at_reference_m": 0.123})
    references = ReferencePoses.without_bias(np.eye(4)[None])
    monkeypatch.setattr(work_rooms, "measure_bias_at_reference", lambda *arguments: (measured, references))
    mixture = execute(tasks.remapped(bundle, "mixture", 25), folder, done)
    assert mixture.figures == {"components": 25, "map_bytes": 1000}
    voxels = execute(tasks.remapped(bundle, "voxels", 0.25), folder, done)
    remapped = read_bundle(voxels.folder / "room.monoloc")
    cells = remapped.adapted
    np.testing.assert_allclose(cells.covariances, np.tile(0.25**2 / 12.0 * np.eye(3), (len(cells), 1, 1)), rtol=1e-5)
    np.testing.assert_allclose((cells.means / 0.25) % 1.0, 0.5, atol=1e-4)
    assert voxels.figures["components"] == len(cells) > 50
    assert remapped.settings.particle_bias.sd_at_reference_m == 0.123 and len(remapped.reference_poses) == 1
    assert remapped.thresholds == room.thresholds
    points = execute(tasks.remapped(bundle, "points", 0.25), folder, done)
    assert points.figures["map_bytes"] == 12 * points.figures["components"]
    coarse = read_bundle(points.folder / "room.monoloc").adapted
    np.testing.assert_allclose(coarse.covariances[0], 0.125**2 * np.eye(3), rtol=1e-5)


def test_bytes_of_an_octree() -> None:
    header = 16
    assert octree_bytes(np.array([[5, -3, 2]])) == header
    # Two neighbours with one parent, and two at opposite corners of a cube of four.
    assert octree_bytes(np.array([[0, 0, 0], [1, 1, 1]])) == header + 1
    assert octree_bytes(np.array([[0, 0, 0], [3, 3, 3]])) == header + 2 + 1
    full = np.stack(np.meshgrid(*[np.arange(8)] * 3), axis=-1).reshape(-1, 3)
    assert octree_bytes(full - 100) == header + 64 + 8 + 1


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_same_map_has_the_same_bias(study: Study, split: Split, folder: Path, done: dict[str, Result]) -> None:
    bundle = tasks.bundle(study, split, NETWORK, "network")
    built = read_bundle(execute(bundle, folder, done).folder / "room.monoloc")
    same = read_bundle(execute(tasks.remapped(bundle, "mixture", 200), folder, done).folder / "room.monoloc")
    # The adapted map has the moments of the cloud under the original one.
    np.testing.assert_allclose(same.adapted.means, built.adapted.means, atol=0.01)
    assert same.depth_model == built.depth_model
    bias, before = same.settings.particle_bias, built.settings.particle_bias
    # Measured in flights that hover at single frames of a network tuned for a few steps, whose ends differ.
    assert 0.5 < bias.sd_at_reference_m / before.sd_at_reference_m < 2.0
    unmeasured = {"sd_at_reference_m": 0.0, "sd_at_reference_rad": 0.0}
    assert bias.model_copy(update=unmeasured) == before.model_copy(update=unmeasured)
    assert same.settings.model_copy(update={"particle_bias": before}) == built.settings


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_posenet_filtered_posenet_and_keypoints(
    study: Study, folder: Path, done: dict[str, Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {"epochs": 2, "learning_rates": (3e-3, 1e-3), "search_epochs": 1, "batch_size": 8}
    monkeypatch.setattr(tasks, "_QUICK_POSENET", short)
    source = f"folder:{folder / 'room'}"
    split = Split("interpolation", source, "0:48:2", {"as recorded": EvalRecording(source, "0:12", None)})
    recording = split.recordings["as recorded"]
    posenet = tasks.posenet(study, split, "tiny", 1, views=True)
    trained = execute(posenet, folder, done)
    trials = trained.figures["trials"]
    best = min(trials, key=lambda trial: trial["position_m"] + trial["rotation_rad"])
    assert len(trials) == 2 and trained.figures["learning_rate"] == best["learning_rate"]
    assert trained.figures["bytes"] == (trained.folder / "posenet.safetensors").stat().st_size
    catalogue = next(model for model in shipped_models() if model.name == NETWORK)
    at_its_size = PoseNet(posenet_config("tiny", 0.35)).multiply_adds(catalogue.input_width, catalogue.input_height)
    assert trained.figures["multiply_adds"] == at_its_size
    bundle = tasks.bundle(replace(study), split, NETWORK, "unadapted")
    runs = [
        execute(tasks.posenet_run(posenet, recording), folder, done),
        execute(tasks.filtered_run(posenet, bundle, recording, 0), folder, done),
        execute(tasks.keypoints_run(study, split, recording, "orb"), folder, done),
    ]
    for run in runs:
        arrays = trajectory(run)
        np.testing.assert_array_equal(arrays["unseen"], np.arange(12) % 2 == 1)
        assert run.figures["frames"] == 12 and run.figures["unseen_frames"] == 6
        assert {"unseen_ate_rmse_m", "unseen_rot_median_deg", "unseen_failed_frames"} <= set(run.figures)
    assert trajectory(runs[0])["poses"].shape == (12, 4, 4) and runs[0].figures["failed_frames"] == 0
