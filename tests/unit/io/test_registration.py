"""Depth registered to the colour camera: where it lies, what it hides, and which cracks it closes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc import geometry
from monoloc.camera import Camera
from monoloc.geometry import FloatArray
from monoloc.io import seven_scenes
from monoloc.io.registration import DepthRegistration


def render_scene(camera: Camera, T_depth_camera: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Depth (h, w) of a slanted wall behind a steep board, and where the board is, (h, w) bool.

    Both are given in the depth camera's frame.
    """
    rays = camera.pixel_rays() @ T_depth_camera[:3, :3].T
    origin = T_depth_camera[:3, 3]

    def hit(normal: list[float], distance: float) -> FloatArray:
        return (distance - origin @ np.array(normal)) / (rays @ np.array(normal))

    wall = hit([0.2, 0.1, 1.0], 2.5)
    board = hit([-1.2, 0.0, 1.0], 0.9)
    x, y, _ = np.moveaxis(origin + board[..., None] * rays, -1, 0)
    on_board = (np.abs(x) < 0.25) & (np.abs(y) < 0.2) & (board > 0)
    return np.where(on_board, board, wall), on_board


def near_discontinuity(depth_m: FloatArray, pixels: int) -> NDArray[np.bool_]:
    """Where depth jumps by more than 10 % within some pixels."""
    kernel = np.ones((2 * pixels + 1,) * 2)
    return cv2.dilate(depth_m, kernel) > 1.1 * cv2.erode(depth_m, kernel)


def test_registration_renders_what_the_colour_camera_sees() -> None:
    T_depth_color = geometry.invert(seven_scenes.T_COLOR_DEPTH)
    depth_camera, color_camera = seven_scenes.DEPTH_CAMERA, seven_scenes.COLOR_CAMERA
    seen_by_depth = render_scene(depth_camera, np.eye(4))[0].astype(np.float32)
    expected, board = render_scene(color_camera, T_depth_color)
    register = DepthRegistration(depth_camera, color_camera, seven_scenes.T_COLOR_DEPTH)
    result = register(seen_by_depth)

    # Which points of the colour image the depth camera sees too, by projecting them into it.
    points = geometry.transform(T_depth_color, color_camera.back_project(expected).reshape(-1, 3))
    u, v = np.round(depth_camera.project(points)).astype(int).T
    inside = (u >= 0) & (u < 640) & (v >= 0) & (v < 480)
    visible = np.zeros(640 * 480, dtype=bool)
    visible[inside] = np.abs(seen_by_depth[v[inside], u[inside]] - points[inside, 2]) < 0.02
    visible = visible.reshape(480, 640)

    clear = ~near_discontinuity(expected, 1)
    has_depth = result > 0
    # No hole in what both see, up to the pixel at its border.
    assert has_depth[cv2.erode((visible & clear).astype(np.uint8), np.ones((3, 3))) > 0].all()
    # Nothing invented in the shadow: the wall beside the board that only the colour camera sees.
    shadow = cv2.erode((~visible).astype(np.uint8), np.ones((3, 3))) > 0
    assert shadow.sum() > 1000
    assert not has_depth[shadow].any()
    # Right everywhere: the wall to millimetres, the board (12 mm a pixel) to its slope over a pixel.
    error = np.abs(result - expected)
    assert error[has_depth & clear & ~board].max() < 0.004
    assert error[has_depth & clear & board].max() < 0.02
    assert (board & clear).sum() > 10000


def test_what_only_a_wide_depth_camera_sees_is_not_folded_into_the_image() -> None:
    """A lens whose polynomial turns back beyond the image's corners; depth from there is nearer than what is seen."""
    depth_camera = Camera(320, 288, 100.0, 100.0, 159.5, 143.5)
    color_camera = Camera(640, 480, 600.0, 600.0, 319.5, 239.5, (0.05, -0.15, 0.0, 0.0, 0.0))
    depth_m = np.full((288, 320), 0.7, np.float32)
    depth_m[:, 80:240] = 2.0  # as wide as 0.8 focal lengths to both sides, and the image 0.53
    image = DepthRegistration(depth_camera, color_camera, np.eye(4))(depth_m)
    np.testing.assert_allclose(image[image > 0.0], 2.0, atol=1e-6)


def test_registration_between_equal_cameras_changes_nothing() -> None:
    camera = Camera(40, 30, 35.0, 35.0, 19.5, 14.5)
    depth_m = np.random.default_rng(0).uniform(1.0, 1.02, size=(30, 40)).astype(np.float32)
    result = DepthRegistration(camera, camera, np.eye(4))(depth_m)
    np.testing.assert_allclose(result, depth_m, rtol=1e-6)


def test_registration_closes_cracks_of_one_surface_only() -> None:
    # Twice the focal length writes every second pixel: the gaps between them are cracks, each closed from
    # its two neighbours; the step between the two surfaces stays open.
    depth_camera = Camera(20, 3, 20.0, 10.0, 0.0, 1.0)
    color_camera = Camera(39, 3, 40.0, 10.0, 0.0, 1.0)
    depth_m = np.where(np.arange(20) < 10, 1.0, 2.0).astype(np.float32)[None].repeat(3, axis=0)
    result = DepthRegistration(depth_camera, color_camera, np.eye(4))(depth_m)
    np.testing.assert_allclose(result[:, :19], 1.0)
    assert not result[:, 19].any()
    np.testing.assert_allclose(result[:, 20:], 2.0)
