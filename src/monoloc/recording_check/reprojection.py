"""How far corners land from where they are matched, if depth and relative poses move them.

Errors are shares of the corners' motion, so that they compare between cameras and speeds: 0 is exact, and 1 is as far
off as with no motion at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert, make_pose, so3_exp
from monoloc.recording_check.correspondences import Matches

LEAST_WITH_DEPTH = 15  # matches of a pair
_BEHIND = 100.0  # error, in focal lengths, of a corner behind the camera
_INLIER_PX = 2.0
_AXIS = np.zeros(2)


@dataclass(frozen=True)
class Reprojection:
    """The errors of N pairs; NaN where a pair has no pose or too few corners with depth.

    Attributes:
        shares: (N,) median distance between predicted and matched corners, share of the pair's motion.
    """

    shares: FloatArray

    @property
    def pairs(self) -> int:
        """Number of pairs that were measured."""
        return int(np.isfinite(self.shares).sum())

    @property
    def median(self) -> float:
        """Median over the pairs; infinity if there is none."""
        return float(np.nanmedian(self.shares)) if self.pairs else float("inf")


class Reprojector:
    """Moves the corners of all pairs from the first to the second frame and compares them with their matches."""

    def __init__(self, matches: Matches) -> None:
        self.matches = matches
        self._first, self._second = matches.rays()
        self._of_pairs = [matches.of_pair(index) for index in range(len(matches))]

    def __call__(
        self, T_second_first: FloatArray, depth_m: FloatArray, focal: float = 1.0, fixed: FloatArray = _AXIS
    ) -> Reprojection:
        """Errors of relative poses.

        Args:
            T_second_first: (N, 4, 4) of the pairs; NaN where it is unknown.
            depth_m: (P,) of the corners in the first frame, 0 where it is unknown.
            focal: true over stated focal length.
            fixed: (2,) point at z = 1 of the stated camera whose pixel stays where it is with that focal length; that
                of the principal point by default.
        """
        matches = self.matches
        offset = self._predicted(T_second_first[matches.pair], depth_m, focal, fixed) - self._second[:, :2]
        distance = np.linalg.norm(offset, axis=1) * matches.camera.focal_px
        distance[depth_m <= 0.0] = np.nan
        return Reprojection(np.array([_median(distance[of]) for of in self._of_pairs]) / matches.motion_px)

    def predicted_px(self, T_second_first: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Where the corners are predicted in the second frame, (P, 2) pixels of the matches' camera."""
        rays = self._predicted(T_second_first[self.matches.pair], depth_m)
        return self.matches.camera.project(np.column_stack([rays, np.ones(len(rays))]))

    def _predicted(
        self, T_second_first: FloatArray, depth_m: FloatArray, focal: float = 1.0, fixed: FloatArray = _AXIS
    ) -> FloatArray:
        """Predicted coordinates at z = 1 of the stated camera, (P, 2)."""
        points = self._first.copy()
        points[:, :2] = (points[:, :2] - fixed) / focal + fixed
        points *= depth_m[:, None]
        moved = np.einsum("pij,pj->pi", T_second_first[:, :3, :3], points) + T_second_first[:, :3, 3]
        z = moved[:, 2:]
        seen = focal * (moved[:, :2] / np.where(z > 0.0, z, 1.0) - fixed) + fixed
        return np.asarray(np.where(z > 0.0, seen, _BEHIND))

    def free_motion(self, depth_m: FloatArray) -> FloatArray:
        """Relative poses ``T_second_first`` (N, 4, 4) that the corners alone give by PnP and RANSAC; NaN without."""
        motions = [self._free(index, depth_m) for index in range(len(self.matches))]
        return np.stack(motions) if motions else np.zeros((0, 4, 4))

    def _free(self, index: int, depth_m: FloatArray) -> FloatArray:
        of = self._of_pairs[index]
        known = np.flatnonzero(depth_m[of] > 0.0)
        nothing = np.full((4, 4), np.nan)
        if len(known) < LEAST_WITH_DEPTH:
            return nothing
        points = (self._first[of] * depth_m[of, None])[known]
        seen = self._second[of, :2][known]
        threshold = _INLIER_PX / self.matches.camera.focal_px
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            points, seen, np.eye(3), np.zeros(5),
            iterationsCount=200, reprojectionError=threshold, flags=cv2.SOLVEPNP_EPNP,
        )  # fmt: skip
        if not ok or inliers is None or len(inliers) < LEAST_WITH_DEPTH:
            return nothing
        chosen = inliers.ravel()
        rotation, translation = cv2.solvePnPRefineLM(
            points[chosen], seen[chosen], np.eye(3), np.zeros(5), rotation, translation
        )
        return make_pose(so3_exp(rotation.ravel()), translation.ravel())


def relative_poses(poses: FloatArray, frames: NDArray[np.int64]) -> FloatArray:
    """``T_second_first`` (N, 4, 4) of pairs of frames (N, 2) from ``T_world_camera`` (F, 4, 4)."""
    return invert(poses[frames[:, 1]]) @ poses[frames[:, 0]]


def _median(values: FloatArray) -> float:
    known = np.sort(values[np.isfinite(values)])  # many times faster than np.median of so few
    count = len(known)
    return float(0.5 * (known[(count - 1) // 2] + known[count // 2])) if count >= LEAST_WITH_DEPTH else float("nan")
