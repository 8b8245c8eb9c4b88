"""What it costs to build from poses that another system gave, and what refining them first wins back.

    python benchmarks/noisy_poses.py --data ../shared/data --out runs/noisy-poses

Builds from RedKitchen's frames 0:200:4 with the poses as they are, and with noise of 2 cm and 1 degree per axis, as
given and refined; localises on 0:200 (between, judged on frames that did not build) and on 200:300 (away) with visual
odometry, from a start 10 cm and 3 degrees off, by sensor depth (what the map is worth) and by the network's. Errors
are against the recording's own poses. With ``--tune none`` nothing is adapted, which takes minutes.

The second table says how far poses are from those after one alignment with the map, by sensor depth and by predicted
depth, which is all that a refinement within adaptation's objective would have.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.builder.pose_refinement import PosePrior, refine_poses
from monoloc.builder.room_map import fit_map
from monoloc.bundle import Bundle, read_bundle, read_network, write_bundle
from monoloc.depth.models import DEFAULT
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.evaluation.trajectory import PoseErrors, pose_errors
from monoloc.geometry import se3_exp
from monoloc.io.recording import Recording, Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.run import localize
from monoloc.start import Start

_POSITION_SD_M, _ROTATION_SD_RAD = 0.02, np.deg2rad(1.0)
_BUILD, _JUDGED = "0:200:4", {"between": "0:200", "away": "200:300"}
VARIANTS = {"poses as they are": (False, False), "noisy": (True, False), "noisy, refined": (True, True)}


def with_noise(recording: Recording, rng: np.random.Generator) -> Selection:
    """The recording with every pose disturbed in its own frame."""
    assert recording.poses is not None
    noisy = Selection(recording, np.arange(len(recording)))
    sd = np.repeat([_POSITION_SD_M, _ROTATION_SD_RAD], 3)
    noisy.poses = recording.poses @ se3_exp(rng.normal(scale=sd, size=(len(recording), 6)))
    return noisy


class InMemory:
    """A recording read once, for many runs over it."""

    def __init__(self, source: Recording) -> None:
        self.name, self.camera, self.frame_names = source.name, source.camera, source.frame_names
        self.timestamps_s, self.poses, self.has_depth = source.timestamps_s, source.poses, source.has_depth
        self._colors = [source.color(index) for index in range(len(source))]
        self._depths = [source.depth(index) for index in range(len(source))]

    def __len__(self) -> int:
        return len(self._colors)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self._colors[index]

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._depths[index]


class Predicted(InMemory):
    """A recording whose depth is a network's."""

    def __init__(self, source: Recording, model: DepthModel) -> None:
        super().__init__(source)
        predictor, camera = DepthPredictor(model, source.camera), source.camera
        self._depths = [predictor(color).resized(camera.width, camera.height) for color in self._colors]


def build_once(recording: Recording, path: Path, config: BuildConfig, network: str) -> None:
    """Build a bundle, unless it is there."""
    if not path.exists():
        bundle, report = build_bundle(recording, config, 0, NoProgress(), network=network)
        write_bundle(path, bundle)
        print(f"built {path.name} in {report.seconds:.0f} s", flush=True)


def run_once(bundle: Bundle, recording: Recording, seed: int, use_sensor: bool) -> dict[str, float]:
    """Figures of one run from a start that is off."""
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start.disturbed(recording.poses[0], rng)
    metrics = localize(bundle, recording, start, bundle.settings, rng, NoProgress(), use_sensor).metrics()
    return {key: value for key, value in metrics.items() if isinstance(value, float)}


def map_of(recording: Recording) -> GaussianMixture:
    return fit_map(recording, None, BuildConfig(), np.random.default_rng(0), NoProgress())[1]


