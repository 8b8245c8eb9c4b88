"""What commands write: nothing in the place of something else, and each file whatever becomes of the others."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import json_of, listing, refused, succeeds
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.errors import DataError
from monoloc.io.pose_files import read_tum
from monoloc.io.tum_trajectory import write_tum
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
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
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
        (
            ("localize", "room.monoloc", "video:~/fl.mp4", "--out", "fl.mp4"),
            "--out",
            "fl.mp4 is read by this command",
        ),
        ((*LOCALIZE, "--out", "a.png", "--plot", "./a.png"), "--plot", "a.png is what --out writes"),
        ((*LOCALIZE, "--out", "a", "--record", "walk/../a"), "--record", "a is what --out writes"),
        (
            ("depth", "train", "walk", "--start", "run/network.safetensors", "--out", "run"),
            "--out",
            "run/network.safetensors is read by this command",
        ),
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
        "there.monoloc/landmarks.npz",
        "there.monoloc/manifest.json",
        "there.monoloc/map.npz",
        "way.rrd",
        "way.txt",
    ]


def test_a_source_that_leads_nowhere_is_the_readers_to_refuse(capfd, here):
    Path("loop").symlink_to("loop")
    refused(
        capfd,
        here,
        ("localize", "room.monoloc", "loop", "--out", "way.txt"),
        str(here / "loop"),
        "does not exist",
        "path",
    )


def test_a_file_may_be_written_again_and_beside_its_source(capfd, here):
    for _ in range(2):
        assert json_of(capfd, *LOCALIZE, "--out", "walk/way.txt")["frames"] == FRAMES


@pytest.mark.slow
def test_each_output_is_written_whatever_becomes_of_the_others(capfd, here, monkeypatch):
    """As on a full disk, which is found out after the work."""

    def full(path, *_, **__):
        raise DataError(path, "cannot be written (No space left on device)", "name a file in a folder with space")

    def fails(command: tuple[str, ...], *lost: str) -> str:
        capfd.readouterr()
        assert invoke(list(command)) == 2
        out, err = capfd.readouterr()
        told = [f"{name}: cannot be written (No space left on device); name a file" for name in lost]
        assert err.splitlines()[-1].startswith("monoloc: ") and all(text in err.splitlines()[-1] for text in told)
        assert err.count("monoloc: ") == 1 and not any(f"written: {name}" in err for name in lost)
        return out

    monkeypatch.setattr("monoloc.viz.viewer._check_whole", lambda _: full("way.rrd"))
    command = (*LOCALIZE, "--out", "way.txt", "--plot", "way.png", "--record", "way.rrd")
    assert json.loads(fails((*command, "--json"), "way.rrd"))["frames"] == FRAMES
    assert Path("way.txt").exists() and Path("way.png").exists() and not Path("way.rrd").exists()
    compared = fails(("map", "compare", "room.monoloc", "--record", "way.rrd"), "way.rrd")
    assert "c2c_median_m" in compared and Path("compare.png").exists()
    monkeypatch.setattr("monoloc.cli.localize.write_tum", full)
    assert "median" in fails(command, "way.txt", "way.rrd")
    monkeypatch.undo()
    monkeypatch.chdir(here)
    monkeypatch.setattr("monoloc.cli.localize.plot_localization", full)
    fails(command, "way.png")
    assert Path("way.rrd").exists()
