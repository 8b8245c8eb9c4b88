"""A camera in a place of three rooms: found, followed through a door, and the door measured."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from cli_helpers import json_of, refused
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.errors import BundleError
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, pose_distance_m
from monoloc.io.pose_table import read_pose_table
from monoloc.place import door_measurement, place_localizer
from monoloc.place.door_measurement import MeasuredDoor, measure_door, same_world_door
from monoloc.place.place_files import Place, make_place, read_place, write_place
from monoloc.place.place_localizer import PlaceLocalizer, PlaceStep
from monoloc.place.place_manifest import Door
from monoloc.progress import NoProgress
from monoloc.start import Start
from place_rooms import LEFT, OTHER, RIGHT, T_LEFT_RIGHT, true_door, turning, write_rooms
from refusals import refuses_data, refuses_setting
from synthetic_room import BLACK, CAMERA, FRAME_S, Room, RoomRecording, write_recording

Capture = pytest.CaptureFixture[str]
FRAMES = 26


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rooms")


@pytest.fixture(scope="module")
def place(folder: Path) -> Place:
    made = make_place(folder / "all.place", write_rooms(folder)).with_door(true_door())
    write_place(made)
    return read_place(made.path)


@pytest.fixture(scope="module")
def walk() -> RoomRecording:
    """Through the door, away from the frames that built the bundles."""
    return RoomRecording(Room(), turning(-46.0, 46.0, FRAMES))


def follow(localizer: PlaceLocalizer, recording: RoomRecording, frames: range) -> list[PlaceStep]:
    return [localizer.step(recording.color(index), FRAME_S) for index in frames]


def distance_m(step: PlaceStep, pose: FloatArray) -> float:
    """Pose distance from the truth in the room's world; infinite in a room that has no such world."""
    T_left_room = {LEFT: np.eye(4), RIGHT: T_LEFT_RIGHT}.get(step.room or "")
    if T_left_room is None or step.step is None:
        return float("inf")
    return float(pose_distance_m(pose, (T_left_room @ step.step.estimate.pose)[None])[0])


def test_a_camera_is_found_and_handed_over_once(place: Place, walk: RoomRecording) -> None:
    localizer = PlaceLocalizer(place, CAMERA)
    steps = follow(localizer, walk, range(FRAMES))
    assert [step.room for step in steps if step.entered] == [LEFT, RIGHT]
    # Two searches, 0.2 s apart, must find the same room.
    assert {(step.room, step.state) for step in steps[:3]} == {(None, "lost")}
    assert all(step.state == "tracking" for step in steps[3:]) and steps[-1].room == RIGHT
    assert max(distance_m(step, pose) for step, pose in zip(steps[3:], walk.poses[3:], strict=True)) < 0.1
    again = follow(PlaceLocalizer(place, CAMERA), walk, range(6))
    for one, other in zip(steps[3:], again[3:], strict=False):
        assert one.step is not None and other.step is not None
        np.testing.assert_array_equal(one.step.estimate.pose, other.step.estimate.pose)


def test_an_image_that_repeats_finds_no_room_and_opens_no_door(place: Place, walk: RoomRecording) -> None:
    """Else a frozen camera is found again where it was before, time and again, or goes through a door."""
    localizer = PlaceLocalizer(place, CAMERA)
    follow(localizer, walk, range(8))
    frozen = [localizer.step(walk.color(8), FRAME_S) for _ in range(80)]
    assert {step.room for step in frozen} == {LEFT, None} and not any(step.entered for step in frozen)
    assert all(step.state == "lost" for step in frozen[40:])
    assert follow(localizer, walk, range(9, 13))[-1].state == "tracking"
    at_door = (
        next(index for index, step in enumerate(follow(localizer, walk, range(13, FRAMES))) if step.entered) + 13
    )
    before = PlaceLocalizer(place, CAMERA, LEFT, Start(walk.poses[at_door - 3]))
    follow(before, walk, range(at_door - 3, at_door - 2))
    assert {before.step(walk.color(at_door - 2), FRAME_S).room for _ in range(8)} == {LEFT}


