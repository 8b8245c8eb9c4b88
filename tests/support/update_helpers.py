"""A mapped room in which one box is moved, and flights through it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from edit_helpers import VOXEL_M
from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.bundle import Bundle, CloudSize
from monoloc.editing.box import Box
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.map.cloud import cloud_from_recording
from monoloc.map.em import fit_mixture
from monoloc.progress import NoProgress
from monoloc.updating.observed_flight import ObservedFlight, observe
from monoloc.updating.room_evidence import Evidence
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path

_RATE_HZ = 8.0
_MOVED, _SHIFT_M = 1, -0.7  # the box, and its shift along x


@dataclass(frozen=True)
class ChangedRoom(Room):
    """The room with one of its boxes moved."""

    @property
    def _boxes(self) -> FloatArray:
        boxes = super()._boxes.copy()
        boxes[_MOVED, :, 0] += _SHIFT_M
        return boxes


LEFT = Box.between(*(Room()._boxes[_MOVED] + np.array([[-0.03], [0.03]])), np.array([0.0, 1.0, 0.0]))
"""Where the box was."""


@cache
def mapped() -> Bundle:
    """As built from a walk in the room before the change; nothing adapted."""
    recording = RoomRecording(Room(), make_path(24, 0.0, _RATE_HZ), SMALL_CAMERA)
    cloud = cloud_from_recording(recording, VOXEL_M)
    mixture = fit_mixture(cloud, 80, np.random.default_rng(0)).mixture
    bundle = make_bundle(mixture, recording, range(len(recording)))
    landmarks, bias, evidence = build_landmarks(recording, recording.depth, NoProgress())
    found = {"familiar_found": evidence.familiar_found, "strange_found": evidence.strange_found}
    return replace(
        bundle,
        landmarks=landmarks,
        integrity=bundle.integrity.model_copy(update=found),
        settings=bundle.settings.model_copy(update={"landmark_bias": bias, "particles": 200, "scan_points": 100}),
        cloud=CloudSize(points=len(cloud), voxel_m=VOXEL_M),
    )


@cache
def flight(number: int, room: Room = ChangedRoom()) -> RoomRecording:
    """A flight along the walk, none of whose frames built the map."""
    recording = RoomRecording(room, make_path(20, 0.03 + 0.02 * number, _RATE_HZ), SMALL_CAMERA)
    recording.name = f"flight-{number}"
    return recording


def observed(recording: Recording, bundle: Bundle | None = None, **given: object) -> ObservedFlight:
    """What a flight shows whose start is not known, by its sensor."""
    known = given.get("known", frozenset())
    assert isinstance(known, frozenset)
    rng = np.random.default_rng(0)
    return observe(bundle or mapped(), recording, None, True, known, rng, NoProgress())


@cache
def evidence_of(*numbers: int, room: Room = ChangedRoom()) -> Evidence:
    """What some flights have shown of the mapped room."""
    if not numbers:
        return Evidence.none(mapped())
    before = evidence_of(*numbers[:-1], room=room)
    seen = observed(flight(numbers[-1], room))
    return before.after_flight(mapped(), seen, True, np.random.default_rng(0))
