"""A start by a marker, against rendered images of one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from monoloc.camera import Camera
from monoloc.config import load_settings
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, invert, make_pose, rotation_to_quaternion, so3_exp, transform
from monoloc.relocalization.marker import DEFAULT_DICTIONARY, Marker, MarkerDetector, MarkerLocalizer, Markers
from refusals import refuses_data
from repository import REPOSITORY

CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, distortion=(-0.1, 0.02, 0.001, -0.001, 0.0))
FISHEYE = Camera(640, 480, 300.0, 300.0, 319.5, 239.5, distortion=(0.02, -0.01, 0.0, 0.0), distortion_model="fisheye")
T_WORLD_MARKER = make_pose(so3_exp([0.3, -0.2, 0.5]), [1.0, 2.0, 0.5])
SIZE_M = 0.2


def marker(**changed: object) -> Marker:
    quaternion = tuple(rotation_to_quaternion(T_WORLD_MARKER[:3, :3]).tolist())
    given = {"id": 7, "size_m": SIZE_M, "position_m": (1.0, 2.0, 0.5), "quaternion": quaternion}
    return Marker.model_validate({**given, "error_m": 0.0, "error_rad": 0.0, **changed})


def looking_at_marker(distance_m: float, turn: tuple[float, float, float]) -> FloatArray:
    """``T_world_camera`` of a camera before the marker, upright on its axis and then turned about it."""
    T_marker_camera = make_pose(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, distance_m])
    return T_WORLD_MARKER @ make_pose(so3_exp(turn), np.zeros(3)) @ T_marker_camera


def image(T_world_camera: FloatArray, camera: Camera = CAMERA, number: int = 7) -> NDArray[np.uint8]:
    """A white sheet with the marker, seen by every pixel's ray."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    printed = cv2.aruco.generateImageMarker(dictionary, number, 400)
    T_marker_camera = invert(T_WORLD_MARKER) @ T_world_camera
    rays = camera.pixel_rays().reshape(-1, 3) @ T_marker_camera[:3, :3].T
    origin = T_marker_camera[:3, 3]
    hits = origin + rays * (-origin[2] / rays[:, 2])[:, None]
    column = (hits[:, 0] / SIZE_M + 0.5) * 400.0 - 0.5
    row = (0.5 - hits[:, 1] / SIZE_M) * 400.0 - 0.5
    shape = (camera.height, camera.width)
    maps = (column.reshape(shape).astype(np.float32), row.reshape(shape).astype(np.float32))
    gray = cv2.remap(printed, *maps, cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=255)
    noisy = cv2.GaussianBlur(gray, (0, 0), 0.7) + np.random.default_rng(0).normal(0.0, 3.0, shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["brown", "fisheye"])
@pytest.mark.parametrize(
    ("distance_m", "turn"), [(1.0, (0.5, 0.3, 0.2)), (0.6, (0.0, -0.7, 2.0)), (1.5, (0.8, 0.0, 0.0))]
)
def test_camera_is_found_within_its_stated_error(
    camera: Camera, distance_m: float, turn: tuple[float, float, float]
) -> None:
    T_world_camera = looking_at_marker(distance_m, turn)
    start = MarkerLocalizer(Markers(marker=(marker(),)), camera).start(image(T_world_camera, camera))
    assert start is not None
    errors = pose_errors(start.pose[None], T_world_camera[None])
    assert errors.position_m[0] < 2.0 * start.error_m < 0.2
    assert errors.rotation_rad[0] < 2.0 * start.error_rad < 0.2


