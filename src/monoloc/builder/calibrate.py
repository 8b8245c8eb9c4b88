"""Calibration of the localizer's error model, at known poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.bias import localizer_factory, measure_bias_at_reference
from monoloc.builder.relocalization_error import measure_relocalization_error
from monoloc.builder.samples import Sample, depth_samples, scans_of
from monoloc.builder.scan_evidence import measure_scan_evidence
from monoloc.bundle import Bundle, require_bundle
from monoloc.components import ComponentsFactory
from monoloc.errors import DataError
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, check_arrays, require_recording
from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood, best_over_scales
from monoloc.likelihood.scan import Scan
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.progress import NoProgress, Progress

# The setting of each likelihood that says how large errors are, and its candidates.
_ERROR_SETTINGS = {
    "ray": ("log_depth_sd", (0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.16, 0.24)),
    "volume": ("noise_sd_m", (0.02, 0.03, 0.05, 0.08, 0.12, 0.2)),
}
_LOG_SCALES = np.linspace(-0.4, 0.4, 161)
_WIDE_LOG_SCALES = np.linspace(-2.0, 2.0, 81)  # among which depth of another unit or scale is found
_MOST_PAIRS = 30  # of frames that a calibration measures with
_LEAST_LOG_SCALE_SD = 0.02  # it is less between a build's frames, but away from them the scale varies by as much

LikelihoodFactory = Callable[[LikelihoodConfig], ScanLikelihood]


def calibrate(
    bundle: Bundle,
    recording: Recording,
    components: ComponentsFactory,
    seed: int = 0,
    progress: Progress = NoProgress(),
) -> Bundle:
    """A bundle whose settings fit other components: likelihood, thresholds, bias, relocalisation error.

    Call it once after replacing a component, before :class:`monoloc.Localizer` is given the same components.

    Args:
        bundle: of the room.
        recording: posed frames in that room, at least two; frames that the bundle was not built from give a
            realistic bias.
        components: as for :class:`monoloc.Localizer`. It is called about ten times; build large tables outside it.

    Errors count as if they were made at the reference poses, so the covariance is too wide if the recording is far
    from them. The bias of landmarks is not measured: set ``landmark_bias`` for a landmark localizer of your own.

    Returns:
        The bundle with new ``settings``, ``thresholds`` and classes of the scan (``integrity``). It keeps its
        reference poses, without the biases that were measured there with the old components, and the growth of the
        bias away from them. A bundle without reference poses gets those of the recording.

    Raises:
        DataError: the recording has no poses or fewer than two frames, no frame's depth gives a scan, or depth is off
            by a factor beyond 1.5.
        ValueError: as :func:`monoloc.io.recording.check_arrays`.
        TypeError: the bundle or the recording is a path, or none.
    """
    require_bundle(bundle)
    require_recording(recording)
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "calibrate on a recording with camera poses")
    if len(recording) < 2:
        raise DataError(recording.name, "has fewer than 2 frames", "calibrate on at least 2")
    check_arrays(recording)
    rng = np.random.default_rng(seed)
    camera = recording.camera

    def likelihood_for(config: LikelihoodConfig) -> ScanLikelihood:
        changed = bundle.settings.model_copy(update={"likelihood": config})
        return components(bundle, camera, changed).likelihood

    depth = components(bundle, camera, bundle.settings).depth
    samples = depth_samples(recording, _pairs_of_frames(len(recording)), depth, progress)
    base = bundle.settings.model_copy(update={"particle_bias": BiasModel()})
    settings, thresholds = calibrate_likelihood(likelihood_for, samples, base, rng)
    _check_scale(likelihood_for(settings.likelihood), samples, settings, np.random.default_rng(seed))
    poses = bundle.reference_poses.poses if len(bundle.reference_poses) else recording.poses
    calibrated = replace(
        bundle, settings=settings, thresholds=thresholds, reference_poses=ReferencePoses.without_bias(poses)
    )
    measured, _ = measure_bias_at_reference(
        localizer_factory(replace(calibrated, camera=camera), seed, components), recording, False, progress
    )
    likelihood = likelihood_for(settings.likelihood)
    error_m, error_rad, precision = measure_relocalization_error(likelihood, samples, poses, settings, rng, progress)
    scan = measure_scan_evidence(likelihood, samples, poses, settings, rng)
    integrity = bundle.integrity.model_copy(update={"scan": scan, "scan_search_precision": precision})
    known = bundle.settings.particle_bias
    bias = measured.model_copy(
        update={
            "sd_growth_m": known.sd_growth_m,
            "sd_growth_rad": known.sd_growth_rad,
            "relocalization_sd_m": error_m,
            "relocalization_sd_rad": error_rad,
        }
    )
    settings = settings.model_copy(update={"particle_bias": bias})
    return replace(calibrated, settings=settings, integrity=integrity)


def _check_scale(
    likelihood: ScanLikelihood, samples: list[Sample], settings: LocalizerConfig, rng: np.random.Generator
) -> None:
    """Refuse depth whose scale lies outside the range in which it is followed.

    The scale is at a peak of the mean log-likelihood. A density of points in the world rises without end beyond the
    map, where only the floor and ``log_scale`` are left; that says nothing of the depth.
    """
    values = np.mean(
        [
            likelihood.mean_log_likelihood(
                np.repeat(sample.pose[None], len(_WIDE_LOG_SCALES), axis=0),
                _WIDE_LOG_SCALES,
                scan,
                settings.likelihood.log_depth_sd,
            )
            for scan, sample in scans_of(samples, settings, rng)
        ],
        axis=0,
    )
    before, within, after = values[:-2], values[1:-1], values[2:]
    peaks = np.flatnonzero((within > before) & (within >= after)) + 1
    if not len(peaks):
        return
    log_factor = float(_WIDE_LOG_SCALES[peaks[values[peaks].argmax()]])
    if abs(log_factor) > _LOG_SCALES[-1]:
        problem = f"fits the map best if it is multiplied by {np.exp(log_factor):.2g}"
        raise DataError("depth", problem, "give depth in metres")


@dataclass(frozen=True)
class _Candidate:
    """A likelihood's settings, and for each scan the best mean log-likelihood over scales, and that log-scale."""

    config: LikelihoodConfig
    values: FloatArray
    log_scales: FloatArray


