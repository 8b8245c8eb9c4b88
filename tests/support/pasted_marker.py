"""A real recording with a printed marker in it: on a flat surface of the room, fixed to it by corners of the images.

Perspective and lens are the camera's, each pixel is an average over its area and over the exposure, what stands
before the surface hides the marker, and its paper is white in the image's light. Poses of real recordings are too
noisy to hold a marker still: it would move by centimetres over the wall that it is on. So each frame is placed by
corners that it shares with one frame, at the depth that the sensor measured there.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, se3_log, so3_exp, transform
from monoloc.io.recording import Recording

_CELL_PX, _MARGIN = 24, 0.2  # of the printed sheet: pixels of a cell, and white border, share of the marker's side
_SAMPLES = 3  # of a pixel, along each axis
_MOMENTS = 5  # of an exposure
_EXPOSURE = 0.25  # of the interval between frames
_OPTICS_PX = 0.7  # standard deviation of the lens's blur
_PAPER, _BLACK, _NOISE = 90.0, 0.1, 2.0  # percentile of the image; ink to paper; standard deviation, of 255
_FLAT_M, _HIDDEN_M = 0.01, 0.06  # residual of a flat surface; what stands so far before it hides it
_LEAST_SHARED = 40  # corners of a frame with the one that tells the place
_LEAST_COSINE = 0.5  # of the angle at which the surface is seen where it is found


class MarkedRecording:
    """A :class:`monoloc.io.recording.Recording` with an AprilTag of the family 36h11, and neither poses nor depth.

    Args:
        source: with depth.
        T_marker_camera: of each frame, (N, 4, 4); NaN where it does not show the marker. The marker's x is right and
            its y up on the sheet.
        size_m: side of the black square.
        number: of the marker.
    """

    def __init__(self, source: Recording, T_marker_camera: FloatArray, size_m: float, number: int = 7) -> None:
        self.source = source
        self.name, self.camera = f"{source.name} with a marker", source.camera
        self.frame_names, self.timestamps_s = source.frame_names, source.timestamps_s
        self.poses, self.has_depth = None, False
        self._poses, self._size_m = T_marker_camera, size_m
        self._sheet = _sheet(number)
        self._marked: dict[int, NDArray[np.uint8]] = {}

    def __len__(self) -> int:
        return len(self.source)

    def depth(self, index: int) -> NDArray[np.float32]:
        raise NotImplementedError

    def color(self, index: int) -> NDArray[np.uint8]:
        if index not in self._marked:
            self._marked[index] = self._with_marker(index)
        return self._marked[index]

    def _with_marker(self, index: int) -> NDArray[np.uint8]:
        color, camera = self.source.color(index), self.camera
        if not np.isfinite(self._poses[index]).all():
            return color
        half = (0.5 + _MARGIN) * self._size_m
        corners = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
        at_corners = transform(invert(self._poses[index]), corners)
        if at_corners[:, 2].min() < 0.2:
            return color
        pixels = camera.project(at_corners)
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 12, 0)
        high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 13, [camera.width, camera.height])
        if np.any(high <= low):
            return color
        area = np.s_[low[1] : high[1], low[0] : high[0]]
        moments = np.linspace(-0.5, 0.5, _MOMENTS) * _EXPOSURE
        printed, covered = np.mean([self._seen(index, moment, low, high) for moment in moments], axis=0)
        printed, covered = (cv2.GaussianBlur(image, (0, 0), _OPTICS_PX) for image in (printed, covered))
        covered = covered * self._is_before(index)[area]
        patch = color[area].astype(np.float64)
        paper = np.percentile(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), _PAPER)
        noise = np.random.default_rng(index).normal(0.0, _NOISE, patch.shape)
        inked = paper * (printed / np.maximum(covered, 1e-3))[..., None] + noise
        marked = color.copy()
        mixed = patch + covered[..., None] * (inked - patch)
        marked[area] = np.clip(mixed.round(), 0, 255).astype(np.uint8)
        return marked

    def _pose(self, index: int, moment: float) -> FloatArray:
        """``T_marker_camera`` at a part of the interval to the next frame, or to the one before."""
        pose = self._poses[index]
        other = self._poses[min(max(index + (1 if moment > 0.0 else -1), 0), len(self) - 1)]
        if not np.isfinite(other).all():
            return np.asarray(pose)
        return np.asarray(pose @ se3_exp(abs(moment) * se3_log(invert(pose) @ other)))

    def _seen(
        self, index: int, moment: float, low: NDArray[np.int64], high: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Brightness times coverage, and coverage by the sheet, of the pixels from ``low`` to ``high``."""
        offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        columns = (np.arange(low[0], high[0])[:, None] + offsets).ravel()
        rows = (np.arange(low[1], high[1])[:, None] + offsets).ravel()
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
        T_marker_camera = self._pose(index, moment)
        rays = self.camera.rays(pixels.reshape(-1, 2)).reshape(*pixels.shape[:2], 3) @ T_marker_camera[:3, :3].T
        at = T_marker_camera[:3, 3] - rays * (T_marker_camera[2, 3] / rays[..., 2])[..., None]
        cells = at[..., :2] / self._size_m * [1.0, -1.0] + 0.5 + _MARGIN
        side = self._sheet.shape[0] / (1.0 + 2.0 * _MARGIN)
        where = (cells * side - 0.5).astype(np.float32)
        inside = np.all((cells > 0.0) & (cells < 1.0 + 2.0 * _MARGIN), axis=-1).astype(np.float64)
        ink = cv2.remap(self._sheet, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        shape = (high[1] - low[1], _SAMPLES, high[0] - low[0], _SAMPLES)
        printed, covered = (image.reshape(shape).mean(axis=(1, 3)) for image in (ink * inside, inside))
        return printed, covered

    def _is_before(self, index: int) -> NDArray[np.float64]:
        """Where nothing stands before the marker's plane, (H, W); where the depth is unknown, nothing does."""
        T_camera_marker = invert(self._poses[index])
        normal, origin = T_camera_marker[:3, 2], T_camera_marker[:3, 3]
        plane = (normal @ origin) / (self.camera.pixel_rays() @ normal)
        depth = cv2.medianBlur(self.source.depth(index), 5)
        free = ((depth == 0.0) | (depth > plane - _HIDDEN_M)).astype(np.float32)
        return np.asarray(cv2.GaussianBlur(free, (0, 0), _OPTICS_PX), dtype=np.float64)


def _sheet(number: int) -> NDArray[np.float32]:
    """The printed sheet, brightness 0 to 1."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    side = _CELL_PX * 10  # 8 cells of the marker are so divided into whole pixels
    marker = cv2.aruco.generateImageMarker(dictionary, number, side).astype(np.float32) / 255.0
    sheet = np.pad(marker, round(_MARGIN * side), constant_values=1.0)
    return np.asarray(_BLACK + (1.0 - _BLACK) * sheet, dtype=np.float32)


def flat_place(recording: Recording, size_m: float, rng: np.random.Generator) -> tuple[int, FloatArray]:
    """A frame, and ``T_camera_marker`` in it, (4, 4), of a random flat place by the sensor's depth.

    Raises:
        ValueError: none was found.
    """
    camera = recording.camera
    rays = camera.pixel_rays()
    for _ in range(2000):
        index = int(rng.integers(len(recording)))
        depth = recording.depth(index)
        column, row = int(rng.integers(80, camera.width - 80)), int(rng.integers(80, camera.height - 80))
        if not 0.6 < depth[row, column] < 3.5:
            continue
        half = round((0.5 + _MARGIN) * size_m * camera.focal_px / float(depth[row, column]))
        if not (half <= column < camera.width - half and half <= row < camera.height - half):
            continue
        window = np.s_[row - half : row + half + 1, column - half : column + half + 1]
        known = depth[window] > 0.0
        if known.mean() < 0.8:
            continue
        points = (rays[window] * depth[window][..., None])[known]
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
        normal *= -np.sign(normal @ centre)
        facing = -(normal @ centre) / np.linalg.norm(centre)
        if np.percentile(np.abs((points - centre) @ normal), 90.0) > _FLAT_M or facing < _LEAST_COSINE:
            continue
        right = np.cross([0.0, 1.0, 0.0], -normal)
        right /= np.linalg.norm(right)
        return index, make_pose(np.stack([right, np.cross(normal, right), normal], axis=1), centre)
    raise ValueError("there is no flat place")


def poses_in(recording: Recording, reference: int) -> FloatArray:
    """``T_reference_camera`` of each frame, (N, 4, 4), by corners shared with a frame that has depth; NaN without."""
    camera, sift, matcher = recording.camera, cv2.SIFT.create(2000), cv2.BFMatcher()
    pixels, known = sift.detectAndCompute(_gray(recording, reference), None)
    at = np.array([point.pt for point in pixels])
    depth = recording.depth(reference)[tuple(np.round(at[:, ::-1]).astype(int).T)].astype(np.float64)
    points = camera.rays(at) * depth[:, None]
    poses = np.full((len(recording), 4, 4), np.nan)
    for index in range(len(recording)):
        found, descriptors = sift.detectAndCompute(_gray(recording, index), None)
        pairs = [] if descriptors is None else matcher.knnMatch(descriptors, known, 2)
        good = [a for a, b in pairs if a.distance < 0.75 * b.distance and depth[a.trainIdx] > 0.0]
        if len(good) < _LEAST_SHARED:
            continue
        seen, matrix, distortion = camera.for_pnp(np.array([found[match.queryIdx].pt for match in good]))
        there = points[[match.trainIdx for match in good]]
        cv2.setRNGSeed(0)
        ok, turn, shift, inliers = cv2.solvePnPRansac(there, seen, matrix, distortion, reprojectionError=2.0)
        if ok and len(inliers) >= _LEAST_SHARED:
            kept = inliers[:, 0]
            turn, shift = cv2.solvePnPRefineLM(there[kept], seen[kept], matrix, distortion, turn, shift)
            poses[index] = invert(make_pose(so3_exp(np.ravel(turn)), np.ravel(shift)))
    return poses


def _gray(recording: Recording, index: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def marked(recording: Recording, size_m: float, seed: int) -> MarkedRecording:
    """The recording with marker 7 in a random flat place; see :func:`flat_place`."""
    index, T_camera_marker = flat_place(recording, size_m, np.random.default_rng(seed))
    return MarkedRecording(recording, invert(T_camera_marker) @ poses_in(recording, index), size_m)
