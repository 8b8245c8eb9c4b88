"""What the localizer says of itself where the camera is displaced, stuck or another than stated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.evaluation.consistency import CHI2_6_QUANTILE_95, consistency
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer import Localizer
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.particles import scatter
from monoloc.progress import NoProgress
from monoloc.relocalization.state_machine import Mode
from monoloc.step import Step
from monoloc.supervision.integrity import IntegrityMonitor
from monoloc.supervision.state import Reason
from synthetic_room import (
    BLACK,
    CAMERA,
    FRAME_S,
    SETTINGS,
    Room,
    RoomRecording,
    depth_from_blue,
    follow,
    make_localizer,
    make_path,
    plausible_integrity,
    poses_of,
    sparse_depth,
)

FRAMES = 90
SOON, SOMETIME = 8, 15  # frames: half a second, and a second


class Flights:
    """Makes localizers that start at a frame of the recording, in a room with landmarks."""

    def __init__(self, mixture: GaussianMixture, thresholds: LikelihoodThresholds, recording: RoomRecording) -> None:
        self.mixture, self.thresholds, self.recording = mixture, thresholds, recording
        built = RoomRecording(Room(), make_path(FRAMES, start_s=0.03)[::3])
        self.landmarks, self.bias, evidence = build_landmarks(built, built.depth, NoProgress())
        shares = {"familiar_found": evidence.familiar_found, "strange_found": evidence.strange_found}
        self.integrity = plausible_integrity(thresholds).model_copy(update=shares)

    def localizer(
        self, first: int = 0, landmarks: Landmarks | None = None, threads: int = 1, **given: Any
    ) -> Localizer:
        start = scatter(self.recording.poses[first], SETTINGS.particles, 0.02, 0.01, 0.0, np.random.default_rng(0))
        settings = SETTINGS.model_copy(update={"landmark_bias": self.bias, "threads": threads})
        known = self.landmarks if landmarks is None else landmarks
        poses = self.recording.poses[::10]
        given = {"integrity": self.integrity} | given
        return make_localizer(
            self.mixture, self.thresholds, start, poses, settings=settings, landmarks=known, **given
        )

    def errors_m(self, steps: list[Step], frames: range) -> FloatArray:
        return pose_errors(poses_of(steps), self.recording.poses[frames]).position_m


@pytest.fixture(scope="module")
def flights(mixture: GaussianMixture, thresholds: LikelihoodThresholds, recording: RoomRecording) -> Flights:
    return Flights(mixture, thresholds, recording)


def states(steps: list[Step]) -> list[str]:
    return [step.state for step in steps]


def test_flight_is_tracking_throughout(flights: Flights) -> None:
    frames = range(30)
    steps = follow(flights.localizer(), flights.recording, frames)
    assert set(states(steps)) == {"tracking"} and all(step.reasons == frozenset() for step in steps)
    assert flights.errors_m(steps, frames).max() < 0.03 and steps[-1].probability_far < 0.001


def test_landmarks_of_two_threads_are_the_same_to_the_last_bit(flights: Flights) -> None:
    """After a kidnap too, where a search and the belief look for landmarks in the same image."""

    def steps(threads: int) -> list[Step]:
        localizer, kidnapped = flights.localizer(threads=threads), range(FRAMES - 1, FRAMES - 1 - SOON, -1)
        return [*follow(localizer, flights.recording, range(8)), *follow(localizer, flights.recording, kidnapped)]

    for one, two in zip(steps(1), steps(2), strict=True):
        np.testing.assert_array_equal(one.estimate.pose, two.estimate.pose)
        np.testing.assert_array_equal(one.estimate.covariance, two.estimate.covariance)
        assert one.state == two.state and (one.landmark_pose is None) is (two.landmark_pose is None)


def test_kidnapped_camera_is_not_tracking_until_landmarks_find_it(flights: Flights) -> None:
    """From one frame to the next, to a place a metre and 40 degrees away, and on from there."""
    localizer = flights.localizer()
    assert follow(localizer, flights.recording, range(11))[-1].state == "tracking"
    frames = range(FRAMES - 1, FRAMES - 1 - SOMETIME, -1)
    steps = follow(localizer, flights.recording, frames)
    errors_m = flights.errors_m(steps, frames)
    assert errors_m[0] > 0.8 and steps[0].state != "tracking" and Reason.NO_ODOMETRY in steps[0].reasons
    is_tracking = np.array(states(steps)) == "tracking"
    assert np.all(errors_m[is_tracking] < 0.03) and is_tracking[-1] and is_tracking.sum() > SOON


def test_wrong_start_is_left_for_what_landmarks_find_twice_before_it_is_suspected(
    flights: Flights, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A metre and 40 degrees away, while the belief is only *uncertain*."""
    monkeypatch.setattr(IntegrityMonitor, "probability_wrong", 0.3)
    frames = range(FRAMES - 1, FRAMES - 1 - SOON, -1)
    steps = follow(flights.localizer(), flights.recording, frames)
    errors_m = flights.errors_m(steps, frames)
    assert set(states(steps)) == {"uncertain"} and errors_m[0] > 0.8 and errors_m[-1] < 0.03
    assert [step.restarted for step in steps].count(True) == 1


