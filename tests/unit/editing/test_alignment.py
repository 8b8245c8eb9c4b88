"""Where the same cameras' poses in two worlds put one world in the other."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.editing.alignment import consensus
from monoloc.geometry import se3_exp, transform


@pytest.mark.parametrize("from_origin_m", [0.0, 10.0, 100.0])
def test_worlds_are_joined_where_the_cameras_are_however_far_their_origins(from_origin_m: float) -> None:
    """Centimetres and half a degree of error in each pose leave centimetres, averaged over seven frames."""
    rng = np.random.default_rng(0)
    errors_m = []
    for _ in range(100):
        T_there_here = se3_exp(rng.normal(size=6))
        here = se3_exp(rng.normal(size=(7, 6)) * 0.4)
        here[:, :3, 3] += from_origin_m * np.array([0.8, 0.5, 0.3])
        noise = se3_exp(rng.normal(size=(2, 7, 6)) * np.repeat([0.01, 0.006], 3))
        agreed = consensus(T_there_here @ here @ noise[0], here @ noise[1])
        assert agreed is not None and agreed[1] >= 4
        middle = here[:, :3, 3].mean(axis=0)[None]
        errors_m.append(np.linalg.norm(transform(agreed[0], middle) - transform(T_there_here, middle)))
    assert np.sqrt(np.mean(np.square(errors_m))) < 0.02
