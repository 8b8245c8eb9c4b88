"""Time of a whole step on a floor, beside that in one of its rooms.

    python benchmarks/floor_step.py BUNDLE SOURCE FRAMES

The floor has copies of a room's map, wall to wall, with 100,000 components, and 200,000 landmarks, of which those of
the copies have descriptors of their own. Both are flown at once, frame by frame, from the true pose. Prints processor
times of one thread, and errors.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import cv2
import numpy as np

from monoloc.bundle import Bundle, read_bundle
from monoloc.geometry import FloatArray
from monoloc.io.registry import open_recording, select_frames
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.localizer import Localizer
from monoloc.start import Start
from monoloc_lab.bench.scenes import building, copies_m
from monoloc_lab.bench.timing import one_thread

COMPONENTS, LANDMARKS = 100_000, 200_000
WARM_UP = 5  # first steps, which are left out


def floor_of(bundle: Bundle, rng: np.random.Generator) -> Bundle:
    """The bundle of a floor, whose first room is that of a bundle with landmarks."""
    room, known = bundle.adapted, bundle.landmarks
    rooms = -(-LANDMARKS // len(known))
    offsets = copies_m(room, rooms)
    points = np.concatenate([known.points + offset for offset in offsets]).astype(np.float32)
    others = rng.integers(0, 256, ((rooms - 1) * len(known), 32), dtype=np.uint8)
    descriptors = np.concatenate([known.descriptors, others])
    views = None if known.views is None else views_of_copies(known.views, offsets)
    return replace(bundle, adapted=building(room, COMPONENTS, rng), landmarks=Landmarks(points, descriptors, views))


def views_of_copies(views: LandmarkViews, offsets: FloatArray) -> LandmarkViews:
    """The views of every copy at its offset, each of which finds landmarks of its copy alone."""
    poses = np.tile(views.poses, (len(offsets), 1, 1))
    poses[:, :3, 3] += np.repeat(offsets, len(views.poses), axis=0)
    return LandmarkViews(poses, np.kron(np.eye(len(offsets), dtype=np.bool_), views.found))


def main(bundle_path: str, source: str, frames: str) -> None:
    cv2.setNumThreads(1)
    bundle = read_bundle(bundle_path)
    recording = select_frames(open_recording(source), frames)
    assert recording.poses is not None, f"{source} has no poses"
    floor = floor_of(bundle, np.random.default_rng(0))
    localizers = [Localizer(each, recording.camera, Start(recording.poses[0]), seed=0) for each in (bundle, floor)]
    seconds, positions = np.empty((len(recording), 2)), np.empty((len(recording), 2, 3))
    elapsed_s = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    with one_thread():
        for index in range(len(recording)):
            color = recording.color(index)
            for which in (0, 1) if index % 2 else (1, 0):
                began = time.process_time()
                step = localizers[which].step(color, float(elapsed_s[index]))
                seconds[index, which] = time.process_time() - began
                positions[index, which] = step.estimate.pose[:3, 3]
    timed = 1e3 * seconds[WARM_UP:]
    errors = np.linalg.norm(positions - recording.poses[:, None, :3, 3], axis=2)
    for name, ms, error in zip(("room", "floor"), timed.T, errors.T, strict=True):
        median, p95 = np.percentile(ms, [50.0, 95.0])
        print(f"{name}: median {median:.1f} ms, 95 % {p95:.1f} ms, RMSE {100 * np.sqrt(np.mean(error**2)):.1f} cm")
    print(f"floor over room: {np.median(timed[:, 1]) / np.median(timed[:, 0]):.2f} of the medians")


if __name__ == "__main__":
    main(*sys.argv[1:])
