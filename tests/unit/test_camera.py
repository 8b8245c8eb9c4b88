"""The pinhole camera: properties, and OpenCV as the oracle for distortion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.camera import Camera
from monoloc.errors import SettingError

TUM_FREIBURG1 = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))

# Lenses whose distortion is invertible over the whole image (it folds where the radius stops growing).
coefficients = st.tuples(
    st.floats(-0.1, 0.1),
    st.floats(-0.01, 0.01),
    st.floats(-0.005, 0.005),
    st.floats(-0.005, 0.005),
    st.floats(-0.002, 0.002),
)


@st.composite
def cameras(draw: st.DrawFn, distortion: st.SearchStrategy = coefficients) -> Camera:
    width, height = draw(st.integers(16, 1280)), draw(st.integers(16, 960))
    focal = draw(st.floats(0.9, 2.0)) * max(width, height)
    return Camera(
        width,
        height,
        focal,
        focal * draw(st.floats(0.95, 1.05)),
        width * draw(st.floats(0.4, 0.6)),
        height * draw(st.floats(0.4, 0.6)),
        draw(distortion),
    )


def points_in_view(camera: Camera, seed: int, count: int = 30) -> np.ndarray:
    """Points (count, 3) in front of the camera that project into its image."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0.0, 0.0], [camera.width - 1.0, camera.height - 1.0], size=(count, 2))
    return camera.rays(pixels) * rng.uniform(0.3, 10.0, size=(count, 1))


@given(cameras(), st.integers(0, 1000))
def test_projection_agrees_with_opencv(camera, seed):
    points = points_in_view(camera, seed)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-6)


@given(cameras(), st.integers(0, 1000))
def test_rays_agree_with_opencv_and_invert_projection(camera, seed):
    pixels = camera.project(points_in_view(camera, seed))
    rays = camera.rays(pixels)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    # OpenCV 4 has the iteration's criteria in a function of its own.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    expected = undistort(pixels, camera.matrix, np.array(camera.distortion), R=None, P=None, criteria=criteria)
    np.testing.assert_allclose(rays[:, :2], expected[:, 0], atol=1e-8)
    np.testing.assert_allclose(camera.project(rays), pixels, atol=1e-6)


def test_strongly_distorted_camera_round_trips_at_every_pixel():
    v, u = np.mgrid[0:480, 0:640]
    pixels = TUM_FREIBURG1.project(TUM_FREIBURG1.pixel_rays())
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-6)


@given(cameras(), st.integers(1, 2000), st.integers(1, 2000), st.integers(0, 1000))
def test_resizing_moves_projections_as_it_moves_pixel_areas(camera, width, height, seed):
    points = points_in_view(camera, seed)
    scale = np.array([width / camera.width, height / camera.height])
    resized = camera.resized(width, height)
    assert (resized.width, resized.height) == (width, height)
    expected = (camera.project(points) + 0.5) * scale - 0.5
    np.testing.assert_allclose(resized.project(points), expected, atol=1e-6)


def test_resizing_agrees_with_resized_images():
    # A blob at a known point; where it lands in the resized image is where the resized camera sees it.
    camera = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
    point = np.array([0.13, -0.08, 1.0])
    v, u = np.mgrid[0:120, 0:160]
    center = camera.project(point)
    image = np.exp(-((u - center[0]) ** 2 + (v - center[1]) ** 2) / (2 * 6.0**2))
    small = cv2.resize(image, (80, 60), interpolation=cv2.INTER_AREA)
    v, u = np.mgrid[0:60, 0:80]
    centroid = np.array([(small * u).sum(), (small * v).sum()]) / small.sum()
    np.testing.assert_allclose(camera.resized(80, 60).project(point), centroid, atol=1e-3)


@given(cameras(), st.integers(0, 1000), st.data())
def test_cropping_moves_projections_by_the_corner(camera, seed, data):
    left = data.draw(st.integers(0, int(camera.cx)))
    top = data.draw(st.integers(0, int(camera.cy)))
    cropped = camera.cropped(left, top, camera.width - left, camera.height - top)
    points = points_in_view(camera, seed)
    np.testing.assert_allclose(cropped.project(points), camera.project(points) - [left, top], atol=1e-6)


@given(cameras(), st.integers(0, 1000))
def test_flipping_mirrors_projections(camera, seed):
    points = points_in_view(camera, seed)
    pixels = camera.project(points)
    expected = np.column_stack([camera.width - 1 - pixels[:, 0], pixels[:, 1]])
    np.testing.assert_allclose(camera.flipped().project(points * [-1.0, 1.0, 1.0]), expected, atol=1e-6)
    assert camera.flipped().flipped().cx == pytest.approx(camera.cx)


@given(cameras(distortion=st.just((0.0,) * 5)))
def test_pinhole_ignores_the_distortion_model(camera):
    assert not camera.is_distorted
    ray = camera.rays([camera.cx + camera.fx, camera.cy - camera.fy])
    np.testing.assert_allclose(ray, [1.0, -1.0, 1.0])


def test_back_projection_inverts_projection_of_every_pixel():
    camera = Camera(8, 6, 10.0, 11.0, 3.2, 2.9, (0.1, -0.05, 0.001, 0.002, 0.0))
    depth_m = np.random.default_rng(0).uniform(0.5, 4.0, size=(6, 8))
    points = camera.back_project(depth_m)
    np.testing.assert_array_equal(points[..., 2], depth_m)
    v, u = np.mgrid[0:6, 0:8]
    np.testing.assert_allclose(camera.project(points), np.stack([u, v], axis=-1), atol=1e-9)


def test_points_behind_the_camera_project_to_nan():
    camera = Camera(8, 6, 10.0, 10.0, 3.5, 2.5)
    assert np.isnan(camera.project([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]])).all()


def test_depth_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"shape \(6, 8\), got \(8, 6\)"):
        Camera(8, 6, 10.0, 10.0, 3.5, 2.5).back_project(np.ones((8, 6)))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"width": 0}, "camera.width/height"),
        ({"fx": -1.0}, "camera.fx/fy"),
        ({"fy": np.nan}, "camera.fx/fy"),
        ({"cx": 900.0}, "camera.cx/cy"),
        ({"cy": np.nan}, "camera.cx/cy"),
        ({"distortion": (0.1, 0.2)}, "camera.distortion"),
        ({"distortion": (0.1, 0.2, 0.0, 0.0, np.inf)}, "camera.distortion"),
    ],
)
def test_impossible_intrinsics_are_refused(change, field):
    intrinsics = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(SettingError, match=field):
        Camera(**(intrinsics | change))


@given(st.floats(0.02, 2.0), st.floats(0.1, 0.9))
def test_distortion_that_folds_the_image_is_refused(bend, share):
    """Radius r becomes r - bend r^3, which grows up to r = (3 bend)^-1/2, where it is two thirds of that."""
    farthest = 2.0 / 3.0 / np.sqrt(3.0 * bend)
    width, height = 640, 480
    corner_px = np.hypot(width / 2.0, height / 2.0)
    inside, outside = (corner_px / (factor * farthest) for factor in (1.0 - 0.1 * share, 1.0 + 0.1 * share))
    Camera(width, height, inside, inside, 319.5, 239.5, (-bend, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(SettingError, match=r"camera\.distortion: .* folds the image onto itself; give k1"):
        Camera(width, height, outside, outside, 319.5, 239.5, (-bend, 0.0, 0.0, 0.0, 0.0))
