"""Classical localisation: ORB or SIFT keypoints matched with those of posed RGB-D frames, and PnP-RANSAC.

A baseline without learning. Sources: Rublee et al., *ORB* (ICCV 2011); Lowe, *Distinctive Image
Features from Scale-Invariant Keypoints* (IJCV 2004), with the ratio test for both; Gao et al., *Complete Solution
Classification for the Perspective-Three-Point Problem* (PAMI 2003); Fischler & Bolles, *RANSAC* (1981). Frames of the
map are retrieved by votes of the image's strongest keypoints, as in Schindler et al., *City-Scale Location
Recognition* (CVPR 2007), without their vocabulary tree, which a room does not need.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.camera import Camera
from monoloc.contrast import equaliser
from monoloc.depth.depth_image import sample_depth
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp, transform
from monoloc.io.recording import Recording
from monoloc.progress import Progress


class KeypointConfig(BaseModel):
    """Settings of map and localisation; pixels are of the full image.

    Attributes:
        kind: of keypoint and descriptor.
        keypoints: largest number per image.
        voters: number of the strongest keypoints of an image that vote for frames of the map.
        retrieved: number of frames of the map that are then matched in full.
        ratio: Lowe's ratio test: best over second best distance.
        reprojection_px: inlier threshold of RANSAC.
        iterations: largest number of RANSAC iterations.
        min_inliers: smallest number of keypoints of the image, each counted once, that a pose rests on.
        depth_jump: the map leaves out keypoints at a relative jump of depth above this.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["orb", "sift"] = "orb"
    keypoints: int = Field(1000, ge=10)
    voters: int = Field(200, ge=1)
    retrieved: int = Field(5, ge=1)
    ratio: float = Field(0.8, gt=0.0, le=1.0)
    reprojection_px: float = Field(3.0, gt=0.0)
    iterations: int = Field(1000, ge=1)
    min_inliers: int = Field(12, ge=6)
    depth_jump: float = Field(0.15, gt=0.0)


@dataclass(frozen=True)
class KeypointMap:
    """Keypoints of K posed frames, P in all.

    Attributes:
        points: (P, 3) float32, world frame.
        descriptors: (P, D) uint8.
        starts: (K + 1,), frame k has the keypoints starts[k] to starts[k + 1].
    """

    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    starts: NDArray[np.int64]

    @property
    def bytes(self) -> int:
        """Size of the map."""
        return self.points.nbytes + self.descriptors.nbytes + self.starts.nbytes


def build_keypoint_map(recording: Recording, config: KeypointConfig, progress: Progress) -> KeypointMap:
    """Keypoints of every frame, back-projected with its depth.

    Raises:
        DataError: no poses, no depth, or no frame with enough keypoints that have depth.
    """
    if recording.poses is None or not recording.has_depth:
        lacking = "no poses" if recording.poses is None else "no depth"
        raise DataError(recording.name, f"has {lacking}", "build from posed frames with depth")
    detector = _Detector(config)
    points, descriptors, counts = [], [], []
    with progress.task("keypoints", len(recording)) as show:
        for index in range(len(recording)):
            pixels, found = detector(recording.color(index))
            camera = recording.camera
            depth = sample_depth(pixels, camera, recording.depth(index), camera, config.depth_jump)
            lifted = depth > 0.0
            local = camera.rays(pixels[lifted]) * depth[lifted, None]
            points.append(transform(recording.poses[index], local).astype(np.float32))
            descriptors.append(found[lifted])
            counts.append(int(lifted.sum()))
            show(index + 1)
    if max(counts, default=0) < config.min_inliers:
        raise DataError(recording.name, "has no frame with enough keypoints", "build from lit frames with texture")
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return KeypointMap(np.concatenate(points), np.concatenate(descriptors), starts)


