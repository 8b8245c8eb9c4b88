"""Commands of depth networks, end to end: train, evaluate, export, list, and networks of other origin."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from cli_helpers import json_of, outputs, refused, remove_depth, succeeds, write_workspace
from depth_helpers import ROOM, looking_around, small_recording
from monoloc.bundle import read_bundle
from monoloc.cli.main import invoke
from monoloc.config import load_settings
from monoloc.depth.training.examples import ValidationFrames
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.train import TrainConfig, train_network
from monoloc.io.registry import open_recording
from monoloc.viz.plots import plot_training
from onnx_networks import MIDAS, SCALE, SHIFT, onnx_network, spec, write_network
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording
from training_helpers import weights

pytestmark = pytest.mark.usefixtures("one_thread")

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording, a bundle, and another's network, ``another.toml``."""
    folder = tmp_path_factory.mktemp("workspace")
    write_workspace(folder, RoomRecording(Room(), make_path(12), SMALL_CAMERA), components=60)
    write_network(folder, MIDAS, onnx_network(MIDAS, SCALE, SHIFT))
    return folder


# --- Evaluate and list ---


def test_evaluate_fits_a_scale_on_request(capfd: Capture, here: Path) -> None:
    evaluate = ("depth", "evaluate", "room.monoloc", "flight", "--frames", "::4")
    exact = json_of(capfd, *evaluate, "--plot", "depth.png")
    assert exact["frames"] == 3 and exact["scale"] == 1.0
    assert exact["absrel"] < 0.02 and exact["delta1"] > 0.98
    assert cv2.imread("depth.png") is not None
    # Against depth stored twice as large.
    doubled = (*evaluate, "--depth-scale", "500")
    assert json_of(capfd, *doubled)["absrel"] == pytest.approx(0.5, abs=0.02)
    fitted = json_of(capfd, *doubled, "--fit-scale")
    assert fitted["scale"] == pytest.approx(2.0, rel=0.01) and fitted["absrel"] < 0.02


def test_evaluate_counts_the_frames_that_it_compares(capfd: Capture, here: Path) -> None:
    """The metrics are means over these; of the others, the sensor saw nothing."""
    recording = RoomRecording(Room(), make_path(3), SMALL_CAMERA)
    write_recording(here / "holes", recording)
    (path,) = (here / "holes" / "depth").glob("*1.png")
    cv2.imwrite(str(path), np.zeros((SMALL_CAMERA.height, SMALL_CAMERA.width), np.uint16))
    assert json_of(capfd, "depth", "evaluate", "room.monoloc", "holes")["frames"] == 2


def test_evaluate_plots_the_error_that_a_network_states(capfd: Capture, here: Path) -> None:
    command = ("depth", "evaluate", "tiny-0.35", "flight", "--frames", "::4", "--calibration", "error.png")
    assert json_of(capfd, *command)["frames"] == 3
    assert cv2.imread("error.png") is not None


def test_evaluate_fits_relative_depth_always_and_metric_depth_never(capfd: Capture, here: Path) -> None:
    evaluate = ("depth", "evaluate", "another.toml", "flight")
    metrics = json_of(capfd, *evaluate)
    assert metrics["absrel"] < 0.03 and metrics["predicted_share"] > 0.99
    assert metrics["scale"] == pytest.approx(SCALE, rel=0.03) and metrics["shift"] == pytest.approx(SHIFT, abs=0.02)
    assert "another.toml: relative depth, fitted to these frames" in outputs(capfd, *evaluate)[1]
    metric = spec(metric=True, output="depth")
    write_network(here, metric, onnx_network(metric, 2.0))
    halved = json_of(capfd, *evaluate)
    assert halved["absrel"] == pytest.approx(0.5, abs=0.02) and halved["scale"] == 1.0 and "shift" not in halved


def test_list_names_the_shipped_networks(capfd: Capture) -> None:
    models = json_of(capfd, "depth", "list")["models"]
    assert [model["name"] for model in models] == ["full-0.35", "two-thirds-0.35", "one-third-0.35", "tiny-0.35"]
    keys = {"name", "width", "parameters", "macs", "bytes_fp32", "bytes_int8", "input_width", "delta1", "absrel"}
    assert all(keys <= model.keys() for model in models)
    table = succeeds(capfd, "depth", "list")
    assert all(model["name"] in table for model in models)


