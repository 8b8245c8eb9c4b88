"""TUM trajectories: written and read, and compared with evo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc.errors import DataError
from monoloc.geometry import FloatArray, se3_exp
from monoloc.io.pose_files import read_tum
from monoloc.io.tum_trajectory import write_tum

GOOD_LINE = "1.5 1 2 3 0 0 0 1"


def trajectory(seed: int, frames: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return 1.3e9 + np.arange(frames) / 15.0, se3_exp(rng.normal(size=(frames, 6)))


@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 8))
@settings(max_examples=15, deadline=None)
def test_written_trajectory_is_read(tmp_path_factory: pytest.TempPathFactory, seed: int, frames: int) -> None:
    path = tmp_path_factory.mktemp("tum") / "trajectory.txt"
    timestamps_s, poses = trajectory(seed, frames)
    write_tum(path, timestamps_s, poses)
    read_s, read_poses = read_tum(path)
    np.testing.assert_array_equal(read_s, timestamps_s)
    np.testing.assert_allclose(read_poses, poses, atol=1e-8)


def test_evo_reads_the_same_trajectory(tmp_path: Path) -> None:
    timestamps_s, poses = trajectory(3, 20)
    write_tum(tmp_path / "trajectory.txt", timestamps_s, poses)
    theirs = file_interface.read_tum_trajectory_file(str(tmp_path / "trajectory.txt"))
    np.testing.assert_array_equal(theirs.timestamps, timestamps_s)
    np.testing.assert_allclose(np.stack(theirs.poses_se3), poses, atol=1e-8)


def test_comments_and_empty_lines_are_skipped(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text(f"# ground truth\n\n{GOOD_LINE}\n  # more\n2.5\t1 2 3 0 0 0 -1\n")
    timestamps_s, poses = read_tum(path)
    np.testing.assert_array_equal(timestamps_s, [1.5, 2.5])
    np.testing.assert_array_equal(poses[:, :3, 3], [[1, 2, 3], [1, 2, 3]])
    np.testing.assert_array_equal(poses[1, :3, :3], np.eye(3))


def test_rounded_quaternions_give_rotations(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text("0 0 0 0 0.6574 0.6126 -0.2949 -0.3248\n")  # four decimals, as the benchmark's files
    rotation = read_tum(path)[1][0, :3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (f"{GOOD_LINE}\n2.5 1 2 3\n", "line 2 is not 8 numbers"),
        ("1.5 1 two 3 0 0 0 1\n", "line 1 is not 8 numbers"),
        ("1.5 1 2 3 0 0 0 0\n", "pose 1 is not rigid: its quaternion has length 0"),
        ("# nothing\n", "has no lines of numbers"),
        ("", "is empty"),
    ],
)
def test_invalid_file_is_named_with_its_line(tmp_path: Path, content: str, problem: str) -> None:
    path = tmp_path / "trajectory.txt"
    path.write_text(content)
    with pytest.raises(DataError) as caught:
        read_tum(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: {problem}; ")
    assert "\n" not in message


def test_unreadable_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.txt: cannot be read \(No such file or directory\); "):
        read_tum(tmp_path / "none.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match=r"binary\.txt: is not a text file; "):
        read_tum(tmp_path / "binary.txt")


@pytest.mark.parametrize(
    ("timestamps_s", "poses", "message"),
    [
        (np.zeros((1, 1)), np.eye(4)[None], r"timestamps_s must have shape \(N,\), got \(1, 1\)"),
        (np.zeros(2), np.eye(4)[None], r"poses must have shape \(2, 4, 4\), got \(1, 4, 4\)"),
        (np.array([np.nan]), np.eye(4)[None], "timestamps_s must be finite"),
        (np.zeros(1), np.full((1, 4, 4), np.nan), "poses must be rigid, got another matrix in frame 0"),
        (np.zeros(1), 2.0 * np.eye(4)[None], "poses must be rigid"),
    ],
)
def test_invalid_trajectory_is_not_written(
    tmp_path: Path, timestamps_s: FloatArray, poses: FloatArray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        write_tum(tmp_path / "out.txt", timestamps_s, poses)
    assert list(tmp_path.iterdir()) == []
