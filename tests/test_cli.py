"""The command line: help, exit codes, one line for every kind of bad input, and nothing half-written."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

import synthetic_recordings as synthetic
from cli_helpers import json_of, listing, python, refused, succeeds
from monoloc import __version__
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.evaluation.trajectory import pose_errors, summarise
from monoloc.io.pose_files import read_tum
from monoloc.io.tum_trajectory import write_tum
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import ConsoleProgress
from synthetic_room import (
    FRAME_RATE_HZ,
    SMALL_CAMERA,
    Room,
    RoomRecording,
    make_bundle,
    make_path,
    room_mixture,
    write_recording,
)

FRAMES = 10
PLAIN = ("--tune", "none", "--no-map-transform")
QUICK = (*PLAIN, "-k", "40")
COMMANDS = [
    ("demo",),
    ("build",),
    ("localize",),
    ("evaluate",),
    ("inspect",),
    ("map", "fit"),
    ("map", "info"),
    ("map", "compare"),
    ("depth", "train"),
    ("depth", "evaluate"),
    ("depth", "export"),
    ("depth", "list"),
    ("bench", "kernels"),
    ("bench", "map"),
    ("bench", "pipeline"),
    ("synth", "room"),
    ("synth", "flight"),
    ("synth", "render"),
    ("synth", "views"),
]
ACCURACY_KEYS = {
    "ate_rmse_m",
    "ate_median_m",
    "ate_max_m",
    "rot_rmse_deg",
    "rot_median_deg",
    "within_5cm_5deg",
    "within_10cm_10deg",
}
LOCALIZE_KEYS = ACCURACY_KEYS | {
    "frames",
    "lost_frames",
    "landmark_used_frames",
    "coverage_95",
    "step_ms_median",
    "step_ms_p95",
    "particles",
    "scan_points",
    "motion",
    "depth_absrel",
    "depth_delta1",
    "depth_ssim",
}


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def made(tmp_path_factory, recording) -> Path:
    """A folder with a recording ``walk`` and a bundle ``room.monoloc`` built from every second frame of it."""
    folder = tmp_path_factory.mktemp("made")
    write_recording(folder / "walk", recording)
    write_bundle(folder / "room.monoloc", make_bundle(room_mixture(Room()), recording, range(0, FRAMES, 2)))
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch) -> Path:
    """A working folder with a recording and a bundle of one's own to spoil."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- Help ---


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_says_what_it_does_and_gives_examples_first(capfd, command):
    text = succeeds(capfd, *command, "--help")
    name = " ".join(("monoloc", *command))
    usage, description, examples, options = (
        text.index(f"Usage: {name}"),
        re.search(r"^  [A-Z][^.]+\.$", text, re.MULTILINE).start(),
        text.index("Examples:"),
        text.index("Options:"),
    )
    assert usage < description < examples < options
    first = text[examples:].splitlines()[1]
    assert first.startswith(f"    {name}")
    assert "--json" in text


def test_version(capfd):
    assert succeeds(capfd, "--version") == f"monoloc {__version__}\n"


def test_help_lists_every_command(capfd):
    text = succeeds(capfd, "--help")
    for command in COMMANDS:
        assert re.search(rf"^  {command[0]} ", text, re.MULTILINE), command


@pytest.mark.parametrize("group", [(), ("map",), ("depth",)], ids=str)
def test_a_group_alone_shows_its_commands(capfd, group):
    assert invoke(list(group)) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith(f"Usage: {' '.join(('monoloc', *group))} [OPTIONS] COMMAND")
    assert "Commands:" in err


def test_examples_in_help_have_options_that_exist(capfd):
    """Every option shown in an example is one of the command's."""
    for command in COMMANDS:
        text = succeeds(capfd, *command, "--help")
        examples, options = text[text.index("Examples:") : text.index("Options:")], text[text.index("Options:") :]
        for option in re.findall(r"(?<= )--?[a-z][a-z0-9-]*", examples):
            assert re.search(rf"(^|[ ,/]){option}\b", options, re.MULTILINE), (command, option)


# --- What cannot be parsed ---


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fly",), "No such command 'fly'. (see: monoloc --help)"),
        (("map", "fly"), "No such command 'fly'. (see: monoloc map --help)"),
        (("build", "walk", "--out", "x.monoloc", "--fast"), "No such option: --fast.*build --help"),
        (("build", "walk"), "Missing option '--out' / '-o'. (see: monoloc build --help)"),
        (("localize", "room.monoloc"), "Missing argument 'SOURCE'. (see: monoloc localize --help)"),
        (("build", "walk", "--out", "x", "--tune", "most"), "'--tune'.*'none', 'last', 'decoder'.*build --help"),
        (("localize", "room.monoloc", "walk", "--seed", "-1"), "'--seed'.*greater than or equal to 0"),
        *(
            (("localize", "room.monoloc", "walk", "--start-error-cm", v), "'--start-error-cm'")
            for v in ("nan", "inf", "1e6")
        ),
        *(
            (("localize", "room.monoloc", "walk", "--start-error-deg", v), "'--start-error-deg'")
            for v in ("inf", "181")
        ),
        (("localize", "room.monoloc", "walk", "--motion", "jump"), "'--motion'.*'visual', 'random-walk'"),
        (("localize", "room.monoloc", "walk", "--depth", "lidar"), "'--depth'.*'predicted', 'sensor'"),
    ],
)
def test_usage_errors_are_one_line_that_names_the_help(capfd, here, arguments, message):
    before = listing(here)
    assert invoke(list(arguments)) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1
    pattern = message if ".*" in message or message.startswith("'--") else re.escape(message)
    assert re.search(pattern, err), err
    assert listing(here) == before


# --- Recordings that cannot be used; through `build`, which reads all of one ---


def test_missing_folder(capfd, here):
    for command in (("build", "no", "--out", "x.monoloc"), ("localize", "room.monoloc", "no"), ("inspect", "no")):
        refused(capfd, here, command, str(here / "no"), "does not exist", "check the path")


def test_empty_folder(capfd, here):
    (here / "empty").mkdir()
    build = ("build", "empty", "--out", "x.monoloc")
    refused(capfd, here, build, "empty", "is not recognised as a recording", "FORMAT:PATH")
    refused(capfd, here, ("build", "7scenes:empty", *build[2:]), "empty", "has no frame-NNNNNN", "7-Scenes")
    refused(capfd, here, ("build", "tum:empty", *build[2:]), "empty/rgb.txt", "is missing", "TUM")
    refused(capfd, here, ("build", "folder:empty", *build[2:]), "empty/dataset.toml", "is missing", "write one")


def test_unknown_format(capfd, here):
    refused(capfd, here, ("inspect", "kinect:walk"), "SOURCE", "unknown format 'kinect'", "7scenes")


