"""The state of the belief: a pose, the biases of what measures it, and the scale of odometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monoloc.evaluation.consistency import CHI2_6_QUANTILE_99
from monoloc.geometry import FloatArray, adjoint, invert, se3_exp, se3_log
from monoloc.particle_filter.estimate import Estimate

PARTICLES, LANDMARKS = 0, 1
"""The sources, each with its bias."""

GATE = CHI2_6_QUANTILE_99
"""Chi-squared: a measured pose beyond it is down-weighted."""

# Errors of the particles' pose are correlated for some frames. Treated as independent from frame to frame, their
# standard deviation is inflated by this factor.
_PARTICLE_INFLATION = 4.0
_LEAST_VARIANCE = 1e-10  # of the particles' pose, m^2 and rad^2: all may be one
_LOG_SCALE_SD = 0.2  # of odometry's translation, beside the scale that particles estimate


@dataclass(frozen=True)
class BiasAugmentedState:
    """Pose, and biases of S sources that measure it.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        biases: (S, 6) twists in the camera's frame: source s measures ``pose @ exp(biases[s])`` plus noise.
        log_scale: natural logarithm of true over measured translation of the odometry.
        covariance: (7 + 6 S, 7 + 6 S) of the pose's twist, as in :class:`Estimate`, of the biases, and of the
            log-scale.
        prior_sds: (S, 6) standard deviations of biases that no measurement has corrected, after the motion so far.
        considered: (7 + 6 S, 7 + 6 S) covariance of errors that come on top and are not estimated, so that no
            measurement is weighted by them (Schmidt 1966).
        considered_bias: (6, 6) covariance of the landmarks' bias in it that no measurement has corrected.
    """

    pose: FloatArray
    biases: FloatArray
    log_scale: float
    covariance: FloatArray
    prior_sds: FloatArray
    considered: FloatArray
    considered_bias: FloatArray

    @classmethod
    def from_start(cls, start: Estimate, prior_sds: FloatArray) -> BiasAugmentedState:
        """Before the first measurement: pose and biases are independent."""
        covariance = _block_diagonal(start.covariance, _prior_covariance(prior_sds))
        return cls._with_nothing_considered(start.pose, covariance, prior_sds)

    @classmethod
    def from_measurement(
        cls,
        source: int,
        pose: FloatArray,
        noise: FloatArray,
        prior_sds: FloatArray,
    ) -> BiasAugmentedState:
        """From one source's pose (4, 4) and nothing else: the pose's error is minus its bias, plus noise (6, 6)."""
        bias = np.diag(prior_sds[source] ** 2)
        covariance = _block_diagonal(noise + bias, _prior_covariance(prior_sds))
        own = slice(6 + 6 * source, 12 + 6 * source)
        covariance[:6, own] = covariance[own, :6] = -bias
        return cls._with_nothing_considered(pose.copy(), covariance, prior_sds)

    @classmethod
    def _with_nothing_considered(
        cls, pose: FloatArray, covariance: FloatArray, prior_sds: FloatArray
    ) -> BiasAugmentedState:
        biases, nothing = np.zeros_like(prior_sds), np.zeros_like(covariance)
        return cls(pose, biases, 0.0, covariance, prior_sds, nothing, np.zeros((6, 6)))

    def predict(
        self,
        T_previous_current: FloatArray,
        noise: FloatArray,
        correlation: float,
        prior_sds: FloatArray,
        by_log_scale: FloatArray = np.zeros(6),
        scale_correlation: float = 1.0,
        considered_noise: FloatArray = np.zeros((6, 6)),
    ) -> BiasAugmentedState:
        """After a motion: the pose moves along, and the biases decay.

        Where a source's bias is larger, its variance grows at once; where it is smaller, the old bias lasts until it
        has decayed.

        Args:
            T_previous_current: the motion, (4, 4).
            noise: its covariance, (6, 6), of a twist in the new camera's frame.
            correlation: of the biases before and after the motion.
            prior_sds: (S, 6) at the new pose.
            by_log_scale: derivative of the motion by the log-scale, a twist (6,) in the new camera's frame.
            scale_correlation: of the log-scale before and after the motion.
            considered_noise: of the motion, (6, 6), on top of ``noise``; see ``considered``.
        """
        remaining = (correlation * self.prior_sds) ** 2
        variances = np.maximum(remaining + (1.0 - correlation**2) * prior_sds**2, prior_sds**2)
        decay = np.append(np.full(prior_sds.size, correlation), scale_correlation)
        transition = _block_diagonal(adjoint(invert(T_previous_current)), np.diag(decay))
        transition[:6, -1] = by_log_scale
        scale_variance = (1.0 - scale_correlation**2) * _LOG_SCALE_SD**2
        process_noise = _block_diagonal(noise, np.diag(np.append((variances - remaining).ravel(), scale_variance)))
        covariance = transition @ self.covariance @ transition.T + process_noise
        considered = transition @ self.considered @ transition.T
        considered[:6, :6] += considered_noise
        pose, log_scale = self.pose @ T_previous_current, scale_correlation * self.log_scale
        biases, considered_bias = correlation * self.biases, correlation**2 * self.considered_bias
        return BiasAugmentedState(
            pose, biases, log_scale, covariance, np.sqrt(variances), considered, considered_bias
        )

    def update_from_particles(self, measured: Estimate) -> BiasAugmentedState:
        """After the particles' pose; their spread is its noise. One beyond the gate counts less, as for landmarks."""
        return self._gated_update(PARTICLES, measured.pose, particle_noise(measured))

    def update_from_landmarks(
        self,
        pose: FloatArray,
        noise: FloatArray,
        is_decisive: bool,
        considered_bias: FloatArray = np.zeros((6, 6)),
    ) -> BiasAugmentedState:
        """After a landmark pose (4, 4) and its noise (6, 6), without its bias.

        Beyond the gate, the noise of one that is not decisive is inflated until it lies on the gate.

        Args:
            considered_bias: (6, 6) covariance of a bias that comes on top; see ``considered``.
        """
        state = self._with_considered_bias(considered_bias)
        update = state._update if is_decisive else state._gated_update
        return update(LANDMARKS, pose, noise)

    def _with_considered_bias(self, covariance: FloatArray) -> BiasAugmentedState:
        """With a landmark bias of at least this covariance (6, 6) in every direction."""
        values, vectors = np.linalg.eigh(covariance - self.considered_bias)
        grown = (vectors * np.maximum(values, 0.0)) @ vectors.T
        own = slice(6 + 6 * LANDMARKS, 12 + 6 * LANDMARKS)
        considered = self.considered.copy()
        considered[own, own] += grown
        return replace(self, considered=considered, considered_bias=self.considered_bias + grown)

    def landmark_excess(self, pose: FloatArray, noise: FloatArray) -> float:
        """How far a landmark pose is from the expected one: above 1 it is beyond the gate."""
        return self._excess(LANDMARKS, pose, noise)

    def _excess(self, source: int, pose: FloatArray, noise: FloatArray) -> float:
        innovation, covariance = self._innovation(source, pose, noise)
        return float(innovation @ np.linalg.solve(covariance, innovation)) / GATE

    def _gated_update(self, source: int, pose: FloatArray, noise: FloatArray) -> BiasAugmentedState:
        return self._update(source, pose, max(1.0, self._excess(source, pose, noise)) * noise)

    def _update(self, source: int, pose: FloatArray, noise: FloatArray) -> BiasAugmentedState:
        """The Kalman update with a source's ``T_world_camera`` (4, 4) and its noise (6, 6)."""
        innovation, innovation_covariance = self._innovation(source, pose, noise)
        H = self._observation_matrix(source)
        gain = np.linalg.solve(innovation_covariance, H @ self.covariance).T
        correction = gain @ innovation
        remaining = np.eye(len(self.covariance)) - gain @ H
        # Joseph's form stays symmetric and positive.
        covariance = remaining @ self.covariance @ remaining.T + gain @ noise @ gain.T
        return replace(
            self,
            pose=self.pose @ se3_exp(correction[:6]),
            biases=self.biases + correction[6:-1].reshape(-1, 6),
            log_scale=self.log_scale + float(correction[-1]),
            covariance=covariance,
            considered=remaining @ self.considered @ remaining.T,
        )

    def _innovation(self, source: int, pose: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured minus expected twist, (6,), and its covariance, (6, 6)."""
        H = self._observation_matrix(source)
        innovation: FloatArray = se3_log(invert(self.pose) @ pose) - self.biases[source]
        return innovation, H @ self.covariance @ H.T + noise

    def _observation_matrix(self, source: int) -> FloatArray:
        """A source observes the pose's error plus its own bias: (6, 7 + 6 S)."""
        H = np.zeros((6, len(self.covariance)))
        H[:, :6] = H[:, 6 + 6 * source :][:, :6] = np.eye(6)
        return H

    def stated_covariance(self, source: int, sds: FloatArray) -> FloatArray:
        """Covariance (6, 6) of the pose, had a source's bias larger standard deviations (6,) than its prior's.

        The part of the pose's error that comes with that bias is larger by the same factors. Where other sources have
        revealed the bias, it is small. The considered errors are added.
        """
        own = slice(6 + 6 * source, 12 + 6 * source)
        shared = self.covariance[:6, own]
        part = shared @ np.linalg.pinv(self.covariance[own, own], hermitian=True) @ shared.T
        prior = self.prior_sds[source]
        ratio = np.divide(sds, prior, out=np.ones_like(prior), where=prior > 0.0)
        excess = np.sqrt(np.maximum(ratio**2 - 1.0, 0.0))
        return np.asarray(self.covariance[:6, :6] + excess[:, None] * part * excess + self.considered[:6, :6])

    def estimate(self, log_scale: float) -> Estimate:
        """Pose and covariance as copies, because callers turn them to other axes in place."""
        return Estimate(self.pose.copy(), self.covariance[:6, :6].copy(), log_scale)


def _block_diagonal(first: FloatArray, second: FloatArray) -> FloatArray:
    size = len(first) + len(second)
    both = np.zeros((size, size))
    both[: len(first), : len(first)], both[len(first) :, len(first) :] = first, second
    return both


def _prior_covariance(prior_sds: FloatArray) -> FloatArray:
    """Of biases (S, 6) and log-scale that no measurement has corrected: (6 S + 1, 6 S + 1)."""
    return np.diag(np.append(prior_sds.ravel(), _LOG_SCALE_SD) ** 2)


def particle_noise(measured: Estimate) -> FloatArray:
    """Covariance (6, 6) of the particles' pose without its bias."""
    return np.asarray(_PARTICLE_INFLATION**2 * measured.covariance + _LEAST_VARIANCE * np.eye(6))
