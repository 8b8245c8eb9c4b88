"""Adaptation: a hold-out run on all but the held-out frames, then a final run on all frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.result import AdaptResult
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import make_views
from monoloc.adapt.tuning import Adaptation
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.export import export_model
from monoloc.evaluation.hold_out import HELD_OUT_SHARE, REGIONS, hold_out_regions
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.map.depth_rendering import supervision
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress

_EVALUATIONS = 10


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

    Depth supervision comes from the sensor where the recording has sensor depth, else from the cloud rendered at the
    frames' poses.

    Raises:
        DataError: a frame or the network cannot be read.
    """
    rng = np.random.default_rng(seed)
    assert recording.poses is not None
    regions = hold_out_regions(recording.poses, REGIONS, HELD_OUT_SHARE)
    held_out = np.sort(np.concatenate(regions))
    network = load_network(network_file)
    depth_of = supervision(recording, cloud)
    synthesised = config.synthesised_views if config.by_depth else 0
    with progress.task("views", len(recording) * (2 if synthesised else 1)) as step:
        views = make_views(recording, depth_of, network.config.focal_px, synthesised, held_out, rng, step)

    hold_out = Adaptation(network, AdaptedMap(mixture, cloud), config)
    steps = config.hold_out_steps
    with progress.task("adapt: hold-out run", steps) as step:
        scores = hold_out.run(views, steps, _generator(seed), held_out, max(1, steps // _EVALUATIONS), step)
    best = hold_out.best_step(scores)
    scores.append(hold_out.score(views.of_frames(held_out, only_whole=True), best))
    hold_out_model, hold_out_map = export_model(network, network_file.stem), hold_out.map.adapted_mixture()

    # Tuning with depth supervision gains even if the hold-out run shows no gain, and the final run continues from it.
    # Tuning on the likelihood alone may lose; it starts anew, because the map's inflation is part of its schedule.
    final, steps = hold_out, config.most_steps
    if not config.by_depth:
        final = Adaptation(load_network(network_file), AdaptedMap(mixture, cloud), config)
        steps = steps if best else 0
    if steps:
        with progress.task("adapt: final run", steps) as step:
            final.run(views, steps, _generator(seed + 1), progress=step)
    return AdaptResult(
        original=final.map.original_mixture(),
        adapted=final.map.adapted_mixture(),
        depth_model=export_model(final.network, network_file.stem),
        hold_out_model=hold_out_model,
        hold_out_map=hold_out_map,
        held_out=regions,
        scores=scores,
        steps=steps,
        kl=final.kl(),
        transform=final.map.transform.learnt() if config.map_transform else None,
    )


def _generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)