def test_no_poses(capfd, here):
    synthetic.write_video(here / "flight.avi")
    camera = ("--intrinsics", "64,48,50,50,31,23")
    build, localize = ("build", "flight.avi", "--out", "x.monoloc"), ("localize", "room.monoloc", "flight.avi")
    refused(capfd, here, (*build, *camera), "flight", "has no poses", "with camera poses")
    write_tum(here / "way.txt", [0.0], np.eye(4)[None])
    for command in (localize, ("inspect", "flight.avi"), ("evaluate", "way.txt", "flight.avi")):
        refused(capfd, here, command, "flight.avi", "says nothing of its camera", "--intrinsics 64,48,FX,FY,CX,CY")
    toml = here / "walk" / "dataset.toml"
    toml.write_text(toml.read_text().replace('"sequence"', '"pairs"'))
    refused(capfd, here, ("evaluate", "way.txt", "walk"), "walk", "has no poses", "recording or TUM")


def test_no_depth(capfd, here):
    toml = (here / "walk" / "dataset.toml").read_text()
    (here / "walk" / "dataset.toml").write_text(re.sub(r"depth = .*\n", "", toml))
    refused(capfd, here, ("build", "walk", "--out", "x.monoloc", *QUICK), "walk", "has no depth", "cloud")
    refused(capfd, here, ("localize", "room.monoloc", "walk", "--depth", "sensor"), "walk", "has no depth", "--depth")
    refused(capfd, here, ("depth", "evaluate", "room.monoloc", "walk"), "walk", "has no depth", "depth images")
    refused(capfd, here, ("map", "fit", "walk", "--out", "m.npz"), "walk", "has no depth", "cloud")


def spoil_poses(folder: Path, change: Callable[[np.ndarray], None]) -> Path:
    path = folder / "poses.txt"
    rows = np.loadtxt(path)
    change(rows)
    np.savetxt(path, rows)
    return path


def test_poses_that_are_not_rigid(capfd, here):
    spoil_poses(here / "walk", lambda rows: rows[3].__setitem__(slice(4, 8), [2.0, 0.0, 0.0, 2.0]))
    refused(
        capfd, here, ("build", "walk", "--out", "x.monoloc", *QUICK), "walk/poses.txt", "its quaternion has length"
    )
    scene = here / "scene"
    synthetic.write_seven_scenes(scene, frames=2)
    np.savetxt(scene / "seq-01" / "frame-000002.pose.txt", np.diag([1.0, 1.0, -1.0, 1.0]))
    names = "scene/seq-01/frame-000002.pose.txt"
    refused(capfd, here, ("build", "scene", "--out", "x.monoloc"), names, "is not rigid", "proper rotation")


def test_poses_that_are_nan(capfd, here):
    spoil_poses(here / "walk", lambda rows: rows[5].__setitem__(1, np.nan))
    for command in (("build", "walk", "--out", "x.monoloc", *QUICK), ("localize", "room.monoloc", "walk")):
        refused(capfd, here, command, "walk/poses.txt", "pose 6 is NaN or infinite", "leave out frames")


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_frames_whose_depth_is_all_zero_do_not_stand_in_the_way(capfd, here):
    for index in (0, 7):
        synthetic.write_depth(here / f"walk/depth/{index:06d}.png", np.zeros((128, 160), dtype=np.uint16))
    np.savetxt(here / "room.xyz", Room().cloud(0.04))
    for more in ((), ("--refine-poses", "--cloud", "room.xyz")):
        assert json_of(capfd, "build", "walk", "--out", "x.monoloc", *QUICK, *more)["frames"] == FRAMES
    for depth in ("predicted", "sensor"):
        metrics = json_of(capfd, "localize", "room.monoloc", "walk", "--depth", depth)
        assert metrics["frames"] == FRAMES and metrics["depth_absrel"] < 0.02
    evaluated = ("depth", "evaluate", "room.monoloc", "walk")
    assert json_of(capfd, *evaluated, "--plot", "depth.png")["absrel"] < 0.02
    refused(capfd, here, (*evaluated, "--frames", "7:8"), "blue", "gives no depth at any pixel of known", "--frames")
    held = json_of(capfd, "inspect", "walk")
    assert held["depth_share"] == 0.0 and held["depth_median_m"] is None


def test_depth_of_another_size(capfd, here):
    synthetic.write_depth(here / "walk/depth/000007.png", np.full((64, 80), 2000, dtype=np.uint16))
    command = ("build", "walk", "--out", "x.monoloc", *QUICK)
    refused(capfd, here, command, "walk/depth/000007.png", "is 80x64, but the intrinsics are for 160x128")


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_truncated_png(capfd, here, kind):
    file = here / "walk" / kind / "000007.png"
    file.write_bytes(file.read_bytes()[:2000])
    commands = [
        ("build", "walk", "--out", "x.monoloc", *QUICK),
        ("localize", "room.monoloc", "walk", "--out", "way.txt", "--plot", "way.png"),
        ("depth", "evaluate", "room.monoloc", "walk", "--plot", "depth.png"),
    ]
    for command in commands:
        refused(capfd, here, command, f"walk/{kind}/000007.png", "is cut short", "copy the file again")


def test_intrinsics_that_do_not_fit_the_image(capfd, here):
    given = ("--intrinsics", "640,480,525,525,320,240")
    for command in (("build", "walk", "--out", "x.monoloc", *QUICK), ("localize", "room.monoloc", "walk")):
        problem = "is 160x128, but the intrinsics are for 640x480"
        refused(capfd, here, (*command, *given), "walk/color/000000.png", problem, "intrinsics of these images")
    toml = (here / "walk" / "dataset.toml").read_text()
    (here / "walk" / "dataset.toml").write_text(toml.replace("cx = 79.5", "cx = 790.5"))
    problem = r"\(790.5, 63.5\) lies outside the 160x128 image"
    refused(capfd, here, ("inspect", "walk"), "walk/dataset.toml", problem, "belong to this image size")


@pytest.mark.parametrize(
    "text",
    [
        "640,480,525",
        "a,b,c,d,e,f",
        "nan,480,525,525,320,240",
        "320.5,256,1,1,1,1",
        "",
        "64,48,50,50,31,23,0.1",
        "64,48,50,50,31,23,0,0,0,0,0,0",
    ],
)
def test_intrinsics_that_are_no_numbers(capfd, here, text):
    command = ("localize", "room.monoloc", "walk", "--intrinsics", text)
    refused(capfd, here, command, "--intrinsics", f"is '{text}'", "W,H,FX,FY,CX,CY.*K1,K2,P1,P2,K3")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("64,48,0,50,31,23", r"fx/fy is \(0.0, 50.0\)"),
        ("64,48,50,50,99,23", r"cx/cy \(99.0, 23.0\) lies outside"),
        ("0,48,50,50,31,23", "width/height is 0x48"),
        ("64,48,50,50,31,23,-9,0,0,0,0", "distortion .*folds the image"),
        ("160,128,136,136,79.5,63.5", "is for 160x128, but flight.avi is 64x48"),
    ],
)
def test_intrinsics_that_are_no_camera(capfd, here, text, problem):
    synthetic.write_video(here / "flight.avi")
    refused(capfd, here, ("inspect", "flight.avi", "--intrinsics", text), "--intrinsics", problem)
    given = ("build", "nyu:walk", "--out", "x.monoloc", "--depth-scale", "5")
    refused(capfd, here, given, "--depth-scale", "has no meaning for a nyu recording", "leave this option out")


