"""How rooms are made: adapted to a network, or given another map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.builder.bias import localizer_factory, measure_bias_at_reference
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.builder.room_map import room_cloud
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
    """A room with another map: its bias at the reference poses, which depends on the map, is measured again.

    The rest of the calibration stays. It describes the depth's errors, and a coarse map's own errors are in its
    covariances. It could not be measured again: by now the network has been tuned on every frame.
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
    make = localizer_factory(bundle, settings["seed"])
    measured, reference_poses = measure_bias_at_reference(make, recording, True, NoProgress())
    sds = {"sd_at_reference_m": measured.sd_at_reference_m, "sd_at_reference_rad": measured.sd_at_reference_rad}
    bias = bundle.settings.particle_bias.model_copy(update=sds)
    localizer = bundle.settings.model_copy(update={"particle_bias": bias})
    write_bundle(folder / BUNDLE, replace(bundle, settings=localizer, reference_poses=reference_poses))
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
