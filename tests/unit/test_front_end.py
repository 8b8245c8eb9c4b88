"""Observations of frames, before anything is known of the pose."""

from __future__ import annotations

import threading
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.components import Components
from monoloc.depth.predictor import DepthPrediction
from monoloc.front_end import FrontEnd
from monoloc.geometry import FloatArray, se3_exp, so3_exp
from monoloc.landmarks.pnp import LandmarkLocalizer, NoLandmarks
from monoloc.likelihood.scan import scan_from_corners, scan_from_depth
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.motion import Motion
from monoloc.odometry.scale_tilt import ScaleTiltConfig, correct_scale_and_tilt
from monoloc.odometry.standing_pixels import StandingPixels
from monoloc.second_thread import SecondThread
from monoloc.step_budget import StepPlan

CAMERA = Camera(80, 64, 70.0, 70.0, 39.5, 31.5)
DEPTH_CAMERA = CAMERA.resized(40, 32)
CONFIG = LocalizerConfig(scan_points=50, scale_tilt=None)
COLOR = np.random.default_rng(0).integers(0, 256, (4, 5, 3), dtype=np.uint8).repeat(16, axis=0).repeat(16, axis=1)
NEXT = np.roll(COLOR, 1, axis=1)  # of a camera that moved
BLACK = np.zeros_like(COLOR)
PREDICTED = DepthPrediction(
    np.full((32, 40), 2.0, np.float32), DEPTH_CAMERA, np.linspace(-3.0, 0.0, 1280, dtype=np.float32).reshape(32, 40)
)
MEASURED = DepthPrediction(np.full((32, 40), 3.0, np.float32), DEPTH_CAMERA)


def corners_of(depth: DepthPrediction, tilt: float) -> Motion:
    """A motion whose corners see the depth with a tilt."""
    rays = depth.camera.pixel_rays()[4:-4:6, 4:-4:6].reshape(-1, 3)
    points = 2.0 * np.exp(tilt * rays[:, :1]) * rays
    log_depth_sd = np.where(np.arange(len(points)) % 5 == 0, 0.3, 0.02)
    return Motion(se3_exp([0.1, 0.0, 0.0, 0.0, 0.02, 0.0]), len(points), points, log_depth_sd)


class _Depth:
    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction:
        self.calls += 1
        return PREDICTED


class _Landmarks(NoLandmarks):
    """Notes the thread of every detection."""

    def __init__(self) -> None:
        self.threads: list[int] = []

    def detect(self, color: NDArray[np.uint8]) -> None:
        self.threads.append(threading.get_ident())


class _Odometry:
    """Has one motion after another, and None thereafter."""

    def __init__(self, *motions: Motion | None) -> None:
        self._motions = list(motions)
        self.calls = 0
        self.rotations: list[FloatArray | None] = []

    def step(
        self,
        color: NDArray[np.uint8],
        depth_m: NDArray[np.float32],
        depth_camera: Camera,
        R_previous_current: FloatArray | None = None,
    ) -> Motion | None:
        self.calls += 1
        self.rotations.append(R_previous_current)
        return self._motions.pop(0) if self._motions else None


def make_front_end(
    odometry: _Odometry | None = None,
    config: LocalizerConfig = CONFIG,
    depth: _Depth | None = None,
    landmarks: LandmarkLocalizer[Any] | None = None,
) -> FrontEnd:
    components = Components(depth or _Depth(), odometry, likelihood=None, landmarks=landmarks or NoLandmarks())
    second_thread = SecondThread(config.threads == 2)
    return FrontEnd(components, CAMERA, config, np.random.default_rng(0), second_thread, StandingPixels(CAMERA))


def test_first_frame_has_no_elapsed_time_and_counts_as_tracked() -> None:
    front_end = make_front_end(_Odometry())
    first = front_end.observe(COLOR, -5.0, None, None)
    assert first.is_first and first.elapsed_s == 0.0 and first.motion is None and first.odometry_tracked
    second = front_end.observe(COLOR, 0.1, None, None)
    assert not second.is_first and second.elapsed_s == 0.1 and not second.odometry_tracked