@pytest.mark.slow
def test_cloud_that_does_not_go_with_the_poses(capfd, here):
    def write(name: str, points: np.ndarray) -> tuple[str, ...]:
        np.savetxt(here / name, points, fmt="%.4f")
        return ("build", "walk", "--cloud", name, "--out", "x.monoloc", *QUICK)

    cloud = Room().cloud(0.04)
    with_nan = np.where(np.arange(len(cloud))[:, None] % 100 == 0, np.nan, cloud)
    refused(capfd, here, write("nan.xyz", with_nan), "nan.xyz", "points are not finite", "remove them")
    refused(capfd, here, write("mm.xyz", 1000.0 * cloud), "cloud", "has neighbours within", "in metres")
    z_up = cloud[:, [2, 0, 1]] * [1.0, -1.0, -1.0] + [0.5, 1.0, 2.0]
    refused(capfd, here, write("up.xyz", z_up), "walk", "poses and cloud are not in one frame", "T_world_camera")
    assert json_of(capfd, *write("room.xyz", cloud))["warnings"] == []
    build = write("off.xyz", cloud + np.array([0.26, 0.0, 0.13]))
    half_off = json_of(capfd, *build)["warnings"]
    assert len(half_off) == 1 and "may not be in one frame" in half_off[0]
    assert invoke(list(build)) == 0
    assert f"warning: walk: {half_off[0]}\n" in capfd.readouterr().err


def test_too_few_frames(capfd, here):
    command = ("build", "walk", "--frames", "0:3", "--out", "x.monoloc", *QUICK)
    refused(capfd, here, command, "walk", "gives 3 frames", "at least 5")


@pytest.mark.parametrize(
    ("frames", "problem"), [("90:", "selects none of the 10"), ("wat", "is not START:STOP:STEP")]
)
def test_impossible_frames(capfd, here, frames, problem):
    refused(capfd, here, ("localize", "room.monoloc", "walk", "--frames", frames), "--frames", problem)
    train = ("depth", "train", "walk", "--out", "run", "--validate", frames)
    refused(capfd, here, train, "--validate", problem)
    evaluate = ("depth", "evaluate", "room.monoloc", "walk", "--frames", frames)
    refused(capfd, here, evaluate, "--frames", problem)


def test_depth_scale_that_leaves_nothing(capfd, here):
    command = ("build", "walk", "--out", "x.monoloc", *QUICK, "--depth-scale", "1")
    refused(capfd, here, command, "walk", "has no depth between 0 and", "check the depth scale")
    command = (*command[:-1], "0")
    refused(capfd, here, command, "--depth-scale", "is 0.0", "such as 1000")


def test_frames_of_what_has_none(capfd, here):
    write_tum(here / "way.txt", [0.0], np.eye(4)[None])
    np.savetxt(here / "room.xyz", Room().cloud(0.1))
    for command, what in (
        (("evaluate", "way.txt", "way.txt"), "a trajectory"),
        (("map", "fit", "room.xyz", "--out", "m.npz"), "a cloud"),
        (("inspect", "room.monoloc"), "a bundle"),
    ):
        refused(capfd, here, (*command, "--frames", "0:4"), "--frames", f"has no meaning for {what}", "leave it out")
    command = ("inspect", "room.monoloc", "--intrinsics", "160,128,136,136,79.5,63.5")
    refused(capfd, here, command, "--intrinsics", "has no meaning for a bundle", "leave it out")


# --- Bundles, maps, networks, trajectories ---


@pytest.mark.parametrize("name", ["map.npz", "depth.onnx", "manifest.json"])
@pytest.mark.parametrize("kind", ["cut short", "edited", "missing"])
def test_bundle_that_is_not_whole(capfd, here, name, kind):
    file = here / "room.monoloc" / name
    content = file.read_bytes()
    if kind == "missing":
        file.unlink()
    elif kind == "cut short":
        file.write_bytes(content[: len(content) // 2])
    elif name == "manifest.json":
        file.write_bytes(content.replace(b'"particles": 1000', b'"particles": 1001'))
    else:
        file.write_bytes(content[:-30] + bytes([content[-30] ^ 1]) + content[-29:])
    names = "room.monoloc" if (name, kind) == ("manifest.json", "missing") else f"room.monoloc/{name}"
    for command in (("localize", "room.monoloc", "walk", "--out", "way.txt"), ("map", "info", "room.monoloc")):
        refused(capfd, here, command, names, "(is|was)", "(copy the bundle again|monoloc build)")


def test_place_where_no_bundle_can_be(capfd, here):
    refused(
        capfd, here, ("build", "walk", "--out", "no/x.monoloc"), "no/x.monoloc", "folder does not exist", "make no"
    )
    refused(capfd, here, ("build", "walk", "--out", "walk"), "walk", "exists and is not a bundle", "another name")


def test_file_that_is_no_map(capfd, here):
    for name, problem in (("walk/dataset.toml", "is no mixture map"), ("no.npz", "there is no such file")):
        refused(capfd, here, ("map", "info", name), name, problem, "monoloc map fit")
    np.savez(here / "other.npz", x=np.zeros(3))
    refused(capfd, here, ("map", "info", "other.npz"), "other.npz", "key 'weights' is missing", "monoloc map fit")


def test_file_that_is_no_cloud(capfd, here):
    for command in (("build", "walk", "--out", "x.monoloc", "--cloud"), ("map", "fit", "--out", "m.npz")):
        refused(capfd, here, (*command, "no.ply"), "no.ply", "there is no such file", "check the path")


def test_file_that_is_no_network(capfd, here):
    toml = "walk/dataset.toml"
    refused(capfd, here, ("depth", "evaluate", "no", "walk"), "no", "does not exist", "safetensors")
    refused(capfd, here, ("depth", "evaluate", toml, "walk"), toml, "mean: Field required", "mend the field named")
    poses = "walk/poses.txt"
    refused(capfd, here, ("depth", "evaluate", poses, "walk"), poses, "cannot be loaded", "depth export")
    build = ("build", "walk", "--out", "x.monoloc", "--network", "one-thrid-0.35")
    refused(capfd, here, build, "one-thrid-0.35", "does not exist", "one of full-0.35, .*one-third-0.35")


def test_file_that_is_no_trajectory(capfd, here):
    refused(capfd, here, ("evaluate", "no.txt", "walk"), "no.txt", "cannot be read", "check the path")
    command = ("evaluate", "walk/dataset.toml", "walk")
    refused(capfd, here, command, "walk/dataset.toml", "line 1 is not 8 numbers", "tx ty tz")


@pytest.mark.parametrize("times", [(1.0, 0.0), (1.0, 1.0)])
def test_trajectory_that_does_not_go_on_in_time(capfd, here, times):
    write_tum(here / "way.txt", times, np.tile(np.eye(4), (2, 1, 1)))
    for command in (("evaluate", "way.txt", "walk"), ("evaluate", "walk/poses.txt", "way.txt")):
        refused(capfd, here, command, "way.txt", "the time stamp of entry 2 does not increase", "by time")


@pytest.mark.parametrize("name", ["gt", "gt.csv"])
def test_truth_of_another_name(capfd, here, name):
    shutil.copy(here / "walk" / "poses.txt", here / name)
    refused(capfd, here, ("evaluate", "walk/poses.txt", name), name, "is not recognised", "NAME.txt if it is a TUM")


def test_trajectory_of_another_clock(capfd, here):
    write_tum(here / "way.txt", [1e6, 1e6 + 1], np.tile(np.eye(4), (2, 1, 1)))
    command = ("evaluate", "way.txt", "walk")
    refused(capfd, here, command, "way.txt", "has no pose within 0.02 s", "same clock$")
    refused(
        capfd, here, (*command, "--frames", "2:"), "way.txt", "has no pose within", "same clock, and that --frames"
    )


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
def test_start_that_is_no_pose(capfd, here, start):
    refused(
        capfd, here, ("localize", "room.monoloc", "walk", "--start", start), "--start", f"is '{start}'", "TX,TY,TZ"
    )


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (("localize", "room.monoloc", "walk"), "--out"),
        (("localize", "room.monoloc", "walk"), "--plot"),
        (("map", "fit", "walk"), "--out"),
        (("map", "compare", "room.monoloc"), "--out"),
        (("depth", "evaluate", "room.monoloc", "walk"), "--plot"),
        (("depth", "export", "network.safetensors"), "--out"),
    ],
)
def test_output_that_cannot_be_written_is_refused_before_the_work(capfd, here, command, option):
    refused(capfd, here, (*command, option, "no/file"), option, "no does not exist", "make the folder first")
    refused(capfd, here, (*command, option, "walk"), option, "walk is a folder", "name a file")
    assert "done in" not in capfd.readouterr().err


