"""Depth at viewpoints that tuned nothing, in a known room: what each way of tuning is worth.

    python benchmarks/new_viewpoints.py --data ../shared/data
    python benchmarks/new_viewpoints.py --data ../shared/data --network one-third-0.35 --only "all, synthesised"

Tunes on RedKitchen's frames 0:300:3 and judges on 300:400 (away) and on frames of 0:300 between those (between).
AbsRel is of depth as predicted; *shape* is AbsRel after the best scale for each image; *scale* is the mean and the
spread over images of the logarithm of that scale.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from monoloc.adapt.map_depth import supervision
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.train import Adaptation
from monoloc.adapt.transform import AdaptedMap
from monoloc.adapt.views import Views, make_views
from monoloc.build import BuildConfig, fit_map
from monoloc.datasets.base import Recording
from monoloc.datasets.registry import open_recording, select_frames
from monoloc.depth.checkpoint import load_network
from monoloc.depth.model import trainable_file
from monoloc.models import DEFAULT
from monoloc.progress import NoProgress

_BUILD, _AWAY, _BETWEEN = "0:300:3", "300:400:3", "1:300:9"
_NONE_HELD_OUT = np.zeros(0, dtype=np.int64)
VARIANTS = {
    "untuned": AdaptConfig(tune="none", map_transform=False),
    "decoder": AdaptConfig(tune="decoder", map_transform=False, synthesised_views=0),
    "decoder, synthesised": AdaptConfig(tune="decoder", map_transform=False),
    "all": AdaptConfig(tune="all", map_transform=False, synthesised_views=0),
    "all, synthesised": AdaptConfig(tune="all", map_transform=False),
}


def judge(adaptation: Adaptation, views: Views) -> list[float]:
    """AbsRel, AbsRel of shape, mean and spread of log-scale."""
    log_depth = adaptation.predict(views)[:, 0].numpy()
    truth = views.depth_m[:, 0, 1::2, 1::2].numpy()
    absrel, shape, scale = [], [], []
    for predicted, true in zip(log_depth, truth, strict=True):
        error = predicted[true > 0.0] - np.log(true[true > 0.0])
        scale.append(np.median(error))
        absrel.append(np.mean(np.abs(np.expm1(error))))
        shape.append(np.mean(np.abs(np.expm1(error - scale[-1]))))
    return [float(np.mean(absrel)), float(np.mean(shape)), float(np.mean(scale)), float(np.std(scale))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--network", default=DEFAULT)
    parser.add_argument("--only", choices=list(VARIANTS))
    arguments = parser.parse_args()
    kitchen = open_recording(f"7scenes:{arguments.data / '7scenes' / 'redkitchen'}")
    build = select_frames(kitchen, _BUILD)
    file = trainable_file(arguments.network)
    assert file is not None
    focal_px = load_network(file).config.focal_px
    cloud, mixture = fit_map(build, None, BuildConfig(), np.random.default_rng(0), NoProgress())

    def plain_views(recording: Recording) -> Views:
        return make_views(recording, recording.depth, focal_px, 0, _NONE_HELD_OUT, np.random.default_rng(0))

    away, between = (plain_views(select_frames(kitchen, frames)) for frames in (_AWAY, _BETWEEN))
    print(f"| {arguments.network} | away AbsRel | shape | scale | between AbsRel | shape | scale | s |")
    print("|" + "---|" * 8)
    for name, config in VARIANTS.items():
        if arguments.only not in (None, name):
            continue
        started = time.perf_counter()
        rng = np.random.default_rng(0)
        depth_of = supervision(build, cloud)
        views = make_views(build, depth_of, focal_px, config.synthesised_views, _NONE_HELD_OUT, rng)
        adaptation = Adaptation(load_network(file), AdaptedMap(mixture, cloud), config)
        adaptation.run(views, config.most_steps, torch.Generator().manual_seed(0))
        seconds = time.perf_counter() - started
        cells = []
        for absrel, shape, scale, spread in (judge(adaptation, away), judge(adaptation, between)):
            cells += [f"{absrel:.3f}", f"{shape:.3f}", f"{scale:+.3f} ± {spread:.3f}"]
        print(f"| {name} | " + " | ".join(cells) + f" | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main()
