"""A depth sensor in place of the network."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.map.mixture import GaussianMixture
from monoloc.sensor_depth import sensor_bundle, sensor_settings, sparse_depth
from monoloc.supervision.integrity import Classes, SensorModel
from synthetic_room import CAMERA, SETTINGS, RoomRecording, make_bundle

FRAMES = 3


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        replace(CAMERA, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0)),
        replace(CAMERA, distortion=(), distortion_model="fisheye"),
        replace(CAMERA, cx=-0.4, cy=-0.4),
        CAMERA.cropped(200, 140, 120, 116),
    ],
    ids=["pinhole", "brown", "fisheye", "centre at the corner", "centre outside"],
)
def test_sparse_pixels_see_what_the_image_sees_there(camera: Camera) -> None:
    """Not averaged: every pixel that is kept has its own depth, along its own ray."""
    depth_m = np.random.default_rng(0).uniform(1.0, 4.0, (camera.height, camera.width)).astype(np.float32)
    sparse = sparse_depth(depth_m, camera)
    assert (
        sparse.depth_m.shape == (camera.height // 4, camera.width // 4) == (sparse.camera.height, sparse.camera.width)
    )
    np.testing.assert_array_equal(sparse.depth_m, depth_m[2::4, 2::4])
    np.testing.assert_allclose(sparse.camera.pixel_rays(), camera.pixel_rays()[2::4, 2::4], atol=1e-6)


def test_millimetres_as_a_sensors_driver_gives_them_are_refused() -> None:
    depth_mm = np.full((CAMERA.height, CAMERA.width), 1500, dtype=np.uint16)
    with pytest.raises(ValueError, match=r"^depth_m must be float32, metres, got uint16; divide millimetres by"):
        sparse_depth(cast(Any, depth_mm), CAMERA)


def test_sensors_errors_are_small_and_everything_else_stays() -> None:
    settings = sensor_settings(SETTINGS.model_copy(update={"particles": 123, "motion": "random-walk"}))
    assert settings.particles == 123 and settings.motion == "random-walk"
    assert settings.landmark_bias == SETTINGS.landmark_bias
    assert settings.log_scale_sd == 0.01 and settings.scale_tilt is None
    assert settings.likelihood.kind == "volume" and settings.particle_bias.sd_at_reference_m == 0.015


def test_what_the_build_measured_of_the_sensor_replaces_what_it_measured_of_the_network(
    mixture: GaussianMixture, recording: RoomRecording
) -> None:
    sensor = SensorModel(
        thresholds=LikelihoodThresholds(low=3.0, lost=2.0),
        scan=Classes(edges=(2.5,), right=(0.1, 0.9), wrong=(0.9, 0.1)),
        search_precision=0.8,
    )
    bias = 0.1 * np.ones((FRAMES, 6))
    bundle = make_bundle(mixture, recording)
    bundle = replace(bundle, sensor=sensor, reference_poses=ReferencePoses(recording.poses, bias, bias))
    by_sensor = sensor_bundle(bundle)
    assert by_sensor.thresholds == sensor.thresholds and by_sensor.settings == sensor_settings(bundle.settings)
    assert by_sensor.integrity == bundle.integrity.model_copy(
        update={"scan": sensor.scan, "scan_search_precision": 0.8}
    )
    assert by_sensor.integrity.landmarks == bundle.integrity.landmarks != Classes()
    # The networks' bias is not the sensor's.
    known = by_sensor.reference_poses
    np.testing.assert_array_equal(known.poses, recording.poses)
    np.testing.assert_array_equal(known.bias_at(recording.poses[1], np.ones(6)), 0.0)
    assert by_sensor.adapted is bundle.adapted and by_sensor.landmarks is bundle.landmarks


def test_unmeasured_sensor_says_nothing_of_the_belief(mixture: GaussianMixture, recording: RoomRecording) -> None:
    by_sensor = sensor_bundle(make_bundle(mixture, recording))
    assert by_sensor.thresholds == LikelihoodThresholds.none()
    right, wrong = by_sensor.integrity.scan.likelihoods(-1000.0)
    assert right == wrong