@pytest.mark.parametrize("command", [("depth", "train", "walk")])
def test_output_folder_that_cannot_be_made(capfd, here, command):
    refused(capfd, here, (*command, "--out", "no/a"), "--out", "no does not exist", "make the folder first")
    refused(capfd, here, (*command, "--out", "walk/poses.txt"), "--out", "is a file", "name a folder")


def test_demo_without_its_data(capfd, here):
    refused(capfd, here, ("demo", "--data", "no"), "no/7scenes/redkitchen", "is not there", "leave it out")


# --- Settings ---


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("compnents = 5\n", "compnents: Extra inputs are not permitted"),
        ("[adapt]\nstep = 5\n", "adapt.step: Extra inputs are not permitted"),
        ("voxel_m = -1\n", "voxel_m: Input should be greater than 0"),
        ('components = "many"\n', "components: Input should be a valid integer.*or Input should be 'bic'"),
        ('[adapt]\ntune = "most"\n', "adapt.tune: Input should be 'none', 'last', 'decoder' or 'all'"),
        ("[localizer.measurement]\noutlier_share = 1.0\n", "localizer.measurement.outlier_share: .*less than 1"),
        ("components 5\n", "is not TOML"),
    ],
)
def test_settings_file_that_is_wrong(capfd, here, text, problem):
    (here / "s.toml").write_text(text)
    command = ("build", "walk", "--out", "x.monoloc", "--settings", "s.toml", *PLAIN)
    refused(capfd, here, command, "s.toml", problem, "mend the (field|line) named")


def test_missing_settings_file(capfd, here):
    command = ("build", "walk", "--out", "x.monoloc", "--settings", "no.toml")
    refused(capfd, here, command, "no.toml", "cannot be read", "TOML settings file")


@pytest.mark.parametrize(
    ("options", "field", "problem"),
    [
        (("-k", "0"), "--components", "greater than or equal to 1, or .*'bic'"),
        (("-k", "forty"), "--components", "valid integer.*or .*'bic'"),
        (("--lambda", "nan"), "--lambda", "greater than or equal to 0"),
        (("-k", "1000000", *PLAIN), "--components", "is 1000000 for a cloud of"),
    ],
)
def test_option_of_build_out_of_range(capfd, here, options, field, problem):
    refused(capfd, here, ("build", "walk", "--out", "x.monoloc", *options), field, problem)


@pytest.mark.parametrize("option", ["--particles", "--scan-points"])
def test_option_of_localize_out_of_range(capfd, here, option):
    command = ("localize", "room.monoloc", "walk", option, "3")
    refused(capfd, here, command, option, "greater than or equal to 10", "--help")


def test_a_value_of_the_settings_file_is_not_called_an_option(capfd, here):
    (here / "s.toml").write_text("components = 1000000\n")
    command = ("build", "walk", "--out", "x.monoloc", "--settings", "s.toml", *PLAIN)
    refused(capfd, here, command, "components", "is 1000000 for a cloud of")
    refused(capfd, here, (*command, "-k", "2000000"), "--components", "is 2000000 for a cloud of")


def test_settings_are_taken_and_options_go_before_them(capfd, here):
    (here / "s.toml").write_text("components = 25\nvoxel_m = 0.06\n[localizer]\nparticles = 77\n")
    command = ("build", "walk", "--out", "x.monoloc", "--settings", "s.toml", *PLAIN)
    report = json_of(capfd, *command)
    assert report["components"] == 25
    assert read_bundle(here / "x.monoloc").settings.particles == 77
    assert json_of(capfd, *command, "-k", "12")["components"] == 12


# --- What succeeds ---


def test_build_and_localize(capfd, here, recording):
    report = json_of(capfd, "build", "walk", "--frames", "::2", "--out", "x.monoloc", *QUICK)
    assert report["bundle"] == "x.monoloc" and report["components"] == 40 and report["frames"] == FRAMES // 2
    assert report["bytes"] == sum(file.stat().st_size for file in (here / "x.monoloc").iterdir())
    assert report["kl"] == 0.0 and report["steps"] == 0 and report["shift_p95_m"] == 0.0
    bundle = read_bundle(here / "x.monoloc")
    assert list(bundle.provenance.frames) == recording.frame_names[::2]
    assert bundle.provenance.tune == "none" and not bundle.provenance.map_transform
    # The room's own map: its means lie near the surfaces that were seen.
    assert np.median(Room().distance_m(bundle.adapted.means)) < 0.05
    metrics = json_of(capfd, "localize", "x.monoloc", "walk", "--depth", "sensor", "--out", "way.txt")
    assert metrics["unseen_frames"] == FRAMES // 2 and metrics["depth"] == "sensor"
    assert read_tum(here / "way.txt")[1].shape == (FRAMES, 4, 4)


