"""Meshes of simple shapes."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc_lab.synth.shapes import Mesh, box, cylinder, ellipsoid, panel


@pytest.mark.parametrize(
    ("mesh", "volume", "area"),
    [
        (box(np.array([0.5, 1.0, 2.0])), 1.0, 7.0),
        (cylinder(np.array([1.0, 1.0, 2.0])), np.pi / 2.0, 2.5 * np.pi),
        (cylinder(np.array([1.0, 1.0, 3.0]), taper=0.0), np.pi / 4.0, None),
        (ellipsoid(np.array([2.0, 2.0, 2.0])), 4.0 * np.pi / 3.0, 4.0 * np.pi),
    ],
)
def test_shapes_are_closed_and_face_outwards(mesh: Mesh, volume: float, area: float | None) -> None:
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    # Gauss: the flux of x / 3 through the surface is the volume. Circles with 28 corners lose two percent.
    assert np.sum(corners.mean(axis=1) * normals) / 3.0 == pytest.approx(volume, rel=0.03)
    if area is not None:
        assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-9)
    flat = np.linalg.norm(normals, axis=1) > 1e-9
    agrees = np.sum(mesh.normals[mesh.faces].mean(axis=1) * normals, axis=1)
    assert np.all(agrees[flat] > 0.0)


def test_rounded_box_is_inside_the_sharp_one() -> None:
    sharp, rounded = np.array([0.4, 0.6, 0.2]), box(np.array([0.4, 0.6, 0.2]), 0.05)
    assert np.all(np.abs(rounded.vertices) <= sharp / 2.0 + 1e-9)
    np.testing.assert_allclose(np.abs(rounded.vertices).max(axis=0), sharp / 2.0)
    assert np.linalg.norm(rounded.vertices, axis=1).max() < np.linalg.norm(sharp / 2.0) - 0.02


def test_panel_faces_the_front_with_the_right_side_up() -> None:
    mesh = panel(np.array([2.0, 0.0, 1.0]))
    np.testing.assert_allclose(mesh.normals, [[0.0, -1.0, 0.0]] * len(mesh.normals), atol=1e-12)
    np.testing.assert_allclose(mesh.span, mesh.vertices[:, [0, 2]] / [2.0, 1.0] + 0.5)
