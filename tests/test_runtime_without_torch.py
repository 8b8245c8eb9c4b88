"""The drone's machine has no PyTorch: the online way works without it, and never imports it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import python
from monoloc.bundle import read_bundle, write_bundle
from monoloc.evaluation.trajectory import pose_errors
from monoloc.io.pose_files import read_tum
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture, write_recording

# Everything that is no dependency of the bare package.
ABSENT = (
    "torch",
    "mitsuba",
    "drjit",
    "scipy",
    "matplotlib",
    "sklearn",
    "skimage",
    "h5py",
    "onnx",
    "safetensors",
    "rerun",
    "pyarrow",
    "evo",
    "hypothesis",
    "joblib",
    "distributed",
    "dask",
    "reportlab",
)
FORBID = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""
ONLINE = [
    "monoloc",
    "monoloc.localizer",
    "monoloc.run",
    "monoloc.bundle",
    "monoloc.builder.pipeline",
    "monoloc.odometry.visual",
    "monoloc.depth.predictor",
    "monoloc.depth.model_files",
    "monoloc.depth.scale_fit",
    "monoloc.io.registry",
    "monoloc.evaluation.depth_metrics",
    "monoloc.viz.plots",
    "monoloc.map.em",
    "monoloc.io.tum_trajectory",
    "monoloc.viz.viewer",
    "monoloc.adapt.settings",
    "monoloc.builder.calibrate",
    "monoloc_lab.experiments.engine",
    "monoloc_lab.experiments.figures",
    "monoloc_lab.bench.steps",
    "monoloc.cli.main",
    "monoloc.cli.app",
]


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(12), SMALL_CAMERA)


@pytest.fixture(scope="module")
def here(tmp_path_factory, recording) -> Path:
    folder = tmp_path_factory.mktemp("drone")
    write_recording(folder / "walk", recording)
    write_bundle(folder / "room.monoloc", make_bundle(room_mixture(Room()), recording))
    return folder


def monoloc(here: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command line in a process in which the extras cannot be imported."""
    return python(FORBID + "from monoloc.cli.main import run; run()", *arguments, here=here)


@pytest.mark.parametrize(
    "name", ["torch", "onnx.helper", "scipy.optimize", "monoloc.adapt.adaptation", "monoloc.depth.training.train"]
)
def test_the_extras_are_really_absent(name):
    result = python(FORBID + f"import {name}")
    assert result.returncode == 1
    assert "ModuleNotFoundError" in result.stderr


def test_everything_online_can_be_imported():
    result = python(FORBID + "\n".join(f"import {name}" for name in ONLINE))
    assert result.returncode == 0, result.stderr


def test_localize_from_the_command_line(here, recording):
    result = monoloc(here, "localize", "room.monoloc", "walk", "--out", "way.txt", "--json")
    assert result.returncode == 0, result.stderr
    metrics = json.loads(result.stdout)
    assert metrics["frames"] == 12 and metrics["unseen_frames"] == 12
    _, poses = read_tum(here / "way.txt")
    assert pose_errors(poses, recording.poses).position_m.max() < 0.15
    assert metrics["depth_absrel"] < 0.02  # by the network, not by luck


@pytest.mark.slow
def test_the_other_commands_of_the_online_way(here):
    assert monoloc(here, "localize", "room.monoloc", "walk", "--out", "way.txt").returncode == 0
    for command in (
        ("evaluate", "way.txt", "walk"),
        ("inspect", "room.monoloc"),
        ("inspect", "walk"),
        ("map", "fit", "walk", "--out", "room.npz", "-k", "20"),
        ("map", "info", "room.npz"),
        ("depth", "evaluate", "room.monoloc", "walk"),
    ):
        result = monoloc(here, *command, "--json")
        assert result.returncode == 0, result.stderr
        assert isinstance(json.loads(result.stdout), dict)


def test_build_without_adaptation(here):
    options = ("--tune", "none", "--no-map-transform", "-k", "30")
    result = monoloc(here, "build", "walk", "--out", "plain.monoloc", *options, "--json")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["components"] == 30
    assert np.allclose(read_bundle(here / "plain.monoloc").adapted.weights.sum(), 1.0)
    assert monoloc(here, "localize", "plain.monoloc", "walk", "--depth", "sensor").returncode == 0


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (("build", "walk", "--out", "x.monoloc"), "train"),
        (("build", "walk", "--out", "x.monoloc", "--tune", "none"), "train"),
        (("depth", "train", "walk", "--out", "trained"), "train"),
        (("depth", "export", "network.safetensors", "--out", "x.onnx"), "train"),
        (("localize", "room.monoloc", "walk", "--plot", "x.png"), "report"),
        (("depth", "evaluate", "room.monoloc", "walk", "--plot", "x.png"), "report"),
        (("localize", "room.monoloc", "walk", "--record", "x.rrd"), "view"),
        (("localize", "room.monoloc", "walk", "--view"), "view"),
    ],
)
def test_what_needs_an_extra_says_which_before_it_works(here, arguments, extra):
    before = sorted(path.name for path in here.iterdir())
    result = monoloc(here, *arguments)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1  # not even a finished task
    fix = f'install it, where the sources are, with: pip install ".[{extra}]"'
    assert f'needs the extra "{extra}"; {fix}' in result.stderr
    assert sorted(path.name for path in here.iterdir()) == before


def test_where_the_extras_are_installed_they_are_not_imported(here):
    """Nothing is forbidden here; nothing is loaded either."""
    code = f"""
import sys
from monoloc.cli.main import invoke
assert invoke(["localize", "room.monoloc", "walk", "--json"]) == 0
assert invoke(["evaluate", "walk/poses.txt", "walk", "--json"]) == 0
print({{name.partition(".")[0] for name in sys.modules}} & set({ABSENT!r}), file=sys.stderr)
"""
    result = python(code, here=here)
    assert result.returncode == 0, result.stderr
    assert result.stderr.splitlines()[-1] == "set()"