def calibrate_likelihood(
    likelihood_for: LikelihoodFactory,
    samples: list[Sample],
    base: LocalizerConfig,
    rng: np.random.Generator,
    fits_width: bool = True,
) -> tuple[LocalizerConfig, LikelihoodThresholds]:
    """Error size of the likelihood and spread of the depth's scale, by maximum likelihood at true poses.

    The error size is that under which the samples' scans are most likely, each at its own best depth scale. The slow
    part of these scales is the prior of the filter's log-scale. The outlier share is not fitted: the most likely one
    is small, and a generous one tracks better, since the errors within an image are correlated.

    Args:
        fits_width: whether the error size is fitted; if not, that of ``base`` stays.

    Raises:
        DataError: no frame's depth gives a scan.
    """
    scans = scans_of(samples, base, rng)
    if not scans:
        problem = f"gives no usable depth on any of {len(samples)} frames"
        fix = "check output, metric and scale in its TOML: depth must come out in metres"
        raise DataError("network", problem, fix)
    given = [(base.likelihood, likelihood_for(base.likelihood))]
    likelihoods = _likelihoods(likelihood_for, base.likelihood, scans) if fits_width else given
    candidates = [
        _Candidate(config, *_best_over_scales(likelihood, config, scans)) for config, likelihood in likelihoods
    ]
    best = max(candidates, key=lambda candidate: float(candidate.values.mean()))
    frames = np.array([sample.index for _, sample in scans])
    changes = {"likelihood": best.config, "log_scale_sd": slow_sd(best.log_scales, frames)}
    return base.model_copy(update=changes), LikelihoodThresholds.from_log_likelihoods(best.values)


def _likelihoods(
    likelihood_for: LikelihoodFactory, base: LikelihoodConfig, scans: list[tuple[Scan, Sample]]
) -> list[tuple[LikelihoodConfig, ScanLikelihood]]:
    """Candidates, or only the settings as they are if they make no difference, as to a likelihood with its own."""
    setting, values = _ERROR_SETTINGS[base.kind]
    configs = [base.model_copy(update={setting: value}) for value in values]
    candidates = [(config, likelihood_for(config)) for config in configs]
    distinct = {float(_best_over_scales(likelihood, config, scans[:1])[0][0]) for config, likelihood in candidates}
    return candidates if len(distinct) > 1 else [(base, likelihood_for(base))]


def _pairs_of_frames(frames: int) -> NDArray[np.int64]:
    """Pairs of consecutive frames, spread evenly over a recording, or all frames of a short one."""
    first = np.linspace(0, max(0, frames - 2), _MOST_PAIRS).round().astype(np.int64)
    return np.unique(np.clip(np.concatenate([first, first + 1]), 0, frames - 1))


def _best_over_scales(
    likelihood: ScanLikelihood, config: LikelihoodConfig, scans: list[tuple[Scan, Sample]]
) -> tuple[FloatArray, FloatArray]:
    """Best mean log-likelihood of every scan over the depth's scale, (N,), and the log-scale there, (N,)."""
    best = [
        best_over_scales(likelihood, sample.pose, scan, _LOG_SCALES, config.log_depth_sd) for scan, sample in scans
    ]
    values, best_log_scales = zip(*best, strict=True)
    return np.array(values), np.array(best_log_scales)


def slow_sd(log_scales: FloatArray, frames: NDArray[np.int64]) -> float:
    """Standard deviation about 0 of the part of (N,) log-scales that consecutive frames share.

    The mean product of consecutive frames' log-scales: noise of single frames cancels. A wider prior would let the
    filter trade the depth's scale against the distance to the walls.
    """
    products = (log_scales[1:] * log_scales[:-1])[np.diff(frames) == 1]
    shared = float(products.mean()) if len(products) else 0.0
    return float(np.sqrt(max(shared, _LEAST_LOG_SCALE_SD**2)))