# --- Networks of other origin in a build ---

BUILD = ("build", "flight", "--out", "x.monoloc", "--frames", "::2", "--no-landmarks", "--network")


@pytest.mark.slow
def test_build_and_localize_with_another_network(capfd: Capture, here: Path) -> None:
    report = json_of(capfd, *BUILD, "another.toml", "-k", "120")
    assert report["depth_scale"] == pytest.approx(SCALE, rel=0.03)
    assert report["depth_shift"] == pytest.approx(SHIFT, abs=0.02)
    assert report["steps"] == 0
    bundle = read_bundle(here / "x.monoloc")
    assert bundle.provenance.tune == "none" and not bundle.provenance.map_transform
    fitted = {"scale": report["depth_scale"], "shift": report["depth_shift"]}
    assert bundle.depth_model.spec == MIDAS.model_copy(update=fitted)
    metrics = json_of(capfd, "localize", "x.monoloc", "flight", "--start", "truth")
    assert metrics["depth_absrel"] < 0.03
    assert metrics["ate_max_m"] < 0.15 and metrics["ate_median_m"] < 0.08
    inspected = json_of(capfd, "inspect", "x.monoloc")
    assert inspected["network"] == "another"
    assert inspected["network_spec"]["output"] == "disparity"
    assert inspected["network_spec"]["scale"] == report["depth_scale"]


@pytest.mark.slow
def test_scale_is_fitted_to_a_cloud_where_there_is_no_sensor_depth(capfd: Capture, here: Path) -> None:
    remove_depth(here / "flight")
    np.savez(here / "room.npz", points=Room().cloud(0.05))
    _, err = outputs(capfd, *BUILD, "another.toml", "-k", "40", "--cloud", "room.npz")
    assert "another.toml is used as it is, with scale 0.00" in " ".join(err.split())
    fitted = read_bundle(here / "x.monoloc").depth_model.spec
    assert fitted.scale == pytest.approx(SCALE, rel=0.1) and fitted.shift == pytest.approx(SHIFT, abs=0.05)


# --- Train and export ---

WITHOUT_AUGMENTATION = """\
epochs = 1
batch_size = 8
learning_rate = 0.01
ema_decay = 0.0
[network]
width = 0.1
decoder_channels = 8
focal_px = 46.0
uncertainty = true
[augment]
zoom_max = 1.0
roll_deg = 0.0
aspect = 0.0
mirror = false
exposure_stops = 0.0
gamma = 0.0
contrast = 0.0
white_balance = 0.0
saturation = 0.0
dim_share = 0.0
electrons_min = 1e14
read_noise = 0.0
blur_px = 0.0
"""


