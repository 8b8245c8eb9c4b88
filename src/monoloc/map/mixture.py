"""The map: a Gaussian mixture with full covariances, 40 bytes per component on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

import monoloc._core as _core
from monoloc.array_files import encode_arrays, read_arrays
from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc.geometry import FloatArray
from monoloc.map.arguments import float64
from monoloc.map.index import MixtureIndex
from monoloc.map.numpy_twins import log_sum_exp, log_terms
from monoloc.map.rays import RayMixture

BYTES_PER_COMPONENT = 40  # ten float32: weight, mean, Cholesky factor
_POINTS_AT_ONCE = 4096
_LOWER = np.tril_indices(3)  # order of the stored Cholesky factor: (0,0) (1,0) (1,1) (2,0) (2,1) (2,2)
_PARTS = {"weights": (None,), "means": (None, 3), "cholesky": (None, 6)}


@dataclass(frozen=True)
class GaussianMixture:
    """``M(x) = sum_k pi_k N(x; mu_k, Sigma_k)`` in the world frame, density in 1/m^3.

    Attributes:
        weights: pi, (K,) float64, non-negative, with sum 1.
        means: mu, (K, 3) float64, world frame, metres.
        covariances: Sigma, (K, 3, 3) float64, symmetric positive definite, m^2.

    Raises:
        ValueError: a shape is wrong, a value is not finite, or weights or covariances are invalid.
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray

    def __post_init__(self) -> None:
        weights = float64("weights", self.weights, None)
        count = len(weights)
        if count == 0:
            raise ValueError("weights must have at least one component, got shape (0,)")
        means = float64("means", self.means, count, 3)
        covariances = float64("covariances", self.covariances, count, 3, 3)
        if weights.min() < 0.0 or abs(weights.sum() - 1.0) > 1e-6:
            raise ValueError(
                f"weights must be >= 0 and sum to 1, got minimum {weights.min()} and sum {weights.sum()}"
            )
        asymmetry = np.abs(covariances - covariances.swapaxes(-1, -2)).max()
        if asymmetry > 1e-9 * np.abs(covariances).max():
            raise ValueError(f"covariances must be symmetric, got entries that differ by {asymmetry:.3g}")
        indefinite = np.flatnonzero(np.linalg.eigvalsh(covariances)[:, 0] <= 0.0)
        if len(indefinite):
            raise ValueError(f"covariances must be positive definite, got component {indefinite[0]} that is not")
        for name, value in (("weights", weights), ("means", means), ("covariances", covariances)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.weights)

    def log_density(self, points: ArrayLike) -> FloatArray:
        """Exact ``log M(x)``, nats: (P, 3) world frame, m -> (P,).

        Raises:
            ValueError: the shape is wrong, or a value is not finite.
        """
        points = float64("points", points, None, 3)
        return _core.log_density(points, self.weights, self.means, self.covariances)

    def responsibilities(self, points: ArrayLike) -> FloatArray:
        """Responsibilities ``p(k | x)``: (P, 3) world frame, m -> (P, K); each row sums to 1.

        Raises:
            ValueError: see :meth:`log_density`.
        """
        cloud = float64("points", points, None, 3)
        result = np.empty((len(cloud), len(self)))
        # Blocks of points limit temporaries, which need several times the memory of the result.
        blocks = max(1, len(cloud) // _POINTS_AT_ONCE)
        for part, place in zip(np.array_split(cloud, blocks), np.array_split(result, blocks), strict=True):
            terms = log_terms(part, self.weights, self.means, self.covariances)
            np.exp(terms - log_sum_exp(terms)[:, None], out=place)
        return result

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw independent points, (count, 3), world frame, m."""
        component = rng.choice(len(self), size=count, p=self.weights / self.weights.sum())
        lower = np.linalg.cholesky(self.covariances)
        noise = rng.standard_normal((count, 3))
        return np.asarray(self.means[component] + np.einsum("nij,nj->ni", lower[component], noise))

    def bounds_m(self, sigmas: float = 3.0) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner, (3,) each, of the bounding box of all components' ``sigmas`` ellipsoids."""
        reach = sigmas * np.sqrt(np.diagonal(self.covariances, axis1=-2, axis2=-1))
        return (self.means - reach).min(axis=0), (self.means + reach).max(axis=0)

    def beyond_m(self, points: FloatArray) -> float:
        """Distance from the one-sigma box of :meth:`bounds_m` to the farthest of points (N, 3), metres; 0 inside."""
        lower, upper = self.bounds_m(1.0)
        beyond = np.maximum(np.maximum(lower - points, points - upper), 0.0)
        return float(np.linalg.norm(beyond, axis=1).max(initial=0.0))

    @property
    def volume_m3(self) -> float:
        """Volume of :meth:`bounds_m` at 3 sigma, the support of outliers."""
        lower, upper = self.bounds_m()
        return float(np.prod(upper - lower))

    @property
    def nbytes_stored(self) -> int:
        """Size on disk without headers, bytes."""
        return BYTES_PER_COMPONENT * len(self)

    def index(
        self, voxel_m: float = 0.08, floor_density: float | None = None, tolerance: float = 0.02
    ) -> MixtureIndex:
        """Build the voxel index of the mixture for likelihoods of particles; see :class:`MixtureIndex`.

        Args:
            voxel_m: edge of a voxel.
            floor_density: smallest outlier density in use, 1/m^3; None for 0.1 / :attr:`volume_m3`, an outlier share
                of 0.1.
            tolerance: allowed relative error of density.
        """
        floor = 0.1 / self.volume_m3 if floor_density is None else floor_density
        return MixtureIndex(
            self.weights,
            self.means,
            self.covariances,
            voxel_m=voxel_m,
            floor_density=floor,
            tolerance=tolerance,
        )

    def smoothed(self, sd_m: float) -> GaussianMixture:
        """The mixture convolved with an isotropic Gaussian of this standard deviation, metres."""
        return replace(self, covariances=self.covariances + sd_m**2 * np.eye(3))

    def along_rays(self) -> RayMixture:
        """The depth distribution of the mixture along rays, for likelihoods of particles; see :class:`RayMixture`."""
        return RayMixture(self.weights, self.means, self.covariances)

    def to_arrays(self, prefix: str = "") -> dict[str, NDArray[np.float32]]:
        """Ten float32 per component, with the keys ``prefix + weights, means, cholesky``.

        A covariance is stored as the lower factor L of ``L L^T``, row by row, because the product remains positive
        definite after rounding of L.
        """
        lower = np.linalg.cholesky(self.covariances)[:, _LOWER[0], _LOWER[1]]
        parts = {"weights": self.weights, "means": self.means, "cholesky": lower}
        return {prefix + name: part.astype(np.float32) for name, part in parts.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]], prefix: str = "") -> GaussianMixture:
        """Inverse of :meth:`to_arrays`, up to rounding to float32.

        Raises:
            ValueError: a key is missing, shapes do not match, or the values are not a valid mixture.
        """
        missing = [prefix + name for name in _PARTS if prefix + name not in arrays]
        if missing:
            raise ValueError(f"key {missing[0]!r} is missing")
        weights, means, factor = (float64(prefix + n, arrays[prefix + n], *shape) for n, shape in _PARTS.items())
        if not len(weights) == len(means) == len(factor):
            raise ValueError(f"component counts differ: {len(weights)}, {len(means)}, {len(factor)}")
        if len(weights) == 0 or weights.min() < 0.0 or abs(weights.sum() - 1.0) > 1e-3:
            raise ValueError(f"weights must be >= 0 and sum to 1, got sum {weights.sum()}")
        lower = np.zeros((len(weights), 3, 3))
        lower[:, _LOWER[0], _LOWER[1]] = factor
        return cls(weights / weights.sum(), means, lower @ lower.swapaxes(-1, -2))

    def save(self, path: Path) -> None:
        """Write an ``.npz`` for :meth:`load` atomically.

        Raises:
            DataError: the file cannot be written.
        """
        write_whole(Path(path), encode_arrays(self.to_arrays()))

    @classmethod
    def load(cls, path: Path) -> GaussianMixture:
        """Read a file of :meth:`save`, without unpickling.

        Raises:
            DataError: the file is missing, truncated, or not a mixture.
        """
        fix = "give a bundle or a map written by `monoloc map fit`"
        try:
            return cls.from_arrays(read_arrays(Path(path)))
        except FileNotFoundError:
            raise DataError(path, "there is no such file", fix) from None
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise DataError(path, f"is no mixture map ({error})", fix) from None
