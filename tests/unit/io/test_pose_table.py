"""Tables of poses: what is read is what was written, without lost frames, and what is no table is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.flight.pose_log import PoseLog
from monoloc.geometry import se3_exp
from monoloc.io.pose_table import read_pose_table
from refusals import refuses_data


def write_table(path: Path, lost: tuple[int, ...]) -> np.ndarray:
    poses = se3_exp(np.random.default_rng(0).standard_normal((6, 6)))
    log = PoseLog(path)
    for index, pose in enumerate(poses):
        log.take(result_at(1.5e9 + index, step_at(pose, state="lost" if index in lost else "uncertain")))
    log.close()
    return poses


def test_lost_frames_are_left_out(tmp_path: Path) -> None:
    poses = write_table(tmp_path / "a.csv", lost=(0, 3))
    times_s, read = read_pose_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(times_s, 1.5e9 + np.array([1, 2, 4, 5]))
    np.testing.assert_allclose(read, poses[[1, 2, 4, 5]], atol=1e-12)


@pytest.mark.parametrize(
    ("spoil", "problem", "fix"),
    [
        (lambda text: text.replace("state", "mode", 1), "is no table of poses", "monoloc localize --out"),
        (lambda text: text.replace("tracking", "lost"), "every frame is lost", "with poses"),
        (lambda text: text.replace("1500000000.0", ""), "line 2 has no pose", "remove"),
        # As of a copy that broke off, in the number of a pose or behind it.
        (lambda text: text[: text.rindex("tracking") + 40], "line 7 is cut short", "remove"),
        (lambda text: text[: text.rindex(",")], "line 7 is cut short", "remove"),
        (lambda text: text.replace("time_s", "0" * 200_000, 1), "line 1 has no pose", "remove"),
        (lambda text: text.replace("1500000002.0", "1.0"), "entry 3 does not increase", "sort"),
    ],
)
def test_what_is_no_table_of_poses_is_refused(tmp_path: Path, spoil, problem: str, fix: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.csv"
    write_table(path, lost=())
    path.write_text(spoil(path.read_text().replace("uncertain", "tracking")))
    refuses_data(lambda: read_pose_table(path), path, problem, fix)
