"""The map transform that a build has learnt, without PyTorch: a bundle keeps it to adapt what is added to the map."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.map.arguments import float64
from monoloc.map.mixture import GaussianMixture

HIDDEN = 128
"""Width of the transform's only hidden layer."""

_SHAPES: dict[str, tuple[int, ...]] = {
    "centre": (3,),
    "hidden_weight": (HIDDEN, 3),
    "hidden_bias": (HIDDEN,),
    "output_weight": (3, HIDDEN),
    "output_bias": (3,),
}
# Gauss-Hermite nodes of a standard normal variable, three an axis: exact for moments of cubic displacements.
_NODES = np.array(list(itertools.product((-np.sqrt(3.0), 0.0, np.sqrt(3.0)), repeat=3)))
_NODE_WEIGHTS = np.array([np.prod(w) for w in itertools.product((1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0), repeat=3)])
_FADE_M = 0.5  # distance beyond the room of the build at which a displacement has fallen to 1 / e
_RIDGE = 1e-6  # of a fit, relative to the mean square of the features: a smoother transform among equally good ones


@dataclass(frozen=True)
class LearntTransform:
    """``f(x) = x + W2 tanh(W1 (x - c) / r + b1) + b2``, metres, world frame.

    Outside of the room that it was learnt in, nothing is known of it, and the displacement fades.

    Attributes:
        centre, radius: c, (3,), and r; the room is the cube of these about it.
        hidden_weight, hidden_bias: W1, (128, 3), and b1, (128,).
        output_weight, output_bias: W2, (3, 128), and b2, (3,).

    Raises:
        ValueError: other shapes, or values that are not finite.
    """

    centre: FloatArray
    radius: float
    hidden_weight: FloatArray
    hidden_bias: FloatArray
    output_weight: FloatArray
    output_bias: FloatArray

    def __post_init__(self) -> None:
        for name, shape in _SHAPES.items():
            object.__setattr__(self, name, float64(name, getattr(self, name), *shape))
        object.__setattr__(self, "radius", float(self.radius))
        if not 0.0 < self.radius < np.inf:
            raise ValueError(f"radius must be positive and finite, got {self.radius}")

    def __call__(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) as the network sees them, (N, 3)."""
        inside = self.centre + np.clip(points - self.centre, -self.radius, self.radius)
        fade = np.exp(-np.linalg.norm(points - inside, axis=1) / _FADE_M)
        hidden = np.tanh((inside - self.centre) / self.radius @ self.hidden_weight.T + self.hidden_bias)
        displacement = hidden @ self.output_weight.T + self.output_bias
        return np.asarray(points + fade[:, None] * displacement)

    def moments(self, means: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Means (K, 3) and covariances (K, 3, 3) of ``f(X)`` for normal X with the given ones.

        A build takes the same moments over the points of its cloud that belong to a component.
        """
        mapped = self(_nodes_of(means, covariances).reshape(-1, 3)).reshape(-1, len(_NODES), 3)
        mapped_means = np.einsum("n,kni->ki", _NODE_WEIGHTS, mapped)
        offsets = mapped - mapped_means[:, None]
        return mapped_means, np.einsum("n,kni,knj->kij", _NODE_WEIGHTS, offsets, offsets)

    @classmethod
    def between(cls, original: GaussianMixture, adapted: GaussianMixture) -> LearntTransform:
        """A transform that maps the components of one mixture to those of equal index in the other.

        For bundles that did not keep theirs. The hidden layer is drawn from a fixed seed, the output layer fitted by
        ridge regression to the displacement of both mixtures' nodes.

        Raises:
            ValueError: the numbers of components differ.
        """
        if len(original) != len(adapted):
            raise ValueError(f"maps must have the same components, got {len(original)} and {len(adapted)}")
        points = _nodes_of(original.means, original.covariances).reshape(-1, 3)
        targets = _nodes_of(adapted.means, adapted.covariances, original.covariances).reshape(-1, 3)
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = float(0.5 * np.ptp(points, axis=0).max())
        rng = np.random.default_rng(0)
        hidden_weight, hidden_bias = 2.0 * rng.normal(size=(HIDDEN, 3)), rng.uniform(-2.0, 2.0, HIDDEN)
        features = np.tanh((points - centre) / radius @ hidden_weight.T + hidden_bias)
        features = np.column_stack([features, np.ones(len(points))])
        weights = np.repeat(original.weights, len(_NODES)) * np.tile(_NODE_WEIGHTS, len(original))
        weighted = features.T * weights
        normal = weighted @ features + _RIDGE * np.eye(HIDDEN + 1)
        output = np.linalg.solve(normal, weighted @ (targets - points))
        return cls(centre, radius, hidden_weight, hidden_bias, output[:-1].T, output[-1])

    def to_arrays(self, prefix: str) -> dict[str, NDArray[np.float32]]:
        """About 900 float32, with the keys ``prefix + `` the attributes' names."""
        return {prefix + name: np.asarray(getattr(self, name), dtype=np.float32) for name in (*_SHAPES, "radius")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], prefix: str) -> LearntTransform | None:
        """Inverse of :meth:`to_arrays`, up to rounding to float32; None where there is none.

        Raises:
            KeyError, ValueError: an array is missing, or has another shape or type.
        """
        if prefix + "centre" not in arrays:
            return None
        radius = float(arrays[prefix + "radius"])
        return cls(radius=radius, **{name: arrays[prefix + name] for name in _SHAPES})


def _nodes_of(means: FloatArray, covariances: FloatArray, frames: FloatArray | None = None) -> FloatArray:
    """Nodes (K, 27, 3) of normal distributions.

    Args:
        frames: covariances (K, 3, 3) whose square root ``covariances`` are a small deformation of; nodes of equal
            index then correspond.
    """
    if frames is None:
        return np.asarray(means[:, None] + np.einsum("kij,nj->kni", _root(covariances), _NODES))
    # The optimal map between two normal distributions (Gelbrich 1990) takes one's nodes to the other's.
    root = _root(frames)
    inverse = np.linalg.inv(root)
    transport = inverse @ _root(root @ covariances @ root) @ inverse
    return np.asarray(means[:, None] + np.einsum("kij,kjl,nl->kni", transport, root, _NODES))


def _root(covariances: FloatArray) -> FloatArray:
    """Symmetric square roots, (K, 3, 3) -> (K, 3, 3)."""
    values, axes = np.linalg.eigh(covariances)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))[:, None]) @ axes.swapaxes(-1, -2))
