"""The online way, one page: frame -> depth -> motion -> level -> scan -> predict -> weigh -> resample -> join."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.camera import Camera
from monoloc.contrast import shows_something
from monoloc.depth.predictor import DepthPrediction
from monoloc.fusion.bias_filter import Joiner
from monoloc.fusion.bias_model import LastingErrors
from monoloc.fusion.gravity import turned_about_m, upright
from monoloc.fusion.reference_poses import Viewpoints
from monoloc.geometry import FloatArray
from monoloc.landmarks.features import Landmarks
from monoloc.landmarks.pnp import LandmarkSight, Sighting
from monoloc.likelihood.scan import NOTHING, Scan, scan_from_corners, scan_from_depth
from monoloc.likelihood.scan_likelihood import Measurement, MeasurementConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.odometry.scale_tilt import LevelConfig, level
from monoloc.odometry.visual import Motion, OdometryConfig, VisualOdometry
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.motion_model import MotionConfig, predict
from monoloc.particle_filter.particles import Particles
from monoloc.particle_filter.resampling import resample
from monoloc.particle_filter.tempering import correct
from monoloc.relocalization.search import Search
from monoloc.relocalization.state_machine import Recovery
from monoloc.supervision.state import WIDE_SD_M, HealthyRange, State, is_wide, judge

_FEWEST_POINTS = 10  # of a scan that says where the camera is


class LocalizerConfig(BaseModel):
    """Settings of the online way; the measured ones are written by ``monoloc build``.

    Attributes:
        particles, scan_points: size of the filter and of the scan.
        motion: visual odometry, or a random walk.
        ess_fraction: resample when the effective sample size is under this share of the particles.
        log_scale_sd: spread of the depth's log-scale from image to image.
        level: how depth is levelled on the corners that odometry follows; None leaves it as it is.
        lasting: errors that last from frame to frame, of which the particles know nothing; see
            :mod:`monoloc.fusion.bias_filter`.
        sighted: the same of what landmarks say.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    particles: int = Field(500, ge=10)
    scan_points: int = Field(200, ge=10)
    motion: Literal["visual", "random-walk"] = "visual"
    ess_fraction: float = Field(0.5, gt=0.0, le=1.0)
    log_scale_sd: float = Field(0.05, ge=0.0)
    measurement: MeasurementConfig = MeasurementConfig()
    motion_noise: MotionConfig = MotionConfig()
    odometry: OdometryConfig = OdometryConfig()
    level: LevelConfig | None = LevelConfig()
    lasting: LastingErrors = LastingErrors()
    sighted: LastingErrors = LastingErrors()

    @property
    def can_find(self) -> bool:
        """Whether a scan tells where in the room a lost camera is, near enough to be believed."""
        return self.lasting.found_sd_m < WIDE_SD_M


class DepthSource(Protocol):
    """Depth of a colour image; :class:`monoloc.depth.predictor.DepthPredictor` is one."""

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction: ...


class Odometry(Protocol):
    """Motion of the camera from frame to frame; :class:`monoloc.odometry.visual.VisualOdometry` is one."""

    def step(self, color: NDArray[np.uint8], depth_m: NDArray[np.float32], depth_camera: Camera) -> Motion | None: ...


class Sight(Protocol):
    """Where a camera is by landmarks, as :class:`monoloc.landmarks.pnp.LandmarkSight` says."""

    def __call__(self, color: NDArray[np.uint8], belief: FloatArray, covariance: FloatArray) -> Sighting | None: ...
    def anywhere(self, color: NDArray[np.uint8]) -> Sighting | None: ...


