"""What a build measured, and what it warns of."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from monoloc.adapt.result import AdaptResult
from monoloc.builder.bias import KnownBiasCheck
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.mapped_room import MappedRoom
from monoloc.builder.start_network import StartNetwork
from monoloc.bundle import Bundle
from monoloc.map.compare import compare_maps

_USUAL_ABSREL = 0.15  # of depth on held-out frames; the default had 0.09 and 0.11 in two rooms


@dataclass(frozen=True)
class BuildReport:
    """What a build measured; the JSON keys of ``monoloc build``.

    ``frames`` were used of ``recorded_frames``. ``nll`` and AbsRel are of held-out frames, in regions apart from the
    others. The change of the map is as in :class:`monoloc.map.compare.MapChange`. Scale and shift of the network's
    output are None where they were not fitted, see :class:`monoloc.depth.spec.ModelSpec`. ``known_bias_used`` says
    whether flights subtract the bias that was measured at the reference poses. They do if that helped in
    ``known_bias_check``, which is None where no frame was held out, or where no segment of the recording is long
    enough to know a bias of. ``scale_sd`` is the relative standard deviation of the map's scale, None where a sensor
    measured it.
    """

    frames: int
    recorded_frames: int
    cloud_points: int
    components: int
    nll_start: float | None
    nll_end: float | None
    kl: float
    shift_median_m: float
    shift_p95_m: float
    correspondence_share: float
    size_ratio_median: float
    landmarks: int
    held_out_frames: int
    depth_absrel_before: float | None
    depth_absrel_after: float | None
    depth_scale: float | None
    depth_shift: float | None
    steps: int
    known_bias_used: bool
    known_bias_check: KnownBiasCheck | None
    scale_sd: float | None
    pose_shift_median_m: float | None
    pose_turn_median_deg: float | None
    seconds: float
    warnings: list[str]


def make_report(
    bundle: Bundle,
    room: MappedRoom,
    adapted: AdaptResult,
    network: StartNetwork,
    known_bias: KnownBiasCheck | None,
    config: BuildConfig,
    recorded_frames: int,
    seconds: float,
) -> BuildReport:
    """The report of a build that started from ``network`` and took ``seconds``."""
    first, last = (adapted.scores[0], adapted.scores[-1]) if adapted.scores else (None, None)
    fitted = adapted.depth_model.spec if network.fits_scale else None
    moved = room.refinement
    return BuildReport(
        frames=len(room.recording),
        recorded_frames=recorded_frames,
        cloud_points=len(room.cloud),
        components=len(room.mixture),
        nll_start=first.nll if first else None,
        nll_end=last.nll if last else None,
        kl=adapted.kl,
        **asdict(compare_maps(adapted.original, adapted.adapted)),
        landmarks=len(bundle.landmarks),
        held_out_frames=len(adapted.evaluation_frames(len(room.recording))),
        depth_absrel_before=first.absrel if first else None,
        depth_absrel_after=last.absrel if last else None,
        depth_scale=fitted.scale if fitted else None,
        depth_shift=fitted.shift if fitted and fitted.has_shift else None,
        steps=adapted.steps,
        known_bias_used="known-bias" not in bundle.settings.without,
        known_bias_check=known_bias,
        scale_sd=bundle.provenance.scale_sd,
        pose_shift_median_m=None if moved is None else float(np.median(moved.position_m)),
        pose_turn_median_deg=None if moved is None else float(np.rad2deg(np.median(moved.rotation_rad))),
        seconds=seconds,
        warnings=[*room.warnings, *_warnings(bundle, config, last.absrel if last else None)],
    )


def _cure(config: BuildConfig) -> str:
    """What makes the network's depth better than this build did."""
    if config.adapt.tune == "none":
        return "Tune its network, or build from more of the room"
    return "Record more of the room" if config.adapt.steps is None else "Build without --quick"


def _warnings(bundle: Bundle, config: BuildConfig, depth_absrel: float | None) -> list[str]:
    warnings = []
    if depth_absrel is not None and depth_absrel > _USUAL_ABSREL:
        problem = f"depth is wrong by {depth_absrel:.0%} on held-out frames; above {_USUAL_ABSREL:.0%},"
        warnings.append(f"{problem} a flight depends on landmarks. {_cure(config)}")
    if bundle.down is None:
        problem = "floor and walls do not show the direction of gravity"
        warnings.append(f"{problem}: poses for an autopilot need down = [x, y, z] in flight.toml")
    if config.landmarks and len(bundle.landmarks) == 0:
        warnings.append("too few corners are seen by several frames: there are no landmarks")
    if not bundle.supports_relocalization:
        share = bundle.integrity.scan_search_precision
        warnings.append(f"a search by one scan is right {share:.0%} of the time, too rarely: flights need a start")
    return warnings
