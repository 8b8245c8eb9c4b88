"""Readers on the real recordings: counts, poses, depth, and depth registered to colour."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc import geometry
from monoloc.camera import Camera
from monoloc.geometry import FloatArray
from monoloc.io import seven_scenes
from monoloc.io.images import read_depth
from monoloc.io.registry import open_recording
from monoloc.io.rgbd_scenes_v2 import read_pose_file
from synthetic_recordings import check_recording

pytestmark = pytest.mark.data


def test_redkitchen_is_continuous_and_has_depth(data_root: Path) -> None:
    recording = open_recording(f"7scenes:{data_root}/7scenes/redkitchen")
    check_recording(recording, 400)
    assert recording.timestamps_s[-1] == pytest.approx(798 / 30)
    # The camera was carried: no step beyond 10 cm at 15 Hz.
    assert np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1).max() < 0.1
    depth_m = recording.depth(200)
    assert 0.6 < (depth_m > 0).mean() < 0.9
    assert 0.8 < np.median(depth_m[depth_m > 0]) < 4.0


def depth_edges(depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels on the near side of depth steps beyond 10 %, away from the image border."""
    edges = np.zeros(depth_m.shape, dtype=bool)
    for axis in (0, 1):
        first = depth_m[:-1] if axis == 0 else depth_m[:, :-1]
        second = depth_m[1:] if axis == 0 else depth_m[:, 1:]
        step = (first > 0) & (second > 0) & (np.abs(first - second) > 0.1 * np.minimum(first, second))
        edges_first = edges[:-1] if axis == 0 else edges[:, :-1]
        edges_second = edges[1:] if axis == 0 else edges[:, 1:]
        edges_first |= step & (first < second)
        edges_second |= step & (second < first)
    edges[:12] = edges[-12:] = edges[:, :12] = edges[:, -12:] = False
    return edges


def test_registration_brings_depth_edges_to_colour_edges(data_root: Path) -> None:
    source = f"7scenes:{data_root}/7scenes/redkitchen"
    recording = open_recording(source)
    distances_px: dict[str, list[FloatArray]] = {"before": [], "after": []}
    for index in range(0, 400, 80):
        grey = cv2.GaussianBlur(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2GRAY), (0, 0), 1.5)
        to_color_edge = cv2.distanceTransform(255 - cv2.Canny(grey, 30, 90), cv2.DIST_L2, 3)
        stored = read_depth(recording.depth_paths[index], recording.depth_scale, seven_scenes.DEPTH_CAMERA)
        distances_px["before"].append(to_color_edge[depth_edges(stored)])
        distances_px["after"].append(to_color_edge[depth_edges(recording.depth(index))])
    for before, after in zip(distances_px["before"], distances_px["after"], strict=True):
        assert after.mean() < before.mean()
    before, after = (np.concatenate(distances_px[key]) for key in ("before", "after"))
    assert np.median(after) < 0.7 * np.median(before)  # 2.9 against 5.7 pixels
    assert (after <= 2.0).mean() > 1.3 * (before <= 2.0).mean()


def test_poses_of_rgbd_scenes_v2_are_rigid_and_continuous(data_root: Path) -> None:
    counts = []
    for scene in range(1, 15):
        poses = read_pose_file(data_root / "rgbd-scenes-v2" / "pc" / f"{scene:02d}.pose")
        assert geometry.is_rigid(poses).all()
        np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-12)
        # Recorded at 30 Hz by hand: no step beyond 2 cm or 2 degrees.
        steps = geometry.se3_log(geometry.invert(poses[:-1]) @ poses[1:])
        assert np.linalg.norm(steps[:, :3], axis=1).max() < 0.02
        assert np.degrees(np.linalg.norm(steps[:, 3:], axis=1)).max() < 2.0
        counts.append(len(poses))
    assert sum(counts) == 11427


def test_poses_of_rgbd_scenes_v2_lie_in_their_cloud(data_root: Path) -> None:
    folder = data_root / "rgbd-scenes-v2" / "pc"
    lines = (folder / "03_ascii.ply").read_text().split("end_header\n")[1].splitlines()
    cloud = np.array([line.split()[:3] for line in lines[:20510]], dtype=float)
    poses = read_pose_file(folder / "03.pose")
    # The cameras lie within the cloud's extent, and each sees a good part of it, none of it closer than
    # the sensor can measure.
    assert (poses[:, :3, 3] > cloud.min(axis=0)).all()
    assert (poses[:, :3, 3] < cloud.max(axis=0)).all()
    camera = Camera(640, 480, 570.3, 570.3, 320.0, 240.0)
    for pose in poses[::100]:
        points = geometry.transform(geometry.invert(pose), cloud)
        u, v = camera.project(points).T
        seen = (u > 0) & (u < 640) & (v > 0) & (v < 480)
        assert seen.mean() > 0.15
        assert points[seen, 2].min() > 0.4
        assert 1.5 < np.median(points[seen, 2]) < 3.0


def test_nyu_pairs_have_depth_but_no_poses(data_root: Path) -> None:
    recording = open_recording(str(data_root / "nyu-labelled"))
    check_recording(recording, 1449)
    assert recording.poses is None
    assert recording.camera.width == 304
    depth_m = recording.depth(700)
    assert 0.5 < depth_m[depth_m > 0].min() < depth_m.max() <= 10.0
