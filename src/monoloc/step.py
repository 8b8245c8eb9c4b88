"""The result of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.likelihood.scan import Scan
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles
from monoloc.relocalization.state_machine import Mode
from monoloc.step_budget import Level
from monoloc.supervision.map_change import ChangedRegion
from monoloc.supervision.state import Reason, State


@dataclass(frozen=True)
class Step:
    """The result of one frame.

    Attributes:
        estimate: the belief: pose, covariance, depth scale. While the state is ``uncertain`` or ``lost``, the
            covariance also allows for a wrong belief, in proportion to its probability.
        state: whether to believe the estimate: ``tracking``, ``uncertain``, ``lost``, or ``map-changed``. In the
            last, the pose is as good as while ``tracking``, but a region in view no longer matches the map.
        reasons: why the state is not ``tracking``; empty if it is.
        probability_far: probability that the position is more than 30 cm off; the state follows from it.
        restarted: whether the belief restarted at this frame, after a search or a contradiction by landmarks: the
            pose may have jumped.
        particle_estimate: pose of the particles alone.
        mean_log_likelihood: mean log-likelihood of the scan at that pose, nats per point; NaN for an empty scan.
        landmark_pose: pose from landmarks; None if there are none, or too few are seen.
        mode: mode of the relocalisation.
        motion: motion since the previous frame, from images or another sensor; None if nothing measured it.
        depth: depth of the frame, after the correction of scale and tilt; None if the budget left it out.
        scan: the points of that depth that were compared with the map.
        changed_region: a region in view that no longer matches the map; None if there is none, or if the pose is not
            known well enough to tell.
        level: what the step left out to keep its budget.
        standing: (h, w) bool, the image in small, what stands still in it while the camera moves, such as a part of
            the drone (:mod:`monoloc.odometry.standing_pixels`). Scan and odometry leave it out; ``depth`` does not,
            since somebody who walks ahead of the camera stands still in its images, too. None if it is little.
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
    standing: NDArray[np.bool_] | None = None

    @property
    def standing_share(self) -> float:
        """Share of the image that stands still, 0..1."""
        return 0.0 if self.standing is None else float(self.standing.mean())


@dataclass(frozen=True)
class LocalizedFrame:
    """A frame of a recording after it was localised.

    Attributes:
        index: index of the frame in the recording.
        color: (H, W, 3) uint8 RGB, the localizer's input.
        step: the localizer's result.
        particles: particles after the step.
        odometry: (4, 4) ``T_world_camera`` by dead reckoning.
        step_ms: duration of the step.
    """

    index: int
    color: NDArray[np.uint8]
    step: Step
    particles: Particles
    odometry: FloatArray
    step_ms: float
