"""Printed markers in images of a pinhole camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, transform

_PRINTED_PX, _MARGIN_PX = 200, 40


def with_marker(
    color: NDArray[np.uint8], camera: Camera, T_camera_marker: FloatArray, size_m: float, number: int
) -> NDArray[np.uint8]:
    """The image with a white sheet on which an AprilTag of the family 36h11 is printed."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    sheet = np.full((_PRINTED_PX + 2 * _MARGIN_PX,) * 2, 255, np.uint8)
    printed = slice(_MARGIN_PX, _MARGIN_PX + _PRINTED_PX)
    sheet[printed, printed] = cv2.aruco.generateImageMarker(dictionary, number, _PRINTED_PX)
    side_m = size_m * sheet.shape[0] / _PRINTED_PX
    corners = side_m / 2.0 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    seen = camera.project(transform(T_camera_marker, corners)).astype(np.float32)
    end = sheet.shape[0] - 0.5
    on_sheet = np.array([[-0.5, -0.5], [end, -0.5], [end, end], [-0.5, end]], np.float32)
    homography = cv2.getPerspectiveTransform(on_sheet, seen)
    size = (camera.width, camera.height)
    warped = cv2.warpPerspective(sheet, homography, size, flags=cv2.INTER_AREA)
    mask = cv2.warpPerspective(np.full_like(sheet, 255), homography, size, flags=cv2.INTER_NEAREST) > 0
    return np.where(mask[..., None], warped[..., None], color).astype(np.uint8)
