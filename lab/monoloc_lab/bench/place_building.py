"""A drawn building as a place: its rooms recorded, built into bundles, and joined by measured doors."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle, write_bundle
from monoloc.camera import Camera
from monoloc.config import override
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, rotation_angle
from monoloc.io.recording import Recording
from monoloc.place.door_measurement import MeasuredDoor, measure_door
from monoloc.place.place_files import Place, make_place, write_place
from monoloc.progress import NoProgress, Progress
from monoloc_lab.synth.box_view import BoxView
from monoloc_lab.synth.row_of_rooms import RowOfRooms

CAMERA = Camera(256, 192, 209.6, 209.6, 127.5, 95.5)
RATE_HZ = 5.0
SPEED_M_S = 1.2
STEP_M = SPEED_M_S / RATE_HZ

_NETWORK = "one-third-0.35-int8"
_BUILD = override(
    BuildConfig(),
    components=100,
    voxel_m=0.05,
    adapt={"tune": "none", "map_transform": False},
    localizer={"particles": 20, "scan_points": 40, "without": ("bias", "known-bias")},
)
_FLOWN = {"particles": 100, "scan_points": 100, "without": ("known-bias",)}  # settings of flights
_SEEN_ROOMS = 1  # on either side, that are drawn
_DOOR_STEP_M, _DOOR_M, _DOOR_ASIDE_M = 0.25, 2.2, 0.1  # of the walk that measures a door


class Views:
    """A :class:`monoloc.io.recording.Recording` of drawn views.

    Args:
        views: colour and depth of each frame.
        poses: ``T_world_camera``, (N, 4, 4).
    """

    def __init__(
        self, name: str, views: list[tuple[NDArray[np.uint8], NDArray[np.float32]]], poses: FloatArray
    ) -> None:
        self.name, self.camera, self.has_depth = name, CAMERA, True
        self.frame_names = [f"{index:06d}" for index in range(len(views))]
        self.timestamps_s = np.arange(len(views)) / RATE_HZ
        self.poses: FloatArray | None = poses
        self._views = views

    def __len__(self) -> int:
        return len(self._views)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self._views[index][0]

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._views[index][1]


class Drawing:
    """Draws views of a building; the rooms around the last view's stay ready."""

    def __init__(self, row: RowOfRooms) -> None:
        self._row, self._number = row, -1
        self._view: BoxView | None = None

    def views(self, room: int, T_building_camera: FloatArray) -> list[tuple[NDArray[np.uint8], NDArray[np.float32]]]:
        """Colour and depth of cameras (N, 4, 4) in a room and around it."""
        if self._view is None or room != self._number:
            self._view = BoxView(self._row.placed(room - _SEEN_ROOMS, room + _SEEN_ROOMS))
            self._number = room
        return [self._view(CAMERA, pose) for pose in T_building_camera]


def room_of(row: RowOfRooms, position: FloatArray) -> int:
    """The number of the room that a position (3,), building frame, is in; a wall's middle parts two."""
    return int(np.searchsorted([row.passage(n)[0] for n in range(len(row.rooms) - 1)], position[0]))


def build_rooms(row: RowOfRooms, drawing: Drawing, folder: Path, seed: int, progress: Progress) -> list[Path]:
    """A bundle of each room, untuned, from a recording of its own in its own world; those that are there are kept."""
    paths = [folder / f"{room_name(number)}.monoloc" for number in range(len(row.rooms))]
    with progress.task("rooms", len(paths)) as show:
        for number, path in enumerate(paths):
            if not path.exists():
                poses = row.mapping_views(number)
                recording = Views(f"room {number}", drawing.views(number, poses), row.in_world(number, poses))
                write_bundle(path, _built(recording, seed))
            show(number + 1)
    return paths


def _built(recording: Recording, seed: int) -> Bundle:
    """A bundle of a room; the biases of the particles are the defaults, whose measuring takes half of a build.

    The build measures its scans with few particles and points, which takes most of the rest.
    """
    bundle, _ = build_bundle(recording, _BUILD, seed, NoProgress(), network=_NETWORK)
    settings = bundle.settings.model_copy(update=_FLOWN)
    return replace(bundle, settings=settings)


def room_name(number: int) -> str:
    return f"room-{number:02d}"


@dataclass(frozen=True)
class DoorError:
    """Error of a measured door, as it puts a camera in the door: metres and radians, and the stated deviations."""

    door: MeasuredDoor
    position_m: float
    rotation_rad: float


def join_rooms(
    row: RowOfRooms, drawing: Drawing, bundles: list[Path], path: Path, progress: Progress
) -> tuple[Place, list[DoorError]]:
    """A place of the bundles, written to a path, with each door measured by a walk through it.

    A walk that is refused leaves its door out.
    """
    place, errors = make_place(path, bundles), []
    with progress.task("doors", len(bundles) - 1) as show:
        for number in range(len(bundles) - 1):
            with suppress(DataError):
                measured = _measured(row, drawing, place, number)
                errors.append(_error(row, number, measured))
                place = place.with_door(measured.door)
            show(number + 1)
    write_place(place)
    return place, errors


def _measured(row: RowOfRooms, drawing: Drawing, place: Place, number: int) -> MeasuredDoor:
    poses = row.walk(number, number + 1, _DOOR_STEP_M, _DOOR_ASIDE_M)
    poses = poses[np.abs(poses[:, 0, 3] - row.passage(number)[0]) < _DOOR_M]
    walk = Views("door", drawing.views(number, poses), poses)
    walk.poses = None
    names = room_name(number), room_name(number + 1)
    return measure_door(names, (place.read_room(names[0]), place.read_room(names[1])), walk, NoProgress())


def _error(row: RowOfRooms, number: int, measured: MeasuredDoor) -> DoorError:
    camera = np.eye(4)
    camera[:3, 3] = row.passage(number)
    here, beyond = row.in_world(number, camera), row.in_world(number + 1, camera)
    placed = measured.door.T_a_b @ beyond
    angle = float(rotation_angle(placed[:3, :3].T @ here[:3, :3]))
    return DoorError(measured, float(np.linalg.norm(placed[:3, 3] - here[:3, 3])), angle)
