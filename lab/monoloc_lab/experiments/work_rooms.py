"""How rooms are made: adapted to a network, or given another map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.build.bias import measure_near
from monoloc.build.pipeline import BuildConfig, build_bundle, room_cloud, starts_in
from monoloc.bundle import read_bundle, write_bundle
from monoloc.geometry import FloatArray
from monoloc.map.cloud import voxel_thin
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import BUNDLE, Settings, built_from

_POINT_BYTES = 12  # three float32


def bundle(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    config = BuildConfig.model_validate(settings["config"])
    recording = built_from(settings)
    room, report = build_bundle(recording, config, settings["seed"], NoProgress(), network=settings["network"])
    write_bundle(folder / BUNDLE, room)
    sizes = {"network_bytes": len(room.depth_model.content), "map_bytes": room.adapted.nbytes_stored}
    return asdict(report) | sizes


def remapped(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    """What poses err by near the build's viewpoints is measured anew, for it is of network and map together.

    The rest of what was calibrated stays: it is of depth's errors, and a map's own coarseness is in its covariances.
    It could not be measured anew: by now the network has been tuned on every frame.
    """
    config = BuildConfig.model_validate(settings["config"])
    rng = np.random.default_rng(settings["seed"])
    recording = built_from(settings)
    cloud = room_cloud(recording, None, config, NoProgress())
    size = settings["size"]
    if settings["map"] == "mixture":
        room = fit_mixture(cloud, int(size), rng).mixture
        stored = room.nbytes_stored
    elif settings["map"] == "voxels":
        occupied = np.unique(np.floor(cloud / size).astype(np.int64), axis=0)
        room, stored = _alike((occupied + 0.5) * size, size / np.sqrt(12.0)), octree_bytes(occupied)
    else:
        points = voxel_thin(cloud, size)
        room, stored = _alike(points, size / 2.0), _POINT_BYTES * len(points)
    bundle = replace(read_bundle(needs[0].folder / BUNDLE), original=room, adapted=room)
    near, viewpoints = measure_near(starts_in(bundle, settings["seed"]), recording, True, NoProgress())
    widths = {"near_sd_m": near.near_sd_m, "near_sd_rad": near.near_sd_rad}
    kept = bundle.settings
    measured = kept.model_copy(update={"lasting": kept.lasting.model_copy(update=widths)})
    write_bundle(folder / BUNDLE, replace(bundle, settings=measured, viewpoints=viewpoints))
    return {"components": len(room), "map_bytes": stored}


def octree_bytes(occupied: Any) -> int:
    """Bytes of occupied voxels (N, 3), whole numbers, as an octree: of each inner node, which children it has.

    Such trees are what voxel maps are stored as, see Hornung et al., *OctoMap* (2013), whose nodes take two bytes,
    for free space has to be told from unknown. Origin and edge of the root are four float32 more.
    """
    nodes = occupied - occupied.min(axis=0)
    total = 16
    while len(nodes) > 1 or nodes.any():
        nodes = np.unique(nodes // 2, axis=0)
        total += len(nodes)
    return total


def _alike(centres: FloatArray, sd_m: float) -> GaussianMixture:
    """Isotropic components of equal weight at N points (N, 3)."""
    count = len(centres)
    return GaussianMixture(np.full(count, 1.0 / count), centres, np.tile(sd_m**2 * np.eye(3), (count, 1, 1)))
