"""Choice of the frames that a build uses of a long recording: those that show most of the room.

Half of them are stretches of frames in a row, on which the bias of the particles can be measured forward and
backward. The others are chosen one by one by what they add: surfaces, the directions and distances that these are
seen from, and places of the camera. Greedy choice covers at least 63 % of what the best choice would (Nemhauser,
Wolsey and Fisher 1978).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.trajectories import LONG_FRAMES, can_be_followed
from monoloc.geometry import FloatArray, invert, pose_distance_m, rotation_angle, transform
from monoloc.io.recording import Recording, evenly_spaced, narrowed
from monoloc.progress import Progress

_CANDIDATES = 2  # times the frames that are wanted: so many depth images are read
_STRETCH_SHARE = 0.5  # of the frames
_STRETCH_PERIOD_S, _STRETCH_STEP_M = 0.25, 0.02  # at least, between frames of a stretch; pose distance
_STRETCH_FRAMES = LONG_FRAMES + 1
_CELL_M, _GRID = 0.25, (8, 6)  # of surfaces and places; pixels of a depth image that are looked at
_DIRECTION_STEPS = 2.0  # of a unit vector's coordinates, to each side
_NEAREST_M = 1e-3

Cell = tuple[int, ...]
"""A place, the direction in which it is seen, and from how far."""


def choose_frames(recording: Recording, most: int, progress: Progress) -> Recording:
    """The recording, or at most so many of its frames.

    Args:
        recording: posed frames.
        most: frames, at least 1.
        progress: shows the number of depth images read.

    Raises:
        DataError: a frame cannot be read.
    """
    if len(recording) <= most:
        return recording
    poses = recording.poses
    assert poses is not None
    candidates = _along_the_path(poses, _CANDIDATES * most)
    with progress.task("choose frames", len(candidates)) as show:
        cells = _cells_of(recording, poses, candidates, show)
    order = _spread_order(len(candidates))  # of candidates that add the same, the first counts
    candidates, cells = candidates[order], [cells[index] for index in order.tolist()]
    stretches = _stretches(candidates, cells, recording.timestamps_s, poses, round(_STRETCH_SHARE * most))
    within = np.zeros(len(recording), dtype=np.bool_)
    for stretch in stretches:
        within[stretch[0] : stretch[-1] + 1] = True
    taken = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *stretches]))
    covered = set[Cell]().union(*(cells[index] for index in np.flatnonzero(within[candidates]).tolist()))
    free = np.flatnonzero(~np.isin(candidates, taken))
    chosen = free[most_covering([cells[index] for index in free.tolist()], most - len(taken), covered)]
    chosen = np.append(chosen, free[~np.isin(free, chosen)][: most - len(taken) - len(chosen)])
    frames = np.union1d(taken, candidates[chosen])
    return narrowed(recording, frames)


def most_covering(sets: list[set[Cell]], count: int, covered: Iterable[Cell] = ()) -> list[int]:
    """Indices of sets, each of which adds most to those before it and to what is covered, as long as one adds any."""
    known = set(covered)
    heap = [(-len(each), index) for index, each in enumerate(sets)]
    heapq.heapify(heap)
    chosen: list[int] = []
    while heap and len(chosen) < count:
        _, index = heapq.heappop(heap)
        gain = len(sets[index] - known)
        # What a set adds only falls: if it still leads with what it adds now, no other can add more.
        if heap and (-gain, index) > heap[0]:
            heapq.heappush(heap, (-gain, index))
            continue
        if gain == 0:
            break
        chosen.append(index)
        known |= sets[index]
    return chosen


def spread_stretches(count: int, times_s: FloatArray, poses: FloatArray) -> NDArray[np.int64]:
    """Frames of at most so many stretches in a row, spread over a recording, along each of which it can be followed.

    Args:
        times_s, poses: of all its frames, (N,) and (N, 4, 4).
    """
    middles = evenly_spaced(len(poses), count + 2)[1:-1].tolist() or [0]
    frames = np.zeros(0, dtype=np.int64)
    for middle in middles:
        if middle > frames.max(initial=-1):  # else it is in the stretch before
            frames = np.union1d(frames, _stretch_around(middle, times_s, poses))
    return frames


def _along_the_path(poses: FloatArray, count: int) -> NDArray[np.int64]:
    """At most so many frames, at equal steps of pose distance travelled: a camera that stands adds few.

    Of a camera that hardly moved, frames at equal steps of time too, so that there are some to measure with.
    """
    steps = invert(poses[:-1]) @ poses[1:]
    travelled = np.cumsum(np.linalg.norm(steps[:, :3, 3], axis=1) + rotation_angle(steps[:, :3, :3]))
    targets = np.linspace(0.0, travelled[-1], min(count, len(poses)))
    frames = np.unique(np.searchsorted(np.concatenate([[0.0], travelled]), targets))
    few = min(count // 2, LONG_FRAMES)
    return frames if len(frames) >= few else np.union1d(frames, evenly_spaced(len(poses), few))


def _spread_order(count: int) -> NDArray[np.int64]:
    """Indices below a count in an order whose every beginning is spread over them (van der Corput 1935)."""
    bits = count.bit_length()
    return np.argsort([int(f"{index:0{bits}b}"[::-1], 2) for index in range(count)])


def _cells_of(
    recording: Recording, poses: FloatArray, frames: NDArray[np.int64], show: Callable[[int], None]
) -> list[set[Cell]]:
    """Cells of each frame: the camera's place and direction, and with depth the surfaces that it sees."""
    camera = recording.camera
    columns, rows = (
        ((np.arange(count) + 0.5) * size / count).astype(np.int64)
        for count, size in zip(_GRID, (camera.width, camera.height), strict=True)
    )
    rays = camera.pixel_rays()[np.ix_(rows, columns)]
    cells = []
    for done, index in enumerate(frames.tolist()):
        pose = poses[index]
        seen = _cells(pose[None, :3, 3], pose[None, :3, 2], np.full(1, _NEAREST_M))
        if recording.has_depth:
            depth_m = recording.depth(index)[np.ix_(rows, columns)].astype(np.float64)
            points = (rays * depth_m[..., None])[depth_m > 0.0]
            points_world = transform(pose, points)
            offsets = points_world - pose[:3, 3]
            ranges_m = np.maximum(np.linalg.norm(offsets, axis=1), 2.0 * _NEAREST_M)
            seen |= _cells(points_world, offsets / ranges_m[:, None], ranges_m)
        cells.append(seen)
        show(done + 1)
    return cells


