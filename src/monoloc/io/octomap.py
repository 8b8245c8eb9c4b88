"""Writer of OctoMap's binary trees, .bt: which voxels are occupied, which are free; what is in none is unknown.

Format: https://github.com/OctoMap/octomap, OccupancyOcTreeBase::writeBinaryNode. A node is two bytes, two bits for
each of its eight children: 0 unknown, 1 free, 2 occupied, 3 with children of its own, which follow depth first. Child
i is in the upper half along x if bit 0 of i is set, along y for bit 1, along z for bit 2. The tree is 16 levels deep,
and the frame's origin is in its middle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import SettingError
from monoloc.files import write_whole

_LEVELS = 16
_MIDDLE = 1 << (_LEVELS - 1)
_FREE, _OCCUPIED, _INNER = 1, 2, 3
_HEADER = """\
# Octomap OcTree binary file
# (feel free to add / change comments, but leave the first line as it is!)
#
id OcTree
size {size}
res {voxel_m:.9g}
data
"""


def write_octomap(path: Path, occupied: NDArray[np.int64], free: NDArray[np.int64], voxel_m: float) -> None:
    """Write a tree; eight children in the same state become one.

    Args:
        path: of the file.
        occupied, free: indices of voxels, (N, 3) and (M, 3), apart; index i begins at ``i * voxel_m`` on its axis.
        voxel_m: edge of a voxel.

    Raises:
        SettingError: a voxel is farther from the origin than the tree reaches.
        DataError: the file cannot be written.
    """
    keys = np.concatenate([occupied, free]) + _MIDDLE
    if len(keys) and (keys.min() < 0 or keys.max() >= 2 * _MIDDLE):
        reach_m = _MIDDLE * voxel_m
        problem = f"is {voxel_m:g}, and an OctoMap of such voxels reaches {reach_m:.0f} m from the origin"
        raise SettingError("voxel_m", problem, "give larger voxels")
    codes = _interleaved(keys)
    states = np.repeat(np.array([_OCCUPIED, _FREE], dtype=np.int64), [len(occupied), len(free)])
    order = np.argsort(codes)
    codes, states = codes[order], states[order]
    levels: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []  # codes of inner nodes and their bits, from below
    size = 0
    for _ in range(_LEVELS):
        size += len(codes)
        parents, first = np.unique(codes >> 3, return_index=True)
        bits = np.add.reduceat(states << (2 * (codes & 7)), first) if len(codes) else np.zeros(0, dtype=np.int64)
        is_leaf = (bits == 0x5555) | (bits == 0xAAAA)
        size -= 8 * int(is_leaf.sum())
        levels.append((parents[~is_leaf], bits[~is_leaf]))
        codes, states = parents, np.where(is_leaf, bits & 3, _INNER)
    content = _HEADER.format(size=size + len(codes), voxel_m=voxel_m).encode() + _depth_first(levels)
    write_whole(path, content)


def _interleaved(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Keys (N, 3) as one number each, three bits a level: the path from the root."""
    codes = np.zeros(len(keys), dtype=np.int64)
    for bit in range(_LEVELS):
        for axis in range(3):
            codes |= ((keys[:, axis] >> bit) & 1) << (3 * bit + axis)
    return codes


def _depth_first(levels: list[tuple[NDArray[np.int64], NDArray[np.int64]]]) -> bytes:
    """Two bytes a node, every node before its children: in order of its path, a node before those that extend it."""
    paths = [codes << (3 * (above + 1)) for above, (codes, _) in enumerate(levels)]
    depths = [np.full(len(codes), _LEVELS - above) for above, (codes, _) in enumerate(levels)]
    order = np.lexsort((np.concatenate(depths), np.concatenate(paths)))
    bits = np.concatenate([bits for _, bits in levels])[order]
    return bits.astype("<u2").tobytes()
