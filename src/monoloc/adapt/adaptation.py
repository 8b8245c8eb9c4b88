"""Adaptation from beginning to end: rehearse without the held-out frames, then tune on all of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import make_views
from monoloc.adapt.tuning import Adaptation, Score
from monoloc.depth.spec import DepthModel
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.export import export_model
from monoloc.evaluation.hold_out import HELD_OUT_SHARE, REGIONS, hold_out_regions
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.map.depth_rendering import supervision
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress

_EVALUATIONS = 10
_REHEARSAL_SHARE = 0.5  # of the steps: it is there to measure with


@dataclass(frozen=True)
class AdaptResult:
    """What adaptation gives.

    Attributes:
        original, adapted: the map before and after; component i of one is component i of the other.
        depth_model: the network tuned on all frames.
        held_out_model, held_out_map: the rehearsal's, tuned without the held-out frames, to measure honestly with.
        held_out: those frames, by region of viewpoints.
        scores: on the held-out frames, the first before tuning, the last of the state that was kept.
        steps: optimiser steps on all frames; none where only likelihood is tuned for, and the rehearsal never
            bettered the held-out frames.
        kl: KL(M || M_A), nats.
    """

    original: GaussianMixture
    adapted: GaussianMixture
    depth_model: DepthModel
    held_out_model: DepthModel
    held_out_map: GaussianMixture
    held_out: list[NDArray[np.int64]]
    scores: list[Score]
    steps: int
    kl: float


def adapt(
    recording: Recording,
    cloud: FloatArray,
    mixture: GaussianMixture,
    network_file: Path,
    config: AdaptConfig,
    seed: int,
    progress: Progress,
) -> AdaptResult:
    """Adapt a network and a map to each other on posed frames.

    Supervision of depth is the sensor's where it has some, else that of the cloud seen from the frames' poses.

    Raises:
        DataError: a frame or the network cannot be read.
    """
    rng = np.random.default_rng(seed)
    assert recording.poses is not None
    regions = hold_out_regions(recording.poses, REGIONS, HELD_OUT_SHARE)
    held_out = np.sort(np.concatenate(regions))
    training_frames = np.setdiff1d(np.arange(len(recording)), held_out)
    network = load_network(network_file)
    depth_of = supervision(recording, cloud)
    synthesised = config.synthesised_views if config.by_depth else 0
    with progress.task("views", len(recording) * (2 if synthesised else 1)) as step:
        views = make_views(recording, depth_of, network.config.focal_px, synthesised, held_out, rng, step)
    held_out_views = views.of_frames(held_out, only_whole=True)

    rehearsal = Adaptation(network, AdaptedMap(mixture, cloud), config)
    rehearsed = max(1, round(_REHEARSAL_SHARE * config.most_steps))
    with progress.task("adapt: rehearsal", rehearsed) as step:
        scores = rehearsal.run(
            views.of_frames(training_frames),
            rehearsed,
            _generator(seed),
            held_out_views,
            max(1, rehearsed // _EVALUATIONS),
            step,
        )
    best = rehearsal.best_step(scores)
    held_out_model = export_model(network, network_file.stem)

    # A schedule is worth taking whole: before its end, scores are those of a rate that is still high. What learns
    # depth gains by it even where so short a rehearsal shows nothing; what only fits the map may lose.
    steps = config.most_steps if best or config.by_depth else 0
    final = Adaptation(load_network(network_file), AdaptedMap(mixture, cloud), config)
    if steps:
        with progress.task("adapt: all frames", steps) as step:
            final.run(views, steps, _generator(seed), progress=step)
    return AdaptResult(
        original=final.map.original_mixture(),
        adapted=final.map.adapted_mixture(),
        depth_model=export_model(final.network, network_file.stem),
        held_out_model=held_out_model,
        held_out_map=rehearsal.map.adapted_mixture(),
        held_out=regions,
        scores=[*scores, rehearsal.score(held_out_views, best)],
        steps=steps,
        kl=final.kl(),
    )


def _generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)
