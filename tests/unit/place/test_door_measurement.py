"""Bundles that cannot be of one world are not joined as if they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.bundle import Bundle
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import make_pose, so3_exp
from monoloc.map.surface import transformed
from monoloc.place.door_measurement import same_world_door
from refusals import refuses_setting
from synthetic_room import Room, RoomRecording, make_bundle, make_path, room_mixture

NAMES = ("hall", "kitchen")


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    recording = RoomRecording(Room(), make_path(4))
    made = make_bundle(room_mixture(Room(), 120), recording, range(4))
    poses = np.stack([recording.poses[index] for index in range(4)])
    return replace(made, reference_poses=ReferencePoses.without_bias(poses))


def tilted(bundle: Bundle, angle_deg: float) -> Bundle:
    """The bundle in a world that is turned about its x axis."""
    T = make_pose(so3_exp([np.deg2rad(angle_deg), 0.0, 0.0]), np.zeros(3))
    poses = ReferencePoses.without_bias(T @ bundle.reference_poses.poses)
    down = tuple((T[:3, :3] @ bundle.provenance.down_world).tolist())
    provenance = bundle.provenance.model_copy(update={"down_world": down})
    original = transformed(bundle.original, T)
    return replace(bundle, original=original, reference_poses=poses, provenance=provenance)


def test_rooms_whose_gravity_differs_are_of_two_worlds(bundle: Bundle) -> None:
    assert same_world_door(NAMES, (bundle, tilted(bundle, 10.0))).by == "same world"
    problem = "gravity of rooms hall and kitchen differs by 27°"
    refuses_setting(
        lambda: same_world_door(NAMES, (bundle, tilted(bundle, 27.0))), "--same-world", problem, "record a walk"
    )


def test_a_room_without_poses_of_its_build_is_refused(bundle: Bundle) -> None:
    bare = replace(bundle, reference_poses=ReferencePoses.none())
    problem = "the bundle of room kitchen keeps no poses of its build"
    refuses_setting(lambda: same_world_door(NAMES, (bundle, bare)), "--same-world", problem, "record a walk")
