"""Bundles: built from a recording, or given another map."""

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
from monoloc_lab.experiments.task_inputs import BUNDLE, Settings, build_frames

_POINT_BYTES = 12  # three float32


def bundle(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    config = BuildConfig.model_validate(settings["config"])
    recording = build_frames(settings)
    room, report = build_bundle(recording, config, settings["seed"], NoProgress(), network=settings["network"])
    write_bundle(folder / BUNDLE, room)
    sizes = {"network_bytes": len(room.depth_model.content), "map_bytes": room.adapted.nbytes_stored}
    return asdict(report) | sizes


def remapped(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    """A bundle with another map. Its bias at the reference poses, which depends on the map, is measured again.

    The rest of the calibration stays. It describes the errors of the depth; those of a coarse map are in the
    covariances of the map. It cannot be measured again, because the network has been tuned on all frames.
    """
    config = BuildConfig.model_validate(settings["config"])
    rng = np.random.default_rng(settings["seed"])
    recording = build_frames(settings)
    cloud = room_cloud(recording, None, config, NoProgress())
    size = settings["size"]
    if settings["map"] == "mixture":
        room = fit_mixture(cloud, int(size), rng).mixture
        stored = room.nbytes_stored
    elif settings["map"] == "voxels":
        occupied = np.unique(np.floor(cloud / size).astype(np.int64), axis=0)
        room, stored = _isotropic((occupied + 0.5) * size, size / np.sqrt(12.0)), octree_bytes(occupied)
    else:
        points = voxel_thin(cloud, size)
        room, stored = _isotropic(points, size / 2.0), _POINT_BYTES * len(points)
    bundle = replace(read_bundle(needs[0].folder / BUNDLE), original=room, adapted=room)
    make = localizer_factory(bundle, settings["seed"])
    measured, reference_poses = measure_bias_at_reference(make, recording, True, NoProgress())
    sds = {"sd_at_reference_m": measured.sd_at_reference_m, "sd_at_reference_rad": measured.sd_at_reference_rad}
    bias = bundle.settings.particle_bias.model_copy(update=sds)
    localizer = bundle.settings.model_copy(update={"particle_bias": bias})
    write_bundle(folder / BUNDLE, replace(bundle, settings=localizer, reference_poses=reference_poses))
    return {"components": len(room), "map_bytes": stored}


def octree_bytes(occupied: Any) -> int:
    """Bytes of occupied voxels (N, 3), integers, as an octree: one byte per inner node, a bit per child.

    Voxel maps are stored as octrees, see Hornung et al., *OctoMap* (2013). Their nodes take two bytes, because they
    distinguish free from unknown space. Origin and edge of the root take four more float32.
    """
    nodes = occupied - occupied.min(axis=0)
    total = 16
    while len(nodes) > 1 or nodes.any():
        nodes = np.unique(nodes // 2, axis=0)
        total += len(nodes)
    return total


def _isotropic(centres: FloatArray, sd_m: float) -> GaussianMixture:
    """Isotropic components of equal weight at points (N, 3)."""
    count = len(centres)
    return GaussianMixture(np.full(count, 1.0 / count), centres, np.tile(sd_m**2 * np.eye(3), (count, 1, 1)))
