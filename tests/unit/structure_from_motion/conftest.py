"""A walk through the synthetic room, as images without poses."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import FloatArray
from monoloc.structure_from_motion.sparse_model import SparseModel
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

UNIT_M = 0.25


@pytest.fixture(scope="session")
def walk() -> RoomRecording:
    """Twelve frames, three a second."""
    return RoomRecording(Room(), make_path(12, rate_hz=3.0), SMALL_CAMERA)


@pytest.fixture(scope="session")
def model(walk: RoomRecording) -> SparseModel:
    """The walk's true poses and some of the room's points, in units of 0.25 m."""
    assert walk.poses is not None
    rng = np.random.default_rng(0)
    points: FloatArray = rng.uniform([-1.0, -1.0, 1.0], [1.0, 1.0, 3.0], (40, 3))
    nothing = np.zeros(0, dtype=np.int64)
    frames = np.arange(len(walk))
    metric = SparseModel(SMALL_CAMERA, {}, frames, walk.poses, points, nothing, nothing, np.zeros((0, 2)), len(walk))
    return metric.scaled(1.0 / UNIT_M)
