"""Bad input on the command line: one line that names it and the fix, exit code 2, and nothing written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from cli_helpers import QUICK, UNTUNED, refused, remove_depth, write_workspace
from monoloc.io.tum_trajectory import write_tum
from onnx_networks import MIDAS, onnx_network, write_network
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

LOCALIZE = ("localize", "room.monoloc", "flight", "--start", "truth", "--out", "trajectory.txt", "--plot", "plot.png")
BUILD = ("build", "flight", "--out", "x.monoloc")
DEPTH_EVALUATE = ("depth", "evaluate", "room.monoloc", "flight", "--plot", "depth.png")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    write_workspace(folder, RoomRecording(Room(), make_path(6), SMALL_CAMERA), components=60)
    return folder


def nothing(_: Path) -> None:
    """Leave the folder as it is."""


def cut_short(name: str) -> Callable[[Path], None]:
    def spoil(here: Path) -> None:
        (here / name).write_bytes((here / name).read_bytes()[:1000])

    return spoil


def without_depth(here: Path) -> None:
    remove_depth(here / "flight")


def without_poses(here: Path) -> None:
    description = here / "flight" / "dataset.toml"
    description.write_text(description.read_text().replace('poses = "poses.txt"', "rate_hz = 15"))


def with_settings(text: str) -> Callable[[Path], None]:
    def write(here: Path) -> None:
        (here / "s.toml").write_text(text)

    return write


def with_network_of_another(here: Path) -> None:
    write_network(here, MIDAS, onnx_network(MIDAS, 0.004, -0.3))


def with_trajectory(here: Path) -> None:
    write_tum(here / "trajectory.txt", [0.0], np.eye(4)[None])


@pytest.mark.parametrize(
    ("spoil", "command", "names", "problem", "fix"),
    [
        # Build.
        (without_poses, BUILD, "flight", "moves so little that it has [0-9] keyframes", "walk through the room"),
        (
            lambda here: (without_poses(here), (here / "room.xyz").write_text("0 0 1\n")),
            (*BUILD, "--cloud", "room.xyz"),
            "--cloud",
            "is of a world that images without poses are not in",
            "leave it out",
        ),
        (
            nothing,
            (*BUILD, "--scale", "depth"),
            "--scale",
            "has no meaning for a recording with poses",
            "leave it out",
        ),
        (without_poses, (*BUILD, "--scale", "2"), "--scale", "is '2'", "marker:ID:SIZE_M"),
        (nothing, ("reconstruct", "flight", "--out", "flight"), "--out", "is read by this command", "another place"),
        (nothing, ("reconstruct", "flight", "--out", "."), ".", "holds files", "a new folder"),
        (
            nothing,
            ("reconstruct", "flight", "--out", "walk", "--camera-out", "cam.toml"),
            "--camera-out",
            "has no meaning where the intrinsics are given",
            "leave it out",
        ),
        (without_depth, (*BUILD, *QUICK), "flight", "has no depth", "cloud"),
        (without_depth, (*BUILD, "--refine-poses"), "--refine-poses", "needs depth", "leave it out"),
        (nothing, (*BUILD, "--frames", "0:3"), "flight", r"has too few frames \(3\)", "at least 5"),
        (nothing, (*BUILD, "--frames", "90:"), "--frames", "selects none of the 6", "START"),
        (nothing, (*BUILD, *QUICK, "--depth-scale", "1"), "flight", "has no depth between 0 and", "depth scale"),
        (nothing, (*BUILD, *UNTUNED, "-k", "1000000"), "--components", "is 1000000 for a cloud of", ""),
        (nothing, (*BUILD, "--lambda", "nan"), "--lambda", "a finite number", "correct its value"),
        (
            with_settings(""),
            (*BUILD, "--method", "paper", "--settings", "s.toml"),
            "--method",
            "is given beside s.toml",
            "leave one",
        ),
        (
            nothing,
            ("localize", "room.monoloc", "flight", "--without", "bias,landmark"),
            "--without",
            "has 'landmark'",
            "choose from landmarks, scan, odometry",
        ),
        (
            nothing,
            ("localize", "room.monoloc", "flight", "--start-error-cm", "5"),
            "--start-error-cm",
            "has no effect without a start",
            "give a start too",
        ),
        (
            nothing,
            ("localize", "room.monoloc", "flight", "--without", "relocalization"),
            "--start",
            "is unknown, and the search for the camera is left out",
            "write",
        ),
        (
            with_settings("components = 1000000\n"),
            (*BUILD, *UNTUNED, "--settings", "s.toml"),
            "components",
            "is 1000000 for a cloud of",
            "",
        ),
        (nothing, (*BUILD, "--cloud", "no.ply"), "no.ply", "there is no such file", "check the path"),
        (nothing, (*BUILD, "--network", "one-thrid-0.35"), "one-thrid-0.35", "does not exist", "one-third-0.35"),
        (
            nothing,
            (*BUILD, *UNTUNED, "--network", "tiny-0.35-int8", "--int8"),
            "--int8",
            "cannot be quantised",
            "32 bits",
        ),
        (
            with_network_of_another,
            (*BUILD, "--network", "another.toml", "--tune", "decoder"),
            "--tune",
            "is decoder, but another.toml can only be run, not tuned",
            "give --tune none",
        ),
        (
            with_network_of_another,
            (*BUILD, "--network", "another.toml", "--map-transform"),
            "--map-transform",
            "is on, but another.toml",
            "give --tune none",
        ),
        (
            lambda here: (with_network_of_another(here), with_settings('[adapt]\ntune = "decoder"\n')(here)),
            (*BUILD, "--network", "another.toml", "--settings", "s.toml"),
            "adapt.tune",
            "is decoder, but another.toml",
            "give --tune none",
        ),
        (
            nothing,
            (*BUILD, *UNTUNED, "--intrinsics", "160,128,900,900,79.5,63.5"),
            "camera",
            "focal length of 900 px, for full-0.35 32x32",
            "check the intrinsics",
        ),
        (nothing, (*BUILD[:-1], "flight"), "flight", "exists and is not a bundle", "another name"),
        (nothing, (*BUILD[:-1], "room.txt"), "--out", "room.txt is not named as a bundle", "NAME.monoloc"),
        (nothing, (*BUILD[:-1], "room.monoloc", "--network", "room.monoloc"), "--out", "is read by", "name another"),
        (cut_short("flight/depth/000003.png"), (*BUILD, *QUICK), "flight/depth/000003.png", "is cut short", "again"),
        # Localize.
        (nothing, (*LOCALIZE[:2], "no", "--out", "a.txt"), "", "/no: does not exist", "check the path"),
        (cut_short("flight/color/000003.png"), LOCALIZE, "flight/color/000003.png", "is cut short", "again"),
        (cut_short("room.monoloc/map.npz"), LOCALIZE, "room.monoloc/map.npz", "(is|was)", "copy the bundle again"),
        (without_depth, (*LOCALIZE, "--depth", "sensor"), "flight", "has no depth", "--depth"),
        (nothing, (*LOCALIZE, "--particles", "3"), "--particles", "greater than or equal to 10", "correct its value"),
        (nothing, (*LOCALIZE, "--start", "here"), "--start", "is 'here'", "TX,TY,TZ"),
        (nothing, (*LOCALIZE[:6], "a.json"), "--out", "a.json has no suffix of a trajectory", "choose from .txt"),
        (nothing, (*LOCALIZE[:-1], "plot.pdf"), "--plot", "plot.pdf would be a PNG by another name", "NAME.png"),
        (
            nothing,
            (*LOCALIZE[:-1], "room.monoloc/a.png"),
            "--plot",
            "lies in the bundle room.monoloc",
            "name another",
        ),
        (nothing, (*LOCALIZE[:6], "flight/poses.txt"), "--out", "lies in flight, which is read", "a new file"),
        # Evaluate and inspect.
        (nothing, ("evaluate", "no.txt", "flight"), "no.txt", "cannot be read", "check the path"),
        (with_trajectory, ("evaluate", "trajectory.txt", "no"), "", "/no: does not exist", "check the path"),
        (nothing, ("inspect", "room.monoloc", "--frames", "0:4"), "--frames", "no meaning for a bundle", "leave it"),
        (
            nothing,
            ("inspect", "room.monoloc", "--intrinsics", "1,1,1,1,1,1"),
            "--camera",
            "no meaning for a bundle",
            "",
        ),
        # Maps.
        (without_depth, ("map", "fit", "flight", "--out", "m.npz"), "flight", "has no depth", "cloud"),
        (nothing, ("map", "fit", "flight", "--out", "no/m.npz"), "--out", "no does not exist", "make the folder"),
        (
            nothing,
            ("map", "fit", "flight", "--out", "m.txt"),
            "--out",
            "m.txt would be a map by another name",
            "NAME.npz",
        ),
        (
            nothing,
            ("calibrate", "camera", "x", "--out", "c.txt"),
            "--out",
            "would be a camera file by another",
            "NAME.toml",
        ),
        (
            nothing,
            ("reconstruct", "flight", "--out", "walk", "--camera-out", "c.txt"),
            "--camera-out",
            "would be a camera file by another name",
            "NAME.toml",
        ),
        (
            nothing,
            ("calibrate", "camera", "pictures", "--size", "1280x720", "--out", "c.toml"),
            "--size",
            "has no meaning for pictures and videos",
            "leave it out",
        ),
        (
            nothing,
            ("calibrate", "board", "--out", "board.png"),
            "--out",
            "would be a PDF by another name",
            "NAME.pdf",
        ),
        (
            nothing,
            ("map", "fit", "a.xyz", "--out", "m.npz", "--frames", "::2"),
            "--frames",
            "no meaning for a cloud",
            "",
        ),
        (nothing, ("map", "fit", "flight/poses.txt", "--out", "flight/poses.txt"), "--out", "is read by", "another"),
        (
            nothing,
            ("map", "info", "flight/dataset.toml"),
            "flight/dataset.toml",
            "is no mixture map",
            "monoloc map fit",
        ),
        (nothing, ("map", "compare", "flight"), "flight", "is not a bundle", "monoloc build"),
        # Depth.
        (without_depth, DEPTH_EVALUATE, "flight", "has no depth", "depth images"),
        (
            nothing,
            (*DEPTH_EVALUATE[:4], "--calibration", "a.png"),
            "--calibration",
            "does not state its error",
            "leave it",
        ),
        (
            nothing,
            ("depth", "evaluate", "flight/poses.txt", "flight"),
            "flight/poses.txt",
            "cannot be loaded",
            "export",
        ),
        (nothing, ("depth", "export", "flight/poses.txt", "--out", "a.onnx"), "flight/poses.txt", "is not", "give a"),
        (
            nothing,
            ("depth", "export", "a.safetensors", "--out", "b.safetensors"),
            "--out",
            "would be an ONNX file by another name",
            "NAME.onnx",
        ),
        (
            nothing,
            ("depth", "export", "full-0.35", "--out", "a.onnx"),
            "network",
            "comes with monoloc",
            "use its name",
        ),
        (
            nothing,
            ("depth", "export", "a.safetensors", "--out", "a.onnx", "--frames", "::2"),
            "--frames",
            "no meaning for",
            "",
        ),
        (nothing, ("depth", "train", "flight", "--out", "run", "--validate", "9:"), "--validate", "selects none", ""),
        (nothing, ("depth", "train", "flight", "--out", "flight/poses.txt"), "--out", "is a file", "name a folder"),
        (nothing, ("depth", "train", "flight", "--out", "room.monoloc"), "--out", "is or lies in the bundle", ""),
        (
            nothing,
            ("depth", "train", "flight", "--out", "run", "--encoder", "no.npz"),
            "no.npz",
            "is missing",
            "check the path",
        ),
        (
            nothing,
            ("depth", "train", "flight", "--out", "run", "--encoder", "a.npz", "--start", "a.onnx"),
            "--start",
            "conflicts with --encoder",
            "one of them",
        ),
    ],
)
def test_bad_input_is_refused_and_leaves_no_trace(
    capfd: pytest.CaptureFixture[str],
    here: Path,
    spoil: Callable[[Path], object],
    command: tuple[str, ...],
    names: str,
    problem: str,
    fix: str,
) -> None:
    spoil(here)
    refused(capfd, here, command, names, problem, fix)


def test_video_without_poses_is_refused(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    synthetic.write_video(here / "flight.avi")
    problem, fix = "does not state its intrinsics", "--camera 64,48,FX,FY,CX,CY"
    refused(capfd, here, (*LOCALIZE[:2], "flight.avi"), "flight.avi", problem, fix)
