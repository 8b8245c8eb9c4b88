"""The cloud and the mixture of a room."""

from __future__ import annotations

import numpy as np

from monoloc.builder.build_config import BuildConfig
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.map.cloud import cloud_from_recording, remove_outliers, voxel_thin
from monoloc.map.em import choose_components, fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress

_COMPONENT_LADDER = (50, 100, 200, 400, 800)
_LEAST_KEPT = 0.5  # of a cloud's points; if fewer have neighbours, it is sparse, and neighbours are farther away
_LEAST_EDGE_M, _MOST_EDGE_M, _WIDER = 0.03, 0.3, 1.5


def fit_map(
    recording: Recording | None,
    cloud: FloatArray | None,
    config: BuildConfig,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[FloatArray, GaussianMixture]:
    """Cloud (N, 3) and mixture of a room, from a cloud if one is given, else from a recording with depth.

    Raises:
        DataError: as :func:`room_cloud`.
        SettingError: more components than points.
    """
    cloud = room_cloud(recording, cloud, config, progress)
    if config.components == "bic":
        with progress.task("map (choosing K)", None):
            return cloud, choose_components(cloud, _COMPONENT_LADDER, rng)[0].mixture
    with progress.task("map", 100) as step:
        return cloud, fit_mixture(cloud, config.components, rng, progress=lambda done, _: step(done)).mixture


def room_cloud(
    recording: Recording | None, cloud: FloatArray | None, config: BuildConfig, progress: Progress
) -> FloatArray:
    """The cloud (N, 3) that a map is fitted to, thinned and without outliers.

    Raises:
        DataError: no point is left without the outliers, or as :func:`cloud_from_recording`.
    """
    if cloud is None:
        assert recording is not None
        with progress.task("cloud", len(recording)) as step:
            cloud = cloud_from_recording(
                recording, config.voxel_m, config.max_depth_m, progress=lambda done, _: step(done)
            )
    count = len(cloud)
    cloud = _without_outliers(voxel_thin(cloud, config.voxel_m), config.voxel_m)
    if len(cloud) == 0:
        problem = f"none of {count} points has neighbours within a few voxels"
        raise DataError("cloud", problem, "give a denser one, in metres")
    return cloud


def _without_outliers(thinned: FloatArray, voxel_m: float) -> FloatArray:
    """A thinned cloud (N, 3) without points that have few neighbours, which in a sparse cloud may be farther away."""
    cloud, edge_m = remove_outliers(thinned, voxel_m), max(voxel_m, _LEAST_EDGE_M)
    while len(cloud) < _LEAST_KEPT * len(thinned) and edge_m < _MOST_EDGE_M:
        edge_m *= _WIDER
        cloud = remove_outliers(thinned, edge_m)
    return cloud
