"""The camera: properties for every distortion model, and OpenCV as the oracle for distortion."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from monoloc.camera import Camera
from monoloc.errors import SettingError

TUM_FREIBURG1 = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))

# 170 degrees from corner to corner. The coefficients are near those of a RealSense T265.
WIDE = Camera(600, 460, 275.5, 276.5, 299.5, 229.5, (-0.006, 0.042, -0.04, 0.007), "fisheye")
# 120 degrees from corner to corner.
RATIONAL = Camera(640, 480, 250.0, 251.0, 322.0, 238.0, (0.51, 0.1, 1e-3, -1e-3, 0.01, 0.8, 0.2, 0.03), "rational")
LENSES = [TUM_FREIBURG1, RATIONAL, WIDE]


def within(*bounds: float) -> st.SearchStrategy:
    return st.tuples(*(st.floats(-bound, bound) for bound in bounds))


# Lenses whose distortion is invertible over the whole image (it folds where the radius stops growing), and the
# shortest focal length over the longer side of the image.
coefficients = st.one_of(
    st.tuples(st.just("brown"), within(0.1, 0.01, 0.005, 0.005, 0.002), st.just(0.9)),
    st.tuples(st.just("rational"), within(0.1, 0.01, 0.005, 0.005, 0.002, 0.1, 0.01, 0.002), st.just(0.9)),
    st.tuples(st.just("fisheye"), within(0.02, 0.01, 0.005, 0.001), st.just(0.6)),
)
pinholes = st.tuples(st.just("brown"), st.just((0.0,) * 5), st.just(0.9))


@st.composite
def cameras(draw: st.DrawFn, lens: st.SearchStrategy = coefficients) -> Camera:
    width, height = draw(st.integers(16, 1280)), draw(st.integers(16, 960))
    model, distortion, shortest = draw(lens)
    focal = draw(st.floats(shortest, 2.0)) * max(width, height)
    fy, cx, cy = focal * draw(st.floats(0.95, 1.05)), *(size * draw(st.floats(0.4, 0.6)) for size in (width, height))
    try:
        return Camera(width, height, focal, fy, cx, cy, distortion, model)
    except SettingError:  # a corner is beyond the widest view
        reject()


def points_in_view(camera: Camera, seed: int, count: int = 30) -> np.ndarray:
    """Points (count, 3) in front of the camera that project into its image."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0.0, 0.0], [camera.width - 1.0, camera.height - 1.0], size=(count, 2))
    return camera.rays(pixels) * rng.uniform(0.3, 10.0, size=(count, 1))


