"""The surface of a map: patches, points on them, ellipsoids."""

from __future__ import annotations

import numpy as np
import pytest

from map_helpers import make_mixture
from monoloc.geometry import make_pose, so3_exp
from monoloc.map.mixture import GaussianMixture
from monoloc.map.surface import ellipsoid_mesh, mass_per_area, patch_normals, surface_points, transformed


def test_points_have_the_moments_of_the_mixture_and_end_with_the_patch() -> None:
    mixture = make_mixture(1)
    points = surface_points(mixture, 200_000, np.random.default_rng(0))
    np.testing.assert_allclose(points.mean(axis=0), mixture.means[0], atol=2e-3)
    np.testing.assert_allclose(np.cov(points.T), mixture.covariances[0], atol=2e-4)
    across = (points - mixture.means[0]) @ patch_normals(mixture)[0]
    thickness = np.sqrt(np.linalg.eigvalsh(mixture.covariances[0])[0])
    assert np.abs(across).max() == pytest.approx(np.sqrt(3.0) * thickness, rel=1e-3)


def test_mass_per_area_is_that_of_an_evenly_covered_wall() -> None:
    cells = np.stack(np.meshgrid(np.arange(4), np.arange(3), [0.0]), axis=-1).reshape(-1, 3) * [0.5, 0.25, 1.0]
    covariance = np.diag([0.5**2 / 12.0, 0.25**2 / 12.0, 0.01**2 / 12.0])
    wall = GaussianMixture(np.full(12, 1.0 / 12.0), cells, np.tile(covariance, (12, 1, 1)))
    assert mass_per_area(wall) == pytest.approx(1.0 / (12 * 0.5 * 0.25))


def test_density_moves_with_the_frame() -> None:
    mixture, T = make_mixture(20), make_pose(so3_exp([0.3, -0.8, 2.0]), [1.0, -2.0, 0.5])
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 3))
    moved = points @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(transformed(mixture, T).log_density(moved), mixture.log_density(points), rtol=1e-6)


def test_ellipsoids_are_closed_face_outwards_and_have_the_volume_of_their_axes() -> None:
    mixture = make_mixture(5)
    vertices, faces, component = ellipsoid_mesh(mixture)
    assert len(vertices) == len(component) and set(component) == set(range(5))
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    signed = np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0
    volumes = np.bincount(component[faces[:, 0]], signed)
    exact = 4.0 / 3.0 * np.pi * 3.0**1.5 * np.sqrt(np.linalg.det(mixture.covariances))
    assert np.all((volumes > 0.8 * exact) & (volumes < exact))
