"""A place of many rooms: unknown starts, hand-overs through doors, and what a step costs at several sizes.

The building is drawn (:mod:`monoloc_lab.synth.row_of_rooms`), each room is recorded by itself and built untuned, and
each door is measured by a walk through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.evaluation.consistency import FAR_M
from monoloc.geometry import FloatArray, rotation_angle
from monoloc.place.place_files import Place, make_place, write_place
from monoloc.progress import Progress
from monoloc.supervision.state import VOUCHED_FOR
from monoloc_lab.bench.place_building import (
    RATE_HZ,
    STEP_M,
    DoorError,
    Drawing,
    build_rooms,
    join_rooms,
    room_name,
    room_of,
)
from monoloc_lab.bench.place_flights import PlaceFlight, fly_apart, fly_frames, write_frames
from monoloc_lab.synth.row_of_rooms import RowOfRooms, looking, row_of_rooms
from monoloc_lab.synth.sequence import claim

SIZES = (2, 5)
"""Numbers of rooms at which steps are timed, beside that of the whole place."""

_START_S, _FOUND_M, _FOUND_RAD = 3.0, 0.2, np.deg2rad(10.0)
_START_SPREAD_M, _START_TURN_RAD_S = 0.4, np.deg2rad(20.0)  # of the starts' places, and how fast they turn
_PAST_M = 1.5  # behind a passage, where the belief must have gone over


@dataclass(frozen=True)
class SizeFigures:
    """What a step costs in a place of so many rooms, by processor time.

    Attributes:
        rooms: in the place.
        step_ms_median, step_ms_p95: from when the camera is found to the middle of the second room, the same frames
            at each size.
        search_ms: of the first frame, which searches the place.
        rooms_loaded: in memory at most, over the flight through all of its rooms.
        peak_memory_mb: of a process that flies through all of them.
    """

    rooms: int
    step_ms_median: float
    step_ms_p95: float
    search_ms: float
    rooms_loaded: int
    peak_memory_mb: float


@dataclass(frozen=True)
class PlaceFigures:
    """JSON keys of ``monoloc bench place``.

    Attributes:
        rooms: in the place.
        index_bytes: of a room in the index, on average.
        doors_measured, doors_by_landmarks: doors whose walk was not refused, of ``passages``, and those of them with
            frames that see both rooms.
        door_error_m_median, door_error_m_max, door_error_deg_median: of a camera in the door.
        starts, found: unknown starts, one a room, and those *tracking* in the right room less than 20 cm and 10
            degrees off within 3 s.
        wrong_starts: starts in which a frame that is vouched for is in another room, or more than 30 cm off.
        passages, handed_over: doors on the flight, measured or not, and those 1.5 m behind which the belief is in the
            next room.
        switches: entries into rooms on that flight; one a passage, and one at the start, is right.
        flight_frames, flight_states: of it.
        flight_wrong_frames: of it that are vouched for and more than 30 cm off, in the building's frame.
        flight_error_m_median: of frames that are vouched for.
        sizes: what a step costs.
        step_ms_ratio, memory_ratio: of the whole place over that of two rooms.
    """

    rooms: int
    index_bytes: float
    doors_measured: int
    doors_by_landmarks: int
    door_error_m_median: float | None
    door_error_m_max: float | None
    door_error_deg_median: float | None
    starts: int
    found: int
    wrong_starts: int
    passages: int
    handed_over: int
    switches: int
    flight_frames: int
    flight_states: dict[str, int]
    flight_wrong_frames: int
    flight_error_m_median: float | None
    sizes: list[SizeFigures]
    step_ms_ratio: float
    memory_ratio: float


def bench_place(rooms: int, seed: int, folder: Path, progress: Progress) -> PlaceFigures:
    """Draw, build, join and fly a building.

    Args:
        rooms: at least two.
        seed: of the building, the builds and the flights.
        folder: for bundles, places and images; an earlier call's bundles are used again.

    Raises:
        DataError: the folder has another building, or cannot be written.
    """
    claim(folder, {"rooms": rooms, "seed": seed})
    row = row_of_rooms(rooms, seed)
    drawing = Drawing(row)
    bundles = build_rooms(row, drawing, folder, seed, progress)
    place, doors = join_rooms(row, drawing, bundles, folder / "building.place", progress)
    starts = _fly_starts(row, drawing, place, folder / "starts.raw", seed, progress)
    walk = row.walk(0, rooms - 1, STEP_M)
    write_frames(folder / "walk.raw", _drawn(row, drawing, walk, progress))
    flights = {}
    sizes = [*(size for size in SIZES if size < rooms), rooms]
    with progress.task("flights", len(sizes)) as show:
        for done, size in enumerate(sizes, start=1):
            path = _first_rooms(place, bundles[:size], folder / f"{size}.place")
            flights[size] = fly_apart(path, folder / "walk.raw", _frames_to(row, walk, size - 1), seed)
            show(done)
    return _figures(row, place, doors, starts, walk, flights)


def _drawn(row: RowOfRooms, drawing: Drawing, poses: FloatArray, progress: Progress) -> list[NDArray[np.uint8]]:
    images = []
    with progress.task("draw", len(poses)) as show:
        for done, pose in enumerate(poses, start=1):
            images.append(drawing.views(room_of(row, pose[:3, 3]), pose[None])[0][0])
            show(done)
    return images


def _fly_starts(
    row: RowOfRooms, drawing: Drawing, place: Place, images: Path, seed: int, progress: Progress
) -> list[tuple[FloatArray, PlaceFlight]]:
    """A start in each room, which turns slowly: true poses in the building's frame, and the flight."""
    rng, flights = np.random.default_rng([seed, 0x57A7]), []
    times_s = np.arange(0.0, _START_S, 1.0 / RATE_HZ)
    with progress.task("starts", len(row.rooms)) as show:
        for number in range(len(row.rooms)):
            offset = np.append(rng.uniform(-_START_SPREAD_M, _START_SPREAD_M, 2), 0.0)
            yaws = rng.uniform(-np.pi, np.pi) + _START_TURN_RAD_S * times_s
            poses = np.stack([looking(row.middle(number) + offset, yaw) for yaw in yaws])
            write_frames(images, [color for color, _ in drawing.views(number, poses)])
            flights.append((poses, fly_frames(place.path, images, len(poses), seed)))
            show(number + 1)
    return flights