def test_kidnapped_camera_is_not_tracking_where_there_are_no_landmarks(flights: Flights) -> None:
    """Nor do scans find it in this room. After a second its covariance allows for the error."""
    integrity = plausible_integrity(flights.thresholds, 0.1)
    localizer = flights.localizer(landmarks=Landmarks.none(), integrity=integrity)
    assert follow(localizer, flights.recording, range(11))[-1].state == "tracking"
    frames = range(FRAMES - 1, FRAMES - 1 - 2 * SOMETIME, -1)
    steps = follow(localizer, flights.recording, frames)
    is_far = flights.errors_m(steps, frames) > 0.3
    assert is_far[:SOON].all() and "tracking" not in np.array(states(steps))[is_far]
    covariances = np.stack([step.estimate.covariance for step in steps])
    stated = consistency(poses_of(steps), flights.recording.poses[frames], covariances)
    assert stated.pose_nees[SOMETIME:].max() <= CHI2_6_QUANTILE_95


def test_landmarks_of_things_that_moved_together_are_not_vouched_for_at_once(flights: Flights) -> None:
    """A quarter of a metre, most of those in view: they agree on one pose, and odometry on another."""
    localizer = flights.localizer()
    assert follow(localizer, flights.recording, range(11))[-1].state == "tracking"
    moved = np.random.default_rng(0).uniform(size=len(flights.landmarks)) < 0.75
    points = flights.landmarks.points + np.float32([0.25, 0.0, 0.0]) * moved[:, None]
    localizer._landmarks = OrbLandmarkLocalizer(replace(flights.landmarks, points=points), CAMERA)
    frames = range(11, 11 + SOON)
    steps = follow(localizer, flights.recording, frames)
    assert flights.errors_m(steps, frames).min() > 0.2 and "tracking" not in states(steps)
    assert Reason.BELIEF_DOUBTFUL in steps[0].reasons


def test_camera_without_a_start_is_found_by_landmarks_alone(flights: Flights) -> None:
    """In its first frame, in a room whose scans do not tell places apart."""
    localizer = make_localizer(
        flights.mixture,
        flights.thresholds,
        None,
        flights.recording.poses[::10],
        settings=SETTINGS.model_copy(update={"landmark_bias": flights.bias}),
        landmarks=flights.landmarks,
        integrity=plausible_integrity(flights.thresholds, 0.1),
    )
    frames = range(40, 45)
    steps = follow(localizer, flights.recording, frames)
    assert set(states(steps)) == {"tracking"} and flights.errors_m(steps, frames).max() < 0.03


def test_covered_camera_without_a_start_is_lost_because_it_searches(flights: Flights) -> None:
    depth = DepthPredictor(depth_from_blue(), CAMERA)
    localizer = make_localizer(flights.mixture, flights.thresholds, None, flights.recording.poses[::10], depth=depth)
    step = localizer.step(BLACK, 0.0)
    assert step.state == "lost" and step.mode is Mode.SEARCHING and step.probability_far == 1.0
    assert {Reason.SEARCHING, Reason.IMAGE_EMPTY} <= step.reasons


def test_stream_that_shows_images_twice_is_no_worse(flights: Flights) -> None:
    """The next image tells the motion of both; without landmarks nothing else would mend a doubt."""
    frames = range(20)
    localizer = flights.localizer(landmarks=Landmarks.none())
    steps = follow(localizer, flights.recording, [frame for frame in frames for _ in range(2)])
    plain = follow(flights.localizer(landmarks=Landmarks.none()), flights.recording, frames)
    assert set(states(steps)) == {"tracking"}
    doubts = [np.array([step.probability_far for step in each]) for each in (steps[::2], plain)]
    assert np.all(doubts[0] <= 1.5 * doubts[1])


def test_frozen_image_is_uncertain_soon_and_then_lost(flights: Flights) -> None:
    """Sensor depth or none; the camera may be anywhere by then. A new image finds it again."""
    localizer = flights.localizer()
    follow(localizer, flights.recording, range(11))
    frozen = follow(localizer, flights.recording, [10] * 30)
    assert all(step.motion is None and len(step.scan) == 0 and step.landmark_pose is None for step in frozen)
    # After 0.2 s; the first repetition may be a stream's.
    assert frozen[0].state == "tracking"
    assert all(step.state != "tracking" and Reason.IMAGE_REPEATED in step.reasons for step in frozen[3:])
    assert set(states(frozen[3:SOON])) == {"uncertain"} and set(states(frozen[20:])) == {"lost"}
    frames = range(30, 30 + SOMETIME)
    thawed = follow(localizer, flights.recording, frames)
    assert set(states(thawed[SOON:])) == {"tracking"} and flights.errors_m(thawed, frames)[SOON:].max() < 0.03


