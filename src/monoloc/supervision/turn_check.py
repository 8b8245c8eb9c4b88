"""Whether a camera lies on its side or upside down. Its depth network was not trained on such images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.image_turns import LEAST_IN_IMAGE

_LEAST_UPRIGHT = 0.5  # cosine of the image's turn: 60 degrees
_LEAST_SHARE = 0.75  # of the build's frames that stand upright


class TurnCheck:
    """Whether a camera lies on its side or upside down, where the build's stood upright.

    A camera that looks up or down does not count as turned. Nor does any camera if the build's did not stand upright,
    as one that looked at the floor.

    Args:
        poses: of the build's camera, (N, 4, 4).
        down_world: direction of gravity, (3,) unit vector; None where it is not known: then no camera
            counts as turned.
    """

    def __init__(self, poses: FloatArray, down_world: FloatArray | None) -> None:
        self._down_world = np.zeros(3) if down_world is None else down_world
        in_image, is_upright = self._seen_by(poses)
        self._is_known = len(poses) > 0 and float((in_image & is_upright).mean()) >= _LEAST_SHARE

    def is_turned(self, pose: FloatArray) -> bool:
        """Of a camera at ``T_world_camera``, (4, 4)."""
        in_image, is_upright = self._seen_by(pose[None])
        return self._is_known and bool(in_image[0] and not is_upright[0])

    def _seen_by(self, poses: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether gravity is along the image of cameras (N, 4, 4), and then points to its lower edge, (N,) each."""
        right, down, _ = (poses[:, :3, :3].transpose(0, 2, 1) @ self._down_world).T
        length = np.hypot(right, down)
        return length > LEAST_IN_IMAGE, down >= _LEAST_UPRIGHT * length
