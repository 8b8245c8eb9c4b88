"""Settings of the localizer."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.odometry.odometry_config import OdometryConfig
from monoloc.odometry.scale_tilt import ScaleTiltConfig
from monoloc.particle_filter.motion_model import MotionConfig

Part = Literal[
    "landmarks", "scan", "odometry", "depth-scale", "scale-tilt", "bias", "known-bias", "gravity", "relocalization"
]
"""A part of the localizer that can be left out; :func:`monoloc.parts.leave_out` says what each is."""

PARTS: tuple[Part, ...] = get_args(Part)
ADDITIONS: tuple[Part, ...] = tuple(part for part in PARTS if part != "scan")
"""Parts that Shukla et al. 2023 do not have."""


class LocalizerConfig(BaseModel):
    """Settings of the localizer; ``monoloc build`` writes those that it measures.

    Attributes:
        particles: number of particles.
        scan_points: points of a scan.
        motion: motion model: visual odometry, or a random walk.
        ess_fraction: particles are resampled when the effective sample size is below this share of their number.
        log_scale_sd: standard deviation of the depth's log-scale.
        likelihood: error model of scan points.
        motion_noise: noise of the motion model.
        odometry: settings of visual odometry.
        scale_tilt: correction of a depth image's scale and tilt by odometry's corners; None for no correction.
        particle_bias: slowly varying bias of the particles' pose; see :mod:`monoloc.fusion.bias_filter`.
        landmark_bias: the same of landmark poses, and their noise.
        without: parts that are left out, see :func:`monoloc.parts.leave_out`.
        threads: of a step: with two, depth is predicted and landmarks are measured while the odometry follows corners
            and particles are weighed. Results are the same.
        budget_ms: that a step may take; the slower the computer, the more is left out, see
            :mod:`monoloc.step_budget`. None leaves nothing out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    particles: int = Field(300, ge=10, le=100000)
    scan_points: int = Field(200, ge=10, le=20000)
    motion: Literal["visual", "random-walk"] = "visual"
    ess_fraction: float = Field(0.5, gt=0.0, le=1.0)
    log_scale_sd: float = Field(0.05, ge=0.0, le=1.0)
    likelihood: LikelihoodConfig = LikelihoodConfig()
    motion_noise: MotionConfig = MotionConfig()
    odometry: OdometryConfig = OdometryConfig()
    scale_tilt: ScaleTiltConfig | None = ScaleTiltConfig()
    particle_bias: BiasModel = BiasModel()
    landmark_bias: LandmarkBiasModel = LandmarkBiasModel()
    without: tuple[Part, ...] = ()
    threads: Literal[1, 2] = 1
    budget_ms: float | None = Field(None, ge=1.0, le=10_000.0)
