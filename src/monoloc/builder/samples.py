"""Frames at known poses that a calibration measures with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction, DepthSource
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.likelihood.scan import Scan, scan_from_depth
from monoloc.localizer_config import LocalizerConfig
from monoloc.progress import Progress


@dataclass(frozen=True)
class Sample:
    """A frame: its index, its depth before the correction of scale and tilt, and its true ``T_world_camera``."""

    index: int
    depth: DepthPrediction
    pose: FloatArray


def depth_samples(
    recording: Recording, frames: NDArray[np.int64], depth: DepthSource, progress: Progress
) -> list[Sample]:
    """Samples of some frames of a posed recording."""
    poses = recording.poses
    assert poses is not None
    samples = []
    with progress.task("calibrate", len(frames)) as show:
        for index in frames.tolist():
            samples.append(Sample(index, depth(recording.color(index)), poses[index]))
            show(len(samples))
    return samples


def scans_of(samples: list[Sample], config: LocalizerConfig, rng: np.random.Generator) -> list[tuple[Scan, Sample]]:
    """The scans that a localizer would take of samples; samples without a usable pixel are left out."""
    scans = [scan_from_depth(s.depth, config.scan_points, rng, config.likelihood.error_power) for s in samples]
    return [(scan, sample) for scan, sample in zip(scans, samples, strict=True) if len(scan)]