@pytest.mark.parametrize(
    ("factor", "first"),
    [(1.1, 40), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0.8, 0), (1.2, 0), (0.8, 40)))],
)
def test_another_lens_than_stated_is_said(flights: Flights, factor: float, first: int) -> None:
    """Within two seconds; depth and landmarks all fit a pose that is decimetres off."""
    lens = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    count = 30
    flight = RoomRecording(Room(), flights.recording.poses[first : first + count], lens)
    stated = Camera(80, 64, CAMERA.fx / 4.0, CAMERA.fy / 4.0, CAMERA.cx / 4.0, CAMERA.cy / 4.0)
    localizer = flights.localizer(first)
    for index in range(count):
        depth = DepthPrediction(sparse_depth(flight, index).depth_m, stated)
        step = localizer.step(flight.color(index), FRAME_S, depth)
    assert step.state != "tracking" and Reason.CAMERA_MISMATCH in step.reasons


def test_right_lens_that_is_not_the_builds_is_confirmed(flights: Flights) -> None:
    """Until then the covariance allows for a focal length that is a tenth wrong."""
    lens = replace(CAMERA, fx=1.1 * CAMERA.fx, fy=1.1 * CAMERA.fy)
    flight = RoomRecording(Room(), flights.recording.poses[:30], lens)
    localizer = flights.localizer(camera=lens)
    steps = [
        localizer.step(flight.color(index), FRAME_S, DepthPrediction(flight.depth(index), lens))
        for index in range(30)
    ]
    along_axis_m = np.sqrt([step.estimate.covariance[2, 2] for step in steps])
    scene_m = np.median(flight.depth(0))
    assert along_axis_m[0] >= 0.1 * scene_m and along_axis_m[-1] < 0.6 * along_axis_m[0]
    assert steps[0].reasons == {Reason.POSITION_WIDE, Reason.CAMERA_UNCONFIRMED}
    assert steps[-1].state == "tracking"
    assert all(step.changed_region is None for step in steps)


@pytest.mark.parametrize("factor", [0.9, pytest.param(1.1, marks=pytest.mark.slow)])
def test_focal_length_that_is_stated_wrong_is_never_vouched_for(flights: Flights, factor: float) -> None:
    """The pose is 30 cm off from the first frame on: a tenth of the distance to the walls."""
    stated = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    localizer = flights.localizer(camera=stated)
    frames = range(30)
    steps = [
        localizer.step(
            flights.recording.color(index), FRAME_S, DepthPrediction(flights.recording.depth(index), stated)
        )
        for index in frames
    ]
    assert flights.errors_m(steps, frames).min() > 0.2 and set(states(steps)) == {"uncertain"}


@pytest.mark.slow
def test_stated_lens_is_never_doubted(flights: Flights) -> None:
    frames = range(FRAMES)
    steps = follow(flights.localizer(), flights.recording, frames)
    assert all(Reason.CAMERA_MISMATCH not in step.reasons for step in steps)
    assert set(states(steps)) == {"tracking"}


@dataclass(frozen=True)
class RearrangedRoom(Room):
    """One of the boxes stands elsewhere."""

    box: int = 0
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def _boxes(self) -> FloatArray:
        boxes = super()._boxes.copy()
        boxes[self.box] += self.shift_m
        return boxes


def test_moved_furniture_is_a_changed_map_whose_place_is_named(flights: Flights) -> None:
    """A cupboard that stands half a metre to the left and nearer; the pose stays as good as it was."""
    number, shift_m = 1, (-0.5, 0.0, -0.5)
    count = 60
    flight = RoomRecording(RearrangedRoom(box=number, shift_m=shift_m), flights.recording.poses[:count])
    assert flights.integrity.familiar_found > 0.5 and flights.integrity.strange_found < 0.3
    steps = follow(flights.localizer(), flight)
    assert set(states(steps)) == {"tracking", "map-changed"}
    assert flights.errors_m(steps, range(count)).max() < 0.03
    changed = [step for step in steps if step.state == "map-changed"]
    assert len(changed) > 2 * SOMETIME and all(step.reasons == {Reason.MAP_CHANGED} for step in changed)
    lower, upper = Room()._boxes[number]
    regions = [step.changed_region for step in changed]
    assert regions[-1] is not None and np.all(regions[-1].lower < upper) and np.all(regions[-1].upper > lower)
    for region in regions:
        # What the cupboard hides where it stands now is missing too, up to the wall behind it.
        assert (
            region is not None and np.all(region.lower > lower + shift_m - 0.7) and np.all(region.upper < upper + 0.7)
        )
    unchanged = [step for step in steps if step.state == "tracking"]
    assert all(step.changed_region is None and step.reasons == frozenset() for step in unchanged)


@pytest.mark.slow
def test_room_as_it_was_is_hardly_a_changed_map_in_half_the_light(flights: Flights) -> None:
    """Never in its own light, see above."""
    localizer, named = flights.localizer(), 0
    for index in range(FRAMES):
        color = (0.5 * flights.recording.color(index)).astype(np.uint8)
        step = localizer.step(color, FRAME_S, sparse_depth(flights.recording, index))
        assert step.state in {"tracking", "map-changed"}
        named += step.state == "map-changed"
    assert named <= 0.1 * FRAMES
