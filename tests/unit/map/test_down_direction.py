"""A map tells the direction of gravity by its floor and walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from map_helpers import make_mixture
from monoloc.geometry import FloatArray, so3_exp
from monoloc.map.down_direction import down_of
from monoloc.map.mixture import GaussianMixture
from synthetic_room import Room, room_mixture

DOWN = np.array([0.0, 1.0, 0.0])  # of the synthetic room


def rotated(mixture: GaussianMixture, rotation: FloatArray) -> GaussianMixture:
    return GaussianMixture(mixture.weights, mixture.means @ rotation.T, rotation @ mixture.covariances @ rotation.T)


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_direction_is_that_of_a_rotated_room(seed: int) -> None:
    """Though the first guess is 25 degrees off."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    axis = np.cross(DOWN, rng.normal(size=3))
    guess = 3.0 * so3_exp(np.deg2rad(25.0) * axis / np.linalg.norm(axis)) @ DOWN
    down = down_of(rotated(room_mixture(Room()), rotation), rotation @ guess)
    assert down is not None and np.linalg.norm(down) == pytest.approx(1.0)
    assert np.rad2deg(np.arccos(min(1.0, down @ rotation @ DOWN))) < 0.5


def test_without_a_floor_or_a_guess_the_direction_is_unknown() -> None:
    mixture = room_mixture(Room())
    normals = np.linalg.eigh(mixture.covariances)[1][:, :, 0]
    walls = np.abs(normals @ DOWN) < 0.5
    only_walls = GaussianMixture(
        mixture.weights[walls] / mixture.weights[walls].sum(), mixture.means[walls], mixture.covariances[walls]
    )
    assert down_of(only_walls, DOWN) is None
    assert down_of(mixture, np.zeros(3)) is None
    spheres = replace(make_mixture(20), covariances=np.tile(np.eye(3), (20, 1, 1)))
    assert down_of(spheres, DOWN) is None
