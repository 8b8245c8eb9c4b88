"""A start by a marker of known place: an ArUco marker or AprilTag, seen in one image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, make_pose, quaternion_to_rotation, so3_exp, transform
from monoloc.start import Start

_CORNER_SD_PX = 0.5  # of a detected corner, and of a lens that is not quite the calibrated one
_CENTRE_PX = 0.5  # of the first pixel, as these corners are counted; here it is at 0
_LEAST_RATIO = 2.0  # of reprojection errors of a square's two poses, below which it is not known which is right
_MOST_ERROR_PX = 3.0  # of the better one: a marker of another size fits as well, but not a wrong lens
_STEP_M, _STEP_RAD = 1e-4, 1e-4  # of the numerical Jacobian

Dictionary = Literal[
    "4x4_50", "5x5_100", "6x6_250", "aruco_original", "apriltag_16h5", "apriltag_25h9", "apriltag_36h11"
]
DEFAULT_DICTIONARY: Dictionary = "apriltag_36h11"
_DICTIONARIES: dict[Dictionary, int] = {
    "4x4_50": cv2.aruco.DICT_4X4_50,
    "5x5_100": cv2.aruco.DICT_5X5_100,
    "6x6_250": cv2.aruco.DICT_6X6_250,
    "aruco_original": cv2.aruco.DICT_ARUCO_ORIGINAL,
    "apriltag_16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "apriltag_25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "apriltag_36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
_Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
_Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]


class Marker(BaseModel):
    """A marker and its place.

    The marker's axes are x right and y up on the printed sheet, z out of it towards the reader; its origin is its
    centre.

    Attributes:
        id: its number in the dictionary.
        size_m: side of the black square.
        position_m: of its centre, world frame.
        quaternion: ``R_world_marker`` as x, y, z, w; either this or ``rpy_deg``.
        rpy_deg: the same as turns about the world's x, then its y, then its z axis, degrees.
        error_m, error_rad: standard deviations of its place, per axis.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: int = Field(ge=0)
    size_m: float = Field(gt=0.005, le=5.0)
    position_m: tuple[_Coordinate, _Coordinate, _Coordinate]
    quaternion: tuple[float, float, float, float] | None = None
    rpy_deg: tuple[_Degrees, _Degrees, _Degrees] | None = None
    error_m: float = Field(0.01, ge=0.0, le=1.0)
    error_rad: float = Field(0.01, ge=0.0, le=1.0)

    @field_validator("quaternion")
    @classmethod
    def _is_unit(cls, quaternion: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if quaternion is not None and abs(math.hypot(*quaternion) - 1.0) > 1e-3:
            raise ValueError("give x, y, z, w of length 1")
        return quaternion

    @model_validator(mode="after")
    def _has_one_rotation(self) -> Marker:
        if (self.quaternion is None) == (self.rpy_deg is None):
            raise ValueError("give either quaternion or rpy_deg")
        return self

    @property
    def T_world_marker(self) -> FloatArray:
        if self.rpy_deg is not None:
            turns = np.diag(np.deg2rad(self.rpy_deg))
            return make_pose(so3_exp(turns[2]) @ so3_exp(turns[1]) @ so3_exp(turns[0]), self.position_m)
        return make_pose(quaternion_to_rotation(np.array(self.quaternion)), self.position_m)

    @property
    def corners(self) -> FloatArray:
        """Corners in the marker's frame, (4, 3) m: as OpenCV detects them, clockwise from the top left."""
        return self.size_m / 2.0 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


class Markers(BaseModel):
    """The markers of a room, as a TOML file lists them under ``[[marker]]``.

    Attributes:
        dictionary: that the markers are printed from.
        marker: at least one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    dictionary: Dictionary = DEFAULT_DICTIONARY
    marker: tuple[Marker, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _check(self) -> Markers:
        check_markers(self.dictionary, self.marker)
        return self


def check_markers(dictionary: Dictionary, markers: Sequence[Marker]) -> None:
    """Raise ValueError where two markers have the same number, or one has a number that the dictionary has not."""
    numbers = [marker.id for marker in markers]
    if len(set(numbers)) < len(numbers):
        raise ValueError("two markers have the same id")
    count = len(cv2.aruco.getPredefinedDictionary(_DICTIONARIES[dictionary]).bytesList)
    if markers and max(numbers) >= count:
        raise ValueError(f"a marker has the id {max(numbers)}, but those of {dictionary} are 0 to {count - 1}")


class MarkerDetector:
    """Finds the markers of a dictionary in images."""

    def __init__(self, dictionary: Dictionary) -> None:
        parameters = cv2.aruco.DetectorParameters()
        # Lines along the sides meet where the corners are. Gradients around a corner meet inside the black square, a
        # quarter to half a pixel away, so that the marker looks smaller.
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
        known = cv2.aruco.getPredefinedDictionary(_DICTIONARIES[dictionary])
        self._detector = cv2.aruco.ArucoDetector(known, parameters)

    def __call__(self, color: NDArray[np.uint8]) -> list[tuple[int, FloatArray]]:
        """Numbers and corners, (4, 2) px clockwise from the top left, of all markers in an image (H, W, 3) RGB."""
        corners, numbers, _ = self._detector.detectMarkers(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
        known = () if numbers is None else np.ravel(numbers).tolist()  # no array where there is none
        return [
            (int(number), np.asarray(found, dtype=np.float64).reshape(4, 2) - _CENTRE_PX)
            for number, found in zip(known, corners, strict=True)
        ]


class MarkerLocalizer:
    """Finds the camera by markers.

    Args:
        markers: of the room.
        camera: of the images.
    """

    def __init__(self, markers: Markers, camera: Camera) -> None:
        self._markers = {marker.id: marker for marker in markers.marker}
        self._camera = camera
        self._detected = MarkerDetector(markers.dictionary)

    def start(self, color: NDArray[np.uint8]) -> Start | None:
        """The camera's pose from the marker that tells it best, or None where none does.

        Args:
            color: (H, W, 3) uint8 RGB.
        """
        starts = []
        for number, corners in self._detected(color):
            if number in self._markers and (start := self._from_marker(self._markers[number], corners)) is not None:
                starts.append(start)
        return min(starts, key=lambda start: start.error_m, default=None)

    def _from_marker(self, marker: Marker, pixels: FloatArray) -> Start | None:
        """A square seen from afar has two poses that look alike; where it is not clear which, there is none."""
        seen, matrix, distortion = self._camera.for_pnp(pixels)
        count, rotations, translations, errors = cv2.solvePnPGeneric(
            marker.corners, seen, matrix, distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        if count == 0:
            return None
        error_px = np.ravel(errors)
        is_ambiguous = count > 1 and error_px[1] < _LEAST_RATIO * max(error_px[0], _CORNER_SD_PX)
        if is_ambiguous or not error_px[0] <= _MOST_ERROR_PX:
            return None
        T_camera_marker = make_pose(so3_exp(np.ravel(rotations[0])), np.ravel(translations[0]))
        covariance = self._covariance(marker, T_camera_marker)
        if covariance is None:
            return None
        lever_m = float(np.linalg.norm(T_camera_marker[:3, 3]))
        error_m = np.sqrt(
            np.trace(covariance[:3, :3]) + 3.0 * marker.error_m**2 + 2.0 * (marker.error_rad * lever_m) ** 2
        )
        error_rad = np.sqrt(np.trace(covariance[3:, 3:]) + 3.0 * marker.error_rad**2)
        return Start(marker.T_world_marker @ invert(T_camera_marker), float(error_m), float(error_rad))

    def _covariance(self, marker: Marker, T_camera_marker: FloatArray) -> FloatArray | None:
        """Of the camera's position and rotation vector in the marker's frame, (6, 6); None if undetermined."""
        T_marker_camera = invert(T_camera_marker)

        def pixels(change: FloatArray) -> FloatArray:
            moved = make_pose(so3_exp(change[3:]) @ T_marker_camera[:3, :3], T_marker_camera[:3, 3] + change[:3])
            return self._camera.project(transform(invert(moved), marker.corners)).ravel()

        steps = np.diag([_STEP_M] * 3 + [_STEP_RAD] * 3)
        jacobian = np.stack([(pixels(step) - pixels(-step)) / (2.0 * step.max()) for step in steps], axis=1)
        information = jacobian.T @ jacobian / _CORNER_SD_PX**2
        if not np.all(np.isfinite(information)) or np.linalg.cond(information) > 1e12:
            return None
        return np.asarray(np.linalg.inv(information))
