"""What the commands share: intrinsics, outputs that may not be written, names of options, and tables."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

import synthetic_recordings as synthetic
from monoloc.cli.common import (
    naming,
    open_cloud,
    open_source,
    print_figures,
    print_table,
    refuse_frames,
    text_of,
)
from monoloc.cli.output_checks import check_apart, check_folder, check_outputs, check_picture, check_viewing
from monoloc.errors import MissingExtraError, SettingError
from refusals import refuses_setting

# --- Recordings and their options ---


@pytest.mark.parametrize(
    "text",
    ["640,480,525", "a,b,c,d,e,f", "320.5,256,1,1,1,1", "", "64,48,50,50,31,23,0.1", "64,48,50,50,31,23" + 6 * ",0"],
)
def test_intrinsics_that_are_not_six_or_eleven_numbers_are_refused(text: str) -> None:
    refuses_setting(
        lambda: open_source("no", "::", text), "--camera", f"is '{text}'", "W,H,FX,FY,CX,CY.*K1,K2,P1,P2,K3"
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("64,48,0,50,31,23", r"fx/fy is \(0.0, 50.0\)"),
        ("nan,480,525,525,320,240", "is 'nan,480"),
        ("64,48,50,50,99,23", r"cx/cy \(99.0, 23.0\) lies outside"),
        ("0,48,50,50,31,23", "width/height is 0x48"),
        ("64,48,50,50,31,23,-9,0,0,0,0", "distortion .*folds the image"),
        ("160,128,136,136,79.5,63.5", "is for 160x128, but flight.avi is 64x48"),
    ],
)
def test_intrinsics_of_no_possible_camera_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    synthetic.write_video(tmp_path / "flight.avi")
    refuses_setting(lambda: open_source("flight.avi", "::", text), "--camera", problem, "")


def test_settings_of_a_recording_are_named_by_their_options(tmp_path: Path) -> None:
    synthetic.write_folder(tmp_path)
    source = str(tmp_path)
    refuses_setting(lambda: open_source(source, "9:"), "--frames", "selects none of the 3", "START")
    refuses_setting(lambda: open_source(source, "9:", frames_option="--validate"), "--validate", "selects none", "")
    refuses_setting(lambda: open_source(source, "::", depth_scale=0.0), "--depth-scale", "is 0.0", "such as 1000")


def test_what_a_reader_left_out_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    synthetic.write_folder(tmp_path / "walk")
    path = tmp_path / "walk/poses.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "5.1" + 7 * " nan", lines[3]]))
    assert len(open_source(str(tmp_path / "walk"), "::")) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err == "note: walk: 1 of 3 frames are left out: 1 without a pose\n"


def test_what_is_left_out_of_a_cloud_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\nnan 2 3\n")
    assert len(open_cloud(tmp_path / "a.xyz")) == 1
    expected = f"note: {tmp_path / 'a.xyz'}: 1 of 2 points are left out: they are not finite\n"
    assert capsys.readouterr().err == expected


def test_six_intrinsics_do_not_change_the_distortion_and_eleven_do(tmp_path: Path) -> None:
    synthetic.write_folder(tmp_path)
    source, own = str(tmp_path), (0.1, -0.2, 0.0, 0.001, 0.0)
    assert open_source(source, "::", "32,24,30,31,15.5,11.5").camera.distortion == own
    assert open_source(source, "::", "32,24,30,31,15.5,11.5,0,0,0,0,0").camera.distortion == (0.0,) * 5


def test_only_named_settings_become_options() -> None:
    for field, expected in (("components", "--components"), ("voxel_m", "voxel_m")):
        with (
            pytest.raises(SettingError, match=f"^{expected}: is wrong; mend it"),
            naming({"components": "--components"}),
        ):
            raise SettingError(field, "is wrong", "mend it")


def test_choice_of_frames_is_refused_where_there_are_none() -> None:
    refuse_frames(" :: ", "a cloud")
    refuses_setting(lambda: refuse_frames("0:4", "a cloud"), "--frames", "has no meaning for a cloud", "leave it out")


# --- Outputs ---


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with two files of a bundle and of a recording, a cloud, a link to it, a video, an empty folder
    and a pipe."""
    for folder in ("room.monoloc", "run", "walk"):
        (tmp_path / folder).mkdir()
    files = ("room.monoloc/manifest.json", "room.monoloc/depth.onnx", "walk/dataset.toml", "walk/poses.txt")
    for name in (*files, "room.xyz", "flight.mp4"):
        (tmp_path / name).write_text("content")
    (tmp_path / "link.txt").symlink_to("room.xyz")
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("output", "inputs", "problem"),
    [
        ("flight.mp4", ("flight.mp4",), "flight.mp4 is read by this command"),
        ("./flight.mp4", ("video:flight.mp4",), "flight.mp4 is read"),
        ("flight.mp4", ("video:~/flight.mp4",), "flight.mp4 is read"),
        ("link.txt", ("room.xyz",), "link.txt is read"),
        ("room.monoloc", (None, "room.monoloc"), "room.monoloc is read"),
        ("room.monoloc/map.png", ("room.monoloc",), "lies in the bundle room.monoloc"),
        ("run/../room.monoloc/manifest.json", (), "lies in the bundle run/../room.monoloc"),
        ("room.monoloc/sub/map.png", (), "lies in the bundle room.monoloc"),
        ("walk/poses.txt", ("walk",), "walk/poses.txt lies in walk, which is read by this command"),
        ("walk/poses.txt", ("folder:~/walk/",), "walk/poses.txt lies in ~/walk/"),
        ("walk/poses.txt", ("walk/dataset.toml",), "walk/poses.txt lies in walk/dataset.toml"),
        ("flight.mp4", ("rosbag:flight.mp4#/camera",), "flight.mp4 is read"),
    ],
)
def test_output_in_the_place_of_an_input_is_refused(
    here: Path, output: str, inputs: tuple[str | None, ...], problem: str
) -> None:
    refuses_setting(lambda: check_apart(Path(output), "--out", inputs), "--out", problem, "another place")


