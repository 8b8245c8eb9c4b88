"""What other methods make of a real room, in good and in dim light: PoseNet, filtered PoseNet, ORB, SIFT.

    python benchmarks/redkitchen.py --data ../shared/data --out runs/redkitchen
    python benchmarks/baselines.py --data ../shared/data --bundles runs/redkitchen --out runs/baselines

The splits are those of ``redkitchen.py``, whose bundles give the filtered PoseNet the same depth network, for its
odometry, as monoloc itself has, and give the rows ``monoloc`` and ``unadapted`` to compare with. PoseNets that are in
``--out`` are used again. Every frame of a split's run is located, in order; figures are of those that did not build.
What follows the camera starts 10 cm and 3 degrees off, and its row is the median over seeds. Dim light is a sixteenth
of that in which the images were taken, with the noise of a small sensor; L1 to L3 are those of ``monoloc synth``, put
on the images.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import torch

from monoloc.baselines.keypoints import KeypointConfig, KeypointLocalizer, build_keypoint_map
from monoloc.baselines.pose_filter import PoseFilter
from monoloc.baselines.posenet import posenet_config
from monoloc.baselines.posenet_file import load_posenet, save_posenet
from monoloc.baselines.posenet_training import PoseNetTraining, PosePredictor, TrainedPoseNet, train_posenet
from monoloc.baselines.run import Locate, Transform, locate_all
from monoloc.bundle import Bundle, fingerprint, read_bundle
from monoloc.datasets.base import Recording
from monoloc.datasets.registry import open_recording, select_frames
from monoloc.depth.augment import Exposure, expose
from monoloc.depth.family import SIZES
from monoloc.depth.runtime import DepthPredictor
from monoloc.filter.particles import Particles, scatter
from monoloc.localizer import Localizer
from monoloc.progress import NoProgress
from monoloc.runs import disturbed
from monoloc.synth.light import LIGHTS as ROOM_LIGHTS
from monoloc.synth.light import relit
from redkitchen import SPLITS, InMemory, bundle_path

_WIDTH = 0.35
_DIM = Exposure(stops=-4.0, electrons=3000.0)
_START_M, _START_RAD = 0.10, np.deg2rad(3.0)
LIGHTS = ("good", "dim", *ROOM_LIGHTS)
METHODS = ("posenet", "filtered", "orb", "sift", "monoloc", "unadapted")

# A method at the start of a run, with its random numbers.
Start = Callable[[np.random.Generator], Locate]


def transform_of(light: str) -> Transform | None:
    rng = np.random.default_rng(0)
    if light in ROOM_LIGHTS:
        return lambda color: relit(color, ROOM_LIGHTS[light], rng)
    return None if light == "good" else lambda color: expose(color, _DIM, rng)


def trained(out: Path, split: str, size: str, build: Recording, weights: Path) -> TrainedPoseNet:
    path = out / f"{split}-{size}.safetensors"
    if not path.exists():
        started = time.perf_counter()
        config = PoseNetTraining(network=posenet_config(size, _WIDTH))
        network = train_posenet(build, config, 0, NoProgress(), weights)
        save_posenet(network, path)
        trials = {trial.learning_rate: round(trial.score_m, 3) for trial in network.trials}
        print(f"{path.name}: {time.perf_counter() - started:.0f} s, {trials}, {network.error}", flush=True)
    return load_posenet(path)


def particles_at_start(recording: Recording, bundle: Bundle, rng: np.random.Generator) -> Particles:
    assert recording.poses is not None
    settings = bundle.settings
    start = disturbed(recording.poses[0], _START_M, _START_RAD, rng)
    return scatter(start, settings.particles, _START_M, _START_RAD, settings.log_scale_sd, rng)


def localizer(recording: Recording, bundle: Bundle) -> Start:
    def start(rng: np.random.Generator) -> Locate:
        particles = particles_at_start(recording, bundle, rng)
        depth = DepthPredictor(bundle.depth_model, recording.camera)
        follower = Localizer(bundle.adapted, depth, recording.camera, particles, bundle.settings, bundle.healthy, rng)
        return lambda color, elapsed_s: follower.step(color, elapsed_s).estimate.pose

    return start


def filtered(recording: Recording, bundle: Bundle, network: TrainedPoseNet) -> Start:
    def start(rng: np.random.Generator) -> Locate:
        particles = particles_at_start(recording, bundle, rng)
        depth = DepthPredictor(bundle.depth_model, recording.camera)
        measure = PosePredictor(network, recording.camera)
        follower = PoseFilter(measure, network.error, depth, recording.camera, particles, bundle.settings, rng)
        return lambda color, elapsed_s: follower.step(color, elapsed_s).pose

    return start


def methods(
    arguments: argparse.Namespace, split: str, build: Recording, recording: Recording
) -> Iterator[tuple[str, Start, int, dict[str, object]]]:
    """Name, start, number of seeds, and further figures of every method that is asked for."""
    wanted, seeds = arguments.methods, arguments.seeds
    for size in arguments.sizes if {"posenet", "filtered"} & set(wanted) else ():
        network = trained(arguments.out, split, size, build, arguments.weights)
        pose_of = PosePredictor(network, recording.camera)
        parameters: dict[str, object] = {
            "parameters": network.network.parameter_count(),
            "bytes": 4 * network.network.parameter_count(),
        }
        if "posenet" in wanted:
            yield f"posenet {size}", lambda _, of=pose_of: lambda color, _: of(color), 1, parameters
        if "filtered" in wanted:
            bundle = read_bundle(bundle_path(arguments.bundles, split, "all"))
            yield f"filtered posenet {size}", filtered(recording, bundle, network), seeds, parameters
    for kind in ("orb", "sift"):
        if kind in wanted:
            config = KeypointConfig(kind=kind)
            room = build_keypoint_map(build, config, NoProgress())
            pose_at = KeypointLocalizer(room, recording.camera, config)
            yield kind, lambda _, at=pose_at: lambda color, _: at(color), 1, {"bytes": room.bytes}
    for name, variant in (("monoloc", "all"), ("unadapted", "unadapted")):
        if name in wanted:
            path = bundle_path(arguments.bundles, split, variant)
            size_bytes = sum(file.stat().st_size for file in path.iterdir())
            yield name, localizer(recording, read_bundle(path)), seeds, {"bytes": size_bytes}


def measure(arguments: argparse.Namespace, split: str) -> Iterator[dict[str, object]]:
    source = open_recording(f"7scenes:{arguments.data}/7scenes/redkitchen")
    build = select_frames(source, SPLITS[split][0])
    recording = InMemory(select_frames(source, SPLITS[split][1]))
    assert recording.poses is not None
    built_from = {fingerprint(build.color(index)) for index in range(len(build))}
    unseen = np.array([fingerprint(recording.color(index)) not in built_from for index in range(len(recording))])
    for name, start, seeds, further in methods(arguments, split, build, recording):
        for light in arguments.lights:
            rows = []
            for seed in range(seeds):
                locate = start(np.random.default_rng(seed))
                run = locate_all(recording, locate, NoProgress(), transform_of(light))
                rows.append(run.metrics(recording.poses, unseen))
            row = {"split": split, "method": name, "light": light, "seeds": seeds, **further, **median_of(rows)}
            print_row(row)
            yield row


def median_of(rows: list[dict[str, object]]) -> dict[str, object]:
    """Median of every figure, and the spread of the one that matters most."""
    medians = {key: None if rows[0][key] is None else float(np.median([row[key] for row in rows])) for key in rows[0]}
    errors = [row["ate_median_m"] for row in rows]
    spread = {} if None in errors else {"ate_median_m_min": min(errors), "ate_median_m_max": max(errors)}
    return medians | spread


def print_row(row: dict[str, object]) -> None:
    if row["ate_median_m"] is None:
        errors = "| none | | | |"
    else:
        cm = {key: 100.0 * row[key] for key in ("ate_median_m", "ate_median_m_min", "ate_median_m_max", "ate_rmse_m")}
        errors = (
            f"| {cm['ate_median_m']:.1f} cm ({cm['ate_median_m_min']:.1f}-{cm['ate_median_m_max']:.1f}) "
            f"| {cm['ate_rmse_m']:.1f} cm | {row['rot_median_deg']:.1f}° | {row['within_10cm_10deg']:.0%} |"
        )
    size = f"{row['bytes'] / 1e6:.2f} MB"
    failed = f"{row['failed_frames']:.0f} of {row['frames']:.0f}"
    name = f"| {row['split']} | {row['method']} | {row['light']}"
    print(f"{name} {errors} {failed} | {row['step_ms_median']:.0f} | {size} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--weights", type=Path, help="ImageNet weights of the encoder; by default beside the data")
    parser.add_argument("--bundles", type=Path, default=Path("runs/redkitchen"))
    parser.add_argument("--out", type=Path, default=Path("runs/baselines"))
    parser.add_argument("--splits", nargs="+", choices=SPLITS, default=list(SPLITS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--lights", nargs="+", choices=LIGHTS, default=list(LIGHTS))
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args()
    if arguments.weights is None:
        arguments.weights = arguments.data.parent / "weights" / f"mobilenet_v2_{_WIDTH}_imagenet.npz"
    arguments.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    print("| split | method | light | median (seeds) | RMSE | rotation | within 10 cm, 10° | failed | ms | size |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows = [row for split in arguments.splits for row in measure(arguments, split)]
    (arguments.out / "table.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
