"""The result of one frame."""

from __future__ import annotations

from dataclasses import dataclass

from monoloc.depth.predictor import DepthPrediction
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.likelihood.scan import Scan
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.relocalization.state_machine import Mode
from monoloc.step_budget import Level
from monoloc.supervision.map_change import ChangedRegion
from monoloc.supervision.state import Reason, State


@dataclass(frozen=True)
class Step:
    """The result of one frame.

    Attributes:
        estimate: the belief: pose, covariance, depth scale. While the state is ``uncertain`` or ``lost``, the
            covariance also covers a wrong belief, by its probability.
        state: whether to believe it: ``tracking``, ``uncertain``, ``lost``, or ``map-changed``, where the pose is as
            good as while ``tracking``, but the map no longer holds in a region in view.
        reasons: why the state is not ``tracking``; empty where it is.
        probability_far: that the position is more than 30 cm off; the state follows from it.
        restarted: whether the belief started anew at this frame, after a search or a contradiction by landmarks: the
            pose may have jumped.
        particle_estimate: pose of the particles alone.
        mean_log_likelihood: of the scan at that pose, nats a point; NaN for an empty scan.
        landmark_pose: pose by landmarks; None where there are none, or too few are seen.
        mode: of the relocalisation.
        motion: since the previous frame, by images or by another sensor; None where there is none.
        depth: of the frame, after the correction of scale and tilt; None where the budget left it out.
        scan: its points that were compared with the map.
        changed_region: in view, in which the map no longer holds; None where there is none, or the pose is not known
            well enough to tell.
        level: what the step left out to keep its budget.
    """

    estimate: Estimate
    state: State
    reasons: frozenset[Reason]
    probability_far: float
    restarted: bool
    particle_estimate: Estimate
    mean_log_likelihood: float
    landmark_pose: LandmarkPose | None
    mode: Mode
    motion: Motion | None
    depth: DepthPrediction | None
    scan: Scan
    changed_region: ChangedRegion | None
    level: Level = Level.FULL
