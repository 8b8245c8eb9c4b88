"""Landmarks of a build: on the room's surfaces, with a bias as large as is measured."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.builder.landmark_evidence import LandmarkEvidence
from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.fusion.bias_model import BiasModel
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import PRIOR_COVARIANCE
from monoloc.progress import NoProgress
from synthetic_room import BLACK, CAMERA, Room, RoomRecording, make_path

BUILD_POSES, FLIGHT_POSES = make_path(60)[::2], make_path(60, start_s=0.03)  # the same path, half a frame apart


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), BUILD_POSES)


@pytest.fixture(scope="module")
def built(recording: RoomRecording) -> tuple[Landmarks, BiasModel, LandmarkEvidence]:
    return build_landmarks(recording, recording.depth, NoProgress())


def noisy(poses: FloatArray) -> FloatArray:
    rng = np.random.default_rng(1)
    return np.asarray(poses @ se3_exp(rng.normal(size=(len(poses), 6)) * np.repeat([0.01, 0.005], 3)))


def test_landmarks_lie_on_surfaces(built: tuple[Landmarks, BiasModel, LandmarkEvidence]) -> None:
    landmarks, _, _ = built
    assert len(landmarks) > 300
    assert np.percentile(Room().distance_m(landmarks.points), 90.0) < 0.01


def test_errors_of_another_flight_are_as_measured(built: tuple[Landmarks, BiasModel, LandmarkEvidence]) -> None:
    """On the same path no larger: squared, in units of the covariance, their mean is six at most.

    Corners of a room that is drawn without noise are localised to less than a pixel.
    """
    landmarks, bias, _ = built
    localizer = OrbLandmarkLocalizer(landmarks, CAMERA)
    rng, squares = np.random.default_rng(0), []
    for pose in FLIGHT_POSES[::5]:
        prior = pose @ se3_exp(np.sqrt(np.diag(PRIOR_COVARIANCE)) * rng.standard_normal(6))
        found = localizer.measure(localizer.detect(Room().view(pose)[0]), prior, PRIOR_COVARIANCE).pose
        assert found is not None
        error = se3_log(invert(found.pose) @ pose)
        squares.append(error @ np.linalg.solve(found.covariance + np.diag(bias.sds(0.0) ** 2), error))
    assert 0.4 < np.mean(squares) < 6.0
    assert bias.sd_at_reference_m < 0.005 and bias.sd_at_reference_rad < 0.003
    assert bias.sd_growth_m > 0.0 and bias.sd_growth_rad > 0.0 and bias.relocalization_sd_m == 0.0


def test_number_of_landmarks_tells_right_poses_from_wrong_ones(
    built: tuple[Landmarks, BiasModel, LandmarkEvidence],
) -> None:
    """Walls that are drawn without noise show most of theirs everywhere near the path, and hardly any elsewhere."""
    evidence = built[2]
    (many_right, many_wrong), (few_right, few_wrong) = (evidence.landmarks.likelihoods(count) for count in (100, 2))
    assert many_right > 10.0 * many_wrong and few_wrong > 10.0 * few_right
    assert 0.0 < evidence.unseen_share < 0.5


def test_focal_length_of_a_build_is_that_of_its_camera(
    built: tuple[Landmarks, BiasModel, LandmarkEvidence],
) -> None:
    assert abs(built[2].focal_mean) < 0.02 and 0.005 <= built[2].focal_sd < 0.02


@pytest.mark.slow
def test_errors_of_build_poses_widen_the_bias(
    built: tuple[Landmarks, BiasModel, LandmarkEvidence], recording: RoomRecording
) -> None:
    """Poses of another system: the bias is measured against them, and so is at least as large as their errors."""
    with_errors = RoomRecording.__new__(RoomRecording)
    with_errors.__dict__.update(recording.__dict__, poses=noisy(BUILD_POSES))
    landmarks, bias, _ = build_landmarks(with_errors, with_errors.depth, NoProgress())
    assert len(landmarks) > 100
    assert 2.0 * built[1].sd_at_reference_m < bias.sd_at_reference_m < 0.03
    assert 0.002 < bias.sd_at_reference_rad < 0.015


def test_black_frames_have_no_landmarks() -> None:
    recording = RoomRecording(Room(), make_path(6))
    recording._views = [(BLACK, depth) for _, depth in recording._views]
    landmarks, bias, evidence = build_landmarks(recording, recording.depth, NoProgress())
    assert len(landmarks) == 0 and bias.sd_at_reference_m == 0.0 and evidence == LandmarkEvidence()


def test_frames_without_depth_have_no_landmarks() -> None:
    recording = RoomRecording(Room(), make_path(6))
    landmarks, _, _ = build_landmarks(recording, lambda index: np.zeros_like(recording.depth(index)), NoProgress())
    assert len(landmarks) == 0


def test_some_of_many_frames_are_used(
    recording: RoomRecording, built: tuple[Landmarks, BiasModel, LandmarkEvidence], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monoloc.builder.landmark_mapping._MOST_FRAMES", 12)
    landmarks, bias, _ = build_landmarks(recording, recording.depth, NoProgress())
    assert 100 < len(landmarks) < len(built[0]) and bias.sd_at_reference_m < 0.01


def test_hovering_camera_has_a_bias_above_zero() -> None:
    hovering = RoomRecording(Room(), np.repeat(make_path(1), 6, axis=0))
    _, bias, evidence = build_landmarks(hovering, hovering.depth, NoProgress())
    assert bias.sd_at_reference_m > 3e-4 and bias.sd_at_reference_rad > 1e-4
    assert evidence == LandmarkEvidence()  # there is no wrong pose to compare with
