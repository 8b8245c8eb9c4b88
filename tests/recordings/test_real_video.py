"""Structure from motion on the colour images of a real room, against its poses and its depth sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.geometry import nearest_rotation, rotation_angle
from monoloc.io.image_resampling import resize_nearest
from monoloc.io.registry import open_recording, select_frames
from monoloc.structure_from_motion.depth_scale import DepthScale
from monoloc.structure_from_motion.reconstruction import reconstruct

pytestmark = [pytest.mark.data, pytest.mark.slow, pytest.mark.usefixtures("one_thread")]


def test_redkitchen_from_its_colour_images(data_root: Path) -> None:
    recording = select_frames(open_recording(f"7scenes:{data_root / '7scenes' / 'redkitchen'}"), "0:120:4")
    found = reconstruct(recording, DepthScale(), refine_camera=False)
    assert recording.poses is not None
    assert len(found.recording) == found.model.tried
    poses, truth = found.model.poses, recording.poses[found.model.frames]
    R = nearest_rotation(np.einsum("nij,nkj->ik", poses[:, :3, :3], truth[:, :3, :3]))
    turned = np.swapaxes(R @ truth[:, :3, :3], 1, 2) @ poses[:, :3, :3]
    offsets = poses[:, :3, 3] - truth[:, :3, 3] @ R.T
    offsets -= offsets.mean(axis=0)
    assert np.median(np.linalg.norm(offsets, axis=1)) < 0.06  # the given poses are by KinectFusion, which drifts
    assert np.rad2deg(np.median(rotation_angle(turned))) < 2.0
    errors = []
    for depth, index in zip(found.depths, found.model.frames.tolist(), strict=True):
        ours, sensor = resize_nearest(depth, 640, 480), recording.depth(index)
        both = (ours > 0.0) & (sensor > 0.0)
        errors.append(np.abs(ours[both] / sensor[both] - 1.0))
    assert np.median(np.concatenate(errors)) < 0.04
