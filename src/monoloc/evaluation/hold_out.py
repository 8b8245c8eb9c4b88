"""Which frames are held out from tuning: those to measure with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, pose_distance_m

HELD_OUT_SHARE, REGIONS = 0.15, 2  # of a build's frames


def hold_out_regions(poses: FloatArray, regions: int, share: float) -> list[NDArray[np.int64]]:
    """Regions of viewpoints to be held out, frames of each in order.

    A region is a frame and those nearest to it, chosen so that any other frame is as far from the former as can be:
    what is measured there is measured away from what tuned, where neighbours in time show nearly the same picture.
    The first frame is held out by none, so that a run from there comes to the regions with the errors that it has
    gathered.

    Args:
        poses: (N, 4, 4), N >= 3.
        regions: how many, 1 at least; each takes a frame at least. There are fewer where they would overlap.
        share: of the frames, for all regions together; under a half.
    """
    apart = np.stack([pose_distance_m(pose, poses) for pose in poses])
    size = max(1, round(len(poses) * share / regions))
    members = 1 + np.argsort(apart[1:, 1:], axis=1, kind="stable")[:, :size]
    outside = apart[1:].copy()
    np.put_along_axis(outside, members, np.inf, axis=1)
    margin = outside.min(axis=1)
    held: list[NDArray[np.int64]] = []
    for _ in range(regions):
        margin[np.isin(members, held).any(axis=1)] = -1.0
        chosen = margin.argmax()
        if margin[chosen] >= 0.0:
            held.append(np.sort(members[chosen]))
    return held


def hold_out_blocks(frames: int, blocks: int, share: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split frames in order of time: (training, held out), the latter as blocks spread over the recording.

    Blocks, not single frames: the neighbours of a frame show nearly the same picture.
    """
    length = max(1, round(frames * share / blocks))
    starts = np.linspace(0, frames, blocks + 2)[1:-1] - length / 2
    held = np.unique(np.clip(np.concatenate([np.arange(length) + round(s) for s in starts]), 0, frames - 1))
    return np.setdiff1d(np.arange(frames), held), held
