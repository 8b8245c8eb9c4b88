"""How each kind of task is done: from settings, and the results of what it needs, to files and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.build import BuildConfig, build_bundle, room_cloud
from monoloc.bundle import Bundle, read_bundle, read_network, write_bundle
from monoloc.config import override
from monoloc.depth.runtime import DepthPredictor
from monoloc.errors import DataError
from monoloc.evaluation.clouds import compare_clouds
from monoloc.evaluation.depth import depth_metrics
from monoloc.experiments import work_baselines
from monoloc.experiments.common import (
    BUNDLE,
    Settings,
    built_from,
    relighting,
    start_of,
    walked,
    write_way,
)
from monoloc.experiments.task import Result
from monoloc.geometry import FloatArray
from monoloc.map.cloud import voxel_thin
from monoloc.map.fit import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.runs import comparable, localize

_POINT_BYTES = 12  # three float32


def _bundle(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    config = BuildConfig.model_validate(settings["config"])
    recording = built_from(settings)
    bundle, report = build_bundle(recording, config, settings["seed"], NoProgress(), network=settings["network"])
    write_bundle(folder / BUNDLE, bundle)
    sizes = {"network_bytes": len(bundle.depth_model.content), "map_bytes": bundle.adapted.nbytes_stored}
    return asdict(report) | sizes


def _remapped(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    """What was calibrated stays: it is the width of depth's errors, and a map's own coarseness is in its covariances.

    It could not be measured anew either: by now the network has been tuned on every frame.
    """
    config = BuildConfig.model_validate(settings["config"])
    rng = np.random.default_rng(settings["seed"])
    cloud = room_cloud(built_from(settings), None, config, NoProgress())
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
    write_bundle(folder / BUNDLE, replace(_read(needs[0]), original=room, adapted=room))
    return {"components": len(room), "map_bytes": stored}


def _run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    bundle, recording = _read(needs[0]), walked(settings)
    rng = np.random.default_rng(settings["seed"])
    start, config = start_of(settings, recording, rng), override(bundle.settings, motion=settings["motion"])
    relight = relighting(settings["walk"]["light"], settings["seed"])
    run = localize(bundle, recording, start, config, rng, NoProgress(), settings["sensor"], relight)
    further = {"covariances": run.covariances}
    if run.odometry is not None:
        further["odometry"] = run.odometry
    write_way(folder, recording, run.poses, run.unseen, **further)
    return run.metrics()


def _depth(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    recording = walked(settings)
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth", "give a recording whose depth can be compared")
    model = _read(needs[0]).depth_model if needs else read_network(settings["network"])
    predictor = DepthPredictor(model, recording.camera)
    relight = relighting(settings["walk"]["light"], settings["seed"])
    names = ("absrel", "delta1", "ssim")
    per_frame: dict[str, list[Any]] = {name: [] for name in ("index", *names)}
    pictures: dict[str, list[Any]] = {name: [] for name in ("index", "color", "predicted", "truth")}
    for index in sorted({*range(0, len(recording), settings["stride"]), *settings["shown"]}):
        color = relight(recording.color(index)) if relight else recording.color(index)
        predicted, truth = comparable(predictor(color), recording.depth(index))
        if index % settings["stride"] == 0 and truth.any():
            metrics = depth_metrics(predicted, truth)
            for name in names:
                per_frame[name].append(getattr(metrics, name))
            per_frame["index"].append(index)
        if index in settings["shown"]:
            for name, value in zip(pictures, (index, color, predicted, truth), strict=True):
                pictures[name].append(value)
    if not per_frame["index"]:
        raise DataError(recording.name, "has no frame with depth", "give one that can be compared")
    arrays: dict[str, Any] = {name: np.array(values) for name, values in pictures.items()}
    np.savez_compressed(folder / "depth.npz", **arrays)
    # SSIM alone can be undefined: where the sensor's holes leave no whole window.
    means = {name: _mean([value for value in per_frame[name] if value is not None]) for name in names}
    return {**means, "frames": len(per_frame["index"]), "per_frame": per_frame}


def _clouds(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    room = _read(needs[0])
    rng = np.random.default_rng(settings["seed"])
    clouds = compare_clouds(room.original, room.adapted, settings["points"], rng)
    np.savez_compressed(
        folder / "clouds.npz",
        original=clouds.original.astype(np.float32),
        adapted=clouds.adapted.astype(np.float32),
        distances_m=clouds.distances_m.astype(np.float32),
        down_world=np.array(room.provenance.down_world),
    )
    return clouds.figures


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


def _read(needed: Result) -> Bundle:
    return read_bundle(needed.folder / BUNDLE)


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


# Settings, the results of what the task needs, and a folder to put files in -> figures, ready for JSON.
Work = Callable[[Settings, Sequence[Result], Path], dict[str, Any]]

KINDS: dict[str, Work] = {
    "bundle": _bundle,
    "remapped": _remapped,
    "run": _run,
    "depth": _depth,
    "clouds": _clouds,
    "posenet-search": work_baselines.posenet_search,
    "posenet": work_baselines.posenet,
    "posenet-run": work_baselines.posenet_run,
    "filtered-run": work_baselines.filtered_run,
    "keypoints-run": work_baselines.keypoints_run,
}
