"""Local refits of a mixture: what lies in a region is separated from the rest, and what is new is fitted.

A bundle holds no cloud, so a component that crosses the border of a region is refitted to points that are drawn from
it. Components far from the region are not touched, and the cost grows with the number of those near it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, transform
from monoloc.map.em import FLOOR_M, fit_mixture, maximise_likelihood
from monoloc.map.mixture import GaussianMixture

_REACH = 4.0  # standard deviations beyond which a component does not reach a region
_DRAWN = 400  # points a component that may cross the border: shares are known to 2.5 %
_NEGLIGIBLE = 0.02  # share of a component on one side of the border that is dropped
_SMALL = 0.15  # share of a component on one side of the border from which on it starts one of its own there
_LEAST_POINTS = 4  # of a component's points on one side, for moments
_COVERED = 3.0  # standard deviations of a component on one side of the border, within which it covers others' points
_ENTROPY_POINTS = 4000  # drawn for an entropy: its standard error is about 1 %


class Region(Protocol):
    """A part of space.

    Attributes:
        centre: (3,), world frame, metres.
        reach_m: largest distance of a point of the region from it.
    """

    @property
    def centre(self) -> FloatArray: ...

    @property
    def reach_m(self) -> float: ...

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether each of points (N, 3), world frame, is in the region, (N,)."""
        ...


@dataclass(frozen=True)
class Components:
    """Gaussians whose mass is counted in points of the room's cloud, so that it does not depend on the others.

    Attributes:
        mass: (K,) points.
        means, covariances: (K, 3) and (K, 3, 3), world frame, metres.
    """

    mass: FloatArray
    means: FloatArray
    covariances: FloatArray

    @classmethod
    def of(cls, mixture: GaussianMixture, points: float) -> Components:
        """Those of a mixture that stands for so many points."""
        return cls(points * mixture.weights, mixture.means, mixture.covariances)

    @classmethod
    def none(cls) -> Components:
        return cls(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))

    def __len__(self) -> int:
        return len(self.mass)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Components:
        return Components(self.mass[chosen], self.means[chosen], self.covariances[chosen])

    def __add__(self, other: Components) -> Components:
        return Components(
            np.concatenate([self.mass, other.mass]),
            np.concatenate([self.means, other.means]),
            np.concatenate([self.covariances, other.covariances]),
        )

    def mixture(self) -> GaussianMixture:
        """The mixture of them all; at least one has mass."""
        return GaussianMixture(self.mass / self.mass.sum(), self.means, self.covariances)

    def moved(self, T_new_old: FloatArray) -> Components:
        """After a rigid motion (4, 4)."""
        rotation = T_new_old[:3, :3]
        covariances = rotation @ self.covariances @ rotation.T
        covariances = 0.5 * (covariances + covariances.swapaxes(-1, -2))
        return Components(self.mass, transform(T_new_old, self.means), covariances)


@dataclass(frozen=True)
class Parted:
    """Components on both sides of a region's border.

    Attributes:
        is_outside: (K,) which of them stay as they are.
        is_inside: (K,) which of them lie in the region.
        outer, inner: refitted parts of the rest, which cross the border.
    """

    is_outside: NDArray[np.bool_]
    is_inside: NDArray[np.bool_]
    outer: Components
    inner: Components


def part(components: Components, region: Region, rng: np.random.Generator) -> Parted:
    """Separate what lies in a region from the rest."""
    near = np.flatnonzero(_reaches(components, region))
    drawn = _draw(components[near], rng)
    is_in = region.contains(drawn.reshape(-1, 3)).reshape(len(near), _DRAWN)
    share = is_in.mean(axis=1)
    is_outside, is_inside = np.ones(len(components), dtype=np.bool_), np.zeros(len(components), dtype=np.bool_)
    is_outside[near] = share < _NEGLIGIBLE
    is_inside[near] = share > 1.0 - _NEGLIGIBLE
    crosses = ~is_outside[near] & ~is_inside[near]
    mass, drawn, is_in = components.mass[near][crosses], drawn[crosses], is_in[crosses]
    return Parted(is_outside, is_inside, _refitted(mass, drawn, ~is_in), _refitted(mass, drawn, is_in))


