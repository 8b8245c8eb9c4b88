"""Points and meshes written as ply, read back by OpenCV and by the reader."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from monoloc.io.ply import read_ply
from monoloc.io.ply_writer import write_ply

POINTS = np.random.default_rng(0).normal(size=(50, 3))


def test_opencv_reads_points_normals_and_colours(tmp_path: Path) -> None:
    normals = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    colors = np.random.default_rng(1).integers(0, 256, POINTS.shape, dtype=np.uint8)
    write_ply(tmp_path / "a.ply", POINTS, colors=colors, normals=normals)
    vertices, found, tinted = cv2.loadPointCloud(str(tmp_path / "a.ply"))
    np.testing.assert_allclose(vertices[:, 0], POINTS, rtol=1e-6)
    np.testing.assert_allclose(found[:, 0], normals, atol=1e-6)
    np.testing.assert_allclose(tinted[:, 0], colors / 255.0, atol=1e-6)


def test_triangles_are_read_back(tmp_path: Path) -> None:
    triangles = np.array([[0, 1, 2], [7, 49, 3]])
    write_ply(tmp_path / "a.ply", POINTS, triangles=triangles)
    elements = read_ply((tmp_path / "a.ply").read_bytes(), "vertex", "face")
    np.testing.assert_array_equal(np.stack(elements["face"]["vertex_indices"]), triangles)
    np.testing.assert_allclose(elements["vertex"]["y"], POINTS[:, 1], rtol=1e-6)