@pytest.mark.slow
def test_a_camera_that_turns_back_is_handed_back(place: Place, walk: RoomRecording) -> None:
    localizer = PlaceLocalizer(place, CAMERA, RIGHT, Start(np.linalg.inv(T_LEFT_RIGHT) @ walk.poses[-1]))
    steps = follow(localizer, walk, range(FRAMES - 1, -1, -1))
    assert [step.room for step in steps if step.entered] == [LEFT]
    assert all(distance_m(step, pose) < 0.1 for step, pose in zip(steps, walk.poses[::-1], strict=True))


@pytest.mark.parametrize("dark_frames", [0, pytest.param(10, marks=pytest.mark.slow)])
def test_a_camera_carried_into_another_room_is_found_there(
    place: Place, walk: RoomRecording, dark_frames: int
) -> None:
    """Whether the room notices that it lost the camera, or only sees none of its landmarks."""
    localizer = PlaceLocalizer(place, CAMERA)
    assert follow(localizer, walk, range(5))[-1].room == LEFT
    elsewhere = RoomRecording(Room(seed=5), turning(-20.0, 5.0, 8))
    dark = [localizer.step(BLACK + np.uint8(number % 2), 0.4) for number in range(dark_frames)]
    assert all(step.state == "lost" for step in dark[-1:])
    steps = [localizer.step(elsewhere.color(index), 0.4) for index in range(8)]
    assert steps[-1].room == OTHER and steps[-1].state == "tracking"
    step = steps[-1].step
    assert step is not None and pose_distance_m(elsewhere.poses[-1], step.estimate.pose[None])[0] < 0.1
    assert not any(each.room == LEFT and each.state == "tracking" for each in steps[4:])
    assert len(localizer.loaded) <= 3