def fitted(points: FloatArray, mass: float, components: float, rng: np.random.Generator) -> Components:
    """Components of new points (N, 3), at least one.

    Args:
        mass: of the points together.
        components: how many the region needs; rounded.
    """
    if len(points) == 0:
        return Components.none()
    count = int(np.clip(round(components), 1, len(points)))
    return Components.of(fit_mixture(points, count, rng).mixture, mass)


def estimated_points(mixture: GaussianMixture, voxel_m: float) -> int:
    """Number of voxels that a room's surfaces fill, and so of its cloud's points.

    The volume that they fill is the exponential of the entropy of points that are known to a voxel.
    """
    smoothed = mixture.smoothed(voxel_m / np.sqrt(12.0))
    entropy = -float(smoothed.log_density(smoothed.sample(_ENTROPY_POINTS, np.random.default_rng(0))).mean())
    return max(len(mixture), round(float(np.exp(entropy)) / voxel_m**3))


def _reaches(components: Components, region: Region) -> NDArray[np.bool_]:
    """Which components may have a share in the region, (K,)."""
    radius = _REACH * np.sqrt(np.trace(components.covariances, axis1=-2, axis2=-1))
    return np.asarray(np.linalg.norm(components.means - region.centre, axis=1) < region.reach_m + radius)


def _draw(components: Components, rng: np.random.Generator) -> FloatArray:
    """Points (K, D, 3) of each component."""
    lower = np.linalg.cholesky(components.covariances)
    noise = rng.standard_normal((len(components), _DRAWN, 3))
    return np.asarray(components.means[:, None] + np.einsum("kij,kdj->kdi", lower, noise))


def _refitted(mass: FloatArray, drawn: FloatArray, side: NDArray[np.bool_]) -> Components:
    """Components of the points on one side of the border.

    EM starts from the moments of each component's points there. Of components that have little there, points count
    only where those of others cover them: tails around a thing that was cut out would become one cloud in its place.
    To halve components that still reach across the border, as those with a hole in their middle, was not worth their
    number.

    Args:
        mass: of C components, (C,).
        drawn: points of each, (C, D, 3).
        side: which of them are on this side, (C, D).
    """
    share = side.mean(axis=1)
    # Every point stands for the same mass: of heavier components more are drawn.
    side = side & (np.arange(_DRAWN) < np.ceil(_DRAWN * mass / mass.max(initial=1e-12))[:, None])
    starts = (share >= min(_SMALL, share.max(initial=0.0))) & (side.sum(axis=1) >= _LEAST_POINTS)
    if not starts.any():
        return Components.none()
    moments = [_moments(points[chosen]) for points, chosen in zip(drawn[starts], side[starts], strict=True)]
    start = Components((mass * share)[starts], *(np.stack(each) for each in zip(*moments, strict=True)))
    kept = side & starts[:, None]
    others = side & ~starts[:, None]
    kept[others] = _covers(start, drawn[others])
    result = maximise_likelihood(drawn[kept], start.mixture()).mixture
    return Components.of(result, float(mass @ (share * kept.sum(axis=1) / np.maximum(side.sum(axis=1), 1))))


def _covers(components: Components, points: FloatArray) -> NDArray[np.bool_]:
    """Whether one of the components covers each of points (N, 3), (N,)."""
    offsets = points[:, None] - components.means
    squared = np.einsum("nki,kij,nkj->nk", offsets, np.linalg.inv(components.covariances), offsets)
    return np.asarray(squared.min(axis=1) < _COVERED**2)


def _moments(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    mean = points.mean(axis=0)
    offsets = points - mean
    return mean, offsets.T @ offsets / len(points) + FLOOR_M**2 * np.eye(3)