@pytest.mark.parametrize("source", ["home/L1", "folder:home/L1", "home/L1/dataset.toml"])
def test_a_file_beside_the_folder_that_its_description_names_is_kept(here: Path, source: str) -> None:
    """Recordings of one flight in several lights share poses and depth."""
    for folder in ("home/L1", "home/depth"):
        (here / folder).mkdir(parents=True)
    keys = 'color = "{index}.jpg"\ndepth = "../depth/{index:06d}.png"\nposes = "../poses.txt"\n'
    (here / "home/L1/dataset.toml").write_text(keys)
    for name in ("home/poses.txt", "home/depth/000000.png"):
        Path(name).write_text("content")
        with pytest.raises(SettingError, match=r"--out: .* is read by this command, as home/L1.* names it; .*place"):
            check_apart(Path(name), "--out", (source,))
    check_apart(Path("home/trajectory.txt"), "--out", (source,))
    check_apart(Path("home/depth/new.png"), "--out", (source,))


@pytest.mark.parametrize(
    ("outputs", "option", "problem", "fix"),
    [
        ({"--out": "no/file"}, "--out", "no does not exist", "make the folder first"),
        ({"--out": "room.xyz/file"}, "--out", "room.xyz is a file", "name a place in a folder"),
        ({"--out": "run"}, "--out", "run is a folder", "name a file"),
        ({"--out": "pipe"}, "--out", "pipe is neither a file nor a folder", "name a file"),
        ({"--out": "/dev/null"}, "--out", "/dev/null is neither a file nor a folder", "name a file"),
        ({"--out": "a.png", "--plot": "./a.png"}, "--plot", "a.png is what --out writes", "name another file"),
        ({"--out": "a", "--record": "run/../a"}, "--record", "a is what --out writes", "name another file"),
    ],
)
def test_output_that_cannot_be_written_is_refused(
    here: Path, outputs: dict[str, str], option: str, problem: str, fix: str
) -> None:
    paths = {name: Path(path) for name, path in outputs.items()}
    refuses_setting(lambda: check_outputs(paths), option, problem, fix)


