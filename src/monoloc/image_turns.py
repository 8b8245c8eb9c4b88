"""Turns of images by quarters, counter-clockwise as :func:`numpy.rot90` turns them, and of the camera with them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, make_pose

_Value = TypeVar("_Value", bound=np.generic)

LEAST_IN_IMAGE = 0.5
"""Length of gravity's unit vector along the image, from which it tells how the image lies: a camera that looks up or
down has no upright."""

_R_TURNED_CAMERA = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # after one turn


def turns_upright(down_camera: FloatArray) -> NDArray[np.int64]:
    """Turns, 0 to 3, after which images stand upright; those of cameras that look up or down are left out.

    Args:
        down_camera: direction of gravity in the camera's frame, unit vectors, (N, 3).

    Returns:
        (M,), M at most N.
    """
    right, down, _ = down_camera[np.hypot(down_camera[:, 0], down_camera[:, 1]) > LEAST_IN_IMAGE].T
    return np.asarray(np.round(np.arctan2(-right, down) / (0.5 * np.pi)).astype(np.int64) % 4)


def turns_on_body(T_body_camera: FloatArray) -> int:
    """Turns, 0 to 3, that bring a camera's images upright while its vehicle is level; 0 if it looks up or down.

    Args:
        T_body_camera: pose of the camera on the body, whose axes are forward, right, down, (4, 4).
    """
    turns = turns_upright(T_body_camera[2:3, :3])
    return int(turns[0]) if len(turns) else 0


def T_camera_turned(quarter_turns: int) -> FloatArray:
    """Pose of the camera of turned images in the frame of the camera before, (4, 4)."""
    return make_pose(np.linalg.matrix_power(_R_TURNED_CAMERA, quarter_turns % 4).T, np.zeros(3))


def turned_image(image: NDArray[_Value], quarter_turns: int) -> NDArray[_Value]:
    """An image, (H, W, ...), turned."""
    return np.ascontiguousarray(np.rot90(image, quarter_turns))


def in_words(quarter_turns: int) -> str:
    """How images were turned, for a person; 1 to 3 turns."""
    return {1: "90° counter-clockwise", 2: "180°", 3: "90° clockwise"}[quarter_turns]
