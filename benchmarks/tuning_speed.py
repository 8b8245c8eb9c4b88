"""What a step of tuning costs, and a synthesised view, and each without what makes it cheaper.

    OMP_NUM_THREADS=1 python benchmarks/tuning_speed.py --data ../shared/data --threads 1
    ONEDNN_MAX_CPU_ISA=AVX2 ATEN_CPU_CAPABILITY=avx2 python benchmarks/tuning_speed.py     (as without AVX-512)

Steps of the default adaptation on RedKitchen's frames 0:200:3. Each way takes its turn, several times over; the
fastest turn counts.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from monoloc.adapt import tuning, warp
from monoloc.adapt.draw_points import draw_points
from monoloc.adapt.map_transform import AdaptedMap, MapTransform
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import make_views
from monoloc.adapt.tuning import Adaptation
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.room_map import fit_map
from monoloc.depth.models import DEFAULT, shipped_file
from monoloc.depth.training import mobilenet
from monoloc.depth.training import network as networks
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.precision import learns_in_bfloat16
from monoloc.io.registry import open_recording, select_frames
from monoloc.map.depth_rendering import supervision
from monoloc.progress import NoProgress

_VIEWS = 60


def _pooling(x: Tensor) -> Tensor:
    return F.max_pool2d(x, 5, stride=1, padding=2)


def _strided(self: torch.nn.Conv2d, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    return F.conv2d(F.pad(input, (0, 1, 0, 1)), weight, bias, stride=2, groups=self.groups)


_PLAIN: dict[str, Callable[[], object]] = {
    "pooling by the kernel": lambda: patch.object(networks, "max_pool5", _pooling),
    "normalisation folded": lambda: patch.object(mobilenet, "_is_folded", lambda norm: False),
    "last layer as a sum": lambda: patch.object(networks._LastLayer, "_conv_forward", torch.nn.Conv2d._conv_forward),
    "strided convolutions dense": lambda: patch.object(mobilenet._SamePadConv, "_conv_forward", _strided),
    "bent points as columns": lambda: patch.object(MapTransform, "forward", _rows),
    "the precision that suits the processor": lambda: patch.object(tuning, "learns_in_bfloat16", _unsuited),
}


def _rows(self: MapTransform, points: Tensor) -> Tensor:
    normalised = ((points - self.centre) / self.radius).to(self.hidden.weight.dtype)
    displacement: Tensor = self.output(torch.tanh(self.hidden(normalised)))
    return points + displacement


def _unsuited(device_type: str) -> bool:
    return not learns_in_bfloat16(device_type)


@contextmanager
def without(names: tuple[str, ...]) -> Iterator[None]:
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(_PLAIN[name]())  # type: ignore[arg-type]
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--steps", type=int, default=8, help="a turn")
    parser.add_argument("--turns", type=int, default=3)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    steps: int = arguments.steps
    recording = select_frames(open_recording(f"7scenes:{arguments.data}/7scenes/redkitchen"), "0:200:3")
    rng = np.random.default_rng(0)
    cloud, mixture = fit_map(recording, None, BuildConfig(), rng, NoProgress())
    network = load_network(shipped_file(DEFAULT))
    nobody = np.array([], dtype=np.int64)
    views = make_views(recording, supervision(recording, cloud), network.config.focal_px, 0, nobody, rng)
    adaptation = Adaptation(network, AdaptedMap(mixture, cloud), AdaptConfig())

    def turn(names: tuple[str, ...]) -> float:
        """Seconds a step; the work before the first one is left out."""
        done: list[float] = []
        with without(names):
            adaptation.run(
                views,
                1 + steps,
                torch.Generator().manual_seed(0),
                progress=lambda step: done.append(time.perf_counter()),
            )
        return (done[-1] - done[0]) / steps

    def view() -> float:
        """Seconds a synthesised view, with a frame's share of being read."""
        began = time.perf_counter()
        make_views(few, supervision(few, cloud), network.config.focal_px, _VIEWS, nobody, np.random.default_rng(0))
        return (time.perf_counter() - began) / _VIEWS

    few = select_frames(recording, f"::{len(recording) // 5}")
    plain = SimpleNamespace(draw_points=draw_points)
    ways: dict[str, tuple[str, ...]] = {
        "as it is": (),
        **{f"without: {name}": (name,) for name in _PLAIN},
        "without all of these": tuple(_PLAIN),
    }
    fastest = dict.fromkeys(ways, float("inf"))
    drawn, drawn_by_numpy = float("inf"), float("inf")
    for _ in range(arguments.turns):
        drawn = min(drawn, view())
        with patch.object(warp, "_core", plain):
            drawn_by_numpy = min(drawn_by_numpy, view())
        for name, left_out in ways.items():
            fastest[name] = min(fastest[name], turn(left_out))
    print(f"| a step, {arguments.threads} thread(s) | ms | ratio |\n|---|---|---|")
    for name, seconds in fastest.items():
        print(f"| {name} | {1e3 * seconds:.0f} | {seconds / fastest['as it is']:.2f} |")
    print(f"| a view | {1e3 * drawn:.0f} | 1.00 |")
    print(f"| a view without: drawn by the kernel | {1e3 * drawn_by_numpy:.0f} | {drawn_by_numpy / drawn:.2f} |")


if __name__ == "__main__":
    main()
