"""Latency of the shipped depth networks, in 32 and 8 bits."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from monoloc.depth.models import ShippedModel, shipped_file, shipped_models
from monoloc.depth.session import load_session
from monoloc.progress import Progress

_WARM_UP = 0.1  # share of the runs that are not counted


@dataclass(frozen=True)
class Latency:
    """Times of one network on one thread, for an image of its size in the catalogue.

    Attributes:
        ms_median, ms_p95: wall time of a run, milliseconds.
        gflops: multiplications and additions per second, in units of 1e9.
    """

    ms_median: float
    ms_p95: float
    gflops: float


@dataclass(frozen=True)
class NetworkFigures:
    """JSON keys of ``monoloc bench networks``: latencies by network; ``-int8`` is the same in 8 bits."""

    networks: dict[str, Latency]


def bench_networks(runs: int, progress: Progress) -> NetworkFigures:
    """Time every shipped network."""
    named = [(f"{model.name}{suffix}", model) for model in shipped_models() for suffix in ("", "-int8")]
    latencies = {}
    with progress.task("networks", len(named)) as done:
        for number, (name, model) in enumerate(named):
            latencies[name] = _latency(name, model, runs)
            done(number + 1)
    return NetworkFigures(latencies)


def _latency(name: str, model: ShippedModel, runs: int) -> Latency:
    session = load_session(shipped_file(name).read_bytes(), name)
    shape = (1, 3, model.input_height, model.input_width)
    image = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    times_ms = []
    for _ in range(runs):
        started = time.perf_counter()
        session.run(None, {"image": image})
        times_ms.append(1e3 * (time.perf_counter() - started))
    counted = times_ms[int(_WARM_UP * runs) :]
    median = float(np.median(counted))
    return Latency(median, float(np.percentile(counted, 95.0)), 2.0 * model.macs / median / 1e6)