def test_landmarks_are_kept_unless_they_are_not_wanted(capfd, here):
    for options, are_kept in (((), True), (("--no-landmarks",), False)):
        report = json_of(capfd, "build", "walk", "--frames", "::2", "--out", "x.monoloc", *QUICK, *options)
        landmarks = read_bundle(here / "x.monoloc").landmarks
        assert report["landmarks"] == len(landmarks) and (len(landmarks) > 50) == are_kept
        said = json_of(capfd, "inspect", "x.monoloc")
        assert said["landmarks"] == len(landmarks) and said["landmark_bytes"] == 44 * len(landmarks)
        assert (said["settings"]["sighted"]["sd_at_reference_m"] > 0.0) == are_kept
        metrics = json_of(capfd, "localize", "x.monoloc", "walk")
        assert metrics["landmark_used_frames"] == (FRAMES if are_kept else 0)
        # An untuned network: without landmarks its depth is all there is.
        assert (metrics["ate_median_m"] < 0.03) == are_kept


def test_build_knows_where_down_is_and_what_refining_moved(capfd, here):
    given = json_of(capfd, "build", "walk", "--out", "given.monoloc", *QUICK)
    assert given["pose_shift_median_m"] is None and given["pose_turn_median_deg"] is None
    down = read_bundle(here / "given.monoloc").provenance.down_world
    assert down[1] > 0.97 and np.linalg.norm(down) == pytest.approx(1.0)
    refined = json_of(capfd, "build", "walk", "--refine-poses", "--out", "x.monoloc", *QUICK)
    assert 0.0 < refined["pose_shift_median_m"] < 0.02 and 0.0 < refined["pose_turn_median_deg"] < 1.0
    text = (here / "walk" / "dataset.toml").read_text()
    (here / "walk" / "dataset.toml").write_text(re.sub(r"depth = .*\n", "", text))
    np.savetxt(here / "room.xyz", Room().cloud(0.04))
    build = ("build", "walk", "--cloud", "room.xyz", "--refine-poses", "--out", "y.monoloc", *QUICK)
    refused(capfd, here, build, "--refine-poses", "needs depth", "leave it out")


def test_localize_gives_all_figures(capfd, here, recording):
    command = ("localize", "room.monoloc", "walk", "--seed", "3", "--out", "way.txt")
    metrics = json_of(capfd, *command)
    assert set(metrics) >= LOCALIZE_KEYS | {f"unseen_{key}" for key in ACCURACY_KEYS} | {"unseen_frames", "states"}
    assert metrics["frames"] == FRAMES and metrics["unseen_frames"] == FRAMES // 2
    told = {"bundle": "room.monoloc", "source": "walk", "seed": 3, "depth": "network"}
    assert {name: metrics[name] for name in told} == told
    assert metrics["motion"] == "visual" and metrics["particles"] == 1000 and metrics["scan_points"] == 300
    assert sum(metrics["states"].values()) == FRAMES
    assert metrics["depth_absrel"] < 0.02 and metrics["depth_delta1"] > 0.98
    times, poses = read_tum(here / "way.txt")
    assert np.allclose(times, recording.timestamps_s)
    expected = summarise(poses, recording.poses)
    for key in ACCURACY_KEYS:
        assert metrics[key] == pytest.approx(getattr(expected, key), abs=1e-6)
    # From 10 cm off, by the network's depth: see test_localizer for the accuracy itself.
    assert metrics["ate_max_m"] < 0.15 and metrics["ate_median_m"] < 0.08
    first = (here / "way.txt").read_bytes()
    succeeds(capfd, *command)
    assert (here / "way.txt").read_bytes() == first
    succeeds(capfd, *command[:4], "4", *command[5:])
    assert (here / "way.txt").read_bytes() != first


def test_localize_options_reach_the_filter(capfd, here):
    options = ("--particles", "50", "--scan-points", "40", "--motion", "random-walk", "--frames", "0:6")
    metrics = json_of(capfd, "localize", "room.monoloc", "walk", *options)
    assert metrics["particles"] == 50 and metrics["scan_points"] == 40 and metrics["motion"] == "random-walk"
    assert metrics["frames"] == 6
    assert "odometry_ate_rmse_m" not in metrics


def test_localize_from_a_given_start_without_truth(capfd, here, recording):
    frames = [recording.color(index) for index in range(6)]
    writer = cv2.VideoWriter("flight.avi", cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (160, 128))
    for frame in frames:
        writer.write(frame[..., ::-1])
    writer.release()
    x, y, z = recording.poses[0][:3, 3]
    quaternion = synthetic.tum_lines(np.zeros(1), recording.poses[:1]).splitlines()[1].split()[4:]
    start = ",".join([str(x), str(y), str(z), *quaternion])
    camera = ("--intrinsics", "160,128,136,136,79.5,63.5")
    command = ("localize", "room.monoloc", "flight.avi", "--start", start, *camera, "--out", "way.txt")
    metrics = json_of(capfd, *command)
    assert metrics["frames"] == 6
    assert not any(key.startswith(("ate", "unseen_ate", "coverage")) for key in metrics)
    assert np.linalg.norm(read_tum(here / "way.txt")[1][0, :3, 3] - [x, y, z]) < 0.2


@pytest.fixture(scope="module")
def flight() -> RoomRecording:
    """Two seconds, that begin where the bundle's frames were taken."""
    return RoomRecording(Room(), make_path(30), SMALL_CAMERA)


def test_localize_from_an_unknown_start(capfd, here, flight):
    write_recording(here / "flight", flight)
    metrics = json_of(capfd, "localize", "room.monoloc", "flight", "--start", "unknown", "--out", "way.txt")
    trial = metrics["states"]["lost"]
    assert round(FRAME_RATE_HZ) <= trial < 20  # a second, in which nothing is claimed
    found = pose_errors(read_tum(here / "way.txt")[1][trial:], flight.poses[trial:])
    assert found.position_m.max() < 0.1
    assert "odometry_ate_rmse_m" in metrics and "odometry_from_start_ate_rmse_m" not in metrics


def test_localize_from_an_unknown_start_where_places_cannot_be_told_apart(capfd, here):
    room = read_bundle(here / "room.monoloc")
    lasting = room.settings.lasting.model_copy(update={"relocalization_sd_m": 0.97})
    settings = room.settings.model_copy(update={"lasting": lasting})
    write_bundle(here / "room.monoloc", replace(room, settings=settings))
    command = ("localize", "room.monoloc", "walk", "--start", "unknown", "--out", "way.txt")
    problem = "is unknown, and here one image tells where a camera is to 1.0 m only"
    refused(capfd, here, command, "--start", problem, "write TX,TY,TZ,QX,QY,QZ,QW")
    sensor = json_of(capfd, *command, "--depth", "sensor")
    assert sensor["depth"] == "sensor" and sensor["frames"] == FRAMES