def _first_rooms(place: Place, bundles: list[Path], path: Path) -> Path:
    """A place of the first rooms of another, with the doors between them."""
    part = make_place(path, bundles)
    for door in place.manifest.doors:
        if {door.a, door.b} <= set(part.names):
            part = part.with_door(door)
    write_place(part)
    return path


def _frames_to(row: RowOfRooms, walk: FloatArray, room: int) -> int:
    """Number of frames of a walk up to the middle of a room."""
    return int(np.searchsorted(walk[:, 0, 3], row.middle(room)[0]))


def _figures(
    row: RowOfRooms,
    place: Place,
    doors: list[DoorError],
    starts: list[tuple[FloatArray, PlaceFlight]],
    walk: FloatArray,
    flights: dict[int, PlaceFlight],
) -> PlaceFigures:
    rooms = len(row.rooms)
    flight, first = flights[rooms], _frames_to(row, walk, 1)
    poses = walk[: len(flight.states)]
    off_m = _errors(row, poses, flight)[0]
    vouched = _vouched(flight)
    sizes = [_size_figures(size, each, first) for size, each in flights.items()]
    errors_m, turns_rad = [door.position_m for door in doors], [door.rotation_rad for door in doors]
    return PlaceFigures(
        rooms=rooms,
        index_bytes=float(np.mean([each.nbytes for each in place.descriptors])),
        doors_measured=len(doors),
        doors_by_landmarks=sum(door.door.by == "landmarks" for door in doors),
        door_error_m_median=float(np.median(errors_m)) if errors_m else None,
        door_error_m_max=max(errors_m, default=None),
        door_error_deg_median=float(np.rad2deg(np.median(turns_rad))) if turns_rad else None,
        starts=len(starts),
        found=sum(_is_found(row, *start) for start in starts),
        wrong_starts=sum(_is_wrong(row, *start) for start in starts),
        passages=rooms - 1,
        handed_over=sum(_is_handed_over(row, poses, flight, number) for number in range(rooms - 1)),
        switches=_entries(flight.rooms),
        flight_frames=len(flight.states),
        flight_states={state: flight.states.count(state) for state in sorted(set(flight.states))},
        flight_wrong_frames=int(np.sum(vouched & (off_m > FAR_M))),
        flight_error_m_median=float(np.median(off_m[vouched])) if vouched.any() else None,
        sizes=sizes,
        step_ms_ratio=sizes[-1].step_ms_median / sizes[0].step_ms_median,
        memory_ratio=sizes[-1].peak_memory_mb / sizes[0].peak_memory_mb,
    )


