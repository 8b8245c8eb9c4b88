"""Refinement of given build poses against the map that the frames themselves make.

It runs before adaptation, because pose errors enter through the map, and a frame with depth can be aligned with the
map directly. Gauss-Newton on the log posterior aligns each frame's points with the mixture; then the map is rebuilt.
(Point to Gaussian, as in Stoyanov et al., *Fast and accurate scan registration through minimization of the distance
between compact 3D NDT representations*, IJRR 2012; soft matches and outliers as in EM.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, hat, invert, se3_exp, se3_log, transform
from monoloc.io.recording import Recording, Selection
from monoloc.likelihood.scan import scan_from_depth
from monoloc.map.mixture import GaussianMixture
from monoloc.map.numpy_twins import log_sum_exp

_POINTS = 400
_INDEPENDENT_POINTS = 100.0  # effective points per frame: errors of sensor and map are correlated
_MATCHES = 4  # components matched to a point; the others have negligible responsibility
_OUTLIER_SHARE = 0.1
_STEPS, _ROUNDS = 6, 2  # on RedKitchen a third round gained nothing
_MAX_DEPTH_M, _DEPTH_JUMP = 4.5, 0.05  # sensors are less accurate beyond, and at depth edges


@dataclass(frozen=True)
class PosePrior:
    """Standard deviations of given poses, per axis."""

    position_sd_m: float
    rotation_sd_rad: float

    @property
    def information(self) -> FloatArray:
        """Inverse covariance (6, 6) of a twist (rho, phi) in the camera's frame."""
        return np.diag(np.repeat([self.position_sd_m, self.rotation_sd_rad], 3) ** -2.0)


def check_refinable(recording: Recording) -> None:
    """Refuse to refine poses without measured depth; refinement with predicted depth makes poses worse.

    Raises:
        SettingError: the recording has no depth.
    """
    if not recording.has_depth:
        raise SettingError("refine_poses", "needs depth, and the recording has none", "leave it out")


def refine_poses(
    recording: Recording,
    mixture: GaussianMixture,
    remap: Callable[[Recording], GaussianMixture] | None,
    prior: PosePrior,
    rng: np.random.Generator,
    progress: Callable[[int], None] | None = None,
) -> Selection:
    """Align every frame's pose with the map, within the prior.

    Args:
        recording: posed frames with depth.
        mixture: the map at the given poses, or of a separately supplied cloud.
        remap: rebuilds the map from a recording with other poses, once between rounds; None does not rebuild the map.
        prior: prior of the given poses.
        rng: draws the points of each frame.
        progress: called with the number of alignments done, out of :func:`rounds` times the number of frames.

    Returns:
        The recording with refined poses.

    Raises:
        SettingError: the recording has no depth to align.
        DataError: a frame cannot be read.
    """
    check_refinable(recording)
    given = recording.poses
    assert given is not None
    scans = [
        scan_from_depth(
            DepthPrediction(recording.depth(index), recording.camera),
            _POINTS,
            rng,
            max_depth_m=_MAX_DEPTH_M,
            depth_jump=_DEPTH_JUMP,
        ).points.astype(np.float64)
        for index in range(len(recording))
    ]
    refined = Selection(recording, np.arange(len(recording)))
    poses = given.copy()
    for round_ in range(rounds(remap)):
        if round_ and remap is not None:
            mixture = remap(refined)
        target = MixtureTarget(mixture)
        for index, scan in enumerate(scans):
            poses[index] = target.align(scan, poses[index], given[index], prior)
            if progress is not None:
                progress(round_ * len(scans) + index + 1)
        refined.poses = poses.copy()
    return refined


def rounds(remap: object | None) -> int:
    """How often every frame is aligned: once if the map is not rebuilt."""
    return 1 if remap is None else _ROUNDS


class MixtureTarget:
    """A mixture with which points are aligned."""

    def __init__(self, mixture: GaussianMixture) -> None:
        self._means = mixture.means
        lower = np.linalg.cholesky(mixture.covariances)
        self._whitening = np.linalg.inv(lower)  # W^T W is the inverse covariance
        self._information = self._whitening.swapaxes(-1, -2) @ self._whitening
        log_determinant = 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
        with np.errstate(divide="ignore"):  # a component of weight 0
            log_weights = np.log((1.0 - _OUTLIER_SHARE) * mixture.weights)
        self._log_peak = log_weights - 0.5 * (3.0 * np.log(2.0 * np.pi) + log_determinant)
        self._log_outlier = np.log(_OUTLIER_SHARE / mixture.volume_m3)

    def align(self, points: FloatArray, pose: FloatArray, given: FloatArray, prior: PosePrior) -> FloatArray:
        """``T_world_camera`` of largest posterior near ``pose``; points are (P, 3), camera's frame, metres."""
        if len(points) == 0:
            return given
        tempering = min(1.0, _INDEPENDENT_POINTS / len(points))
        for _ in range(_STEPS):
            information, gradient = self._normal_equations(points, pose)
            information = tempering * information + prior.information
            gradient = tempering * gradient + prior.information @ se3_log(invert(given) @ pose)
            pose = pose @ se3_exp(-np.linalg.solve(information, gradient))
        return np.asarray(pose)

    def _normal_equations(self, points: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gauss-Newton's (6, 6) and (6,) of ``-log M(T exp(xi) x)`` summed over points, at ``xi = 0``.

        With responsibilities r_pk under mixture and outliers, the matrix is ``sum_pk r_pk J_p^T S_k^-1 J_p``. The
        vector has the offsets ``y_p - mu_k`` in place of the last factor. ``J_p = R [I, -hat(x_p)]``.
        """
        offsets = transform(pose, points)[:, None, :] - self._means
        squares = (np.einsum("kij,pkj->pki", self._whitening, offsets, optimize=True) ** 2).sum(axis=-1)
        terms = self._log_peak - 0.5 * squares
        count = min(_MATCHES, len(self._means))
        match = np.argpartition(-terms, count - 1, axis=1)[:, :count]
        matched = np.take_along_axis(terms, match, axis=1)
        total = np.logaddexp(log_sum_exp(terms), self._log_outlier)
        information = np.exp(matched - total[:, None])[..., None, None] * self._information[match]
        offset = np.take_along_axis(offsets, match[..., None], axis=1)
        jacobian = np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -hat(points)], axis=2)
        jacobian = pose[:3, :3] @ jacobian
        weighted_offset = np.einsum("pkij,pkj->pi", information, offset)
        return (
            np.einsum("pai,pab,pbj->ij", jacobian, information.sum(axis=1), jacobian, optimize=True),
            np.einsum("pai,pa->i", jacobian, weighted_offset),
        )