def test_localize_searches_the_room_where_no_start_is_given_and_none_known(capfd, here, flight):
    write_recording(here / "flight", flight)
    description = here / "flight" / "dataset.toml"
    description.write_text(description.read_text().replace('poses = "poses.txt"', f"rate_hz = {FRAME_RATE_HZ}"))
    metrics = json_of(capfd, "localize", "room.monoloc", "flight", "--plot", "way.png", "--out", "way.txt")
    trial = metrics["states"]["lost"]
    assert trial < 20
    found = pose_errors(read_tum(here / "way.txt")[1][trial:], flight.poses[trial:])
    assert found.position_m.max() < 0.1
    assert cv2.imread("way.png") is not None


def test_localize_for_people(capfd, here):
    out = succeeds(capfd, "localize", "room.monoloc", "walk", "--out", "way.txt", "--plot", "way.png")
    assert re.search(r"all .* cm .*°.* %.* %", out) and "unseen" in out and "coverage" in out
    picture = cv2.imread("way.png")
    assert picture is not None and min(picture.shape[:2]) > 300
    assert invoke(["localize", "room.monoloc", "walk", "--out", "way.txt"]) == 0
    err = capfd.readouterr().err
    assert "written: way.txt" in err
    states = json_of(capfd, "localize", "room.monoloc", "walk")["states"]
    told = ", ".join(f"{states.get(state, 0)} {state}" for state in ("tracking", "uncertain", "lost"))
    assert f"{FRAMES} frames: {told}; " in err