@dataclass(frozen=True)
class Parts:
    """What a localizer is put together of; each may be someone else's.

    Attributes:
        measurement: how well scans fit the map; one's own overrides :meth:`Measurement.mean_log_likelihood`.
        depth: of a frame.
        odometry: None for a random walk.
        sight: finds landmarks; None where there are none.
    """

    measurement: Measurement
    depth: DepthSource
    odometry: Odometry | None
    sight: Sight | None = None

    @classmethod
    def usual(
        cls,
        mixture: GaussianMixture,
        depth: DepthSource,
        camera: Camera,
        config: LocalizerConfig,
        landmarks: Landmarks = Landmarks.none(),
    ) -> Parts:
        """monoloc's own, for one map and camera."""
        odometry = VisualOdometry(camera, config.odometry) if config.motion == "visual" else None
        sight = LandmarkSight(landmarks, camera) if len(landmarks) else None
        return cls(Measurement(mixture, config.measurement), depth, odometry, sight)


@dataclass(frozen=True)
class Step:
    """What one frame gave.

    Attributes:
        estimate: pose, covariance, depth scale.
        located: what the particles say of it by themselves.
        fit: mean log-likelihood of a scan point where the particles are, nats; NaN for an empty scan.
        state: whether to believe it.
        motion: odometry's motion since the last frame, None where there was none.
        depth: the depth that was used, levelled.
        scan: the points of it that were held against the map.
        sighting: what landmarks say, None where there are none or too few are seen.
    """

    estimate: Estimate
    located: Estimate
    fit: float
    state: State
    motion: Motion | None
    depth: DepthPrediction
    scan: Scan
    sighting: Sighting | None


