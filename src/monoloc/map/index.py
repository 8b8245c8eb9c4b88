"""Voxel index of a mixture, which evaluates the likelihood of a thousand particles in about a millisecond."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import monoloc._core as _core
from monoloc.geometry import FloatArray
from monoloc.map.arguments import check_outlier_share, float32, float64


class MixtureIndex:
    """Density of a mixture near its surface. Each voxel stores the few components that matter in it.

    In each voxel, components are dropped, least important first, as long as their density at a lattice of sample
    points is below ``tolerance`` times (total density + ``floor_density``). Hence the error of ``log((1 - eps) M +
    eps / V)`` is about ``tolerance`` if ``eps / V / (1 - eps)`` is not below the floor. A voxel without components is
    not stored, and its density is 0. Memory grows with the map's surface, not with its bounding box.

    Args:
        weights, means, covariances: (K,), (K, 3), (K, 3, 3) float64, world frame, metres.
        voxel_m: edge of a voxel.
        floor_density: smallest outlier density in use, 1/m^3.
        tolerance: allowed relative error of density, about the largest error in nats.

    Raises:
        ValueError: a setting is not positive, or the voxels are too small or too large for the map.
    """

    def __init__(
        self,
        weights: FloatArray,
        means: FloatArray,
        covariances: FloatArray,
        *,
        voxel_m: float,
        floor_density: float,
        tolerance: float,
    ) -> None:
        for name, value in (("voxel_m", voxel_m), ("floor_density", floor_density), ("tolerance", tolerance)):
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name} must be positive and finite, got {value}")
        self._native = _core.MixtureIndex(weights, means, covariances, voxel_m, floor_density, tolerance)

    def log_density(self, points: ArrayLike) -> FloatArray:
        """Approximate ``log M(x)``, nats: (P, 3) world frame, m -> (P,); -inf outside the stored voxels.

        Raises:
            ValueError: the shape is wrong, or a value is not finite.
        """
        return self._native.log_density(float64("points", points, None, 3))

    def evaluations(self, points: ArrayLike) -> int:
        """Number of components that :meth:`log_density` evaluates at points (P, 3), including padding of blocks.

        Raises:
            ValueError: the shape is wrong, or a value is not finite.
        """
        return self._native.evaluations(float64("points", points, None, 3))

    def weigh(
        self,
        poses: ArrayLike,
        log_scales: ArrayLike,
        scan: ArrayLike,
        *,
        outlier_share: float,
        volume_m3: float,
        point_weights: ArrayLike | None = None,
    ) -> FloatArray:
        """Untempered log-likelihood of a scan for each particle.

        ``sum_p w_p log((1 - eps) M(T e^s x_p) + eps / V)``. NumPy twin: :func:`monoloc.map.numpy_twins.weigh`.

        Args:
            poses: ``T_world_camera``, (N, 4, 4).
            log_scales: s, (N,), natural logarithm of the factor on the scan's depth.
            scan: points in the camera's frame, (P, 3), metres.
            outlier_share: eps in (0, 1], share of scan points that the map does not explain.
            volume_m3: V, volume in which outliers are uniformly distributed.
            point_weights: w, (P,); None for ones.

        Returns:
            (N,) float64, nats.

        Raises:
            ValueError: a shape is wrong, a value is not finite, or eps or V is out of range.
        """
        check_outlier_share(outlier_share)
        if not 0.0 < volume_m3 < np.inf:
            raise ValueError(f"volume_m3 must be positive and finite, got {volume_m3}")
        poses = float64("poses", poses, None, 4, 4)
        scan = float32("scan", scan, None, 3)
        weights = None if point_weights is None else float32("point_weights", point_weights, len(scan))
        return self._native.weigh(
            poses, float64("log_scales", log_scales, len(poses)), scan, weights, outlier_share, volume_m3
        )

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self._native.voxel_m

    @property
    def voxels(self) -> int:
        """Number of stored voxels."""
        return self._native.voxels

    @property
    def lists(self) -> int:
        """Number of distinct component lists; voxels with the same components share one."""
        return self._native.lists

    @property
    def mean_candidates(self) -> float:
        """Mean number of components per stored voxel."""
        return self._native.mean_candidates

    @property
    def nbytes(self) -> int:
        """Memory of the hash table and the lists, bytes."""
        return self._native.nbytes