def test_odometry_tracks_where_it_has_a_motion_and_a_random_walk_always_does() -> None:
    motion = corners_of(PREDICTED, 0.0)
    with_odometry, random_walk = make_front_end(_Odometry(None, motion, None)), make_front_end(None)
    observed = [
        [front_end.observe(color, 0.1, None, None) for color in (COLOR, NEXT, COLOR)]
        for front_end in (with_odometry, random_walk)
    ]
    assert [each.motion for each in observed[0]] == [None, motion, None]
    assert [each.odometry_tracked for each in observed[0]] == [True, True, False]
    assert all(each.odometry_tracked and each.motion is None for each in observed[1])


def test_scan_is_of_the_depth_weighted_by_stated_errors() -> None:
    observation = make_front_end().observe(COLOR, 0.0, None, None)
    expected = scan_from_depth(PREDICTED, 50, np.random.default_rng(0), CONFIG.likelihood.error_power)
    np.testing.assert_array_equal(observation.scan.points, expected.points)
    np.testing.assert_array_equal(observation.scan.weights, expected.weights)
    assert np.ptp(observation.scan.weights) > 0.5


def test_corners_are_those_of_the_motion_that_are_certain_enough() -> None:
    motion = corners_of(PREDICTED, 0.0)
    front_end = make_front_end(_Odometry(None, motion))
    assert len(front_end.observe(COLOR, 0.0, None, None).corners) == 0
    corners = front_end.observe(NEXT, 0.1, None, None).corners
    expected = scan_from_corners(motion, CONFIG.likelihood.max_corner_log_depth_sd)
    assert 0 < len(corners) < len(motion.points)
    np.testing.assert_array_equal(corners.points, expected.points)


def test_depth_is_corrected_before_the_scan_is_taken() -> None:
    motion, scale_tilt = corners_of(PREDICTED, 0.3), ScaleTiltConfig(tilt_sd=0.15)
    front_end = make_front_end(_Odometry(None, motion), CONFIG.model_copy(update={"scale_tilt": scale_tilt}))
    assert front_end.observe(COLOR, 0.0, None, None).depth is PREDICTED  # there is no motion yet
    observation = front_end.observe(NEXT, 0.1, None, None)
    expected = correct_scale_and_tilt(PREDICTED, motion, scale_tilt)
    assert np.ptp(expected.depth_m) > 0.2
    np.testing.assert_array_equal(observation.depth.depth_m, expected.depth_m)
    columns, rows = np.rint(DEPTH_CAMERA.project(observation.scan.points.astype(np.float64))).astype(int).T
    np.testing.assert_allclose(observation.scan.points[:, 2], expected.depth_m[rows, columns], rtol=1e-5)
    # Without the setting, the depth stays.
    uncorrected = make_front_end(_Odometry(motion)).observe(COLOR, 0.0, None, None)
    assert uncorrected.depth is PREDICTED


def test_measured_depth_replaces_the_networks() -> None:
    depth = _Depth()
    observation = make_front_end(depth=depth).observe(COLOR, 0.0, MEASURED, None)
    assert observation.depth is MEASURED and depth.calls == 0 and np.all(observation.scan.points[:, 2] == 3.0)


def test_image_without_contrast_gives_an_empty_scan_of_predicted_depth_only() -> None:
    front_end = make_front_end()
    dark = front_end.observe(BLACK, 0.0, None, None)
    assert len(dark.scan) == 0 and dark.is_empty
    measured = front_end.observe(BLACK + 1, 0.1, MEASURED, None)
    assert len(measured.scan) == 50 and measured.is_empty and not measured.image_is_new
    bright = front_end.observe(COLOR, 0.1, None, None)
    assert len(bright.scan) == 50 and not bright.is_empty and bright.image_is_new