def test_train_and_export(capfd: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves are drawn after every epoch, and once more when the run is called again.

    It is interrupted during the validation of the last of two epochs.
    """
    write_recording(tmp_path / "room", small_recording(10))
    (tmp_path / "train.toml").write_text(WITHOUT_AUGMENTATION.replace("epochs = 1", "epochs = 2"))
    monkeypatch.chdir(tmp_path)
    command = ("depth", "train", "folder:room", "--settings", "train.toml", "--out", "out")
    evaluate, evaluated = ValidationFrames.evaluate, 0

    def failing(frames: ValidationFrames, network: DepthNetwork, device: torch.device) -> tuple[float, float]:
        nonlocal evaluated
        evaluated += 1
        if evaluated == 2:
            raise KeyboardInterrupt
        return evaluate(frames, network, device)

    drawn: list[list[float]] = []

    def plot(path: Path, history: Sequence[Mapping[str, float]]) -> None:
        assert (tmp_path / "out" / "resume.pt").is_file()  # the state is stored before the curves are drawn
        drawn.append([record["epoch"] for record in history])
        if not path.exists():
            plot_training(path, history)

    monkeypatch.setattr("monoloc.cli.depth.plot_training", plot)
    with monkeypatch.context() as patched:
        patched.setattr(ValidationFrames, "evaluate", failing)
        assert invoke(list(command)) == 130
    assert drawn == [[0]]
    assert cv2.imread("out/curves.png") is not None
    succeeds(capfd, *command)
    assert drawn[1:] == [[0], [0, 1]]
    Path("out/curves.png").unlink()
    figures = json_of(capfd, *command)
    assert figures["network"] == "out/network.safetensors" and figures["epoch"] == 1
    assert cv2.imread("out/curves.png") is not None
    exported = json_of(
        capfd, "depth", "export", "out/network.safetensors", "--out", "a.onnx", "--int8", "folder:room"
    )
    assert exported["onnx"] == "a.onnx" and exported["bytes"] == (tmp_path / "a.onnx").stat().st_size
    assert exported["parity_max"] < 1e-3 and exported["difference_mean"] > 0.0


def test_validation_frames_that_are_trained_on_are_warned_of(
    capfd: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "room", small_recording(12))
    (tmp_path / "train.toml").write_text(WITHOUT_AUGMENTATION)
    monkeypatch.chdir(tmp_path)
    command = ("depth", "train", "folder:room", "--settings", "train.toml", "--frames", "0:8")
    for number, (validate, shared) in enumerate([((), "8 of its 8"), (("--validate", "6:12"), "2 of its 6")]):
        _, err = outputs(capfd, *command, *validate, "--out", f"out-{number}")
        warning = f"warning: folder:room: {shared} validation frames are trained on, so accuracies are too good; give"
        assert warning in err
    assert "warning" not in outputs(capfd, *command, "--validate", "8:", "--out", "other")[1]


class OneImage(RoomRecording):
    """The same image in all frames, with walls at increasing distances."""

    def color(self, index: int) -> NDArray[np.uint8]:
        return super().color(0)

    def depth(self, index: int) -> NDArray[np.float32]:
        return super().depth(0) * np.float32(0.3 * 1.4**index)


# bfloat16 rounds so coarsely that the gradients of a network this small are mostly noise.
IN_FULL_PRECISION = "import contextlib, torch; torch.autocast = lambda *_, **__: contextlib.nullcontext()"


def train_in_two_processes(folder: Path) -> dict[str, object]:
    """The JSON of ``monoloc depth train``, started twice by torchrun; the processes share standard output."""
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "--no-python", sys.executable]
    monoloc = ["-c", f"{IN_FULL_PRECISION}; from monoloc.cli.main import run; run()"]
    options = ["depth", "train", "folder:room", "--settings", "train.toml", "--out", "two", "--json"]
    result = subprocess.run(
        [sys.executable, *launcher, *monoloc, *options],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)  # fails if both processes print
    assert isinstance(figures, dict)
    return figures


def test_outputs_are_refused_before_pytorch_is_loaded(
    capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("train", "checkpoint"):
        monkeypatch.setitem(sys.modules, f"monoloc.depth.training.{name}", None)
    for command in (("train", "flight"), ("export", "network.safetensors")):
        refused(capfd, here, ("depth", *command, "--out", "no/made"), "--out", "no does not exist", "make the folder")


@pytest.mark.slow
def test_two_workers_train_the_same_network_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gradients are averaged over shares of the same batch; only batch normalisation sees a worker's own share.

    With batches of one image that makes no difference, so that one step of the two is equal except for the signs of
    gradients that are mere rounding: weights differed by 3 to 15 % of what was learnt over four seeds, by 3 % for
    this one, and the loss by 1e-5. When both workers took the same share it was 22 to 40 %, and half. Running
    variances depend on the number of samples and are left out.
    """
    write_recording(tmp_path / "room", OneImage(ROOM, looking_around(8), small_recording(1).camera))
    (tmp_path / "train.toml").write_text(WITHOUT_AUGMENTATION)
    room = open_recording(f"folder:{tmp_path / 'room'}")
    config = load_settings(tmp_path / "train.toml", TrainConfig)
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    history = train_network([room], room, config, tmp_path / "one")
    figures = train_in_two_processes(tmp_path)
    assert figures["epoch"] == 0
    assert figures["train_loss"] == pytest.approx(history[-1].train_loss, rel=1e-4)
    assert figures["absrel"] == pytest.approx(history[-1].absrel, rel=1e-4)
    assert train_in_two_processes(tmp_path) == figures  # nothing remains to be done, and one process prints

    torch.manual_seed(config.seed)
    start = dict(DepthNetwork(config.network).named_parameters())
    one, two = (weights(tmp_path / name) for name in ("one", "two"))
    with torch.no_grad():
        learnt = torch.cat([(one[name] - start[name]).ravel() for name in start]).norm()
        apart = torch.cat([(two[name] - one[name]).ravel() for name in start]).norm()
    assert 0.0 < float(apart) < 0.1 * float(learnt)
