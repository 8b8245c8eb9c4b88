"""The state of the localizer that a user sees."""

from __future__ import annotations

import math
from typing import Literal

from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate
from monoloc.relocalization.state_machine import Mode

State = Literal["tracking", "uncertain", "lost"]


def classify_state(
    belief: Estimate,
    mode: Mode,
    mean_log_likelihood: float,
    thresholds: LikelihoodThresholds,
    odometry_tracked: bool,
    landmarks_used: bool,
) -> State:
    """The state that a user sees.

    Args:
        mode: of the relocalisation; a camera that is searched for, or whose place is being verified, is *lost*.
        mean_log_likelihood: of the scan at the particles' pose; NaN for an empty scan, which is *uncertain*.
        odometry_tracked: whether odometry, if there is any, followed the camera. Without it the state is at best
            *uncertain*: a network's depth fits somewhere even where it means nothing.
        landmarks_used: whether landmarks measured the pose; then a scan that does not fit is *uncertain* only.
    """
    value = max(mean_log_likelihood, thresholds.lost) if landmarks_used else mean_log_likelihood
    if mode is not Mode.TRACKING or belief.position_is_unknown or value < thresholds.lost:
        return "lost"
    if math.isnan(value) or value < thresholds.low or not odometry_tracked:
        return "uncertain"
    return "tracking"
