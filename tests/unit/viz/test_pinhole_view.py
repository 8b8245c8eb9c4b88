"""Images of distorted cameras, as a pinhole at the same place sees them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.viz.pinhole_view import PinholeView
from synthetic_room import CAMERA, Room, make_path

FISHEYE = Camera(320, 256, 150.0, 151.0, 158.0, 129.0, (-0.01, 0.02, -0.012, 0.001), "fisheye")
BARREL = replace(CAMERA, distortion=(-0.25, 0.06, 0.002, -0.001, 0.0))


@pytest.mark.parametrize(("camera", "seen"), [(BARREL, 0.95), (FISHEYE, 0.6)], ids=["brown", "fisheye"])
def test_view_is_what_a_pinhole_would_see(camera: Camera, seen: float) -> None:
    room, pose = Room(), make_path(3)[1]
    color, _ = room.view(pose, camera)
    view = PinholeView(camera)
    expected, _ = room.view(pose, view.camera)
    shown = view(color)
    inside = shown.any(axis=2)
    assert inside.mean() > seen
    # Textures are sampled twice, so single pixels differ; straight lines and places do not.
    assert np.abs(shown[inside].astype(int) - expected[inside]).mean() < 8.0
    assert np.abs(color[inside].astype(int) - expected[inside]).mean() > 15.0


def test_a_pinhole_stays() -> None:
    color, _ = Room().view(make_path(3)[1], CAMERA)
    view = PinholeView(CAMERA)
    assert view.camera == CAMERA and view(color) is color
