"""Selection of the frames that are held out from tuning, for evaluation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, pose_distance_m

HELD_OUT_SHARE, REGIONS = 0.15, 2  # share of a build's frames; number of regions


def hold_out_regions(poses: FloatArray, regions: int, share: float) -> list[NDArray[np.int64]]:
    """Select regions of poses to hold out; returns the sorted frame indices of each region.

    A region is a frame and the frames nearest to it, chosen so that every other frame is as far from that frame as
    possible. So evaluation happens far from the tuned frames; neighbours in time would show nearly the same image.
    The first frame is never held out, so that a run that starts there reaches the regions with its accumulated
    errors.

    Args:
        poses: (N, 4, 4) ``T_world_camera``, N >= 3.
        regions: number of regions, at least 1; fewer are returned if they would overlap.
        share: share of frames in all regions together, below one half; a region has at least one frame.
    """
    distances_m = np.stack([pose_distance_m(pose, poses) for pose in poses])
    size = max(1, round(len(poses) * share / regions))
    members = 1 + np.argsort(distances_m[1:, 1:], axis=1, kind="stable")[:, :size]
    outside = distances_m[1:].copy()
    np.put_along_axis(outside, members, np.inf, axis=1)
    margin = outside.min(axis=1)
    held_out: list[NDArray[np.int64]] = []
    for _ in range(regions):
        margin[np.isin(members, held_out).any(axis=1)] = -1.0
        chosen = margin.argmax()
        if margin[chosen] >= 0.0:
            held_out.append(np.sort(members[chosen]))
    return held_out
