"""Depth at viewpoints that tuned nothing, in a known room: what each way of tuning is worth.

    python benchmarks/new_viewpoints.py --data ../shared/data
    python benchmarks/new_viewpoints.py --data ../shared/data --network one-third-0.35 --only "all, synthesised"
    python benchmarks/new_viewpoints.py --data ../shared/data --build 0:200:3 --away 200:300:2 --between 1:200:3

Tunes on some of RedKitchen's frames and judges on others: *away* on a stretch beside them, *between* on frames
between them. AbsRel is of depth as predicted; *shape* is AbsRel after the best scale for each image; *scale* is the
mean and the spread over images of the logarithm of that scale; *step* is how far the errors of an image would move
the camera from the true pose (root mean square, nothing else being known of it), and *turn* by what angle.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.pose_step import pose_steps, pose_twists
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import Views, make_views
from monoloc.adapt.tuning import Adaptation
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.room_map import fit_map
from monoloc.depth.model_files import trainable_file
from monoloc.depth.models import DEFAULT
from monoloc.depth.training.checkpoint import load_network
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording, select_frames
from monoloc.map.depth_rendering import supervision
from monoloc.progress import NoProgress

_UNKNOWN = 10.0  # m and rad; no prior
_NONE_HELD_OUT = np.zeros(0, dtype=np.int64)
VARIANTS = {
    "untuned": AdaptConfig(tune="none", map_transform=False),
    "decoder": AdaptConfig(tune="decoder", map_transform=False, synthesised_views=0),
    "decoder, synthesised": AdaptConfig(tune="decoder", map_transform=False),
    "all": AdaptConfig(tune="all", map_transform=False, synthesised_views=0),
    "all, synthesised": AdaptConfig(tune="all", map_transform=False),
    "the same without pose steps": AdaptConfig(tune="all", map_transform=False, pose_weight=0.0),
}


def judge(adaptation: Adaptation, views: Views) -> list[str]:
    """AbsRel, AbsRel of shape, mean and spread of log-scale, step and turn."""
    log_depth, truth = adaptation.predict(views), views.output_depth_m
    absrel, shape, scale = [], [], []
    for predicted, true in zip(log_depth.numpy(), truth.numpy(), strict=True):
        error = predicted[true > 0.0] - np.log(true[true > 0.0])
        scale.append(np.median(error))
        absrel.append(np.mean(np.abs(np.expm1(error))))
        shape.append(np.mean(np.abs(np.expm1(error - scale[-1]))))
    twists = pose_twists(log_depth, truth, pose_steps(truth[:, 0].numpy(), views.rays, _UNKNOWN)).numpy()
    step_m, turn_rad = (np.sqrt(np.square(part).sum(1).mean()) for part in (twists[:, :3], twists[:, 3:]))
    return [
        f"{np.mean(absrel):.3f}",
        f"{np.mean(shape):.3f}",
        f"{np.mean(scale):+.3f} ± {np.std(scale):.3f}",
        f"{100.0 * step_m:.1f} cm",
        f"{np.rad2deg(turn_rad):.1f}°",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--network", default=DEFAULT)
    parser.add_argument("--only", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    parser.add_argument("--build", default="0:300:3")
    parser.add_argument("--away", default="300:400:3")
    parser.add_argument("--between", default="1:300:9")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    kitchen = open_recording(f"7scenes:{arguments.data / '7scenes' / 'redkitchen'}")
    build = select_frames(kitchen, arguments.build)
    file = trainable_file(arguments.network)
    assert file is not None
    focal_px = load_network(file).config.focal_px
    cloud, mixture = fit_map(build, None, BuildConfig(), np.random.default_rng(0), NoProgress())

    def plain_views(recording: Recording) -> Views:
        return make_views(recording, recording.depth, focal_px, 0, _NONE_HELD_OUT, np.random.default_rng(0))

    away, between = (plain_views(select_frames(kitchen, frames)) for frames in (arguments.away, arguments.between))
    columns = "AbsRel | shape | scale | step | turn"
    print(f"| {arguments.network} | away {columns} | between {columns} | s |\n|{'---|' * 12}")
    for name in arguments.only:
        config = VARIANTS[name]
        started = time.perf_counter()
        rng = np.random.default_rng(arguments.seed)
        depth_of = supervision(build, cloud)
        views = make_views(build, depth_of, focal_px, config.synthesised_views, _NONE_HELD_OUT, rng)
        adaptation = Adaptation(load_network(file), AdaptedMap(mixture, cloud), config)
        adaptation.run(views, config.most_steps, torch.Generator().manual_seed(arguments.seed))
        seconds = time.perf_counter() - started
        cells = [*judge(adaptation, away), *judge(adaptation, between)]
        print(f"| {name} | " + " | ".join(cells) + f" | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main()