def _cells(places: FloatArray, directions: FloatArray, ranges_m: FloatArray) -> set[Cell]:
    """Cells of places (N, 3), unit directions (N, 3) and ranges (N,)."""
    numbers = [
        np.floor(places / _CELL_M),
        np.rint(_DIRECTION_STEPS * directions),
        np.floor(np.log2(ranges_m))[:, None],
    ]
    return set(map(tuple, np.column_stack(numbers).astype(np.int64).tolist()))


def _stretches(
    candidates: NDArray[np.int64], cells: list[set[Cell]], times_s: FloatArray, poses: FloatArray, most: int
) -> list[NDArray[np.int64]]:
    """Stretches of frames in a row, at most so many together, around the candidates that cover most."""
    stretches: list[NDArray[np.int64]] = []
    for index in most_covering(cells, len(cells)):
        if (len(stretches) + 1) * _STRETCH_FRAMES > most:
            break
        middle = int(candidates[index])
        if any(stretch[0] <= middle <= stretch[-1] for stretch in stretches):
            continue
        stretch = _stretch_around(middle, times_s, poses)
        if len(stretch) >= LONG_FRAMES:
            stretches.append(stretch)
    return stretches


def _stretch_around(middle: int, times_s: FloatArray, poses: FloatArray) -> NDArray[np.int64]:
    """Frames in a row around one, apart in time, as far as a camera can be followed."""
    before = _followed(middle, -1, _STRETCH_FRAMES // 2, times_s, poses)
    after = _followed(middle, 1, _STRETCH_FRAMES - 1 - len(before), times_s, poses)
    return np.array([*before[::-1], middle, *after], dtype=np.int64)


def _followed(start: int, step: int, count: int, times_s: FloatArray, poses: FloatArray) -> list[int]:
    frames = [start]
    index = start + step
    while 0 <= index < len(times_s) and len(frames) <= count:
        last = frames[-1]
        moved_m = pose_distance_m(poses[last], poses[index : index + 1])[0]
        if abs(times_s[index] - times_s[last]) >= _STRETCH_PERIOD_S and moved_m >= _STRETCH_STEP_M:
            pair = sorted((last, index))
            if not can_be_followed(times_s[pair], poses[pair]):
                break
            frames.append(index)
        index += step
    return frames[1:]
