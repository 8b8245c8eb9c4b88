"""The surface that a map stands for: every component is a patch of it, a box with its mean and covariance.

A Gaussian's tails reach far beyond what was seen; a box along the component's axes with the same mean and covariance
ends where an evenly covered patch ends, at the square root of three standard deviations.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.map.mixture import GaussianMixture

EXTENT_SIGMAS = math.sqrt(3.0)
"""Extent of an evenly covered patch about its component's mean, in standard deviations."""

_RINGS, _SECTIONS = 6, 10  # of an ellipsoid's mesh


def patches(mixture: GaussianMixture) -> tuple[FloatArray, FloatArray]:
    """Axes of the components' boxes as columns, (K, 3, 3), and half their edges, (K, 3) m, the shortest first."""
    variances, axes = np.linalg.eigh(mixture.covariances)
    return axes, EXTENT_SIGMAS * np.sqrt(variances)


def patch_offsets(
    mixture: GaussianMixture, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], FloatArray]:
    """Random points of the patches: component (count,) by its weight, and offset from its mean, (count, 3) m."""
    component = rng.choice(len(mixture), size=count, p=mixture.weights / mixture.weights.sum())
    axes, half_m = patches(mixture)
    within = rng.uniform(-1.0, 1.0, (count, 3)) * half_m[component]
    return component, np.einsum("nij,nj->ni", axes[component], within)


def surface_points(mixture: GaussianMixture, count: int, rng: np.random.Generator) -> FloatArray:
    """Random points of the surface, (count, 3) m, world frame; a component has as many as its weight says."""
    component, offsets = patch_offsets(mixture, count, rng)
    return np.asarray(mixture.means[component] + offsets)


def patch_normals(mixture: GaussianMixture) -> FloatArray:
    """Unit normal of each patch, (K, 3), of either sign: its thinnest axis."""
    return patches(mixture)[0][:, :, 0]


def mass_per_area(mixture: GaussianMixture) -> float:
    """Mass of a square metre of surface, the median over mass of what components have."""
    half_m = patches(mixture)[1]
    density = mixture.weights / np.maximum(4.0 * half_m[:, 1] * half_m[:, 2], 1e-9)
    order = np.argsort(density)
    return float(density[order][np.searchsorted(np.cumsum(mixture.weights[order]), 0.5)])


def transformed(mixture: GaussianMixture, T_to_world: FloatArray) -> GaussianMixture:
    """The mixture in another frame, given the rigid (4, 4) from the world to it."""
    R = T_to_world[:3, :3]
    covariances = R @ mixture.covariances @ R.T
    return GaussianMixture(
        mixture.weights,
        mixture.means @ R.T + T_to_world[:3, 3],
        0.5 * (covariances + covariances.swapaxes(-1, -2)),
    )


def ellipsoid_mesh(mixture: GaussianMixture) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
    """Triangles of the components' ellipsoids, whose axes are as long as the patches' edges.

    Returns:
        Vertices (V, 3) m, world frame; triangles (F, 3), indices of vertices, counter-clockwise from outside; and the
        component of each vertex, (V,).
    """
    sphere, triangles = _sphere()
    axes, half_m = patches(mixture)
    # The axes may be left-handed, which would turn the triangles inside out.
    axes = axes * np.linalg.det(axes)[:, None, None]
    vertices = mixture.means[:, None] + (sphere * half_m[:, None, :]) @ axes.swapaxes(1, 2)
    first = len(sphere) * np.arange(len(mixture))
    faces = triangles[None] + first[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3), np.repeat(np.arange(len(mixture)), len(sphere))


def _sphere() -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices (V, 3) of a unit sphere, and its triangles (F, 3), counter-clockwise from outside."""
    polar = np.pi * np.arange(1, _RINGS) / _RINGS
    around = 2.0 * np.pi * np.arange(_SECTIONS) / _SECTIONS
    theta, phi = (each.ravel() for each in np.meshgrid(polar, around, indexing="ij"))
    ring = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    vertices = np.concatenate([ring, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    top, bottom = len(ring), len(ring) + 1
    here, after = np.arange(_SECTIONS), (np.arange(_SECTIONS) + 1) % _SECTIONS
    faces = [np.stack([np.full(_SECTIONS, top), here, after], axis=1)]
    for row in range(_RINGS - 2):
        a, b = _SECTIONS * row, _SECTIONS * (row + 1)
        faces += [np.stack([a + here, b + here, b + after], 1), np.stack([a + here, b + after, a + after], 1)]
    last = _SECTIONS * (_RINGS - 2)
    faces.append(np.stack([np.full(_SECTIONS, bottom), last + after, last + here], axis=1))
    return vertices, np.concatenate(faces).astype(np.int64)
