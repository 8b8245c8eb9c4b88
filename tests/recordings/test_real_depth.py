"""Depth networks on real images, from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from monoloc.depth.model_files import read_model
from monoloc.depth.models import DEFAULT, shipped_file
from monoloc.depth.predictor import DepthPredictor
from monoloc.io.registry import open_recording
from recording_helpers import monoloc, source

pytestmark = [pytest.mark.data, pytest.mark.slow]


@pytest.fixture(scope="module")
def kitchen(data_root: Path) -> str:
    return source(data_root, "7scenes", "7scenes/redkitchen")


@pytest.fixture(scope="module")
def nyu(data_root: Path) -> str:
    return source(data_root, "folder", "nyu-labelled")


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("depth")


def test_depth_evaluate_on_pairs_it_was_not_trained_on(nyu, here):
    metrics = monoloc("depth", "evaluate", "full-0.35", nyu, "--frames", "1349::5", "--plot", here / "nyu.png")
    assert metrics["frames"] == 20 and metrics["scale"] == 1.0
    # Guessing the mean depth gives AbsRel 0.4 or more.
    assert metrics["absrel"] < 0.3 and metrics["delta1"] > 0.5
    assert metrics["rmse_m"] < 1.2
    assert cv2.imread(str(here / "nyu.png")) is not None


def test_depth_evaluate_fits_a_scale(kitchen):
    command = ("depth", "evaluate", "full-0.35", kitchen, "--frames", "0:400:40")
    as_is, fitted = monoloc(*command), monoloc(*command, "--fit-scale")
    assert as_is["frames"] == fitted["frames"] == 10
    assert 0.5 < fitted["scale"] < 2.0 and fitted["scale"] != 1.0
    assert fitted["delta1"] >= as_is["delta1"] - 0.05


def test_depth_export_gives_the_shipped_network(kitchen, here):
    out = here / "exported.onnx"
    report = monoloc("depth", "export", shipped_file(DEFAULT), "--out", out)
    assert report["bytes"] == out.stat().st_size and report["bytes"] < 3e6
    assert report["parity_mean"] <= report["parity_max"] < 1e-3
    command = ("depth", "evaluate", "full-0.35", kitchen, "--frames", "0:400:100")
    exported = ("depth", "evaluate", out, *command[3:])
    assert monoloc(*exported)["absrel"] == pytest.approx(monoloc(*command)["absrel"], rel=1e-3)


def test_depth_train_learns(nyu, data_root, here):
    encoder = data_root.parent / "weights" / "mobilenet_v2_0.35_imagenet.npz"
    if not encoder.is_file():
        pytest.skip(f"no weights at {encoder}")
    (here / "train.toml").write_text("batch_size = 8\nema_decay = 0.5\nlearning_rate = 0.004\n")
    out = here / "trained"
    options = ("--validate", "1349:1357", "--encoder", encoder, "--settings", here / "train.toml", "--epochs", "3")
    last = monoloc("depth", "train", nyu, "--frames", "0:1300:40", "--out", out, *options)
    history = json.loads((out / "history.json").read_text())
    assert len(history) == 3 and last["epoch"] == 2
    assert history[-1]["train_loss"] < history[0]["train_loss"]
    assert last["absrel"] == history[-1]["absrel"] < 1.0
    assert sorted(path.name for path in out.iterdir()) == [
        "curves.png",
        "history.json",
        "network.safetensors",
        "resume.pt",
    ]
    # The written network is the evaluated one.
    network = out / "network.safetensors"
    evaluated = monoloc("depth", "evaluate", network, nyu, "--frames", "1349:1357")
    assert evaluated["absrel"] == pytest.approx(last["absrel"], rel=0.1)
    exported = here / "trained.onnx"
    assert monoloc("depth", "export", network, "--out", exported)["parity_max"] < 1e-3
    recording = open_recording(nyu)
    depth = DepthPredictor(read_model(exported), recording.camera)(recording.color(1350)).depth_m
    assert np.all(depth > 0.1) and np.all(depth < 20.0)
