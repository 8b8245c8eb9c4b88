"""RGB-D Scenes v2, the source paper's data set: real poses and cloud, rendered, built, localised, reproduced."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cli_helpers import UNTUNED, json_of, succeeds
from monoloc.geometry import transform
from monoloc.io.cloud_files import read_cloud
from monoloc.io.registry import open_recording
from monoloc.io.rgbd_scenes_v2 import CAMERA, read_pose_file
from monoloc.progress import NoProgress
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.engine import carry_out
from monoloc_lab.experiments.study import AS_RECORDED, recorded
from monoloc_lab.make.rgbd_scene import write_scene

pytestmark = [pytest.mark.data, pytest.mark.slow]
NUMBERS = range(0, 96, 4)


@pytest.fixture(scope="module")
def poses_and_clouds(data_root: Path) -> Path:
    folder = data_root / "rgbd-scenes-v2" / "pc"
    if not (folder / "03_ascii.ply").is_file():
        pytest.skip(f"no cloud of RGB-D Scenes v2 in {folder}")
    return folder


@pytest.fixture(scope="module")
def source(poses_and_clouds: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = write_scene(poses_and_clouds, tmp_path_factory.mktemp("rgbd-scenes-v2"), NUMBERS)
    return f"rgbd-scenes-v2:{folder}"


def test_rendered_frames_are_the_scene_s_cloud_at_its_poses(source: str, poses_and_clouds: Path) -> None:
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


def test_build_and_localize_by_sensor_depth(source: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    room = str(tmp_path / "room.monoloc")
    succeeds(capfd, "build", source, "--frames", "::2", *UNTUNED, "--out", room)
    metrics = json_of(capfd, "localize", room, source, "--start", "truth", "--depth", "sensor")
    assert metrics["unseen_frames"] == len(NUMBERS) // 2
    assert metrics["unseen_ate_rmse_m"] < 0.06 and metrics["unseen_rot_median_deg"] < 2.0


def test_reproduction_runs_on_the_extrapolation_split(source: str, tmp_path: Path) -> None:
    """Two of its tasks, by the engine, from a disturbed start."""
    study = recorded(source, "scene_03", len(NUMBERS), quick=True)
    split = study.splits[0]
    bundle = tasks.bundle(study, split, "tiny-0.35", "unadapted")
    run = tasks.run(bundle, split.recordings[AS_RECORDED], seed=0, sensor=True)
    results = carry_out([run], tmp_path, NoProgress(), workers=1)
    assert results[bundle].figures["frames"] == 6
    figures = results[run].figures
    assert figures["frames"] == figures["unseen_frames"] == 6
    assert figures["ate_median_m"] < 0.08
    truth = open_recording(source).poses
    assert truth is not None
    with np.load(results[run].folder / "trajectory.npz") as arrays:
        np.testing.assert_array_equal(arrays["truth"], truth[18:])
        np.testing.assert_allclose(arrays["seconds"], np.arange(6) * 4.0 / 30.0, atol=1e-9)