class KeypointLocalizer:
    """Localises single images of one camera; call it with each."""

    def __init__(self, room: KeypointMap, camera: Camera, config: KeypointConfig) -> None:
        self._map, self._camera, self._config = room, camera, config
        self._detector = _Detector(config)
        self._frames = np.repeat(np.arange(len(room.starts) - 1), np.diff(room.starts))

    def __call__(self, color: NDArray[np.uint8]) -> FloatArray | None:
        """``T_world_camera`` (4, 4) of an image (H, W, 3) uint8 RGB; None if too few keypoints agree."""
        pixels, descriptors = self._detector(color)
        if len(pixels) < self._config.min_inliers:
            return None
        seen, matched = [], []
        for frame in self._retrieve(descriptors):
            first, last = self._map.starts[frame], self._map.starts[frame + 1]
            query, index = _match(descriptors, self._map.descriptors[first:last], self._config)
            seen.append(query)
            matched.append(self._map.points[first + index])
        points_world = np.concatenate(matched).astype(np.float64)
        return self._solve(points_world, pixels.astype(np.float64), np.concatenate(seen))

    def _retrieve(self, descriptors: NDArray[np.uint8]) -> NDArray[np.int64]:
        """The frames of the map with the most votes; frames without a vote are left out."""
        nearest, _ = _nearest(descriptors[: self._config.voters], self._map.descriptors, self._config, 1)
        voted = self._frames[nearest[:, 0]]
        votes = np.bincount(voted, minlength=len(self._map.starts) - 1)
        best = np.argsort(-votes, kind="stable")[: self._config.retrieved]
        return np.asarray(best[votes[best] > 0], dtype=np.int64)

    def _solve(self, points_world: FloatArray, pixels: FloatArray, seen: NDArray[np.int64]) -> FloatArray | None:
        """The pose from points (M, 3) m seen at pixels[seen], (N, 2) and (M,); points may share a keypoint."""
        config = self._config
        if len(np.unique(seen)) < config.min_inliers:
            return None
        pixels, K, distortion = self._camera.for_pnp(pixels[seen])
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            points_world,
            pixels,
            K,
            distortion,
            iterationsCount=config.iterations,
            reprojectionError=config.reprojection_px,
            confidence=0.999,
            flags=cv2.SOLVEPNP_P3P,
        )
        if not ok or inliers is None or len(np.unique(seen[inliers])) < config.min_inliers:
            return None
        chosen = inliers.ravel()
        rotation, translation = cv2.solvePnPRefineLM(
            points_world[chosen], pixels[chosen], K, distortion, rotation, translation
        )
        T_camera_world = make_pose(so3_exp(rotation.ravel()), translation.ravel())
        return invert(T_camera_world) if np.all(np.isfinite(T_camera_world)) else None


class _Detector:
    """Detects the keypoints of an image, strongest first."""

    def __init__(self, config: KeypointConfig) -> None:
        library: Any = cv2  # its stubs lack both
        create = {"orb": library.ORB_create, "sift": library.SIFT_create}[config.kind]
        self._feature = create(nfeatures=config.keypoints)
        # As in monoloc's odometry: without it, dim images have no keypoints.
        self._equalise = equaliser()

    def __call__(self, color: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Pixels (N, 2) and descriptors (N, D) of an image (H, W, 3) RGB."""
        gray = self._equalise.apply(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
        keypoints, descriptors = self._feature.detectAndCompute(gray, None)
        if descriptors is None:
            return np.zeros((0, 2), np.float32), np.zeros((0, self._feature.descriptorSize()), np.uint8)
        order = np.argsort([-keypoint.response for keypoint in keypoints], kind="stable")
        pixels = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float32)
        return pixels[order], np.ascontiguousarray(descriptors.astype(np.uint8)[order])


def _nearest(
    query: NDArray[np.uint8], train: NDArray[np.uint8], config: KeypointConfig, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The nearest of T descriptors for each of Q, nearest first: indices and distances, (Q, count) each."""
    if config.kind == "orb":
        distances, indices = cv2.batchDistance(query, train, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=count)
        return np.asarray(indices, dtype=np.int64), np.asarray(distances, dtype=np.float32)
    # A matrix product: OpenCV takes ten times as long.
    a, b = query.astype(np.float32), train.astype(np.float32)
    squared = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * (a @ b.T)
    few = np.argpartition(squared, count - 1, axis=1)[:, :count]
    nearest = np.take_along_axis(squared, few, axis=1)
    order = np.argsort(nearest, axis=1)
    distances = np.sqrt(np.maximum(np.take_along_axis(nearest, order, axis=1), 0.0))
    return np.take_along_axis(few, order, axis=1), distances


def _match(
    query: NDArray[np.uint8], train: NDArray[np.uint8], config: KeypointConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of descriptors that pass the ratio test: their indices, (M,) each."""
    if len(train) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    indices, distances = _nearest(query, train, config, 2)
    passed = np.flatnonzero(distances[:, 0] < config.ratio * distances[:, 1])
    return passed, indices[passed, 0]
