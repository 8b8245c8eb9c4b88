"""A world that stands upright: z up, by the room's floor and walls, or else by how the camera was held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert, make_pose, transform
from monoloc.map.cloud import remove_outliers, voxel_thin
from monoloc.map.down_direction import down_of
from monoloc.map.em import fit_mixture
from monoloc.structure_from_motion.dense_depth import small_camera
from monoloc.structure_from_motion.sparse_model import SparseModel

_VOXEL_M = 0.05
_COMPONENTS, _ITERATIONS = 200, 30
_WITHIN_RAD = np.deg2rad([30.0, 20.0, 15.0, 10.0, 10.0])  # see down_of; depth by parallax is rough
_STRIDE = 2
_PITCH_WEIGHT = 0.02  # of the mean y axis beside the x axes


def levelled(
    model: SparseModel, depths: Sequence[NDArray[np.float32]], rng: np.random.Generator
) -> tuple[SparseModel, bool]:
    """Turn a metric model upright: z up, the first camera at the origin, looking along x.

    Args:
        model: in metres.
        depths: of its frames, (h, w) of :func:`monoloc.structure_from_motion.dense_depth.small_camera`, metres, 0
            where unknown.
        rng: starts the fit of the surfaces.

    Returns:
        The model, and whether surfaces determined its vertical. Otherwise the camera, held without roll, did.
    """
    held = _held_down(model.poses)
    found = _down(model, depths, held, rng)
    down = held if found is None else found
    z = -down / np.linalg.norm(down)
    ahead = model.poses[0, :3, 2] - (model.poses[0, :3, 2] @ z) * z
    if np.linalg.norm(ahead) < 1e-3:  # looking straight up or down
        ahead = np.cross(model.poses[0, :3, 0], z)
    x = ahead / np.linalg.norm(ahead)
    T_world_new = make_pose(np.stack([x, np.cross(z, x), z], axis=1), model.poses[0, :3, 3])
    return model.moved(invert(T_world_new)), found is not None


def _held_down(poses: FloatArray) -> FloatArray:
    """Down by the cameras' axes: their x axes are level if they are held without roll, (F, 4, 4) -> (3,).

    Views that hardly turn leave the pitch open; it is then that of the mean y axis.
    """
    x, y = poses[:, :3, 0], poses[:, :3, 1].mean(axis=0)
    across = np.eye(3) - np.outer(y, y) / (y @ y)
    down = np.linalg.eigh(x.T @ x / len(x) + _PITCH_WEIGHT * across)[1][:, 0]
    return np.asarray(np.copysign(1.0, down @ y) * down)


def _down(
    model: SparseModel, depths: Sequence[NDArray[np.float32]], held: FloatArray, rng: np.random.Generator
) -> FloatArray | None:
    rays = small_camera(model.camera).pixel_rays()[::_STRIDE, ::_STRIDE]
    clouds = []
    for pose, depth in zip(model.poses, depths, strict=True):
        z = depth[::_STRIDE, ::_STRIDE].astype(np.float64)
        clouds.append(transform(pose, (z[..., None] * rays)[z > 0.0]))
    cloud = remove_outliers(voxel_thin(np.concatenate(clouds), _VOXEL_M), _VOXEL_M)
    if len(cloud) < 10 * _COMPONENTS:
        return None
    return down_of(fit_mixture(cloud, _COMPONENTS, rng, max_iterations=_ITERATIONS).mixture, held, _WITHIN_RAD)
