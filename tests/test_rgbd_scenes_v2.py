"""RGB-D Scenes v2, the source paper's data set, from its layout on disk to a pose: real poses and cloud, drawn."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from repository import REPOSITORY
from monoloc.cli.main import invoke
from monoloc.geometry import transform
from monoloc.io.cloud_files import read_cloud
from monoloc.io.registry import open_recording
from monoloc.io.rgbd_scenes_v2 import CAMERA, read_pose_file
from monoloc.progress import NoProgress
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.engine import carry_out
from monoloc_lab.experiments.study import recorded

pytestmark = [pytest.mark.data, pytest.mark.slow]
NUMBERS = range(0, 96, 4)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    path = REPOSITORY / "benchmarks" / "make_rgbd_scene.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def poses_and_clouds(data_root: Path) -> Path:
    folder = data_root / "rgbd-scenes-v2" / "pc"
    if not (folder / "03_ascii.ply").is_file():
        pytest.skip(f"no cloud of RGB-D Scenes v2 in {folder}")
    return folder


@pytest.fixture(scope="module")
def source(script: ModuleType, poses_and_clouds: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = script.write_scene(poses_and_clouds, tmp_path_factory.mktemp("rgbd-scenes-v2"), NUMBERS)
    return f"rgbd-scenes-v2:{folder}"


def test_what_the_reader_reads_is_the_scene_s_cloud_at_its_poses(source: str, poses_and_clouds: Path) -> None:
    from scipy.spatial import cKDTree

    recording = open_recording(source)
    assert recording.poses is not None and recording.camera == CAMERA
    np.testing.assert_array_equal(recording.poses, read_pose_file(poses_and_clouds / "03.pose")[list(NUMBERS)])
    cloud = cKDTree(read_cloud(poses_and_clouds / "03_ascii.ply"))
    for index in (0, len(recording) - 1):
        depth = recording.depth(index)
        assert np.mean(depth > 0.0) > 0.7
        points = transform(recording.poses[index], CAMERA.pixel_rays() * depth[..., None])[depth > 0.0]
        # The discs have a radius of 4 cm.
        assert cloud.query(points)[0].max() < 0.042


def test_build_and_localise_by_its_sensor_depth(
    source: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    room = str(tmp_path / "room.monoloc")
    assert invoke(["build", source, "--frames", "::2", "--tune", "none", "--no-map-transform", "--out", room]) == 0
    capfd.readouterr()
    assert invoke(["localize", room, source, "--depth", "sensor", "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["unseen_frames"] == len(NUMBERS) // 2
    assert told["unseen_ate_rmse_m"] < 0.06 and told["unseen_rot_median_deg"] < 2.0


def test_what_reproduce_does_of_it(source: str, tmp_path: Path) -> None:
    """Two of its tasks, by the engine: on the split away from the build frames, from a start that is off."""
    study = recorded(source, "scene_03", len(NUMBERS), quick=True)
    split = study.splits[0]
    bundle = tasks.bundle(study, split, "tiny-0.35", "unadapted")
    run = tasks.run(bundle, split.walks["as taken"], seed=0, sensor=True)
    results = carry_out([run], tmp_path, NoProgress(), workers=1)
    assert results[bundle].figures["frames"] == 6
    figures = results[run].figures
    assert figures["frames"] == figures["unseen_frames"] == 6
    assert figures["ate_median_m"] < 0.08
    with np.load(results[run].folder / "way.npz") as way:
        np.testing.assert_array_equal(way["truth"], open_recording(source).poses[18:])  # type: ignore[index]
        np.testing.assert_allclose(way["seconds"], np.arange(6) * 4.0 / 30.0, atol=1e-9)