def _size_figures(size: int, flight: PlaceFlight, first: int) -> SizeFigures:
    found = next((index for index, room in enumerate(flight.rooms) if room is not None), 0)
    step_ms = flight.step_ms[found + 1 : first]
    return SizeFigures(
        rooms=size,
        step_ms_median=float(np.median(step_ms)),
        step_ms_p95=float(np.percentile(step_ms, 95.0)),
        search_ms=float(flight.step_ms[0]),
        rooms_loaded=flight.loaded,
        peak_memory_mb=flight.peak_memory_mb,
    )


def _vouched(flight: PlaceFlight) -> NDArray[np.bool_]:
    return np.isin(np.array(flight.states), list(VOUCHED_FOR))


def _errors(row: RowOfRooms, poses: FloatArray, flight: PlaceFlight) -> tuple[FloatArray, FloatArray]:
    """Errors in the building's frame, metres and radians, (F,) each; NaN where there is no pose."""
    numbers = {room_name(number): number for number in range(len(row.rooms))}
    off_m, off_rad = np.full(len(poses), np.nan), np.full(len(poses), np.nan)
    for index, (room, true) in enumerate(zip(flight.rooms, poses, strict=True)):
        if room is not None:
            placed = row.T_building_worlds[numbers[room]] @ flight.poses[index]
            off_m[index] = np.linalg.norm(placed[:3, 3] - true[:3, 3])
            off_rad[index] = rotation_angle(placed[:3, :3].T @ true[:3, :3])
    return off_m, off_rad


def _is_right_room(row: RowOfRooms, poses: FloatArray, flight: PlaceFlight) -> NDArray[np.bool_]:
    return np.array(
        [room == room_name(room_of(row, pose[:3, 3])) for room, pose in zip(flight.rooms, poses, strict=True)]
    )


def _is_found(row: RowOfRooms, poses: FloatArray, flight: PlaceFlight) -> bool:
    off_m, off_rad = _errors(row, poses, flight)
    is_near = (off_m < _FOUND_M) & (off_rad < _FOUND_RAD)
    return bool(np.any(_vouched(flight) & is_near & _is_right_room(row, poses, flight)))


def _is_wrong(row: RowOfRooms, poses: FloatArray, flight: PlaceFlight) -> bool:
    is_wrong = (_errors(row, poses, flight)[0] > FAR_M) | ~_is_right_room(row, poses, flight)
    return bool(np.any(_vouched(flight) & is_wrong))


def _is_handed_over(row: RowOfRooms, poses: FloatArray, flight: PlaceFlight, number: int) -> bool:
    """Whether the belief is in the next room at the first frame well behind a passage."""
    behind = int(np.searchsorted(poses[:, 0, 3], row.passage(number)[0] + _PAST_M))
    return behind < len(poses) and flight.rooms[behind] == room_name(number + 1)


def _entries(rooms: list[str | None]) -> int:
    """How often a room is entered."""
    return sum(room is not None and room != before for before, room in zip([None, *rooms], rooms, strict=False))