def project_by_opencv(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3)."""
    project = cv2.fisheye.projectPoints if camera.distortion_model == "fisheye" else cv2.projectPoints
    nothing, distortion = np.zeros(3), np.array(camera.distortion)
    return project(points[:, None], nothing, nothing, camera.matrix, distortion)[0].reshape(-1, 2)


def undistort_by_opencv(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Coordinates at z = 1, (N, 2), of pixels (N, 2)."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    arguments = pixels[:, None], camera.matrix, np.array(camera.distortion)
    if camera.distortion_model == "fisheye":
        return cv2.fisheye.undistortPoints(*arguments, criteria=criteria)[:, 0]
    # OpenCV 4 has the iteration's criteria in a function of its own.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    return undistort(*arguments, R=None, P=None, criteria=criteria)[:, 0]


@given(cameras() | st.sampled_from(LENSES), st.integers(0, 1000))
def test_projection_agrees_with_opencv(camera, seed):
    points = points_in_view(camera, seed)
    np.testing.assert_allclose(camera.project(points), project_by_opencv(camera, points), atol=1e-6)


@given(cameras() | st.just(WIDE), st.integers(0, 1000))
def test_rays_agree_with_opencv_and_invert_projection(camera, seed):
    pixels = camera.project(points_in_view(camera, seed))
    rays = camera.rays(pixels)
    np.testing.assert_allclose(rays[:, :2], undistort_by_opencv(camera, pixels), rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(camera.project(rays), pixels, atol=1e-6)


@pytest.mark.parametrize("camera", LENSES)
def test_strongly_distorted_camera_round_trips_at_every_pixel(camera):
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    pixels = camera.project(camera.pixel_rays())
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-6)


@pytest.mark.parametrize("camera", LENSES)
def test_a_sphere_that_holds_a_point_in_sight_is_in_sight(camera):
    rng = np.random.default_rng(0)
    inside = points_in_view(camera, 0, 2000)
    offsets = rng.normal(size=inside.shape)
    centres = inside + 0.7 * offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    assert camera.in_sight(centres, 0.7 + 1e-9).all()
    assert not camera.in_sight(centres).all()
    assert not camera.in_sight(np.array([[0.0, 0.0, -0.8]]), 0.7).any()


@pytest.mark.parametrize("camera", LENSES)
def test_a_point_in_sight_has_one_pixel_and_a_pixel_is_in_sight(camera):
    """A distortion polynomial folds directions far outside the field of view back into the image."""
    inside = points_in_view(camera, 0, 2000)
    assert camera.in_sight(inside).all()
    directions = np.random.default_rng(1).normal(size=(20_000, 3))
    seen = directions[camera.in_sight(directions)]
    pixels = camera.project(seen)
    within_image = ((pixels >= -0.5) & (pixels < [camera.width - 0.5, camera.height - 0.5])).all(axis=1)
    assert within_image.sum() > 500
    expected = seen[within_image, :2] / seen[within_image, 2:]
    np.testing.assert_allclose(camera.rays(pixels[within_image])[:, :2], expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("camera", LENSES)
def test_points_in_view_are_those_that_the_image_shows(camera):
    """Also of an image that was cropped, whose principal point is at its border."""
    for shown in (camera, camera.cropped(camera.width // 2, 0, camera.width // 2, camera.height)):
        directions = np.random.default_rng(1).normal(size=(20_000, 3))
        seen, pixels = shown.in_view(directions)
        assert len(seen) > 300 and np.all((pixels >= -1.0) & (pixels <= [shown.width, shown.height]))
        np.testing.assert_allclose(pixels, shown.project(directions[seen]))
        assert len(shown.in_view(shown.pixel_rays().reshape(-1, 3))[0]) == shown.width * shown.height


def test_a_pixel_beside_a_wide_image_has_a_ray_in_front_of_the_camera():
    rays = WIDE.rays([[-30.0, -30.0], [WIDE.width + 30.0, WIDE.height + 30.0]])
    assert np.rad2deg(np.arctan(np.hypot(rays[:, 0], rays[:, 1]))) == pytest.approx([87.0, 87.0])


def test_fisheye_without_coefficients_is_equidistant():
    camera = Camera(600, 400, 300.0, 300.0, 299.5, 199.5, distortion_model="fisheye")
    assert camera.is_distorted and camera.distortion == (0.0,) * 4
    angle = 0.7
    np.testing.assert_allclose(camera.project([np.sin(angle), 0.0, np.cos(angle)]), [299.5 + 300.0 * angle, 199.5])


@pytest.mark.parametrize("camera", LENSES)
def test_pose_solver_is_given_a_view_that_it_knows(camera):
    """OpenCV's solvers find the pose; errors of pixels are about as large in the view as in the image."""
    rng = np.random.default_rng(0)
    points = points_in_view(camera, 0, 100)
    pixels = camera.project(points) + rng.normal(scale=0.1, size=(100, 2))
    seen, K, distortion = camera.for_pnp(pixels)
    ok, rotation, translation, inliers = cv2.solvePnPRansac(points, seen, K, distortion, reprojectionError=1.0)
    assert ok and len(inliers) > 80
    np.testing.assert_allclose(rotation, 0.0, atol=5e-3)
    np.testing.assert_allclose(translation, 0.0, atol=2e-2)


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


def test_a_window_may_leave_out_the_principal_point():
    camera = TUM_FREIBURG1.cropped(400, 300, 200, 150)
    assert camera.cx < -0.5 and camera.cy < -0.5
    v, u = np.mgrid[0:150, 0:200]
    np.testing.assert_allclose(camera.pixel_rays(), TUM_FREIBURG1.pixel_rays()[300:450, 400:600], atol=1e-9)
    np.testing.assert_allclose(camera.project(camera.pixel_rays()), np.stack([u, v], axis=-1), atol=1e-6)
    assert camera.in_sight(camera.pixel_rays().reshape(-1, 3)).all()
    # A window of a window, and other sizes of one, are windows; a window about the principal point is a plain camera.
    assert camera.resized(100, 75).cropped(10, 10, 50, 50).cx == pytest.approx(0.5 * (camera.cx + 0.5) - 10.5)
    assert TUM_FREIBURG1.cropped(0, 0, 640, 480) == TUM_FREIBURG1


@given(cameras(), st.integers(0, 1000))
def test_turning_turns_projections(camera, seed):
    points = points_in_view(camera, seed)
    pixels = camera.project(points)
    expected = np.column_stack([pixels[:, 1], camera.width - 1 - pixels[:, 0]])  # where rot90 puts them
    turned = np.column_stack([points[:, 1], -points[:, 0], points[:, 2]])
    np.testing.assert_allclose(camera.turned(1).project(turned), expected, atol=1e-6)
    assert (camera.turned(1).width, camera.turned(1).height) == (camera.height, camera.width)
    assert camera.turned(-1) == camera.turned(3) and camera.turned(2).turned(2).cx == pytest.approx(camera.cx)