class Localizer:
    """Follows one camera through one map; call :meth:`step` with every frame in order.

    Args:
        parts: what it is put together of; they keep what they know of a run, so no other localizer may have them.
        camera: of the frames.
        start: the first belief; None where nothing is known, and then the whole room is searched.
        config: settings.
        healthy: range of a pose that can be believed.
        viewpoints: that the room was built from, around which a lost camera is looked for; or none.
        rng: of the particles and the scan.
        down: which way is down in the room, (3,) unit vector, world frame; None where nobody knows.

    Raises:
        ValueError: no start is given, and no camera could be found: ``config.can_find`` is not true, or there are no
            viewpoints to look around.
    """

    def __init__(
        self,
        parts: Parts,
        camera: Camera,
        start: Particles | None,
        config: LocalizerConfig,
        healthy: HealthyRange,
        viewpoints: Viewpoints,
        rng: np.random.Generator,
        down: FloatArray | None = None,
    ) -> None:
        can_find = config.can_find and len(viewpoints) > 0
        search = Search(parts.measurement, viewpoints.poses, config.log_scale_sd) if can_find else None
        self._recovery = Recovery(search, healthy, is_lost=start is None)
        if start is None:
            if search is None:
                raise ValueError("without a start there has to be a room in which a camera can be found")
            start = search.anywhere(config.particles, rng)
        self.config = config
        self.particles = start
        self._camera = camera
        self._measurement, self._depth, self._odometry = parts.measurement, parts.depth, parts.odometry
        self._sight = parts.sight
        self._healthy = healthy
        self._joiner = Joiner(estimate(start), config.lasting, config.motion_noise, viewpoints, config.sighted)
        self._rng = rng
        self._down = down
        self._is_first = True

    def step(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        measured_depth: DepthPrediction | None = None,
        down: FloatArray | None = None,
    ) -> Step:
        """Take one frame in.

        Args:
            color: (H, W, 3) uint8 RGB, of the camera given.
            elapsed_s: seconds since the previous frame; ignored at the first.
            measured_depth: a depth sensor's image, where there is one; None predicts it.
            down: which way is down in the camera's frame, (3,) of any length, where something tells, as a flight
                controller's attitude does; it is taken to be a degree off.

        Raises:
            ValueError: the image is no colour image of the camera's size, time runs backwards, or down is no
                direction or not known of the room; nothing has changed then.
        """
        config = self.config
        if color.shape != (self._camera.height, self._camera.width, 3) or color.dtype != np.uint8:
            shape = f"({self._camera.height}, {self._camera.width}, 3)"
            raise ValueError(f"color must have the camera's shape {shape} as uint8, got {color.shape} {color.dtype}")
        elapsed_s = 0.0 if self._is_first else elapsed_s
        if not 0.0 <= elapsed_s < np.inf:
            raise ValueError(f"elapsed_s must be finite and not negative, got {elapsed_s}")
        if down is not None:
            down = self._direction(down)
        depth = self._depth(color) if measured_depth is None else measured_depth
        motion = self._odometry.step(color, depth.depth_m, depth.camera) if self._odometry else None
        if motion is not None and config.level is not None:
            depth = level(depth, motion, config.level)
        scan = scan_from_depth(depth, config.scan_points, self._rng, self._measurement.config.error_power)
        if measured_depth is None and not shows_something(color):
            scan = NOTHING
        if not self._is_first:
            spread, noise = config.log_scale_sd, config.motion_noise
            blind_s = 0.0 if self._recovery.is_on_trial else self._joiner.blind_s
            self.particles = predict(self.particles, motion, elapsed_s, blind_s, spread, noise, self._rng)
            if motion is None and is_wide(self._joiner.foreseen(elapsed_s)):
                self._recovery.lose()  # after a gap as after darkness: particles metres apart gather somewhere
        is_telling = len(scan) >= _FEWEST_POINTS
        sought_in = scan if is_telling else NOTHING
        anywhere = (lambda: None) if self._sight is None else partial(self._sight.anywhere, color)
        self.particles, is_found = self._recovery.look(self.particles, sought_in, elapsed_s, self._rng, anywhere)
        if self._recovery.is_followed:
            self.particles = correct(self.particles, lambda some: self._weigh(some, scan, motion), self._rng)
        located = estimate(self.particles)
        fit = self._fit(located, scan)  # where depth's lasting error is, the belief's covariance tells
        # Particles that have lost the camera gather somewhere all the same: their word counts where the scan fits.
        is_told = is_telling and fit >= self._healthy.lost and not self._recovery.is_lost
        told = self._joiner.corrected(located)
        if is_told and down is not None and self._down is not None:
            ahead_m = turned_about_m(scan, located.log_scale)
            told = upright(told, down, self._down, ahead_m, self._joiner.rotation_sd(located))
        belief = self._joiner.step(motion, elapsed_s, told, is_told)
        if is_found:
            belief = self._joiner.begin_anew(told)
        sighting = None
        if self._sight is not None and not self._recovery.is_lost:
            sighting = self._sight(color, belief.pose, belief.covariance)
        if sighting is not None:
            belief = self._joiner.sighted(sighting)
        self._recovery.note(fit, belief, elapsed_s)
        self.particles = resample(self.particles, config.ess_fraction, self._rng)
        is_followed = self._is_first or self._odometry is None or motion is not None
        # Landmarks that are where they should be tell the pose, even if depth does not fit.
        fits = fit if sighting is None else max(fit, self._healthy.lost)
        state = "lost" if self._recovery.is_lost else judge(fits, belief, self._healthy, is_followed)
        self._is_first = False
        return Step(belief, located, fit, state, motion, depth, scan, sighting)

    def _direction(self, down: FloatArray) -> FloatArray:
        """A unit vector of what was given for down.

        Raises:
            ValueError: it is none, or not known of the room.
        """
        if self._down is None:
            raise ValueError("down is given, and the room's surfaces do not tell where it is: leave it out")
        length = float(np.linalg.norm(down)) if np.shape(down) == (3,) else 0.0
        if not 0.0 < length < np.inf:
            raise ValueError(f"down must be three finite numbers, not all zero, got {down}")
        return np.asarray(down, dtype=np.float64) / length

    def _weigh(self, particles: Particles, scan: Scan, motion: Motion | None) -> Particles:
        """Particles under the evidence of the depth image and of the corners that parallax has measured."""
        particles = self._measurement.weigh_image(particles, scan)
        if motion is None:
            return particles
        corners = scan_from_corners(motion, self._measurement.config.corner_doubt)
        return self._measurement.weigh_corners(particles, corners)

    def _fit(self, located: Estimate, scan: Scan) -> float:
        if len(scan) == 0:
            return float("nan")
        pose: FloatArray = located.pose[None]
        return float(self._measurement.mean_log_likelihood(pose, np.array([located.log_scale]), scan)[0])
