"""Choice of the frames that depth of a frame is found with: those that see the same points from another side.

Source: Yao et al., *MVSNet* (ECCV 2018), for the score of a pair.
"""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.structure_from_motion.sparse_model import SparseModel

_LEAST_SHARED = 15  # points that both frames see
_BEST_RAD = np.deg2rad(5.0)  # parallax: less is imprecise, more changes what surfaces look like
_NARROW_POWER, _WIDE_RAD = 1.5, np.deg2rad(10.0)


def neighbours_of(model: SparseModel, count: int) -> list[list[int]]:
    """For each frame of a model, up to ``count`` others to find its depth with, best first."""
    centres = model.poses[:, :3, 3]
    saw = np.zeros((len(model.frames), len(model.points)), dtype=np.bool_)
    saw[model.frame, model.point] = True
    chosen = []
    for frame in range(len(model.frames)):
        points = np.flatnonzero(saw[frame])
        directions = _unit(model.points[points] - centres[frame])
        scores = np.zeros(len(model.frames))
        for other in np.flatnonzero(saw[:, points].sum(axis=1) >= _LEAST_SHARED).tolist():
            if other == frame:
                continue
            shared = saw[other, points]
            cosine = np.sum(directions[shared] * _unit(model.points[points[shared]] - centres[other]), axis=1)
            scores[other] = _worth(np.arccos(np.clip(cosine, -1.0, 1.0))).sum()
        best = np.argsort(-scores, kind="stable")[:count]
        chosen.append([int(other) for other in best if scores[other] > 0.0])
    return chosen


def _worth(parallax_rad: FloatArray) -> FloatArray:
    narrow = (parallax_rad / _BEST_RAD) ** _NARROW_POWER
    wide = np.exp(-(((parallax_rad - _BEST_RAD) / _WIDE_RAD) ** 2))
    return np.asarray(np.where(parallax_rad < _BEST_RAD, narrow, wide))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