@pytest.mark.parametrize("distance_m", [0.6, 1.2, 2.0])
def test_marker_is_seen_as_large_as_it_is(distance_m: float) -> None:
    """Corners that lie inside the black square by a quarter of a pixel make a map 1 % too large."""
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    outside_px = []
    for turn in np.random.default_rng(1).uniform(-0.7, 0.7, (8, 3)):
        T_world_camera = looking_at_marker(distance_m, tuple(turn))
        local = transform(invert(T_world_camera) @ T_WORLD_MARKER, marker().corners)
        ((_, seen),) = MarkerDetector(DEFAULT_DICTIONARY)(image(T_world_camera, camera))
        corners = camera.project(local)
        outward = corners - corners.mean(axis=0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        outside_px.append(np.sum((seen - corners) * outward, axis=1))
        assert np.abs(seen - corners).max() < 1.0
    assert abs(np.mean(outside_px)) < 0.1


def test_error_of_the_markers_place_is_passed_on() -> None:
    seen = image(looking_at_marker(1.0, (0.5, 0.3, 0.2)))
    exact = MarkerLocalizer(Markers(marker=(marker(),)), CAMERA).start(seen)
    rough = MarkerLocalizer(Markers(marker=(marker(error_m=0.1, error_rad=0.1),)), CAMERA).start(seen)
    assert exact is not None and rough is not None
    # Three axes, and two of the rotation that a metre turns into position.
    assert rough.error_m == pytest.approx(np.sqrt(exact.error_m**2 + 5.0 * 0.1**2), rel=0.01)
    assert rough.error_rad == pytest.approx(np.sqrt(exact.error_rad**2 + 3.0 * 0.1**2))


def test_marker_of_another_number_and_one_whose_pose_is_ambiguous_say_nothing() -> None:
    localizer = MarkerLocalizer(Markers(marker=(marker(),)), CAMERA)
    assert localizer.start(image(looking_at_marker(1.0, (0.5, 0.3, 0.2)), number=8)) is None
    assert localizer.start(np.full((480, 640, 3), 128, dtype=np.uint8)) is None
    far_and_frontal = image(looking_at_marker(3.0, (0.02, 0.0, 0.0)))
    assert localizer.start(far_and_frontal) is None


def test_nearer_of_two_markers_is_taken() -> None:
    seen = image(looking_at_marker(1.0, (0.5, 0.3, 0.2)))
    sure, vague = marker(), marker(id=3, error_m=0.5)
    localizer = MarkerLocalizer(Markers(marker=(vague, sure)), CAMERA)
    start = localizer.start(seen)
    assert start is not None and start.error_m < 0.1


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"quaternion": (0, 0, 0, 2)}, "length 1"),
        ({"size_m": 0.0}, "size_m"),
        ({"position_m": (0, 0, float("nan"))}, "position_m"),
    ],
)
def test_bad_marker_is_refused(changed: dict[str, object], match: str) -> None:
    with pytest.raises(ValidationError, match=match):
        marker(**changed)


def test_corners_are_where_opencv_says() -> None:
    """Against the library's own projection."""
    T_world_camera = looking_at_marker(0.8, (0.1, 0.2, 0.3))
    T_camera_marker = invert(T_world_camera) @ T_WORLD_MARKER
    rotation, _ = cv2.Rodrigues(T_camera_marker[:3, :3])
    expected, _ = cv2.projectPoints(
        marker().corners, rotation, T_camera_marker[:3, 3], CAMERA.matrix, np.array(CAMERA.distortion)
    )
    np.testing.assert_allclose(
        CAMERA.project(transform(T_camera_marker, marker().corners)), expected[:, 0], atol=1e-6
    )


def test_markers_are_read_as_the_guide_writes_them(tmp_path: Path) -> None:
    guide = (REPOSITORY / "docs/how-to/start-by-a-marker.md").read_text(encoding="utf-8")
    path = tmp_path / "markers.toml"
    path.write_text(guide.split("```toml\n")[1].split("```")[0])
    (only,) = load_settings(path, Markers).marker
    assert (only.id, only.size_m, only.error_rad) == (7, 0.16, 0.02)
    path.write_text(path.read_text().replace("size_m = 0.16", "size_m = true"))
    refuses_data(lambda: load_settings(path, Markers), path, "marker.0.size_m: is true or false", "correct the field")
