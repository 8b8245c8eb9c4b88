"""The drone's machine has no PyTorch: localising works without any extra, and never imports one."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import python
from monoloc.bundle import read_bundle, write_bundle
from monoloc.evaluation.trajectory import pose_errors
from monoloc.io.pose_files import read_tum
from repository import REPOSITORY
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
    "pycolmap",
    "rosbags",
    "mcap",
    "mcap_ros2",
)
FORBID = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""
# Of the modules, those that need an extra: all others must do without.
NEED_EXTRAS = (
    "monoloc.adapt.",
    "monoloc.depth.training.",
    "monoloc.viz.flight_drawing",
    "monoloc.viz.rerun_edits",
    "monoloc.viz.rerun_viewer",
)
DO_WITHOUT_NEVERTHELESS = ("monoloc.adapt.settings",)


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(12), SMALL_CAMERA)


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording) -> Path:
    folder = tmp_path_factory.mktemp("drone")
    write_recording(folder / "recording", recording)
    write_bundle(folder / "room.monoloc", make_bundle(room_mixture(Room()), recording))
    return folder


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str


def monoloc(here: Path, *commands: tuple[str, ...]) -> list[Result]:
    """Commands one after another, in one process in which the extras cannot be imported."""
    code = f"""{FORBID}
import io, json
from contextlib import redirect_stderr, redirect_stdout
from monoloc.cli.main import invoke

results = []
for command in json.loads(sys.argv[1]):
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = invoke(command)
    results.append([code, out.getvalue(), err.getvalue()])
print(json.dumps(results))
"""
    process = python(code, json.dumps(commands), here=here)
    assert process.returncode == 0, process.stderr
    return [Result(*result) for result in json.loads(process.stdout)]


def test_extras_are_really_absent() -> None:
    names = ("torch", "onnx.helper", "scipy.optimize", "monoloc.adapt.adaptation", "monoloc.depth.training.train")
    code = f"""{FORBID}
import importlib
for name in {names!r}:
    try:
        importlib.import_module(name)
        sys.exit(name)
    except ModuleNotFoundError:
        pass
"""
    process = python(code)
    assert process.returncode == 0, process.stderr


def test_all_modules_but_those_of_training_can_be_imported() -> None:
    root = REPOSITORY / "src"
    files = [path.relative_to(root).with_suffix("") for path in (root / "monoloc").rglob("*.py")]
    modules = sorted(".".join(path.parts).removesuffix(".__init__") for path in files)
    online = [name for name in modules if not name.startswith(NEED_EXTRAS) or name in DO_WITHOUT_NEVERTHELESS]
    assert {"monoloc.localizer", "monoloc.cli.app", "monoloc.builder.pipeline"} < set(online)
    process = python(FORBID + "\n".join(f"import {name}" for name in online))
    assert process.returncode == 0, process.stderr


def test_commands_of_the_drone(here: Path, recording: RoomRecording) -> None:
    commands = [
        ("localize", "room.monoloc", "recording", "--start", "truth", "--out", "trajectory.txt"),
        ("evaluate", "trajectory.txt", "recording"),
        ("inspect", "room.monoloc"),
        ("inspect", "recording"),
        ("map", "fit", "recording", "--out", "room.npz", "-k", "20"),
        ("map", "info", "room.npz"),
        ("depth", "evaluate", "room.monoloc", "recording"),
    ]
    results = monoloc(here, *((*command, "--json") for command in commands))
    assert [result.code for result in results] == [0] * len(commands), [result.err for result in results]
    metrics, *others = (json.loads(result.out) for result in results)
    assert all(isinstance(other, dict) for other in others)
    assert metrics["frames"] == 12 and metrics["unseen_frames"] == 12
    assert metrics["depth_absrel"] < 0.02  # by the network, not by luck
    _, poses = read_tum(here / "trajectory.txt")
    assert pose_errors(poses, recording.poses).position_m.max() < 0.15


def test_build_without_adaptation(here: Path) -> None:
    options = ("--frames", "::2", "--no-landmarks", "--tune", "none", "--no-map-transform", "-k", "30", "--json")
    built, localized = monoloc(
        here,
        ("build", "recording", "--out", "plain.monoloc", *options),
        ("localize", "plain.monoloc", "recording", "--start", "truth", "--depth", "sensor"),
    )
    assert built.code == localized.code == 0, built.err + localized.err
    assert json.loads(built.out)["components"] == 30
    assert np.allclose(read_bundle(here / "plain.monoloc").adapted.weights.sum(), 1.0)


def test_command_that_needs_an_extra_says_which_before_it_works(here: Path) -> None:
    needed = {
        ("build", "recording", "--out", "x.monoloc"): "train",
        ("build", "recording", "--out", "x.monoloc", "--tune", "none"): "train",
        ("depth", "train", "recording", "--out", "trained"): "train",
        ("depth", "export", "network.safetensors", "--out", "x.onnx"): "train",
        ("localize", "room.monoloc", "recording", "--plot", "x.png"): "report",
        ("depth", "evaluate", "room.monoloc", "recording", "--plot", "x.png"): "report",
        ("localize", "room.monoloc", "recording", "--record", "x.rrd"): "view",
        ("localize", "room.monoloc", "recording", "--view"): "view",
        ("localize", "room.monoloc", "recording", "--out", "x.mcap"): "mcap",
        ("fly", "room.monoloc", "recording", "--mcap", "x.mcap"): "mcap",
    }
    before = sorted(path.name for path in here.iterdir())
    for result, (command, extra) in zip(monoloc(here, *needed), needed.items(), strict=True):
        assert (result.code, result.out) == (2, ""), command
        assert result.err.count("\n") == 1  # not even a finished task
        assert f'needs the extra "{extra}"' in result.err and f"[{extra}]" in result.err, command
    assert sorted(path.name for path in here.iterdir()) == before


def test_installed_extras_are_not_imported(here: Path) -> None:
    """Nothing is forbidden here; nothing is loaded either."""
    code = f"""
import sys
from monoloc.cli.main import invoke
assert invoke(["localize", "room.monoloc", "recording", "--start", "truth", "--json"]) == 0
assert invoke(["evaluate", "recording/poses.txt", "recording", "--json"]) == 0
print({{name.partition(".")[0] for name in sys.modules}} & set({ABSENT!r}), file=sys.stderr)
"""
    process = python(code, here=here)
    assert process.returncode == 0, process.stderr
    assert process.stderr.splitlines()[-1] == "set()"
