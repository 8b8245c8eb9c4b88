"""Times of a map of a whole floor, compared with those of one of its rooms."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, se3_exp, transform
from monoloc.landmarks.features import Keypoints
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import PRIOR_COVARIANCE
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.scan import uniform_scan
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress
from monoloc_lab.bench.scenes import Weighing, building, copies_m, weighing
from monoloc_lab.bench.timing import one_thread

_CAMERA = Camera(402, 301, 330.0, 330.0, 200.5, 150.0)  # as keypoints are detected
_CHANGED_BITS, _PIXEL_SD = 0.1, 1.0  # of a landmark that is seen again
_TRACKING_SD_M, _TRACKING_SD_RAD = 0.03, 0.015  # of the particles
_FOUND_M = 3.0
_SEEN, _STRAYS = 300, 300  # keypoints of landmarks, and others


@dataclass(frozen=True)
class FloorSizes:
    """Components and landmarks of a room and of the floor, particles and scan points, and runs of each work."""

    room_components: int = 200
    floor_components: int = 100_000
    room_landmarks: int = 5_000
    floor_landmarks: int = 200_000
    particles: int = 300
    points: int = 200
    rounds: int = 5


@dataclass(frozen=True)
class FloorFigures:
    """JSON keys of ``monoloc bench floor``. Times are processor times of one thread, but for ``index_s``.

    Attributes:
        index_s, index_processor_s: building the index of the floor's map, on all cores: time that passes, and the
            sum over cores.
        unknown_start_s: finding the camera among all landmarks, from the keypoints of one image.
        landmarks_ms, landmarks_ratio: measuring the pose near a prior, and that time over a room's.
        weighing_ms, weighing_ratio: the same of weighing the particles of a camera that is tracked, along rays.
    """

    index_s: float
    index_processor_s: float
    unknown_start_s: float
    landmarks_ms: float
    landmarks_ratio: float
    weighing_ms: float
    weighing_ratio: float


def bench_floor(cloud: FloatArray, sizes: FloorSizes, rng: np.random.Generator, progress: Progress) -> FloorFigures:
    """Measure a floor of copies of the room with a cloud (N, 3)."""
    with progress.task("floor", 4) as done, one_thread():
        room = fit_mixture(cloud, sizes.room_components, rng).mixture
        floor = building(room, sizes.floor_components, rng)
        done(1)
        began_s = time.perf_counter()
        index_processor_s = _seconds(floor.index, 1)
        index_s = time.perf_counter() - began_s
        done(2)
        given = weighing(cloud, sizes.particles, sizes.points, rng)
        twists = rng.standard_normal((sizes.particles, 6)) * np.repeat([_TRACKING_SD_M, _TRACKING_SD_RAD], 3)
        given = replace(given, poses=given.poses[0] @ se3_exp(twists))
        weighing_s = [_seconds(_weigher(each, given), sizes.rounds) for each in (room, floor)]
        done(3)
        pose = given.poses[0]
        few = _landmarks(cloud, room, sizes.room_landmarks, 1, rng)
        many = _landmarks(cloud, room, sizes.room_landmarks, -(-sizes.floor_landmarks // sizes.room_landmarks), rng)
        seconds, starts_s = [], []
        for each in (few, many):
            localizer, seen = OrbLandmarkLocalizer(each, _CAMERA), _seen(each, pose, rng)
            starts_s.append(_seconds(partial(localizer.relocalize, seen), 2))
            near_prior = partial(localizer.measure_near, seen, pose, PRIOR_COVARIANCE)
            seconds.append(_seconds(near_prior, sizes.rounds))
        done(4)
    return FloorFigures(
        index_s=index_s,
        index_processor_s=index_processor_s,
        unknown_start_s=starts_s[1],
        landmarks_ms=1e3 * seconds[1],
        landmarks_ratio=seconds[1] / seconds[0],
        weighing_ms=1e3 * weighing_s[1],
        weighing_ratio=weighing_s[1] / weighing_s[0],
    )


def _weigher(mixture: GaussianMixture, given: Weighing) -> Callable[[], object]:
    likelihood, scan = RayLikelihood(mixture, LikelihoodConfig()), uniform_scan(given.scan)
    return lambda: likelihood.mean_log_likelihood(given.poses, given.log_scales, scan)


def _landmarks(
    cloud: FloatArray, room: GaussianMixture, count: int, rooms: int, rng: np.random.Generator
) -> Landmarks:
    """Landmarks all over so many copies of a room, the first of which is the room; each has its own descriptor.

    A view from the middle of each copy found those within _FOUND_M.
    """
    lower, upper = room.bounds_m()
    number = np.repeat(np.arange(rooms), count)
    offsets = copies_m(room, rooms)[number]
    points = (cloud[rng.integers(len(cloud), size=len(number))] + offsets).astype(np.float32)
    poses = np.tile(np.eye(4), (rooms, 1, 1))
    poses[:, :3, 3] = 0.5 * (lower + upper) + offsets[::count]
    found = np.linalg.norm(points - poses[:, None, :3, 3], axis=2) < _FOUND_M
    descriptors = rng.integers(0, 256, (len(number), 32), dtype=np.uint8)
    return Landmarks(points, descriptors, LandmarkViews(poses, found))


def _seen(landmarks: Landmarks, pose: FloatArray, rng: np.random.Generator) -> Keypoints:
    """Keypoints of an image at a pose: of landmarks nearby, with other bits and elsewhere by a little, and strays."""
    local = transform(invert(pose), landmarks.points)
    near = np.flatnonzero(_CAMERA.in_sight(local) & (local[:, 2] < 5.0))
    chosen = rng.choice(near, _SEEN, replace=False)
    pixels = _CAMERA.project(local[chosen]) + rng.normal(0.0, _PIXEL_SD, (_SEEN, 2))
    changed = np.packbits(rng.uniform(size=(_SEEN, 256)) < _CHANGED_BITS, axis=1)
    strays = rng.uniform((0.0, 0.0), (_CAMERA.width - 1.0, _CAMERA.height - 1.0), (_STRAYS, 2))
    others = rng.integers(0, 256, (_STRAYS, 32), dtype=np.uint8)
    return Keypoints(
        np.concatenate([pixels, strays]),
        np.concatenate([landmarks.descriptors[chosen] ^ changed, others]),
        np.full(_SEEN + _STRAYS, _PIXEL_SD),
    )


def _seconds(work: Callable[[], object], rounds: int) -> float:
    """Processor time of the fastest of some runs."""
    taken = []
    for _ in range(rounds):
        started = time.process_time()
        work()
        taken.append(time.process_time() - started)
    return min(taken)