@pytest.mark.parametrize("depth", [None, MEASURED])
def test_repeated_image_gives_neither_motion_nor_scan(depth: DepthPrediction | None) -> None:
    """Bit for bit: one level of one pixel makes another image. Odometry goes on from the last new one."""
    motion = corners_of(PREDICTED, 0.0)
    odometry = _Odometry(None, motion, motion)
    front_end = make_front_end(odometry)
    almost = COLOR.copy()
    almost[5, 7, 1] ^= 1
    new = [front_end.observe(color, 0.1, depth, None) for color in (COLOR, almost)]
    assert [observation.repeated_s for observation in new] == [0.0, 0.0] and new[1].motion is motion
    repeated = [front_end.observe(almost.copy(), elapsed_s, depth, None) for elapsed_s in (0.1, 0.25)]
    assert [observation.repeated_s for observation in repeated] == pytest.approx([0.1, 0.35])
    assert odometry.calls == 2
    for observation in repeated:
        assert observation.motion is None and not observation.odometry_tracked
        assert len(observation.scan) == len(observation.corners) == 0
    assert [(observation.waits, observation.motion_s) for observation in repeated] == [(True, 0.1), (True, 0.25)]
    moved = front_end.observe(COLOR, 0.1, depth, None)
    assert moved.repeated_s == 0.0 and moved.motion is motion and len(moved.scan) == 50
    assert not moved.waits and moved.motion_s == pytest.approx(0.45) and moved.elapsed_s == 0.1
    at_once = front_end.observe(COLOR, 0.0, depth, None)  # as streams do that give an image twice with one time stamp
    assert at_once.repeated_s == 0.0 and at_once.is_repeated and not at_once.image_is_new
    assert front_end.observe(COLOR, 0.1, depth, None).repeated_s == pytest.approx(0.1)


@pytest.mark.parametrize("threads", [1, 2])
def test_landmarks_are_detected_once_and_beside_the_odometry_with_a_second_thread(threads: int) -> None:
    landmarks, here = _Landmarks(), threading.get_ident()
    front_end = make_front_end(config=CONFIG.model_copy(update={"threads": threads}), landmarks=landmarks)
    observation = front_end.observe(COLOR, 0.1, None, None)
    for _ in range(2):
        observation.landmarks_seen()
    assert len(landmarks.threads) == 1 and (landmarks.threads[0] == here) is (threads == 1)
    # Not in a repeated image, nor where it is not their turn, unless a search asks for them.
    front_end.observe(COLOR, 0.1, None, None)
    observation = front_end.observe(NEXT, 0.1, None, None, plan=StepPlan(100, 50, has_landmarks=False))
    assert len(landmarks.threads) == 1
    observation.landmarks_seen()
    assert len(landmarks.threads) == 2


def test_an_image_that_could_not_be_read_is_refused() -> None:
    """OpenCV returns None for a file that it cannot read."""
    with pytest.raises(ValueError, match=r"color must have the camera's shape .* got \(\) NoneType"):
        make_front_end(_Odometry()).observe(None, 0.0, None, None)  # type: ignore[arg-type]


def test_the_time_that_images_repeated_before_a_reset_does_not_count_after_it() -> None:
    front_end = make_front_end()
    repeated = [front_end.observe(COLOR, 0.1, None, None) for _ in range(2)]
    front_end.reset()
    assert repeated[-1].waits and front_end.observe(NEXT, 0.1, None, None).motion_s == 0.0


def test_odometrys_motion_since_before_a_reset_is_none() -> None:
    """The first frame after it may be of another place, and odometry still knows the last one before it."""
    motion = corners_of(PREDICTED, 0.0)
    front_end = make_front_end(_Odometry(None, motion, motion))
    front_end.observe(COLOR, 0.1, None, None)
    front_end.reset()
    first = front_end.observe(NEXT, 0.1, None, None)
    assert first.motion is None and len(first.corners) == 0
    assert front_end.observe(COLOR, 0.1, None, None).motion is motion


def test_image_that_its_owner_overwrites_is_not_a_repeated_one() -> None:
    """A camera driver that gives the same buffer with every frame."""
    front_end, buffer = make_front_end(), COLOR.copy()
    front_end.observe(buffer, 0.0, None, None)
    buffer[:] = NEXT
    assert front_end.observe(buffer, 0.1, None, None).repeated_s == 0.0