@given(cameras(), st.integers(0, 1000))
def test_flipping_mirrors_projections(camera, seed):
    points = points_in_view(camera, seed)
    pixels = camera.project(points)
    expected = np.column_stack([camera.width - 1 - pixels[:, 0], pixels[:, 1]])
    np.testing.assert_allclose(camera.flipped().project(points * [-1.0, 1.0, 1.0]), expected, atol=1e-6)
    assert camera.flipped().flipped().cx == pytest.approx(camera.cx)


@given(cameras(pinholes))
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
        ({"fx": 0.82, "fy": 1.09}, "camera.fx/fy"),  # shares of the image
        ({"fy": np.nan}, "camera.fx/fy"),
        ({"cx": 900.0}, "camera.cx/cy"),
        ({"cy": np.nan}, "camera.cx/cy"),
        ({"distortion": (0.1, 0.2)}, "camera.distortion"),
        ({"distortion": (0.1, 0.2, 0.0, 0.0, np.inf)}, "camera.distortion"),
        ({"distortion": (0.1,) * 8}, r"camera\.distortion: is .*; give k1, k2, p1, p2, k3$"),
        ({"distortion": (0.1,) * 5, "distortion_model": "fisheye"}, r"give k1, k2, k3, k4$"),
        ({"distortion": (0.1,) * 4, "distortion_model": "rational"}, r"give k1, k2, p1, p2, k3, k4, k5, k6$"),
        (
            {"distortion": (0.0,) * 11 + (0.1,) + (0.0,) * 2, "distortion_model": "rational"},
            r"distortion: has \(0.0, 0.0, 0.0, 0.1, 0.0, 0.0\) after k6, of a thin prism .*; calibrate with k1, .*",
        ),
        ({"fx": True}, "camera.fx: is true or false, not a number; give numbers"),
        ({"width": "640"}, "camera.width: is not a number, or not below 1e308; give numbers"),
        ({"cx": 10**400}, "camera.cx: is not a number, or not below 1e308"),
        ({"distortion": (10**400, 0, 0, 0)}, "camera.distortion: is not a number"),
        ({"distortion": (0.1, np.True_, 0.0, 0.0)}, "camera.distortion: is true or false"),
        ({"distortion_model": "omni"}, r"distortion_model: is 'omni'; choose from brown, rational, fisheye"),
        (
            {"fx": 250.0, "fy": 250.0, "distortion_model": "fisheye"},
            r"shows more than 85 degrees off the optical axis .*; crop the images to within 371 pixels",
        ),
    ],
)
def test_impossible_intrinsics_are_refused(change, field):
    intrinsics = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(SettingError, match=field):
        Camera(**(intrinsics | change))


@pytest.mark.parametrize("shape", [(5,), (1, 5), (5, 1)])
def test_distortion_is_taken_as_opencv_returns_it(shape):
    coefficients = (0.1, -0.2, 0.0, 0.001, 0.05)
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, np.reshape(coefficients, shape))
    assert camera.distortion == coefficients and all(type(value) is float for value in camera.distortion)


@pytest.mark.parametrize("count", [8, 12, 14])
def test_a_rational_lens_is_taken_as_opencv_returns_it(count):
    """OpenCV's calibration returns zeros for the terms of a thin prism and a tilted sensor, which were not asked."""
    coefficients = (0.1, -0.2, 0.0, 0.001, 0.05, 0.02, 0.0, 0.01)
    row = np.pad(coefficients, (0, count - 8))[None]
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, row, "rational")
    assert camera.distortion == coefficients


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


def test_folding_by_the_focal_length_of_half_the_size_names_fx_and_fy():
    fix = r"or correct fx, fy, which are \(262, 262\) for images of 640x480"
    with pytest.raises(SettingError, match=f"folds the image onto itself; give k1, .*, {fix}"):
        Camera(640, 480, 262.0, 262.0, 319.5, 239.5, (-0.08, 0.0, 0.0, 0.0, 0.0))


def test_fisheye_that_folds_the_image_is_refused():
    """The angle t becomes t - t^3 / 3, which grows up to t = 1, where it is 2/3."""
    bend = (-1.0 / 3.0, 0.0, 0.0, 0.0)
    corner_px = np.hypot(320.0, 240.0)
    Camera(640, 480, *(1.52 * corner_px,) * 2, 319.5, 239.5, bend, "fisheye")
    with pytest.raises(SettingError, match=r"folds the image onto itself; give k1, k2, k3, k4 as"):
        Camera(640, 480, *(1.48 * corner_px,) * 2, 319.5, 239.5, bend, "fisheye")


def test_brown_of_four_coefficients_has_no_k3():
    assert replace(TUM_FREIBURG1, distortion=(0.1, -0.2, 0.001, 0.002)).distortion == (0.1, -0.2, 0.001, 0.002, 0.0)
