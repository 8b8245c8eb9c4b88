"""Render a recording in the layout of RGB-D Scenes v2: the cloud of its scene 03 from the scene's real poses.

    python -m monoloc_lab.make.rgbd_scene --data ../shared/data --out runs/rgbd-scenes-v2
    monoloc reproduce fig4d --quick --data rgbd-scenes-v2:runs/rgbd-scenes-v2/imgs/scene_03 --out runs/reproduce-03

For machines that have the poses and clouds of the data set, but not its images. Every point of the cloud is rendered
as a disc perpendicular to its normal, large enough to close the gaps. The cloud has no colours, so surfaces have a
texture in the coordinates of the room, lit from above. At holes of the cloud there is no depth, and the image is
black.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, transform
from monoloc.io.rgbd_scenes_v2 import CAMERA, DEPTH_SCALE, read_pose_file

SCENE = "03"
_RADIUS_M = 0.04  # points are 3.4 cm apart in the median, 4.6 cm at the 95th percentile
_NEAREST_M = 0.2
_GRAIN_M = (0.03, 0.09, 0.3)  # grid sizes of the texture's noise
_LIGHT_WORLD = np.array([0.36, -0.88, -0.3])  # towards the lamp; the first camera's y points down


def read_points(path: Path) -> tuple[FloatArray, FloatArray]:
    """Points and unit normals of an ASCII .ply with ``x y z nx ny nz``, (N, 3) each."""
    lines = path.read_text(encoding="ascii").splitlines()
    rows = np.loadtxt(lines[lines.index("end_header") + 1 :])
    return rows[:, :3], rows[:, 3:6]


def draw(
    points_world: FloatArray, normals_world: FloatArray, T_world_camera: FloatArray, camera: Camera
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Image of the discs: colour (H, W, 3) uint8 RGB, depth (H, W) float32 metres, 0 for a pixel without a disc."""
    R_camera_world = T_world_camera[:3, :3].T
    points = (points_world - T_world_camera[:3, 3]) @ R_camera_world.T
    normals = normals_world @ R_camera_world.T
    u, v = (camera.matrix[:2, :2] @ (points[:, :2] / points[:, 2:]).T) + camera.matrix[:2, 2:]
    reach = camera.focal_px * _RADIUS_M / points[:, 2]
    seen = (points[:, 2] > _NEAREST_M) & (u > -reach) & (v > -reach)
    seen &= (u < camera.width + reach) & (v < camera.height + reach)
    rays = camera.pixel_rays()
    nearest = np.full(camera.height * camera.width, np.inf)
    shown = np.full(camera.height * camera.width, -1)
    for index in np.flatnonzero(seen):
        left, top = max(0, int(u[index] - reach[index])), max(0, int(v[index] - reach[index]))
        right, bottom = int(u[index] + reach[index]) + 2, int(v[index] + reach[index]) + 2
        window = rays[top:bottom, left:right]
        if window.size == 0:
            continue
        slope = window @ normals[index]
        z = points[index] @ normals[index] / np.where(np.abs(slope) > 1e-6, slope, 1e-6)
        distance = np.sum((window * z[..., None] - points[index]) ** 2, axis=-1)
        rows, columns = np.nonzero(distance < _RADIUS_M**2)
        pixels = (rows + top) * camera.width + columns + left
        nearer = z[rows, columns] < nearest[pixels]
        nearest[pixels[nearer]] = z[rows, columns][nearer]
        shown[pixels[nearer]] = index
    hit = shown >= 0
    surface = transform(T_world_camera, rays.reshape(-1, 3)[hit] * nearest[hit, None])
    light = 0.45 + 0.55 * np.abs(normals_world[shown[hit]] @ _LIGHT_WORLD)
    color = np.zeros((len(nearest), 3), np.uint8)
    color[hit] = np.clip(255.0 * light[:, None] * texture(surface), 0.0, 255.0)
    depth = np.where(hit, nearest, 0.0).astype(np.float32)
    shape = (camera.height, camera.width)
    return color.reshape(*shape, 3), depth.reshape(shape)


def texture(points: FloatArray) -> FloatArray:
    """Reflectance (N, 3) at points of the room (N, 3): smooth noise that does not depend on the view."""
    total = np.full((len(points), 3), 0.5)
    for grain, strength in zip(_GRAIN_M, (0.5, 0.3, 0.2), strict=True):
        cell = np.floor(points / grain)
        within = points / grain - cell
        smooth = within * within * (3.0 - 2.0 * within)
        for corner in np.ndindex(2, 2, 2):
            share = np.prod(np.where(np.array(corner) == 1, smooth, 1.0 - smooth), axis=1)
            total += strength * share[:, None] * (_noise((cell + corner).astype(np.int64)) - 0.5)
    return total


def _noise(cells: NDArray[np.int64]) -> FloatArray:
    """Three numbers from 0 to 1 per grid cell, (N, 3) -> (N, 3), a deterministic hash."""
    mixed = (cells * np.array([73856093, 19349663, 83492791])).sum(axis=1)[:, None] + np.array([1, 2, 3]) * 2654435761
    mixed = (mixed ^ (mixed >> 13)) * 1274126177 & 0x7FFFFFFF
    return np.asarray((mixed ^ (mixed >> 16)) % 4096 / 4095.0)


def write_scene(data: Path, root: Path, frames: range) -> Path:
    """Write frames of the scene under ``root``; returns its folder of images.

    Args:
        data: the folder ``pc`` of the data set.
        frames: numbers of the real poses; they name the files.
    """
    points, normals = read_points(data / f"{SCENE}_ascii.ply")
    poses = read_pose_file(data / f"{SCENE}.pose")
    folder = root / "imgs" / f"scene_{SCENE}"
    folder.mkdir(parents=True, exist_ok=True)
    (root / "pc").mkdir(exist_ok=True)
    shutil.copyfile(data / f"{SCENE}.pose", root / "pc" / f"{SCENE}.pose")
    for number in frames:
        color, depth = draw(points, normals, poses[number], CAMERA)
        cv2.imwrite(str(folder / f"{number:05d}-color.png"), color[..., ::-1])
        cv2.imwrite(str(folder / f"{number:05d}-depth.png"), np.round(DEPTH_SCALE * depth).astype(np.uint16))
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/rgbd-scenes-v2"))
    parser.add_argument("--step", type=int, default=5, help="one of so many of the 861 poses")
    arguments = parser.parse_args()
    print(write_scene(arguments.data / "rgbd-scenes-v2" / "pc", arguments.out, range(0, 861, arguments.step)))


if __name__ == "__main__":
    main()
