"""What commands write: nothing in the place of something else, and each file whatever becomes of the others."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import json_of, listing, refused, succeeds
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.errors import DataError
from monoloc.outputs.tum import read_tum, write_tum
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture, write_recording

FRAMES = 6
PLAIN = ("--tune", "none", "--no-map-transform", "-k", "40")


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with a recording, a bundle, a cloud, what is named like a video, and places that are no files."""
    folder = tmp_path_factory.mktemp("made")
    recording = RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)
    write_recording(folder / "walk", recording)
    write_bundle(folder / "room.monoloc", make_bundle(room_mixture(Room(), 60), recording))
    np.savetxt(folder / "room.xyz", Room().cloud(0.1))
    (folder / "fl.mp4").write_bytes(b"a flight")
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch) -> Path:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    (tmp_path / "link.txt").symlink_to("room.xyz")
    monkeypatch.chdir(tmp_path)
    return tmp_path


LOCALIZE = ("localize", "room.monoloc", "walk")
FLIGHT = ("localize", "room.monoloc", "fl.mp4")


@pytest.mark.parametrize(
    ("command", "option", "problem"),
    [
        ((*FLIGHT, "--out", "fl.mp4"), "--out", "fl.mp4 is read by this command"),
        (("localize", "room.monoloc", "video:fl.mp4", "--record", "./fl.mp4"), "--record", "fl.mp4 is read"),
        ((*LOCALIZE, "--out", "room.monoloc/manifest.json"), "--out", "lies in the bundle room.monoloc"),
        ((*LOCALIZE, "--plot", "room.monoloc/way.png"), "--plot", "lies in the bundle room.monoloc"),
        (("map", "compare", "room.monoloc", "--out", "room.monoloc/a.png"), "--out", "lies in the bundle"),
        (("map", "fit", "room.xyz", "--out", "room.xyz"), "--out", "room.xyz is read by this command"),
        (("map", "fit", "room.xyz", "--out", "link.txt"), "--out", "link.txt is read by this command"),
        (("depth", "export", "fl.mp4", "--out", "fl.mp4"), "--out", "fl.mp4 is read by this command"),
        (("build", "walk", "--network", "room.monoloc", "--out", "room.monoloc"), "--out", "is read by this command"),
        ((*LOCALIZE, "--out", "a.png", "--plot", "./a.png"), "--plot", "a.png is what --out writes"),
        ((*LOCALIZE, "--out", "a", "--record", "walk/../a"), "--record", "a is what --out writes"),
        ((*LOCALIZE, "--plot", "way.pdf"), "--plot", "way.pdf is a PNG by another name"),
        (("map", "compare", "room.monoloc", "--out", "a.jpg"), "--out", "a.jpg is a PNG by another name"),
        (("depth", "evaluate", "tiny-0.35", "walk", "--plot", "a"), "--plot", "a is a PNG by another name"),
        (("build", "walk", "--out", "room.txt"), "--out", "room.txt is not named as a bundle"),
    ],
)
def test_an_output_in_the_place_of_something_else_is_refused_before_the_work(capfd, here, command, option, problem):
    refused(capfd, here, command, f"{option}: ", problem, "name ")


def test_what_is_no_file_stays_what_it_is(capfd, here):
    os.mkfifo("pipe")
    Path("loop").symlink_to("pipe")
    for name in ("pipe", "loop", "/dev/null"):
        # Not by `refused`: to list a pipe would be to wait for its other end.
        capfd.readouterr()
        assert invoke([*LOCALIZE, "--out", name]) == 2
        assert capfd.readouterr().err == f"monoloc: --out: {name} is neither a file nor a folder; name a file\n"
        with pytest.raises(DataError, match=f"{name}: is neither a file nor a folder; name a file"):
            write_tum(name, [0.0], np.eye(4)[None])
    assert Path("pipe").is_fifo() and Path("loop").is_symlink() and Path("/dev/null").is_char_device()


def test_links_are_written_through(capfd, here):
    (here / "elsewhere").mkdir()
    for name in ("way.txt", "way.rrd"):
        (here / name).symlink_to(here / "elsewhere" / name)  # of which one is there already
    (here / "elsewhere" / "way.txt").write_text("older")
    (here / "linked.monoloc").symlink_to("elsewhere/there.monoloc")
    succeeds(capfd, *LOCALIZE, "--out", "way.txt", "--record", "way.rrd")
    succeeds(capfd, "build", "walk", "--out", "linked.monoloc", *PLAIN)
    assert all((here / name).is_symlink() for name in ("way.txt", "way.rrd", "linked.monoloc"))
    assert len(read_tum(here / "elsewhere" / "way.txt")[0]) == FRAMES
    assert len(read_bundle(here / "elsewhere" / "there.monoloc").adapted) == 40
    assert sorted(listing(here / "elsewhere")) == [
        "there.monoloc",
        "there.monoloc/depth.onnx",
        "there.monoloc/manifest.json",
        "there.monoloc/map.npz",
        "way.rrd",
        "way.txt",
    ]


def test_a_file_may_be_written_again_and_beside_its_source(capfd, here):
    for _ in range(2):
        assert json_of(capfd, *LOCALIZE, "--out", "walk/way.txt")["frames"] == FRAMES
