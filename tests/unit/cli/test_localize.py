"""``monoloc localize``: the pose to start from, and each output written even if another fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.cli.localize import _write_each
from monoloc.cli.start_option import parse_pose, start_of
from monoloc.errors import DataError, SettingError
from monoloc.start import Start
from refusals import refuses
from synthetic_room import Room, RoomRecording, make_bundle, make_path, room_mixture


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "start",
    [
        "1,2,3",
        "0,0,0,0,0,0,0",
        "nan,0,0,0,0,0,1",
        "here",
        "1e300,0,0,0,0,0,1",
        "0,-1e7,0,0,0,0,1",
        "0,0,0,0,0,0,1.02",
        "0,0,0,0,0,0,1e300",
    ],
)
def test_start_that_is_no_pose_is_refused(start: str) -> None:
    refuses(lambda: parse_pose(start), SettingError, f"^--start: is '{start}'.*; write TX,TY,TZ,QX,QY,QZ,QW")


def test_a_word_that_is_no_start_is_answered_with_those_that_are() -> None:
    refuses(lambda: parse_pose("Truth"), SettingError, "in metres, unknown, or truth$")


def test_start_in_millimetres_is_refused() -> None:
    """The room is a few metres wide."""
    bundle = make_bundle(room_mixture(Room()), RoomRecording(Room(), make_path(2)))

    def start(text: str) -> Start | None:
        return start_of(text, bundle, None, 0.1, 0.05, np.random.default_rng(0))

    given = start("0.5,0.2,-0.1,0,0,0,1")
    assert given is not None and given.pose[0, 3] == 0.5
    message = r"^--start: is '500,200,-100,.*', \d+\.?\d* m beyond the map; are these millimetres\? give metres"
    refuses(lambda: start("500,200,-100,0,0,0,1"), SettingError, message)


def test_start_is_a_translation_and_a_quaternion() -> None:
    pose = parse_pose("1,2,3,0,0,1,0")
    np.testing.assert_allclose(pose, np.array([[-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]), atol=1e-12)


def test_each_output_is_written_even_if_another_fails() -> None:
    """As on a full disk, which is noticed only after the work."""
    done: list[Path] = []

    def full(path: Path) -> None:
        raise DataError(path, "cannot be written (No space left on device)", "name a file in a folder with space")

    a, b, c = Path("a"), Path("b"), Path("c")
    written, failures = _write_each([(a, done.append), (None, full), (b, full), (c, done.append)])
    assert written == done == [a, c]
    assert [str(error).split(":")[0] for error in failures] == ["b"]
