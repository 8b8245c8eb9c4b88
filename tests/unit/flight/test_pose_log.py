"""The table of poses: what other programs read from it is what was computed, to the last bit."""

from __future__ import annotations

import csv
import os
import resource
import signal
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.errors import DataError
from monoloc.flight.pose_log import BackgroundPoseLog, PoseLog
from monoloc.geometry import quaternion_to_rotation, se3_exp
from monoloc.io.pose_table import COLUMNS
from monoloc.supervision.state import Reason
from refusals import refuses_data


def test_csv_and_numpy_read_what_was_written_to_the_last_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / "poses.csv"
    log = PoseLog(path)
    poses = se3_exp(rng.standard_normal((20, 6)))
    roots = rng.standard_normal((20, 6, 6)) * 10.0 ** rng.uniform(-9, 9, (20, 6, 1))
    covariances = roots @ np.swapaxes(roots, 1, 2)
    covariances = (covariances + np.swapaxes(covariances, 1, 2)) / 2.0
    times_s = np.cumsum(rng.uniform(0.0, 1.0, 20)) + 1.7e9
    for index, (time_s, pose, covariance) in enumerate(zip(times_s, poses, covariances, strict=True)):
        lost = (
            {"state": "lost", "reasons": frozenset({Reason.SEARCHING, Reason.IMAGE_EMPTY})} if index % 3 == 0 else {}
        )
        step = step_at(pose, **lost, covariance=covariance, probability_far=1.0 / (index + 1), restarted=index == 1)
        log.take(result_at(float(time_s), step))
        assert path.read_bytes().count(b"\n") == index + 2  # each row at once, whole
    log.close()

    with path.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert tuple(rows[0]) == COLUMNS and len(rows) == 20
    assert [row["frame"] for row in rows] == [f"{index:06d}" for index in range(20)]
    assert (rows[0]["state"], rows[0]["reasons"]) == ("lost", "image empty;searching")
    assert (rows[1]["state"], rows[1]["reasons"], rows[1]["restarted"]) == ("tracking", "", "1")
    assert [float(row["probability_far"]) for row in rows] == [1.0 / (index + 1) for index in range(20)]

    numbers = [index for index, name in enumerate(COLUMNS) if name not in ("state", "reasons")]
    table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=numbers)
    names = [COLUMNS[index] for index in numbers]
    np.testing.assert_array_equal(table[:, names.index("time_s")], times_s)
    position = names.index("tx_m")
    np.testing.assert_array_equal(table[:, position : position + 3], poses[:, :3, 3])
    rotations = quaternion_to_rotation(table[:, position + 3 : position + 7])
    np.testing.assert_allclose(rotations, poses[:, :3, :3], atol=1e-12)
    upper = table[:, names.index("cov_x_x_m2") :]
    np.testing.assert_array_equal(upper, covariances[:, *np.triu_indices(6)])
    assert names[names.index("cov_x_x_m2") :][5:8] == ["cov_x_rz_m_rad", "cov_y_y_m2", "cov_y_z_m2"]
    assert names[-1] == "cov_rz_rz_rad2"


def test_a_file_that_cannot_be_written_is_named_at_once_or_when_the_disk_is_full(tmp_path: Path) -> None:
    refuses_data(lambda: PoseLog(tmp_path), tmp_path, "cannot be written .Is a directory.", "folder you can write to")
    full = Path("/dev/full")  # every write to it finds no space
    if full.exists():
        log, result = PoseLog(full), result_at(0.1, step_at(np.eye(4)))
        refuses_data(lambda: log.take(result), full, "cannot be written .No space left on device.", "make room")


def test_the_table_of_the_flight_before_stays_in_its_place_until_a_frame_and_is_kept(tmp_path: Path) -> None:
    path, result = tmp_path / "poses.csv", result_at(0.1, step_at(np.eye(4)))
    path.write_text("of the flight before\n")
    PoseLog(path).close()
    assert path.read_text() == "of the flight before\n"
    log = PoseLog(path)
    log.take(result)
    log.close()
    header, row = path.read_text().splitlines()
    assert header.startswith("time_s,frame,") and row.startswith("0.1,000000,")
    assert (tmp_path / "poses-1.csv").read_text() == "of the flight before\n"
    again = PoseLog(path)
    again.take(result)
    again.close()
    assert path.read_bytes() == (tmp_path / "poses-2.csv").read_bytes()
    assert {each.name for each in tmp_path.iterdir()} == {"poses.csv", "poses-1.csv", "poses-2.csv"}


def test_a_disk_that_fills_up_is_said_once_and_the_rows_before_are_whole(tmp_path: Path) -> None:
    path, most_bytes = tmp_path / "poses.csv", 4000
    log, result = PoseLog(path), result_at(0.1, step_at(np.eye(4)))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))  # as a disk with so much room
    try:
        with pytest.raises(DataError, match=r"poses\.csv: cannot be written \(File too large\); make room"):
            for _ in range(1000):
                log.take(result)
        with pytest.raises(DataError):  # it is full still
            log.take(result)
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with path.open(newline="") as lines:
        rows = list(csv.reader(lines))
    assert path.read_bytes().endswith(b"\n") and most_bytes - 400 < path.stat().st_size <= most_bytes
    assert len(rows) > 5 and {len(row) for row in rows} == {len(COLUMNS)}


def test_a_thread_writes_the_same_rows_and_says_once_what_it_could_not(tmp_path: Path) -> None:
    dropped = Counter[str]()
    logs = PoseLog(tmp_path / "a.csv"), BackgroundPoseLog(tmp_path / "b.csv", dropped)
    for log in logs:
        for index in range(50):
            log.take(result_at(index / 3.0, step_at(np.eye(4))))
        log.close()
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes() and not dropped
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    log = BackgroundPoseLog(tmp_path / "c.csv", dropped)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
    try:
        with pytest.raises(DataError, match=r"c\.csv: cannot be written \(File too large\)"):
            for index in range(1000):
                log.take(result_at(index / 3.0, step_at(np.eye(4))))
            log.close()
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_an_interrupt_ends_the_wait_for_a_disk_that_hangs(tmp_path: Path) -> None:
    """The disk is a pipe that nobody reads: the thread hangs in a write, and has the file's lock."""
    path = tmp_path / "poses.csv"
    os.mkfifo(path)
    reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    log = BackgroundPoseLog(path, Counter())
    for index in range(1000):  # 600 kB, of which a pipe takes 64 KiB
        log.take(result_at(index / 3.0, step_at(np.eye(4))))
    reads_again = threading.Timer(5.0, os.close, [reading])  # else a test that fails would hang
    reads_again.start()
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    began_s = time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        with pytest.raises(KeyboardInterrupt):
            log.close()
        assert time.monotonic() - began_s < 4.0
    finally:
        signal.signal(signal.SIGALRM, before)
        reads_again.cancel()
        reads_again.join()
        if time.monotonic() - began_s < 5.0:
            os.close(reading)