@pytest.mark.parametrize(("pixels", "enough"), [(0, False), (9, False), (10, True)])
def test_scan_has_enough_points_to_constrain_the_pose(pixels: int, enough: bool) -> None:
    depth_m = np.zeros((32, 40), np.float32)
    depth_m[0, :pixels] = 2.0
    observation = make_front_end().observe(COLOR, 0.0, DepthPrediction(depth_m, DEPTH_CAMERA), None)
    assert len(observation.scan) == pixels and observation.scan_has_enough_points == enough


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((128, 128, 3), "uint8"), ((64, 80), "uint8"), ((64, 80, 4), "uint8"), ((64, 80, 3), "float32")],
)
def test_image_of_wrong_size_or_type_is_refused(shape: tuple[int, ...], dtype: str) -> None:
    depth, odometry = _Depth(), _Odometry()
    front_end = make_front_end(odometry, depth=depth)
    with pytest.raises(ValueError, match=r"color must have the camera's shape \(64, 80, 3\) as uint8, got"):
        front_end.observe(np.zeros(shape, dtype=dtype), 0.0, None, None)
    assert depth.calls == odometry.calls == 0
    assert front_end.observe(COLOR, 0.0, None, None).is_first


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (np.eye(4), "odometry must be a Motion or None, got ndarray"),
        (Motion(2.0 * np.eye(4)), "odometry must have a rigid T_previous_current"),
        (Motion(np.eye(4)[:3]), "odometry must have a rigid T_previous_current"),
        (Motion(np.eye(4), view_covariance=np.full((6, 6), np.nan)), "odometry must have a finite, symmetric"),
        (Motion(np.eye(4), view_covariance=np.diag([1.0, 1, 1, 1, 1, -1])), "positive semidefinite view_covariance"),
        (
            Motion(np.eye(4), points=np.ones((4, 3))),
            r"points \(N, 3\) and log_depth_sd \(N,\), got \(4, 3\) and \(0,\)",
        ),
        (Motion(np.eye(4), translation=cast(Any, "metres")), "'metres'; it must be scaled, metric or unknown"),
    ],
)
def test_what_is_no_motion_of_odometry_is_refused(motion: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        make_front_end(_Odometry(motion)).observe(COLOR, 0.0, None, None)


def test_the_motion_of_an_odometry_that_rounds_becomes_exactly_rigid() -> None:
    """A flight chains thousands of motions: with the rounding of each, its poses would be rigid no longer."""
    rounded = se3_exp([0.1, 0.0, 0.2, 0.0, 0.3, 0.1]).round(4)
    front_end = make_front_end(_Odometry(None, Motion(rounded, inliers=7)))
    front_end.observe(COLOR, 0.0, None, None)
    motion = front_end.observe(NEXT, 0.1, None, None).motion
    assert motion is not None and motion.inliers == 7
    rotation = motion.T_previous_current[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(motion.T_previous_current, rounded, atol=1e-4)


def test_an_array_in_place_of_depth_or_motion_is_refused() -> None:
    array: Any = np.ones((32, 40), np.float32)
    depth = _Depth()
    front_end = make_front_end(None, depth=depth)
    with pytest.raises(TypeError, match=r"measured_depth must be a DepthPrediction, got ndarray; .*sparse_depth"):
        front_end.observe(COLOR, 0.0, array, None)
    with pytest.raises(TypeError, match="measured_motion must be a Motion or None, got ndarray"):
        front_end.observe(COLOR, 0.0, None, None, array)
    assert depth.calls == 0 and front_end.observe(COLOR, 0.0, None, None).is_first
    with pytest.raises(TypeError, match=r"the result of Components.depth must be a DepthPrediction, got ndarray"):
        make_front_end(None, depth=lambda color: array).observe(COLOR, 0.0, None, None)


@pytest.mark.parametrize("elapsed_s", [-0.01, np.nan, np.inf, 1.01e12])
def test_time_that_runs_backwards_or_jumps_beyond_all_clocks_is_refused(elapsed_s: float) -> None:
    depth, odometry = _Depth(), _Odometry()
    front_end = make_front_end(odometry, depth=depth)
    front_end.observe(COLOR, 0.0, None, None)
    with pytest.raises(ValueError, match=r"elapsed_s must be a number from 0 to 1e\+12, got"):
        front_end.observe(COLOR, elapsed_s, None, None)
    assert depth.calls == odometry.calls == 1


# --- Motion by another sensor ---


TURN = Motion.rotation(so3_exp([0.0, 0.2, 0.0]), 0.01)
PRECISE = Motion.metric(se3_exp([0.1, 0.0, 0.0, 0.0, 0.02, 0.0]), 0.001, 0.001)
VAGUE = Motion.metric(se3_exp([0.1, 0.0, 0.0, 0.0, 0.02, 0.0]), 0.5, 0.001)


def test_odometry_is_told_the_rotation_since_the_previous_new_image() -> None:
    """The image repeats once, so that the next motion is over two intervals."""
    odometry = _Odometry(None, None, None)
    front_end = make_front_end(odometry)
    for color in (COLOR, COLOR.copy(), NEXT):
        observation = front_end.observe(color, 0.1, None, None, TURN)
    assert odometry.rotations[0] is None and len(odometry.rotations) == 2
    np.testing.assert_allclose(odometry.rotations[1], so3_exp([0.0, 0.4, 0.0]))
    assert observation.motion is not None and observation.motion.translation == "unknown"
    # If one interval is not known, the whole is not.
    for color, motion in ((NEXT.copy(), None), (COLOR, TURN)):
        observation = front_end.observe(color, 0.1, None, None, motion)
    assert observation.motion is None and odometry.rotations[-1] is None


def test_the_motion_while_an_image_repeats_is_kept_as_one() -> None:
    """A camera may freeze for minutes; the first new image must not wait for thousands of motions."""
    front_end = make_front_end(_Odometry(None, None))
    for _ in range(50):
        front_end.observe(COLOR, 0.1, None, None, TURN)
    assert len(front_end._measured) == 1


def test_rotation_alone_stands_in_for_odometry_but_does_not_track() -> None:
    front_end = make_front_end(_Odometry(None, corners_of(PREDICTED, 0.0)))
    assert front_end.observe(COLOR, 0.1, None, None, TURN).motion is None  # the first frame
    with_odometry = front_end.observe(NEXT, 0.1, None, None, TURN)
    assert with_odometry.motion is not None and with_odometry.motion.translation == "scaled"
    without = front_end.observe(COLOR, 0.1, None, None, TURN)
    assert without.motion is TURN and not without.odometry_tracked and len(without.corners) == 0
    assert make_front_end(None).observe(COLOR, 0.1, None, None, TURN).odometry_tracked


@pytest.mark.parametrize("measured", [PRECISE, VAGUE])
def test_the_motion_with_less_noise_counts_and_the_corners_remain(measured: Motion) -> None:
    visual = corners_of(PREDICTED, 0.0)
    front_end = make_front_end(_Odometry(None, visual))
    front_end.observe(COLOR, 0.1, None, None)
    motion = front_end.observe(NEXT, 0.1, None, None, measured).motion
    assert motion is not None and motion.points is visual.points
    assert motion.translation == ("metric" if measured is PRECISE else "scaled")
    alone = front_end.observe(COLOR, 0.1, None, None, measured)
    assert alone.motion is measured and alone.odometry_tracked


def test_motion_without_its_noise_is_refused_and_changes_nothing() -> None:
    odometry = _Odometry(None)
    front_end = make_front_end(odometry)
    with pytest.raises(ValueError, match="measured_motion must state its noise"):
        front_end.observe(COLOR, 0.1, None, None, Motion(np.eye(4)))
    assert odometry.calls == 0 and front_end.observe(COLOR, 0.1, None, None).is_first


def test_an_image_that_shows_nothing_of_a_measured_turn_counts_as_repeated() -> None:
    """A stream that froze under a clock: no image is the one before, and odometry finds the camera at rest."""
    turned = Motion.rotation(so3_exp([0.0, 0.03, 0.0]), 0.003)
    at_rest = Motion(np.eye(4), 50, np.tile([[0.0, 0.0, 2.0]], (50, 1)), np.full(50, 0.02))
    front_end = make_front_end(_Odometry(*[at_rest] * 12))
    for index in range(12):
        image = COLOR.copy()
        image[0, 0] = index
        seen = front_end.observe(image, 0.1, None, None, turned)
        if index < 3:  # the first motion is that of the second frame
            assert not seen.is_repeated and len(seen.scan) > 0
    assert seen.is_repeated and not seen.waits and not seen.image_is_new and len(seen.scan) == 0
    assert seen.repeated_s > 0.5 and seen.motion is turned and not seen.odometry_tracked
    front_end.reset()
    assert not front_end.observe(image, 0.1, None, None, turned).repeated_s > 0.5