def print_pose_errors(frames: Recording, tuned: DepthModel) -> None:
    """One alignment of noisy poses, by depth and map."""
    noisy = with_noise(frames, np.random.default_rng(0))
    assert frames.poses is not None and noisy.poses is not None
    prior = PosePrior(_POSITION_SD_M, float(_ROTATION_SD_RAD))
    depths: dict[str, Recording] = {
        "sensor": noisy,
        "network, tuned on these frames": Predicted(noisy, tuned),
        "network, untuned": Predicted(noisy, read_network(DEFAULT)),
    }
    print("\n| depth | map | position | rotation |\n|---|---|---|---|")
    given = pose_errors(noisy.poses, frames.poses)
    print(_pose_row("none: as given", "", given))
    for map_name, mixture in (("from right poses", map_of(frames)), ("from noisy poses", map_of(noisy))):
        for depth_name, recording in depths.items():
            refined = refine_poses(recording, mixture, None, prior, np.random.default_rng(0))
            assert refined.poses is not None
            print(_pose_row(depth_name, map_name, pose_errors(refined.poses, frames.poses)))
    refined = refine_poses(noisy, map_of(noisy), map_of, prior, np.random.default_rng(0))
    assert refined.poses is not None
    print(_pose_row("sensor", "from noisy poses, then anew", pose_errors(refined.poses, frames.poses)))


def _pose_row(depth: str, mixture: str, errors: PoseErrors) -> str:
    position_cm, rotation_deg = 100.0 * np.median(errors.position_m), np.rad2deg(np.median(errors.rotation_rad))
    return f"| {depth} | {mixture} | {position_cm:.2f} cm | {rotation_deg:.2f}° |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/noisy-poses"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--network", default=DEFAULT, help="with --tune none also a bundle, for a network tuned before"
    )
    parser.add_argument("--tune", default="decoder")
    parser.add_argument("--depth", nargs="+", choices=("sensor", "network"), default=["sensor", "network"])
    parser.add_argument("--steps", type=int, default=None)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    kitchen = open_recording(f"7scenes:{arguments.data}/7scenes/redkitchen")
    frames = select_frames(kitchen, _BUILD)
    judged = {name: InMemory(select_frames(kitchen, chosen)) for name, chosen in _JUDGED.items()}
    print("| poses | depth | split | median (seeds) | RMSE | rotation | AbsRel |\n|---|---|---|---|---|---|---|")
    for name, (noisy, refined) in VARIANTS.items():
        recording = with_noise(frames, np.random.default_rng(0)) if noisy else frames
        config = BuildConfig(
            landmarks=False,
            adapt=AdaptConfig(tune=arguments.tune, map_transform=arguments.tune != "none", steps=arguments.steps),
            refine_poses=refined,
            pose_sd_m=_POSITION_SD_M,
            pose_sd_deg=float(np.rad2deg(_ROTATION_SD_RAD)),
        )
        path = _bundle_path(arguments.out, name)
        build_once(recording, path, config, arguments.network)
        bundle = read_bundle(path)
        for depth, (split, walk) in product(arguments.depth, judged.items()):
            rows = [run_once(bundle, walk, seed, depth == "sensor") for seed in range(arguments.seeds)]
            row = {key: float(np.median([each[key] for each in rows])) for key in rows[0]}
            medians = [100.0 * each["unseen_ate_median_m"] for each in rows]
            print(
                f"| {name} | {depth} | {split} | {np.median(medians):.1f} cm ({min(medians):.1f}-{max(medians):.1f}) "
                f"| {100.0 * row['unseen_ate_rmse_m']:.1f} cm | {row['unseen_rot_median_deg']:.1f}° "
                f"| {'' if depth == 'sensor' else format(row['unseen_depth_absrel'], '.1%')} |",
                flush=True,
            )
    print_pose_errors(frames, read_bundle(_bundle_path(arguments.out, "poses as they are")).depth_model)


def _bundle_path(out: Path, name: str) -> Path:
    return out / f"{name.replace(', ', '-').replace(' ', '-')}.monoloc"


if __name__ == "__main__":
    main()
