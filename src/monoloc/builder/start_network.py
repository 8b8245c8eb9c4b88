"""The network that a build starts from, and everything that can be refused before the work is done."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pose_refinement import check_refinable
from monoloc.bundle import read_network
from monoloc.depth.model_files import trainable_file
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError, SettingError
from monoloc.extras import training_extra
from monoloc.io.recording import Recording, check_arrays
from monoloc.recording_check.inspection import LEAST_FRAMES_OF_A_BUILD


@dataclass(frozen=True)
class StartNetwork:
    """The network that a build starts from; ``file`` to tune it from, None if nothing is tuned."""

    model: DepthModel
    file: Path | None

    @property
    def fits_scale(self) -> bool:
        """Whether the scale of its output is unknown, and is fitted to the recording's depth."""
        return self.file is None and self.model.spec.scale is None


def checked_network(recording: Recording, config: BuildConfig, network: str | Path) -> StartNetwork:
    """The network, after checks of recording, settings and network.

    Raises:
        DataError, SettingError, MissingExtraError: as :func:`monoloc.builder.pipeline.build_bundle`.
        ValueError: as :func:`monoloc.io.recording.check_arrays`.
    """
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "build from a recording with camera poses")
    if len(recording) < LEAST_FRAMES_OF_A_BUILD:
        fix = f"build from at least {LEAST_FRAMES_OF_A_BUILD}"
        raise DataError(recording.name, f"has too few frames ({len(recording)})", fix)
    check_arrays(recording)
    if config.refine_poses:
        check_refinable(recording)
    file = None
    if config.adapt.tune != "none" or config.adapt.map_transform:
        file = _tunable(network, config.adapt)
        with training_extra():
            import monoloc.adapt.adaptation  # noqa: F401
    model = read_network(network)
    if config.int8:
        _check_8_bits(network, recording)
    DepthPredictor(model, recording.camera)  # refuses what does not fit the camera
    return StartNetwork(model, file)


def _tunable(network: str | Path, config: AdaptConfig) -> Path:
    """The file to tune a network from.

    Raises:
        SettingError: it has none; naming the setting that calls for tuning.
    """
    file = trainable_file(network)
    if file is None:
        setting = "tune" if config.tune != "none" else "map_transform"
        value = config.tune if config.tune != "none" else "on"
        problem = f"is {value}, but {network} can only be run, not tuned"
        fix = "give --tune none --no-map-transform, or a network that came from: monoloc depth train"
        raise SettingError(f"adapt.{setting}", problem, fix)
    return file


def _check_8_bits(network: str | Path, recording: Recording) -> None:
    """Refuse what could not be quantised, before the work is done.

    Raises:
        SettingError, DataError, MissingExtraError: it is not one of ours in 32 bits; too few frames; no ONNX.
    """
    if trainable_file(network) is None:
        raise SettingError("int8", f"is on, but {network} cannot be quantised", "choose one of ours in 32 bits")
    with training_extra():
        from monoloc.depth.training.quantise import LEAST_IMAGES
    if len(recording) < LEAST_IMAGES:
        fix = f"build in 8 bits from at least {LEAST_IMAGES}"
        raise DataError(recording.name, f"has too few frames ({len(recording)})", fix)


def in_8_bits(model: DepthModel, images: list[NDArray[np.float32]]) -> DepthModel:
    """The model quantised to 8 bits, calibrated on images as the network takes them."""
    with training_extra():
        from monoloc.depth.training.quantise import quantise
    return replace(model, content=quantise(model.content, images)[0], name=f"{model.name} in 8 bits")
