"""Time of an adaptation step and of a synthesised view, and of the same without each optimisation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from monoloc.adapt import frozen_layers, tuning, warp
from monoloc.adapt.draw_points import draw_points
from monoloc.adapt.map_transform import AdaptedMap, MapTransform
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import make_views
from monoloc.adapt.tuning import Adaptation
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.room_map import fit_map
from monoloc.depth.models import DEFAULT, shipped_file
from monoloc.depth.training import mobilenet, pooling
from monoloc.depth.training import network as networks
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.precision import learns_in_bfloat16
from monoloc.io.recording import Recording, Selection
from monoloc.map.depth_rendering import supervision
from monoloc.progress import NoProgress, Progress

_NONE_HELD_OUT = np.array([], dtype=np.int64)
_FEW = 5  # frames that views are synthesised from


@dataclass(frozen=True)
class TuningSizes:
    """Steps in a measurement, views in a measurement, and rounds, of which the fastest counts."""

    steps: int = 8
    views: int = 60
    rounds: int = 3


@dataclass(frozen=True)
class TuningFigures:
    """JSON keys of ``monoloc bench tuning``.

    Attributes:
        step_ms: wall time of a step of the default adaptation.
        step_ratios: time of a step without an optimisation over ``step_ms``, by the optimisation.
        view_ms: wall time of a synthesised view, with its share of reading the frames.
        view_ratio_numpy: time of a view drawn by NumPy in place of the kernel, over ``view_ms``.
    """

    step_ms: float
    step_ratios: dict[str, float]
    view_ms: float
    view_ratio_numpy: float


def bench_tuning(recording: Recording, sizes: TuningSizes, threads: int, progress: Progress) -> TuningFigures:
    """Time adaptation steps on a recording with poses and depth; compared variants take turns."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        return _measure(recording, sizes, progress)
    finally:
        torch.set_num_threads(before)


def _measure(recording: Recording, sizes: TuningSizes, progress: Progress) -> TuningFigures:
    rng = np.random.default_rng(0)
    cloud, mixture = fit_map(recording, None, BuildConfig(), rng, NoProgress())
    network = load_network(shipped_file(DEFAULT))
    focal_px = network.config.focal_px
    views = make_views(recording, supervision(recording, cloud), focal_px, 0, _NONE_HELD_OUT, rng)
    adapted_map = AdaptedMap(mixture, cloud)
    few = Selection(recording, np.linspace(0, len(recording) - 1, _FEW).astype(np.int64))

    def step_s(without: tuple[str, ...]) -> float:
        """Seconds per step; the work before the first step does not count."""
        done: list[float] = []
        with _without(without):
            # A new one computes the frozen layers' outputs in the variant's precision.
            Adaptation(network, adapted_map, AdaptConfig()).run(
                views,
                1 + sizes.steps,
                torch.Generator().manual_seed(0),
                progress=lambda step: done.append(time.perf_counter()),
            )
        return (done[-1] - done[0]) / sizes.steps

    def view_s() -> float:
        began = time.perf_counter()
        make_views(few, supervision(few, cloud), focal_px, sizes.views, _NONE_HELD_OUT, np.random.default_rng(0))
        return (time.perf_counter() - began) / sizes.views

    variants: dict[str, tuple[str, ...]] = {
        "": (),
        **{name: (name,) for name in _OPTIMISATIONS},
        "all": tuple(_OPTIMISATIONS),
    }
    steps = dict.fromkeys(variants, float("inf"))
    drawn, drawn_by_numpy = float("inf"), float("inf")
    with progress.task("rounds", sizes.rounds) as show:
        for number in range(sizes.rounds):
            drawn = min(drawn, view_s())
            with patch.object(warp, "_core", SimpleNamespace(draw_points=draw_points)):
                drawn_by_numpy = min(drawn_by_numpy, view_s())
            for name, without in variants.items():
                steps[name] = min(steps[name], step_s(without))
            show(number + 1)
    default = steps.pop("")
    return TuningFigures(
        step_ms=1e3 * default,
        step_ratios={name: seconds / default for name, seconds in steps.items()},
        view_ms=1e3 * drawn,
        view_ratio_numpy=drawn_by_numpy / drawn,
    )


@contextmanager
def _without(names: tuple[str, ...]) -> Iterator[None]:
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(_OPTIMISATIONS[name]())
        yield


def _plain_convolution(self: torch.nn.Conv2d, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    return F.conv2d(F.pad(input, (0, 1, 0, 1)), weight, bias, stride=2, groups=self.groups)


def _plain_transform(self: MapTransform, points: Tensor) -> Tensor:
    normalised = ((points - self.centre) / self.radius).to(self.hidden.weight.dtype)
    displacement: Tensor = self.output(torch.tanh(self.hidden(normalised)))
    return points + displacement


@contextmanager
def _in_the_other_precision() -> Iterator[None]:
    def other(device_type: str) -> bool:
        return not learns_in_bfloat16(device_type)

    with patch.object(tuning, "learns_in_bfloat16", other), patch.object(frozen_layers, "learns_in_bfloat16", other):
        yield


@contextmanager
def _without_pooling_kernels() -> Iterator[None]:
    with (
        patch.object(pooling, "has_kernels", lambda x: False),
        patch.object(networks, "has_kernels", lambda x: False),
    ):
        yield


# By name: replaces the optimisation by its plain form.
_OPTIMISATIONS: dict[str, Callable[[], Any]] = {
    "pooling kernels": _without_pooling_kernels,
    "folded normalisation": lambda: patch.object(mobilenet, "_is_folded", lambda norm: False),
    "last layer as a sum": lambda: patch.object(networks._LastLayer, "_conv_forward", torch.nn.Conv2d._conv_forward),
    "dense strided convolutions": lambda: patch.object(mobilenet._SamePadConv, "_conv_forward", _plain_convolution),
    "map transform by columns": lambda: patch.object(MapTransform, "forward", _plain_transform),
    "precision by processor": _in_the_other_precision,
    "map transform by cells": lambda: patch.object(AdaptedMap, "by_cells", AdaptedMap.forward),
}
