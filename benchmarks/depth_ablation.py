"""Losses and augmentation of the depth network, one changed at a time; a table for the report.

    python benchmarks/depth_ablation.py --data ../shared/data --encoder mobilenet_v2_0.35_imagenet.npz --out runs

The network is one-third-0.35. It trains on NYU pairs 0:1240 and is judged on 1249:1349, so that the last 100 pairs,
which the reports quote, choose nothing. Finished runs are kept and not run again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from monoloc.cli.common import stderr
from monoloc.datasets.base import Recording
from monoloc.datasets.registry import open_recording, select_frames
from monoloc.depth.augment import AugmentConfig, Exposure, expose
from monoloc.depth.family import network_config
from monoloc.depth.losses import LossConfig
from monoloc.depth.model import read_model
from monoloc.depth.runtime import DepthPredictor
from monoloc.depth.train import TrainConfig, train_network
from monoloc.evaluation.depth import DepthAccumulator, fit_scale
from monoloc.progress import ConsoleProgress

_EPOCHS = 20
_TRAINING, _VALIDATION = "0:1240", "1249:1349"
_DIM = Exposure(stops=-4.0, electrons=1000.0)  # a sixteenth of the light, and a noisy sensor

_BASE = TrainConfig(network=network_config("one-third", 0.35), epochs=_EPOCHS)
VARIANTS = {
    "base": _BASE,
    "mild light": _BASE.model_copy(
        update={"augment": AugmentConfig(dim_share=0.0, saturation=0.0, electrons_min=3000.0)}
    ),
    "with scale-invariant term, 0.5": _BASE.model_copy(update={"loss": LossConfig(scale_invariant=0.5)}),
    "without gradient term": _BASE.model_copy(update={"loss": LossConfig(gradient=0.0)}),
    "with normal term, 0.2": _BASE.model_copy(update={"loss": LossConfig(normal=0.2)}),
    "weight decay 0.05": _BASE.model_copy(update={"weight_decay": 0.05}),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--encoder", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", help="one variant by name")
    arguments = parser.parse_args()
    pairs = open_recording(f"folder:{arguments.data / 'nyu-labelled'}")
    training, validation = select_frames(pairs, _TRAINING), select_frames(pairs, _VALIDATION)
    print(
        "| variant | AbsRel | delta1 | AbsRel, one scale an image | AbsRel, 4 stops darker |\n|---|---|---|---|---|"
    )
    for name, config in VARIANTS.items():
        if arguments.only is not None and name != arguments.only:
            continue
        folder = arguments.out / name.replace(" ", "-").replace(",", "")
        train_network([training], validation, config, folder, arguments.encoder, progress=ConsoleProgress(stderr))
        figures = judge(folder / "network.safetensors", validation)
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


if __name__ == "__main__":
    main()
