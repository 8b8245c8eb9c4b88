"""A component of one's own works after one calibration, and not before."""

from __future__ import annotations

import re
from copy import copy
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import monoloc
from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.components import Components, ComponentsFactory, default_components
from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import DataError
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, invert
from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood
from monoloc.likelihood.scan import Scan
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path

ROOM = Room()
MIXTURE = fit_mixture(ROOM.cloud(0.1), 150, np.random.default_rng(0)).mixture
VOXEL_M, TYPICAL_DEPTH_M = 0.08, 2.0


class DensityGrid:
    """A mixture's density at the centres of voxels, smoothed by half a voxel."""

    def __init__(self, mixture: GaussianMixture) -> None:
        self.corner, upper = mixture.bounds_m(4.0)  # beyond the surfaces, where there are outliers only
        self.shape = np.ceil((upper - self.corner) / VOXEL_M).astype(np.int64)
        centres = self.corner + (np.indices(self.shape).reshape(3, -1).T + 0.5) * VOXEL_M
        self.density = np.exp(mixture.smoothed(0.5 * VOXEL_M).log_density(centres)).reshape(self.shape)
        self.volume_m3 = mixture.volume_m3


class LikelihoodField:
    """Density looked up in a grid that is blurred by the depth's error (Thrun, Burgard and Fox 2005, 6.4)."""

    def __init__(self, grid: DensityGrid, config: LikelihoodConfig) -> None:
        self._grid = grid
        sd_voxels = TYPICAL_DEPTH_M * config.log_depth_sd / VOXEL_M
        density = gaussian_filter(grid.density, np.sqrt(max(0.0, sd_voxels**2 - 0.5**2)), truncate=3.0)
        self._values = np.log((1.0 - config.outlier_share) * density.ravel() + config.outlier_share / grid.volume_m3)

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        """Of the error size in the settings; ``log_depth_sd`` is not used."""
        turned = np.exp(log_scale)[:, None, None] * (scan.points @ poses[:, :3, :3].swapaxes(1, 2))
        voxels = ((turned + (poses[:, None, :3, 3] - self._grid.corner)) / VOXEL_M).astype(np.int64)
        voxels = np.clip(voxels, 0, self._grid.shape - 1)
        values = self._values[np.ravel_multi_index(tuple(np.moveaxis(voxels, -1, 0)), tuple(self._grid.shape))]
        return np.asarray(values @ scan.weights / scan.weights.sum() + log_scale)


