"""Expected time of a build's stages, from which its progress estimates the remaining time."""

from __future__ import annotations

from monoloc.adapt.settings import Tune
from monoloc.builder.build_config import BuildConfig

# Seconds on a core of a current processor; what a computer takes for them, their progress learns.
_FRAME_S, _REFINED_FRAME_S, _SYNTHESISED_VIEW_S, _LOCALIZER_STEP_S, _LANDMARK_FRAME_S = 0.02, 0.2, 0.012, 0.03, 0.06
_TUNING_STEP_S: dict[Tune, float] = {"none": 0.02, "last": 0.03, "decoder": 0.08, "all": 0.1}
_PASSES_TUNED, _PASSES_PLAIN = 8, 1  # localizer steps of the covariances for each frame


def expected_stages(frames: int, config: BuildConfig) -> dict[str, float]:
    """Seconds of each stage of a build of so many frames, by the name of its task, in order."""
    adapt = config.adapt
    is_adapted = adapt.tune != "none" or adapt.map_transform
    stages: dict[str, float] = {}
    if frames > config.most_frames:
        frames = config.most_frames
        stages["choose frames"] = 2.0 * _FRAME_S * frames
    stages |= {"check": 2.0, "cloud": _FRAME_S * frames, "map": 1.0}
    if config.refine_poses:
        stages["refine poses"] = _REFINED_FRAME_S * frames
    if is_adapted:
        step_s, synthesised = _TUNING_STEP_S[adapt.tune], adapt.synthesised_views if adapt.by_depth else 0
        stages["views"] = _FRAME_S * frames + _SYNTHESISED_VIEW_S * synthesised
        stages["adapt: hold-out run"] = step_s * adapt.hold_out_steps
        stages["adapt: final run"] = step_s * adapt.most_steps
    stages["calibrate"] = 1.0
    if "bias" not in config.localizer.without:
        stages["covariances"] = _LOCALIZER_STEP_S * frames * (_PASSES_TUNED if is_adapted else _PASSES_PLAIN)
    stages |= {"searching": 1.0, "sensor": 1.0}
    if config.landmarks:
        stages["landmarks"] = _LANDMARK_FRAME_S * frames
    return stages