def test_plot_without_matplotlib_is_refused_before_the_work(capfd, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    command = ("localize", "room.monoloc", "walk", "--out", "way.txt", "--plot", "way.png")
    refused(capfd, here, command, "plots", r'needs the extra "report"', r"pip install")


def test_evaluate_agrees_with_localize(capfd, here):
    metrics = json_of(capfd, "localize", "room.monoloc", "walk", "--out", "way.txt")
    for truth in ("walk", "walk/poses.txt"):
        evaluated = json_of(capfd, "evaluate", "way.txt", truth)
        assert evaluated["frames"] == FRAMES and evaluated["unmatched"] == evaluated["missed"] == 0
        for key in ACCURACY_KEYS:
            assert evaluated[key] == pytest.approx(metrics[key], abs=1e-6)
        assert 0.0 < evaluated["rpe_rmse_m"] < 0.05 and 0.0 < evaluated["rpe_rot_rmse_deg"] < 2.0
    some = json_of(capfd, "evaluate", "way.txt", "walk", "--frames", "0:4")
    assert some["frames"] == 4 and some["unmatched"] == FRAMES - 4 and some["missed"] == 0
    times, poses = read_tum(here / "way.txt")
    write_tum(here / "half.txt", times[::2], poses[::2])
    half = json_of(capfd, "evaluate", "half.txt", "walk")
    assert half["frames"] == half["missed"] == FRAMES // 2 and half["unmatched"] == 0
    assert re.search(rf"missed +│ +{FRAMES // 2} ", succeeds(capfd, "evaluate", "half.txt", "walk"))


def test_long_trajectories_are_matched_without_a_table_of_all_pairs(capfd, here):
    times, poses = np.arange(2000) / 100.0, np.tile(np.eye(4), (2000, 1, 1))
    write_tum(here / "truth.txt", times, poses)
    write_tum(here / "way.txt", times + 0.004, poses)
    tracemalloc.start()
    metrics = json_of(capfd, "evaluate", "way.txt", "truth.txt")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert metrics["frames"] == 2000 and metrics["ate_max_m"] == 0.0
    assert peak < 8 * 2000**2 / 2


def test_paths_are_printed_as_they_are(capfd, here):
    (here / "[kitchen]").mkdir()
    assert invoke(["localize", "room.monoloc", "walk", "--frames", "0:2", "--out", "[kitchen]/:way:.txt"]) == 0
    assert "written: [kitchen]/:way:.txt\n" in capfd.readouterr().err
    shutil.copytree(here / "room.monoloc", here / "[kitchen]" / "[a]:x:")
    assert "[kitchen]/[a]:x:" in succeeds(capfd, "map", "info", "[kitchen]/[a]:x:")


def test_inspect_a_bundle(capfd, here):
    content = json_of(capfd, "inspect", "room.monoloc")
    assert content["kind"] == "bundle" and content["components"] == 250 and content["frames"] == FRAMES // 2
    assert content["map_bytes"] == 250 * 40
    assert content["bytes"] == sum(file.stat().st_size for file in (here / "room.monoloc").iterdir())
    assert np.allclose(content["size_m"], [5.0, 2.6, 5.0], atol=0.6)  # of the room, as far as Gaussians tell
    assert content["monoloc_version"] == __version__
    assert content["image"] == [160, 128] and content["intrinsics"] == [136.0, 136.0, 79.5, 63.5]
    assert content["distortion"] == [0.0] * 5


def test_inspect_says_what_is_known_at_viewpoints(capfd, here):
    content = json_of(capfd, "inspect", "room.monoloc")
    assert content["viewpoint_error_m"] is None and content["viewpoint_error_deg"] is None
    bundle = read_bundle(here / "room.monoloc")
    errors = np.zeros((len(bundle.viewpoints), 6))
    errors[::2] = [0.03, 0.0, -0.04, 0.0, np.deg2rad(2.0), 0.0]
    viewpoints = replace(bundle.viewpoints, there=errors, back=errors)
    write_bundle(here / "known.monoloc", replace(bundle, viewpoints=viewpoints))
    content = json_of(capfd, "inspect", "known.monoloc")
    share = np.sqrt(np.mean(np.arange(len(errors)) % 2 == 0))
    # A screw's translation is its twist's to first order.
    assert content["viewpoint_error_m"] == pytest.approx(0.05 * share, rel=0.01)
    assert content["viewpoint_error_deg"] == pytest.approx(2.0 * share, rel=1e-6)


def test_tables_for_people_are_rounded_and_their_titles_whole(capfd, here):
    bundle = read_bundle(here / "room.monoloc")
    path = "a-room-whose-name-is-longer-than-the-table-below-it-is-wide.monoloc"
    write_bundle(
        here / path,
        replace(
            bundle, provenance=bundle.provenance.model_copy(update={"down_world": (1 / 3, -0.1234567, 0.0123456)})
        ),
    )
    assert " 0.333, -0.123, 0.0123 " in succeeds(capfd, "inspect", path)
    assert succeeds(capfd, "map", "info", path).startswith(f"{path}\n")


def test_inspect_a_video(capfd, here):
    synthetic.write_video(here / "flight.avi")
    content = json_of(capfd, "inspect", "flight.avi", "--intrinsics", "64,48,50,50,31,23")
    assert content["frames"] == 6 and content["intrinsics"] == [50.0, 50.0, 31.0, 23.0]
    assert not content["has_poses"] and not content["has_depth"]


def test_inspect_shows_distortion(capfd, here):
    synthetic.write_video(here / "flight.avi")
    inspect = ("inspect", "flight.avi", "--intrinsics", "64,48,50,50,31,23,-0.08,0.01,0.001,-0.002,0.0004")
    assert json_of(capfd, *inspect)["distortion"] == [-0.08, 0.01, 0.001, -0.002, 0.0004]
    assert "-0.08, 0.01, 0.001, -0.002, 0.0004" in succeeds(capfd, *inspect)


def test_inspect_checks_that_a_recording_s_files_are_there(capfd, here):
    (here / "walk/color/000007.png").unlink()
    refused(capfd, here, ("inspect", "walk"), "walk/color/000007.png", "is missing", "restore it")


def test_inspect_a_recording(capfd, here, recording):
    content = json_of(capfd, "inspect", "walk", "--frames", "0:8")
    assert content["kind"] == "recording" and content["frames"] == 8
    assert content["image"] == [160, 128] and content["intrinsics"] == [136.0, 136.0, 79.5, 63.5]
    assert content["has_poses"] and content["has_depth"] and content["depth_share"] == 1.0
    assert content["seconds"] == pytest.approx(7 / 15)
    way = np.linalg.norm(np.diff(recording.poses[:8, :3, 3], axis=0), axis=1).sum()
    assert content["path_m"] == pytest.approx(way, abs=1e-6)
    assert content["depth_median_m"] == pytest.approx(np.median(recording.depth(0)), abs=1e-3)


def test_map_fit_and_info(capfd, here):
    fitted = json_of(capfd, "map", "fit", "walk", "--out", "room.npz", "-k", "30")
    mixture = GaussianMixture.load(here / "room.npz")
    assert fitted["components"] == len(mixture) == 30 and fitted["bytes"] == 1200
    info = json_of(capfd, "map", "info", "room.npz")
    assert info["components"] == 30 and info["bytes"] == 1200
    assert np.all(info["lower_m"] < mixture.means.min(axis=0)) and np.all(info["upper_m"] > mixture.means.max(axis=0))
    assert np.all(info["lower_m"] > np.array([-2.5, -1.4, -2.0]) - 0.5)
    assert np.all(info["upper_m"] < np.array([2.5, 1.2, 3.0]) + 0.5)
    assert 0.0 < info["thickness_median_m"] < 0.05 < info["length_median_m"]
    assert json_of(capfd, "map", "info", "room.monoloc")["components"] == 250
    cloud = Room().cloud(0.1)
    (here / "room.xyz").write_text("\n".join(" ".join(f"{x:.4f}" for x in point) for point in cloud))
    of_cloud = json_of(capfd, "map", "fit", "room.xyz", "--out", "cloud.npz", "-k", "20")
    assert of_cloud["components"] == 20
    shutil.copy(here / "room.xyz", here / "room.txt")
    assert json_of(capfd, "map", "fit", "room.txt", "--out", "cloud.npz", "-k", "20") == of_cloud


def test_map_compare(capfd, here):
    """Of a map that did not change, and of one that lies 5 cm from its original."""
    same = json_of(capfd, "map", "compare", "room.monoloc")
    assert same["c2c_max_m"] < 1e-6 and same["correspondence_kept"] == 1.0 and same["shift_median_m"] == 0.0
    np.testing.assert_allclose(same["box_original_m"]["lower"], [-2.5, -1.4, -2.0], atol=0.6)
    np.testing.assert_allclose(same["box_adapted_m"]["upper"], [2.5, 1.2, 3.0], atol=0.6)
    assert (here / same["picture"]).read_bytes().startswith(b"\x89PNG")
    bundle = read_bundle(here / "room.monoloc")
    moved = replace(bundle.original, means=bundle.original.means + np.array([0.03, 0.0, 0.04]))
    write_bundle(here / "moved.monoloc", replace(bundle, adapted=moved))
    change = json_of(capfd, "map", "compare", "moved.monoloc", "--out", "moved.png")
    assert (here / "moved.png").is_file()
    assert change["shift_median_m"] == pytest.approx(0.05, abs=1e-4)
    assert 0.01 < change["c2c_median_m"] < change["c2c_p95_m"] < change["c2c_max_m"] <= 0.05 + 1e-6
    shift = np.subtract(change["box_adapted_m"]["lower"], change["box_original_m"]["lower"])
    np.testing.assert_allclose(shift, [0.03, 0.0, 0.04], atol=1e-5)
    assert json_of(capfd, "map", "compare", "moved.monoloc", "--out", "again.png") == {
        **change,
        "picture": "again.png",
    }
    refused(capfd, here, ("map", "compare", "walk"), "walk", "is not a bundle", "monoloc build")


def test_depth_evaluate(capfd, here):
    exact = json_of(capfd, "depth", "evaluate", "room.monoloc", "walk", "--frames", "::4", "--plot", "depth.png")
    assert exact["frames"] == 3 and exact["scale"] == 1.0
    assert exact["absrel"] < 0.02 and exact["delta1"] > 0.98
    assert cv2.imread("depth.png") is not None
    # The same network against depth stored twice as large: the scale is found, and takes the error away.
    doubled = ("depth", "evaluate", "room.monoloc", "walk", "--frames", "::4", "--depth-scale", "500")
    assert json_of(capfd, *doubled)["absrel"] == pytest.approx(0.5, abs=0.02)
    fitted = json_of(capfd, *doubled, "--fit-scale")
    assert fitted["scale"] == pytest.approx(2.0, rel=0.01) and fitted["absrel"] < 0.02


def test_depth_evaluate_draws_the_error_that_a_network_states(capfd, here):
    command = ("depth", "evaluate", "tiny-0.35", "walk", "--frames", "::4", "--calibration", "error.png")
    assert json_of(capfd, *command)["frames"] == 3
    assert cv2.imread("error.png") is not None
    command = ("depth", "evaluate", "room.monoloc", "walk", "--frames", "::4", "--calibration", "none.png")
    refused(capfd, here, command, "--calibration", "does not state its error", "leave it out")


def test_depth_list(capfd, here):
    models = json_of(capfd, "depth", "list")["models"]
    assert [model["name"] for model in models] == ["full-0.35", "two-thirds-0.35", "one-third-0.35", "tiny-0.35"]
    keys = {"name", "width", "parameters", "macs", "bytes_fp32", "bytes_int8", "input_width", "delta1", "absrel"}
    assert all(keys <= model.keys() for model in models)
    table = succeeds(capfd, "depth", "list")
    assert all(model["name"] in table for model in models)


def test_a_bundle_can_carry_its_network_in_eight_bits(capfd, here):
    untuned = ("--tune", "none", "--no-map-transform", "-k", "30", "--network", "tiny-0.35")
    wide = json_of(capfd, "build", "walk", "--out", "wide.monoloc", *untuned)
    small = json_of(capfd, "build", "walk", "--out", "small.monoloc", *untuned, "--int8")
    assert small["bytes"] < wide["bytes"]
    inspected = json_of(capfd, "inspect", "small.monoloc")
    assert inspected["network"] == "tiny-0.35 in 8 bits"
    exact, rounded = (json_of(capfd, "depth", "evaluate", f"{name}.monoloc", "walk") for name in ("wide", "small"))
    assert rounded["absrel"] == pytest.approx(exact["absrel"], abs=0.05)
    twice = ("build", "walk", "--out", "no.monoloc", *untuned[:-1], "tiny-0.35-int8", "--int8")
    refused(capfd, here, twice, "--int8", "cannot be quantised", "32 bits")


def test_what_can_only_be_run_is_not_tuned_and_this_is_said(capfd, here):
    build = ("build", "walk", "--out", "x.monoloc", "-k", "30", "--network", "tiny-0.35-int8")
    remark = (
        "tiny-0.35-int8 can only be run: nothing of it was tuned; "
        "for a tuned one in 8 bits: --network tiny-0.35 --int8"
    )
    assert json_of(capfd, *build)["warnings"][0] == remark
    assert remark not in json_of(capfd, *build, "--tune", "none")["warnings"]
    of_bundle = json_of(capfd, *build[:-1], "room.monoloc")["warnings"]
    assert of_bundle[0] == "room.monoloc can only be run: nothing of it was tuned"


# --- Ctrl-C, and faults of ours ---


@pytest.mark.parametrize(
    ("number", "older"),
    [(signal.SIGINT, False), (signal.SIGINT, True), (signal.SIGTERM, False), (signal.SIGHUP, True)],
)
def test_interrupted_build_leaves_nothing_half_written(here, number, older):
    if not older:
        shutil.rmtree(here / "room.monoloc")
    before = listing(here)
    code = "from monoloc.cli.main import run; run()"
    # Thousands of components: the map alone would take many times longer than this test waits.
    command = [sys.executable, "-c", code, "build", "walk", "--out", "room.monoloc", *PLAIN, "-k", "3000"]
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=here,
        # Where the tests run in the background of a shell or under nohup, signals are ignored, which is inherited.
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    assert process.stderr.readline().startswith("cloud: done")
    time.sleep(0.3)
    assert process.poll() is None, "the build ended before it could be interrupted"
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == "" and err == "monoloc: interrupted; nothing half-written is left\n"
    assert listing(here) == before


def test_an_interrupted_write_leaves_no_partial_file(here):
    """Of a file, which is written beside its place first."""
    code = (
        "import os, signal, pathlib, numpy as np\n"
        "from monoloc.cli import app, main\n"
        "from monoloc.io.tum_trajectory import write_tum\n"
        "write = pathlib.Path.write_bytes\n"
        "def stopped(path, content):\n"
        "    write(path, content[:10])\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "pathlib.Path.write_bytes = stopped\n"
        "app.carry_out = lambda _: write_tum('way.txt', [0.0], np.eye(4)[None])\n"
        "main.run()"
    )
    before = listing(here)
    result = python(code, here=here)
    assert (result.returncode, result.stderr) == (130, "monoloc: interrupted; nothing half-written is left\n")
    assert listing(here) == before


def test_ctrl_c_is_heard_while_the_rest_is_imported(here):
    """Even where a library makes a failure of its own of it, as ONNX Runtime does."""
    code = (
        "import os, signal, sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'onnxruntime':\n"
        "            try:\n"
        "                os.kill(os.getpid(), signal.SIGINT)\n"
        "            except KeyboardInterrupt as error:\n"
        "                raise ImportError('initialization failed') from error\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from monoloc.cli.main import run; run()"
    )
    result = python(code, here=here)
    assert (result.returncode, result.stderr) == (130, "monoloc: interrupted; nothing half-written is left\n")


def test_nohup_is_heeded(here):
    code = (
        "import signal; from monoloc.cli.main import run\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "try: run()\n"
        "finally: print(signal.getsignal(signal.SIGHUP) is signal.SIG_IGN)"
    )
    told = python(code, "--version", here=here).stdout
    assert told.splitlines()[1] == "True"


def test_a_terminal_without_a_degree_sign_gets_another(here):
    code = "from monoloc.cli.main import run; run()"
    command = [sys.executable, "-c", code, "localize", "room.monoloc", "walk"]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    result = subprocess.run(command, capture_output=True, text=True, cwd=here, env=environment, check=False)
    assert result.returncode == 0, result.stderr
    assert re.search(r"\d\.\d\?", result.stdout)


@pytest.mark.parametrize(
    "command", [("inspect", "walk"), ("localize", "room.monoloc", "walk"), ("evaluate", "walk/poses.txt", "walk")]
)
def test_what_may_not_be_read_is_named(capfd, here, monkeypatch, command):
    """As folders without permissions are, whose files cannot even be asked for; root, whom tests may be, can."""

    def closed(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "exists", closed)
    monkeypatch.setattr(Path, "is_file", closed)
    assert invoke(list(command)) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert re.fullmatch(r"monoloc: (walk|room.monoloc)\S*: Permission denied; check that .* you may use it", line)


def test_a_fault_of_ours_is_no_bad_input(here, monkeypatch):
    """An unexpected exception is not dressed up: it ends with a traceback, which Python gives exit code 1."""
    environment = os.environ | {"PYTHONPATH": str(here)}
    (here / "sitecustomize.py").write_text(
        "import monoloc.run\ndef fail(*_, **__): raise RuntimeError('a fault of ours')\nmonoloc.run.localize = fail\n"
    )
    command = [sys.executable, "-c", "from monoloc.cli.main import run; run()", "localize", "room.monoloc", "walk"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=here, env=environment)
    assert result.returncode == 1
    assert "Traceback" in result.stderr and "a fault of ours" in result.stderr


# --- Progress ---


def test_progress_in_a_log_is_one_line_a_finished_task():
    log = io.StringIO()
    progress = ConsoleProgress(Console(file=log))
    with progress.task("cloud", 3) as step:
        for done in range(3):
            step(done + 1)
    with pytest.raises(RuntimeError), progress.task("map", None) as step:
        step(1)
        raise RuntimeError
    assert re.fullmatch(r"cloud: done in \d+\.\d s\n", log.getvalue())


def test_progress_on_a_terminal_is_a_bar():
    screen = io.StringIO()
    progress = ConsoleProgress(Console(file=screen, force_terminal=True, width=100))
    with progress.task("localize", 4) as step:
        step(2)
    assert "localize" in screen.getvalue() and "4/4" in screen.getvalue()


def test_six_intrinsics_keep_the_distortion_of_the_file(capfd, here):
    description = Path("walk/dataset.toml")
    description.write_text(description.read_text() + "distortion = [-0.05, 0.0, 0.0, 0.0, 0.0]\n")
    camera = json_of(capfd, "inspect", "walk")
    size, (fx, fy, cx, cy) = camera["image"], camera["intrinsics"]
    six = f"{size[0]},{size[1]},{fx},{fy},{cx},{cy}"
    assert json_of(capfd, "inspect", "walk", "--intrinsics", six)["distortion"] == [-0.05, 0.0, 0.0, 0.0, 0.0]
    assert json_of(capfd, "inspect", "walk", "--intrinsics", f"{six},0,0,0,0,0")["distortion"] == [0.0] * 5