@pytest.fixture(scope="module")
def components() -> ComponentsFactory:
    grid = DensityGrid(MIXTURE)

    def make(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        return replace(
            default_components(bundle, camera, config), likelihood=LikelihoodField(grid, config.likelihood)
        )

    return make


@pytest.fixture(scope="module")
def build_recording() -> RoomRecording:
    return RoomRecording(ROOM, make_path(60), SMALL_CAMERA)


@pytest.fixture(scope="module")
def bundle(build_recording: RoomRecording) -> Bundle:
    """For the default components, with the thresholds of the ray likelihood."""
    settings = LocalizerConfig(particles=200, scan_points=100)
    return replace(make_bundle(MIXTURE, build_recording, range(60)), settings=settings)


@pytest.fixture(scope="module")
def flight() -> RoomRecording:
    return RoomRecording(ROOM, make_path(30, start_s=1.5), SMALL_CAMERA)


def fly(bundle: Bundle, flight: RoomRecording, components: ComponentsFactory) -> Run:
    assert flight.poses is not None
    start = Start.disturbed(flight.poses[0], np.random.default_rng(1), error_m=0.2, error_rad=0.05)
    rng = np.random.default_rng(0)
    return localize(bundle, flight, start, rng, NoProgress(), components=components)


def test_own_likelihood_tracks_after_calibration(
    bundle: Bundle, build_recording: RoomRecording, flight: RoomRecording, components: ComponentsFactory
) -> None:
    run = fly(monoloc.calibrate(bundle, build_recording, components), flight, components)
    assert run.states.count("tracking") > 0.8 * len(flight)
    assert run.truth is not None and run.start is not None and run.odometry is not None
    dead_reckoning = run.start @ invert(run.odometry[0]) @ run.odometry
    error_m, odometry_error_m = (
        np.median(pose_errors(poses, run.truth).position_m) for poses in (run.poses, dead_reckoning)
    )
    assert error_m < 0.5 * odometry_error_m


def test_own_likelihood_is_lost_without_calibration(
    bundle: Bundle, flight: RoomRecording, components: ComponentsFactory
) -> None:
    states = fly(bundle, flight, components).states
    assert states.count("tracking") <= 0.2 * len(states) and states[-1] != "tracking"


def test_recording_without_poses_is_refused(
    bundle: Bundle, flight: RoomRecording, components: ComponentsFactory
) -> None:
    without_poses = copy(flight)
    without_poses.poses = None
    with pytest.raises(DataError, match="room: has no poses; calibrate on a recording with camera poses"):
        monoloc.calibrate(bundle, without_poses, components)


@pytest.mark.parametrize("factor", [0.3, 0.5, 2.0, 3.0])
def test_depth_of_another_unit_or_scale_is_refused(
    bundle: Bundle, build_recording: RoomRecording, factor: float
) -> None:
    def make(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        ours = default_components(bundle, camera, config)

        def depth(color: NDArray[np.uint8]) -> DepthPrediction:
            predicted = ours.depth(color)
            return replace(predicted, depth_m=factor * predicted.depth_m)

        return replace(ours, depth=depth)

    with pytest.raises(DataError, match=r"depth: fits the map best if it is multiplied by .*; give depth in m") as e:
        monoloc.calibrate(bundle, build_recording, make)
    assert float(re.findall("by ([0-9.]+);", str(e.value))[0]) == pytest.approx(1.0 / factor, rel=0.2)


class RisingBeyondMap:
    """As another likelihood, but most likely where the scan is seven times as large, outside of the map."""

    def __init__(self, inner: ScanLikelihood) -> None:
        self._inner = inner

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        values = self._inner.mean_log_likelihood(poses, log_scale, scan, log_depth_sd)
        return values + 10.0 * np.maximum(log_scale - 1.0, 0.0)


def test_likelihood_that_rises_beyond_the_map_says_nothing_of_the_depth(bundle: Bundle) -> None:
    def make(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        ours = default_components(bundle, camera, config)
        return replace(ours, likelihood=RisingBeyondMap(ours.likelihood))

    monoloc.calibrate(bundle, RoomRecording(ROOM, make_path(6), SMALL_CAMERA), make)


def test_recording_of_one_frame_is_refused(bundle: Bundle, components: ComponentsFactory) -> None:
    single = RoomRecording(ROOM, make_path(1), SMALL_CAMERA)
    with pytest.raises(DataError, match="room: has fewer than 2 frames; calibrate on at least 2"):
        monoloc.calibrate(bundle, single, components)


def test_paths_and_a_dict_of_settings_are_refused_by_name(bundle: Bundle, components: ComponentsFactory) -> None:
    walk, rng, path = RoomRecording(ROOM, make_path(6), SMALL_CAMERA), np.random.default_rng(0), cast(Any, "a path")
    with pytest.raises(TypeError, match=r"^bundle must be a bundle, as monoloc\.load\(PATH\) gives it, got str$"):
        monoloc.calibrate(path, walk, components)
    with pytest.raises(TypeError, match=r"^recording must be a recording, as .*open_recording.*, got str$"):
        monoloc.calibrate(bundle, path, components)
    with pytest.raises(TypeError, match=r"^bundle must be a bundle"):
        localize(path, walk, None, rng, NoProgress())
    with pytest.raises(TypeError, match=r"^recording must be a recording"):
        localize(bundle, path, None, rng, NoProgress())
    with pytest.raises(TypeError, match=r"^config must be a BuildConfig, got dict; write BuildConfig"):
        monoloc.build_bundle(walk, cast(Any, {"components": 100}))
