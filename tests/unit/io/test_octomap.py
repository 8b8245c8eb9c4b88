"""OctoMap's binary trees, read back by a reader that follows the format's text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monoloc.io.octomap import write_octomap
from refusals import refuses_setting

State = dict[tuple[int, int, int], int]


def read_octomap(content: bytes) -> tuple[float, int, State]:
    """Edge of a voxel, number of nodes that the header says, and the state of each voxel: 1 free, 2 occupied."""
    header, _, data = content.partition(b"data\n")
    lines = header.decode().splitlines()
    assert lines[0] == "# Octomap OcTree binary file"
    words = dict(line.split() for line in lines if not line.startswith("#"))
    assert words["id"] == "OcTree"
    states: State = {}
    position, nodes = 0, 1

    def node(level: int, corner: tuple[int, int, int]) -> None:
        nonlocal position, nodes
        bits = int.from_bytes(data[position : position + 2], "little")
        position += 2
        edge = 1 << (15 - level)
        inner = []
        for child in range(8):
            state = (bits >> (2 * child)) & 3
            nodes += state > 0
            x, y, z = (corner[axis] + edge * ((child >> axis) & 1) for axis in range(3))
            if state == 3:
                inner.append((x, y, z))
            elif state:
                cells = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
                states.update(dict.fromkeys(map(tuple, (cells + np.array([x, y, z])).tolist()), state))
        for each in inner:
            node(level + 1, each)

    node(0, (-(1 << 15),) * 3)
    assert position == len(data)
    assert nodes == int(words["size"])
    return float(words["res"]), nodes, states


def test_every_voxel_is_read_back_and_equal_ones_become_one(tmp_path: Path) -> None:
    block = np.stack(np.meshgrid(*[np.arange(-8, 8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    lone = np.array([[100, -3, 7], [101, -3, 7], [-2000, 5, 5]])
    write_octomap(tmp_path / "a.bt", lone, block, 0.05)
    voxel_m, nodes, states = read_octomap((tmp_path / "a.bt").read_bytes())
    assert voxel_m == 0.05 and nodes < 300  # 4096 free voxels are eight nodes, and those above them
    expected = {tuple(each): 1 for each in block.tolist()} | {tuple(each): 2 for each in lone.tolist()}
    assert states == expected


def test_voxels_beyond_the_tree_are_refused(tmp_path: Path) -> None:
    far = np.array([[1 << 15, 0, 0]])
    refuses_setting(
        lambda: write_octomap(tmp_path / "a.bt", far, far[:0], 0.01), "voxel_m", "reaches 328 m", "larger voxels"
    )
    assert not list(tmp_path.iterdir())


def test_nothing_is_a_tree_without_nodes(tmp_path: Path) -> None:
    nothing = np.zeros((0, 3), dtype=np.int64)
    write_octomap(tmp_path / "a.bt", nothing, nothing, 0.1)
    assert b"\nsize 0\nres 0.1\ndata\n" in (tmp_path / "a.bt").read_bytes()
