"""Whether adaptation also holds for a camera that the network never saw, and for depth that is wrong by a rule.

    python benchmarks/unfamiliar_depth.py --data ../shared/data --out runs/unfamiliar --network one-third-0.35
    python benchmarks/unfamiliar_depth.py --case "misjudged depth"

RedKitchen, built from 0:400:4 and judged on the frames between, with visual odometry, from starts 10 cm and 3 degrees
off; unadapted, with the paper's variant and with monoloc's default, in three cases:

- as it is;
- the images' middle 60 % only, as by a narrower lens: 40 degrees wide in place of 63;
- a network trained to predict 0.8 d^0.9 + 0.15 m where depth is d: two epochs of NYU's pairs.

What is in ``--out`` is not done again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import read_bundle, write_bundle
from monoloc.config import override
from monoloc.depth.models import shipped_file
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.train import TrainConfig, train_network
from monoloc.io.recording import Recording, Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc.progress import ConsoleProgress, NoProgress
from monoloc.run import localize
from monoloc.start import Start
from monoloc_lab.experiments.tasks import VARIANTS

_BUILD, _JUDGED = "0:400:4", "0:400"
_KEPT = 0.6  # of the image's width and height
_SHOWN = ("unadapted", "last+map", "joint")
_CASES = ("as it is", "narrower lens", "misjudged depth")
_COLUMNS = ("case", "variant", "median (seeds)", "RMSE", "rotation", "AbsRel")


class Cropped(Selection):
    """A recording through a narrower lens: the middle of every image."""

    def __init__(self, source: Recording) -> None:
        super().__init__(source, np.arange(len(source)))
        camera = source.camera
        left, top = (round(0.5 * (1.0 - _KEPT) * size) for size in (camera.width, camera.height))
        width, height = camera.width - 2 * left, camera.height - 2 * top
        self._window = np.s_[top : top + height, left : left + width]
        self.camera = camera.cropped(left, top, width, height)

    def color(self, index: int) -> NDArray[np.uint8]:
        return np.ascontiguousarray(super().color(index)[self._window])

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(super().depth(index)[self._window])


class Misjudged(Selection):
    """A recording whose depth d is said to be 0.8 d^0.9 + 0.15 m."""

    def __init__(self, source: Recording) -> None:
        super().__init__(source, np.arange(len(source)))

    def depth(self, index: int) -> NDArray[np.float32]:
        depth = super().depth(index)
        return np.where(depth > 0.0, 0.8 * depth**0.9 + 0.15, 0.0).astype(np.float32)


def misjudging(network: str, pairs: Recording, out: Path) -> Path:
    """The file of a network that has learnt the rule."""
    start = shipped_file(network)
    config = override(TrainConfig(network=load_network(start).config), epochs=2, learning_rate=1e-3)
    train_network(
        [Misjudged(select_frames(pairs, "0:1349"))],
        Misjudged(select_frames(pairs, "1349:")),
        config,
        out / f"misjudging-{network}",
        start=start,
        progress=ConsoleProgress(Console(stderr=True)),
    )
    return out / f"misjudging-{network}" / "network.safetensors"


def row(case: str, recording: Recording, network: str | Path, variant: str, seeds: int, out: Path) -> list[str]:
    """Medians over seeds; position's smallest and largest in brackets."""
    path = out / f"{Path(network).stem}-{case.replace(' ', '-')}-{variant}.monoloc"
    if not path.exists():
        config = override(BuildConfig(), landmarks=False, adapt=VARIANTS[variant])
        built = select_frames(recording, _BUILD)
        write_bundle(path, build_bundle(built, config, 0, NoProgress(), network=network)[0])
    bundle, judged = read_bundle(path), select_frames(recording, _JUDGED)
    assert judged.poses is not None
    runs = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        start = Start.disturbed(judged.poses[0], rng)
        runs.append(localize(bundle, judged, start, bundle.settings, rng, NoProgress()).metrics())

    def values(name: str) -> list[float]:
        return [float(str(figures[f"unseen_{name}"])) for figures in runs]

    median = 100.0 * np.array(values("ate_median_m"))
    return [
        case,
        variant,
        f"{np.median(median):.1f} cm ({median.min():.1f}-{median.max():.1f})",
        f"{100.0 * np.median(values('ate_rmse_m')):.1f} cm",
        f"{np.median(values('rot_median_deg')):.1f}°",
        f"{np.median(values('depth_absrel')):.3f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/unfamiliar"))
    parser.add_argument("--network", default="one-third-0.35")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--case", nargs="+", choices=_CASES, default=_CASES)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    kitchen = open_recording(f"7scenes:{arguments.data}/7scenes/redkitchen")
    print("| " + " | ".join(_COLUMNS) + " |\n|" + "---|" * len(_COLUMNS))
    for case in arguments.case:
        recording: Recording = Cropped(kitchen) if case == "narrower lens" else kitchen
        network: str | Path = arguments.network
        if case == "misjudged depth":
            pairs = open_recording(f"folder:{arguments.data}/nyu-labelled")
            network = misjudging(arguments.network, pairs, arguments.out)
        for variant in _SHOWN:
            found = row(case, recording, network, variant, arguments.seeds, arguments.out)
            print("| " + " | ".join(found) + " |", flush=True)


if __name__ == "__main__":
    main()