def test_outputs_may_be_new_older_or_linked(here: Path) -> None:
    check_outputs({"--out": Path("new.txt"), "--plot": Path("link.txt"), "--record": None}, ("flight.mp4", None))
    check_outputs({"--out": Path("room.xyz")})
    check_outputs({"--out": Path("walk/trajectory.txt")}, ("walk",))


def test_loop_of_links_is_left_to_the_reader(here: Path) -> None:
    Path("loop").symlink_to("loop")
    check_apart(Path("new.txt"), "--out", ("loop",))


def test_output_folder_that_cannot_be_made_is_refused(here: Path) -> None:
    check_folder(Path("run"), "--out")
    check_folder(Path("new"), "--out")
    refuses_setting(
        lambda: check_folder(Path("no/a"), "--out"), "--out", "no does not exist", "make the folder first"
    )
    refuses_setting(lambda: check_folder(Path("room.xyz"), "--out"), "--out", "is a file", "name a folder")


def test_picture_must_be_named_as_one_and_needs_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    check_picture(None, "--plot")
    check_picture(Path("a.PNG"), "--plot")
    for name in ("a.pdf", "a"):
        refuses_setting(
            lambda name=name: check_picture(Path(name), "--plot"),
            "--plot",
            f"{re.escape(name)} would be a PNG by another name",
            "NAME.png",
        )
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r'plots needs the extra "report".*; .*pip install'):
        check_picture(Path("a.png"), "--plot")


def test_recording_for_the_viewer_must_be_named_as_one() -> None:
    problem = "flight9 would be a recording of Rerun by another name"
    refuses_setting(lambda: check_viewing(view=False, record=Path("flight9")), "--record", problem, "NAME.rrd")


# --- Tables ---


def test_tables_are_rounded_and_their_titles_are_not_wrapped_or_interpreted(
    capfd: pytest.CaptureFixture[str],
) -> None:
    title = "[a]:room: whose name is longer than the table below it is wide.monoloc"
    print_figures(title, {"down": (1 / 3, -0.1234567, 0.0123456), "scale_sd": None, "is_signed": False}, json=False)
    out = capfd.readouterr().out
    assert out.startswith(f"{title}\n")
    assert "│ down      │ 0.333, -0.123, 0.0123 │" in out
    assert "│ scale sd  │ -  " in out and "│ is signed │ no  " in out


def test_keys_are_words_and_their_values_have_units(capfd: pytest.CaptureFixture[str]) -> None:
    figures = {"lower_m": (1.0, -2.5), "rot_rmse_deg": 0.25, "step_ms": None, "m": 3, "files_s": {"a.txt": 2}}
    print_figures("room", figures, json=False)
    rows = [[cell.strip() for cell in row.split("│")[1:-1]] for row in capfd.readouterr().out.splitlines()[2:-1]]
    assert rows == [
        ["lower", "1.000, -2.500 m"],
        ["rot rmse", "0.250°"],
        ["step", "-"],
        ["m", "3"],
        ["files s", "a.txt: 2"],
    ]


def test_words_of_a_wide_table_are_whole_in_80_columns(capfd: pytest.CaptureFixture[str]) -> None:
    names = ["frames", "median", "RMSE", "max", "rotation", "in 5 cm, 5°", "coverage", "depth error"]
    values = ["unseen", "45.7 cm", "44.4 cm", "53.1 cm", "122.3°", "100.0 %", "100.0 %", "23.7 %"]
    print_table("Accuracy", names, [values])
    out = capfd.readouterr().out
    assert all(word in out for word in ("rotation", "coverage", *values))


def test_entries_of_a_dict_in_a_dict_have_its_name_before_theirs() -> None:
    assert text_of({"share": 0.25, "scan": {"edges": [], "right": [1.0]}, "none": {}}) == (
        "share: 0.250\nscan.edges: \nscan.right: 1.000\nnone: "
    )