def test_a_room_beyond_a_door_that_cannot_be_read_takes_no_pose_from_the_room_before_it(
    place: Place, walk: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when a disk fails in flight; nor is it read at every frame. Who asks for that room itself hears of it."""
    read_room, asked = Place.read_room, list[str]()

    def failing(self: Place, room: str) -> Bundle:
        asked.append(room)
        if room == RIGHT:
            raise BundleError(self.path, "cannot be read", "put it back")
        return read_room(self, room)

    monkeypatch.setattr(Place, "read_room", failing)
    localizer = PlaceLocalizer(place, CAMERA, LEFT, Start(walk.poses[8]))
    steps = follow(localizer, walk, range(8, 12))
    assert {(step.room, step.state) for step in steps} == {(LEFT, "tracking")} and asked == [LEFT, RIGHT]
    with pytest.raises(BundleError):
        PlaceLocalizer(place, CAMERA, RIGHT)


def test_path_in_place_of_a_place_and_numbers_in_place_of_a_camera_are_refused(place: Place) -> None:
    with pytest.raises(TypeError, match=r"^place must be a Place, as read_place\(PATH\) gives it, got PosixPath$"):
        PlaceLocalizer(cast(Any, place.path), CAMERA)
    with pytest.raises(TypeError, match=r"^camera must be a monoloc\.Camera, got tuple$"):
        PlaceLocalizer(place, cast(Any, (640, 480, 525.0, 525.0, 319.5, 239.5)))


def test_a_room_that_cannot_be_read_does_not_end_a_flight_that_is_tracking_in_another(
    place: Place, walk: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the room's landmarks are not seen for a while, the place is asked; a failing disk then takes no pose."""
    localizer = PlaceLocalizer(place, CAMERA, LEFT, Start(walk.poses[0]))
    stepped = localizer._stepped
    asked: list[str] = []

    def failing(self: Place, room: str) -> Bundle:
        asked.append(room)
        raise BundleError(self.path, "cannot be read", "put it back")

    monkeypatch.setattr(place_localizer, "_UNSEEN_S", 5.5 * FRAME_S)
    monkeypatch.setattr(Place, "read_room", failing)
    monkeypatch.setattr(localizer._search, "ranked", lambda seen, known: {LEFT: 50, OTHER: 10})
    monkeypatch.setattr(localizer, "_door_taken", lambda color, room, belief: None)
    monkeypatch.setattr(localizer, "_stepped", lambda *given: replace(stepped(*given), landmark_pose=None))
    steps = follow(localizer, walk, range(8))
    assert asked == [OTHER] and {(step.room, step.state) for step in steps} == {(LEFT, "tracking")}


def test_the_place_is_asked_as_soon_by_a_driver_that_gives_each_image_twice(
    place: Place, walk: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    localizer = PlaceLocalizer(place, CAMERA, LEFT, Start(walk.poses[0]))
    stepped, asked = localizer._stepped, list[int]()
    monkeypatch.setattr(place_localizer, "_UNSEEN_S", 5.5 * FRAME_S)
    monkeypatch.setattr(localizer, "_door_taken", lambda color, room, belief: None)
    monkeypatch.setattr(localizer, "_stepped", lambda *given: replace(stepped(*given), landmark_pose=None))
    for frame in range(7):
        monkeypatch.setattr(localizer, "_agreed", lambda given, frame=frame: asked.append(frame))
        localizer.step(walk.color(frame // 2), FRAME_S)
    assert asked == [6]  # that after 5.5 frames is the third of an image that repeats


def test_a_lost_camera_is_found_although_another_room_cannot_be_read(
    place: Place, walk: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when a disk fails in flight; once the other room can be read again, it is entered."""
    read_room, fails = Place.read_room, [True]

    def failing(self: Place, room: str) -> Bundle:
        if room == RIGHT and fails[0]:
            raise BundleError(self.path, "cannot be read", "put it back")
        return read_room(self, room)

    monkeypatch.setattr(Place, "read_room", failing)
    localizer = PlaceLocalizer(place, CAMERA)
    steps = follow(localizer, walk, range(8))
    assert {step.room for step in steps} == {None, LEFT} and steps[-1].state == "tracking"
    assert list(localizer.unreadable) == [RIGHT] and "put it back" in localizer.unreadable[RIGHT]
    fails[0] = False
    steps = [localizer.step(walk.color(FRAMES - 1 - index % 2), 0.4) for index in range(10)]
    assert steps[-1].room == RIGHT and not localizer.unreadable


def test_a_frame_that_is_none_is_refused_while_the_place_is_searched(place: Place, walk: RoomRecording) -> None:
    """Time that is not a number would stay one: an unreadable room would be read at every frame."""
    localizer = PlaceLocalizer(place, CAMERA)
    localizer.step(walk.color(0), math.nan)  # ignored at the first frame
    for elapsed_s in (math.nan, -5.0, 1e30):
        with pytest.raises(ValueError, match="elapsed_s must be a number"):
            localizer.step(walk.color(0), elapsed_s)
    with pytest.raises(ValueError, match="color must have the camera's shape"):
        localizer.step([1, 2], 0.1)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="down must be three finite numbers"):
        localizer.step(walk.color(0), 0.1, down=np.array([math.nan, 0.0, 0.0]))
    assert follow(localizer, walk, range(8))[-1].room == LEFT


def test_frames_before_a_loss_do_not_count_for_a_door(
    place: Place, walk: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three frames in a row must show the room beyond better, and a lost camera sees none."""
    localizer = PlaceLocalizer(place, CAMERA, LEFT, Start(walk.poses[10]))
    monkeypatch.setattr(localizer, "_found", lambda room, seen, belief: 30 if room == RIGHT else 0)
    stepped = localizer._stepped
    entered = []
    for index, is_lost in enumerate((False, False, True, False, False, False)):
        monkeypatch.setattr(
            localizer,
            "_stepped",
            lambda *given, is_lost=is_lost: replace(stepped(*given), state="lost" if is_lost else "tracking"),
        )
        entered.append(localizer.step(walk.color(10 + index % 2), FRAME_S).entered)
    assert entered == [False] * 5 + [True]


def test_rooms_that_look_alike_are_not_told_apart(folder: Path, place: Place, walk: RoomRecording) -> None:
    """A camera in one of two equal rooms stays lost, rather than in one of them by chance."""
    left = read_bundle(folder / "left.monoloc")
    other_seed = left.provenance.model_copy(update={"seed": left.provenance.seed + 1})  # a copy would be refused
    write_bundle(folder / "twin.monoloc", replace(left, provenance=other_seed))
    twins = make_place(folder / "twins.place", [folder / "left.monoloc", folder / "twin.monoloc"])
    write_place(twins)
    steps = follow(PlaceLocalizer(read_place(twins.path), CAMERA), walk, range(8))
    assert {(step.room, step.state) for step in steps} == {(None, "lost")}


def measured(place: Place, recording: RoomRecording) -> MeasuredDoor:
    rooms = place.read_room(LEFT), place.read_room(RIGHT)
    return measure_door((LEFT, RIGHT), rooms, recording, NoProgress())


def test_a_door_is_measured_by_frames_that_show_both_rooms(place: Place) -> None:
    found = measured(place, RoomRecording(Room(), turning(-25.0, 25.0, 7)))
    assert found.by == "landmarks" and found.frames[2] >= 3
    assert pose_distance_m(T_LEFT_RIGHT, found.door.T_a_b[None])[0] < 0.05
    assert np.linalg.norm(found.door.centre_in(LEFT) - (0.0, 0.0, -0.8)) < 0.3
    assert found.door.position_sd_m < 0.05


@pytest.mark.slow
def test_a_door_is_measured_by_odometry_where_no_frame_shows_both(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of each frame, only the room that explains it better counts."""
    recording = RoomRecording(Room(), turning(-25.0, 25.0, 14))
    observed = door_measurement.observe_passage

    def apart(*given: object) -> object:
        passage = observed(*given)  # type: ignore[arg-type]
        for index in range(14):
            (passage.b if index < 7 else passage.a)[index] = None
        return passage

    monkeypatch.setattr(door_measurement, "observe_passage", apart)
    found = measured(place, recording)
    assert found.by == "odometry" and found.frames[2] == 0
    assert pose_distance_m(T_LEFT_RIGHT, found.door.T_a_b[None])[0] < 0.1
    assert found.door.position_sd_m > 0.01

    def broken(*given: object) -> object:
        passage = apart(*given)
        passage.motions[7] = None  # type: ignore[attr-defined]
        return passage

    monkeypatch.setattr(door_measurement, "observe_passage", broken)
    refuses_data(lambda: measured(place, recording), Path("room"), "odometry does not join them", "through the door")


def test_a_walk_that_stays_in_one_room_is_no_door(place: Place) -> None:
    inside = RoomRecording(Room(), turning(-60.0, -50.0, 4))
    problem = r"shows room right in fewer than 3 frames \([012]\)"
    refuses_data(lambda: measured(place, inside), Path("room"), problem, "through the door")


def test_walks_that_do_not_change_the_room_are_no_door(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that two frames show in both rooms, first of all, and one that the first room always explains better."""
    observed = door_measurement.observe_passage
    recording = RoomRecording(Room(), turning(-10.0, 10.0, 6))
    passage = observed(place.read_room(LEFT), place.read_room(RIGHT), recording, NoProgress())
    seen = next(pose for pose in passage.a if pose is not None)
    fewer = replace(seen, points=seen.points[:15])
    in_both = replace(passage, a=[seen] * 2 + [seen, None, seen, None], b=[fewer] * 2 + [None, fewer, None, fewer])
    monkeypatch.setattr(door_measurement, "observe_passage", lambda *_: in_both)
    refuses_data(lambda: measured(place, recording), Path("room"), "begins in both", "through the door")
    stays = replace(passage, a=[seen] * 6, b=[fewer] * 3 + [None] * 3)
    monkeypatch.setattr(door_measurement, "observe_passage", lambda *_: stays)
    refuses_data(lambda: measured(place, recording), Path("room"), "does not go from room left", "through the door")


def test_walks_that_contradict_each_other_are_no_door(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    observed = door_measurement.observe_passage

    def moved(*given: object) -> object:
        passage = observed(*given)  # type: ignore[arg-type]
        for index, pose in enumerate(passage.b):
            if pose is not None:
                pose.pose[0, 3] += 0.5 * index
        return passage

    monkeypatch.setattr(door_measurement, "observe_passage", moved)
    recording = RoomRecording(Room(), turning(-15.0, 15.0, 6))
    refuses_data(lambda: measured(place, recording), Path("room"), "contradicts itself", "through the door")


def test_rooms_of_one_world_are_joined_where_they_were_recorded(folder: Path, place: Place) -> None:
    left = read_bundle(folder / "left.monoloc")
    found = same_world_door((LEFT, OTHER), (left, read_bundle(folder / "other.monoloc")))
    np.testing.assert_allclose(found.door.T_a_b, np.eye(4), atol=1e-12)
    poses = left.reference_poses.poses + np.pad([[9.0], [0.0], [0.0], [0.0]], ((0, 0), (3, 0)))
    away = replace(left, reference_poses=ReferencePoses.without_bias(poses))
    refuses_setting(lambda: same_world_door((LEFT, OTHER), (left, away)), "--same-world", "m apart", "record a walk")
    assert np.linalg.norm(found.door.centre_in(LEFT) - (0.0, 0.0, -0.8)) < 0.4


@pytest.mark.slow
def test_commands(
    capfd: Capture, folder: Path, place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (LEFT, RIGHT, OTHER):
        shutil.copytree(folder / f"{name}.monoloc", f"{name}.monoloc")
    write_recording(Path("door"), RoomRecording(Room(), turning(-25.0, 25.0, 7)))
    write_recording(Path("walk"), RoomRecording(Room(), turning(-46.0, 46.0, 20)))
    made = json_of(capfd, "place", "new", "house.place", "left.monoloc", "right.monoloc", "other.monoloc")
    assert made["rooms"] == [LEFT, RIGHT, OTHER]
    door = json_of(capfd, "place", "door", "house.place", LEFT, RIGHT, "door")
    assert door["by"] == "landmarks" and door["a"] == LEFT
    info = json_of(capfd, "place", "info", "house.place")
    assert [room["doors_to"] for room in info["rooms"]] == [[RIGHT], [LEFT], []]
    assert all(room["index_bytes"] <= 32_000 for room in info["rooms"])
    run = json_of(capfd, "place", "localize", "house.place", "walk", "--truth-room", LEFT, "--out", "walk.csv")
    assert [switch["after"] for switch in run["switches"]] == [LEFT, RIGHT]
    assert run["compared_frames"] == 17 and run["ate_max_m"] < 0.15
    assert Path("walk.csv").read_text().splitlines()[-1].endswith(f",{RIGHT}")
    refuses_data(
        lambda: read_pose_table(Path("walk.csv")), Path("walk.csv"), "several rooms", "remove the column room"
    )
    assert json.loads(Path("house.place/place.json").read_text())["doors"][0]["b"] == RIGHT
    assert isinstance(read_place("house.place").manifest.doors[0], Door)


def test_commands_refuse_what_they_cannot_do(
    capfd: Capture, place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place.path.parent)
    walk = str(tmp_path / "walk")
    write_recording(Path(walk), RoomRecording(Room(), turning(-5.0, 5.0, 2)))
    unknown = ("place", "door", "all.place", LEFT, "cellar", "door")
    refused(capfd, tmp_path, unknown, "ROOM", "cellar is no room", "name one of left, right, other")
    refused(capfd, tmp_path, ("place", "door", "all.place", LEFT, RIGHT), "SOURCE", "is missing", "name a walk")
    both = ("place", "door", "all.place", LEFT, RIGHT, "door", "--same-world")
    refused(capfd, tmp_path, both, "--same-world", "no meaning with a walk", "give one")
    refused(capfd, tmp_path, ("place", "door", "all.place", LEFT, LEFT, "door"), "ROOM", "twice", "two rooms")
    wrong = ("place", "localize", "all.place", walk, "--out", "walk.txt")
    refused(capfd, tmp_path, wrong, "--out", "would be a table by another name", "NAME.csv")
    wrong = ("place", "localize", "all.place", walk, "--truth-room", "cellar")
    refused(capfd, tmp_path, wrong, "--truth-room", "is no room", "name one of")
