"""Layers, losses, augmentation and rendered rooms for the depth network, one changed at a time; a table for a report.

    monoloc synth views --seed 100 --rooms 16 --views 30 --samples 12 --out rooms
    python benchmarks/depth_ablation.py --data ../shared/data --encoder mobilenet_v2_0.35_imagenet.npz \\
        --rooms rooms --out runs

The network is one-third-0.35. It trains on NYU pairs 0:1240 and is judged on 1249:1349, so that the last 100 pairs,
which the reports quote, choose nothing, and on RedKitchen, another room and camera. With rooms it takes as many steps
as without. Finished runs are kept and not run again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from monoloc.cli.common import stderr
from monoloc.depth.model_files import read_model
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.training.augment import AugmentConfig, Exposure, expose
from monoloc.depth.training.family import network_config
from monoloc.depth.training.losses import LossConfig
from monoloc.depth.training.train import TrainConfig, train_network
from monoloc.evaluation.depth_metrics import DepthAccumulator, fit_scale
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording, select_frames
from monoloc.progress import ConsoleProgress

_EPOCHS = 20
_TRAINING, _VALIDATION = "0:1240", "1249:1349"
_KITCHEN = "2:400:12"
_DIM = Exposure(stops=-4.0, electrons=1000.0)  # a sixteenth of the light, and a noisy sensor

_ROOMS = "with rendered rooms"

_BASE = TrainConfig(network=network_config("one-third", 0.35), epochs=_EPOCHS)


def _with_layers(encoder_blocks: tuple[int, ...], pooling_stages: tuple[int, ...]) -> TrainConfig:
    changed = {"encoder_blocks": encoder_blocks, "pooling_stages": pooling_stages}
    return _BASE.model_copy(update={"network": _BASE.network.model_copy(update=changed)})


VARIANTS = {
    "base": _BASE,
    "mild light": _BASE.model_copy(
        update={"augment": AugmentConfig(dim_share=0.0, saturation=0.0, electrons_min=3000.0)}
    ),
    "with scale-invariant term, 0.5": _BASE.model_copy(update={"loss": LossConfig(scale_invariant=0.5)}),
    "without gradient term": _BASE.model_copy(update={"loss": LossConfig(gradient=0.0)}),
    "with normal term, 0.2": _BASE.model_copy(update={"loss": LossConfig(normal=0.2)}),
    "weight decay 0.05": _BASE.model_copy(update={"weight_decay": 0.05}),
    "every repeated block left out": _with_layers((1, 1, 1, 1, 1, 1, 0), (4, 2, 0, 4)),
    "everything at stride 32 left out": _with_layers((1, 2, 3, 4, 3, 0, 0), (0, 2, 1, 4)),
    _ROOMS: _BASE,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--encoder", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rooms", type=Path, help="a folder of monoloc synth views")
    parser.add_argument("--only", help="one variant by name")
    arguments = parser.parse_args()
    pairs = open_recording(f"folder:{arguments.data / 'nyu-labelled'}")
    training, validation = select_frames(pairs, _TRAINING), select_frames(pairs, _VALIDATION)
    kitchen = select_frames(open_recording(f"7scenes:{arguments.data / '7scenes' / 'redkitchen'}"), _KITCHEN)
    print("| variant | AbsRel | delta1 | AbsRel, one scale an image | AbsRel, 4 stops darker |", end="")
    print(" RedKitchen, one scale | one scale an image |\n" + "|---" * 7 + "|")
    for name, config in VARIANTS.items():
        if name != (arguments.only or name) or (name == _ROOMS and arguments.rooms is None):
            continue
        mixed = [training]
        if name == _ROOMS:
            mixed.append(open_recording(f"folder:{arguments.rooms}"))
            config = config.model_copy(update={"epochs": round(_EPOCHS * len(training) / sum(map(len, mixed)))})
        folder = arguments.out / name.replace(" ", "-").replace(",", "")
        train_network(mixed, validation, config, folder, arguments.encoder, progress=ConsoleProgress(stderr))
        network = folder / "network.safetensors"
        figures = judge(network, validation) | judge_elsewhere(network, kitchen)
        (folder / "figures.json").write_text(json.dumps(figures, indent=1))
        print(f"| {name} | " + " | ".join(f"{value:.3f}" for value in figures.values()) + " |", flush=True)


def judge(network: Path, validation: Recording) -> dict[str, float]:
    predictor = DepthPredictor(read_model(network), validation.camera)
    plain, scaled, dim = DepthAccumulator(), DepthAccumulator(), DepthAccumulator()
    rng = np.random.default_rng(0)
    for index in range(len(validation)):
        color, truth = validation.color(index), validation.depth(index)
        depth = cv2.resize(predictor(color).depth_m, truth.shape[::-1])
        plain.add(depth, truth)
        scaled.add(depth * fit_scale(depth, truth), truth)
        dim.add(cv2.resize(predictor(expose(color, _DIM, rng)).depth_m, truth.shape[::-1]), truth)
    return {
        "absrel": plain.mean().absrel,
        "delta1": plain.mean().delta1,
        "absrel_scaled": scaled.mean().absrel,
        "absrel_dim": dim.mean().absrel,
    }


def judge_elsewhere(network: Path, recording: Recording) -> dict[str, float]:
    predictor = DepthPredictor(read_model(network), recording.camera)
    truths = [recording.depth(index) for index in range(len(recording))]
    size = truths[0].shape[::-1]
    found = [cv2.resize(predictor(recording.color(index)).depth_m, size) for index in range(len(recording))]
    known = [truth > 0.0 for truth in truths]
    ratios = [np.log(truth[k] / depth[k]) for truth, depth, k in zip(truths, found, known, strict=True)]
    scale = float(np.exp(np.median(np.concatenate(ratios))))
    common, each = DepthAccumulator(), DepthAccumulator()
    for depth, truth in zip(found, truths, strict=True):
        common.add(depth * scale, truth)
        each.add(depth * fit_scale(depth, truth), truth)
    return {"redkitchen_absrel": common.mean().absrel, "redkitchen_absrel_scaled": each.mean().absrel}


if __name__ == "__main__":
    main()
