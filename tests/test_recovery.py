"""A camera that is lost, or whose start is unknown, is looked for in the whole room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as trials
from hypothesis import strategies as st
from monoloc.likelihood.scan_likelihood import Measurement
from scipy.stats import chi2

from monoloc.builder.calibrate import Sample
from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.builder.relocalization_error import measure_relocalization_error
from monoloc.depth.predictor import DepthPrediction
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, make_pose, pose_distance_m, se3_exp, so3_exp
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.likelihood.scan import EMPTY_SCAN, Scan, scan_from_depth, uniform_scan
from monoloc.localizer import LocalizerConfig, Step
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles, scatter
from monoloc.progress import NoProgress
from monoloc.relocalization.search import Search
from monoloc.relocalization.state_machine import RelocalizationStateMachine
from monoloc.supervision.state import LikelihoodThresholds
from synthetic_room import (
    BLACK,
    CAMERA,
    FRAME_RATE_HZ,
    FRAME_S,
    NO_DEPTH,
    SETTINGS,
    Room,
    RoomRecording,
    follow,
    make_localizer,
    poses_of,
    room_mixture,
    sparse_depth,
)

FRAMES = 60
HEALTHY = LikelihoodThresholds(low=1.0, lost=0.0)
SCAN = uniform_scan(np.ones((20, 3), dtype=np.float32))


def errors_m(steps: list[Step], recording: RoomRecording, frames: range):
    return pose_errors(poses_of(steps), recording.poses[frames]).position_m


def states(steps: list[Step]) -> list[str]:
    return [step.state for step in steps]


# The whole way, in a room whose depth is known exactly.


@pytest.mark.parametrize("seed", range(3))
def test_an_unknown_start_is_found_in_the_room(mixture, recording, healthy, seed):
    localizer = make_localizer(mixture, healthy, None, recording.poses[10::15], seed)
    steps = follow(localizer, recording, range(40))
    trial = round(FRAME_RATE_HZ)  # a second, in which nothing is claimed
    assert set(states(steps[:trial])) == {"lost"}
    assert set(states(steps[trial + 1 :])) == {"tracking"}
    assert np.all(errors_m(steps, recording, range(40))[trial + 1 :] < 0.08)
    # Before, the belief is as wide as the viewpoints are spread, and wider than anyone would fly by.
    spreads = [np.sqrt(np.trace(step.estimate.covariance[:3, :3])) for step in steps]
    assert min(spreads[:trial]) > 0.3 and max(spreads[trial + 1 :]) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_was_carried_elsewhere_in_the_dark_is_found(mixture, recording, healthy, seed):
    start = scatter(recording.poses[0], SETTINGS.particles, 0.03, 0.02, 0.0, np.random.default_rng(seed))
    localizer = make_localizer(mixture, healthy, start, recording.poses[::10], seed)
    assert follow(localizer, recording, range(5))[-1].state == "tracking"
    for _ in range(60):
        dark = localizer.step(BLACK, FRAME_S, NO_DEPTH)
    assert dark.state == "lost"
    frames = range(30, FRAMES)  # 0.7 m and 35 degrees from where it was
    steps = follow(localizer, recording, frames)
    assert set(states(steps[:15])) == {"lost"}
    assert steps[-1].state == "tracking"
    assert errors_m(steps, recording, frames)[-1] < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_a_gap_is_as_a_darkness(mixture, recording, healthy, seed):
    """A picture that comes four seconds late tells as little as one after four seconds in the dark."""
    start = scatter(recording.poses[0], SETTINGS.particles, 0.03, 0.02, 0.0, np.random.default_rng(seed))
    localizer = make_localizer(mixture, healthy, start, recording.poses[::10], seed)
    assert follow(localizer, recording, range(5))[-1].state == "tracking"
    late = localizer.step(recording.color(30), 4.0, sparse_depth(recording, 30))
    there = [late, *follow(localizer, recording, range(31, FRAMES))]
    back = range(FRAMES - 1, 29, -1)
    steps = follow(localizer, recording, back)
    assert set(states(there[:15])) == {"lost"}
    assert steps[-1].state == "tracking"
    is_tracked = np.array(states(steps)) == "tracking"
    assert np.all(errors_m(steps, recording, back)[is_tracked] < 0.05)


def test_where_scans_do_not_fit_for_a_second_the_camera_is_looked_for(mixture, recording, healthy):
    wrong = recording.poses[0] @ se3_exp(np.array([1.0, 0.0, 0.5, 0.0, 1.2, 0.0]))
    start = scatter(wrong, SETTINGS.particles, 0.02, 0.01, 0.0, np.random.default_rng(0))
    localizer = make_localizer(mixture, healthy, start, recording.poses[::10])
    steps = follow(localizer, recording, range(FRAMES))
    assert "tracking" not in states(steps[:30])
    assert steps[-1].state == "tracking"
    assert errors_m(steps, recording, range(FRAMES))[-1] < 0.05


class _Says:
    """Stands for a search by scans: the camera is where nobody would think."""

    def __init__(self, wrong) -> None:
        self.wrong, self.asked = Estimate(wrong, np.eye(6), 0.0), 0

    def __call__(self, scan, here, rng):
        self.asked += 1
        return self.wrong, 0.0

    def around(self, found, count, rng):
        return scatter(found.pose, count, 0.01, 0.01, 0.0, rng)


def test_where_landmarks_say_that_the_camera_is_it_is_looked_for_first(recording, healthy):
    """And then confirmed by them a second later; scans are asked where landmarks say nothing."""
    search, rng = _Says(recording.poses[20]), np.random.default_rng(0)
    recovery = RelocalizationStateMachine(search, LikelihoodThresholds(low=-1.0, lost=-2.0), is_lost=True)
    scan = scan_from_depth(sparse_depth(recording, 0), 100, rng)
    particles = scatter(recording.poses[40], 50, 0.01, 0.01, 0.0, rng)
    sighting = LandmarkPose(recording.poses[0], 1e-6 * np.eye(6), np.zeros((80, 3)))
    particles, is_found = recovery.look(particles, scan, 1.0, rng, lambda: sighting)
    assert not is_found and recovery.is_on_trial and search.asked == 0
    assert pose_errors(particles.poses, recording.poses[:1].repeat(50, axis=0)).position_m.max() < 0.1
    asked = []
    recovery.look(particles, scan, 0.5, rng, lambda: asked.append(1))
    assert not asked  # not yet
    particles, is_found = recovery.look(particles, scan, 0.5, rng, lambda: sighting)
    assert is_found and not recovery.is_lost and search.asked == 0
    recovery.lose()
    particles, _ = recovery.look(particles, scan, 1.0, rng, lambda: None)
    assert search.asked == 1
    assert pose_errors(particles.poses, recording.poses[20:21].repeat(50, axis=0)).position_m.max() < 0.1


def test_landmarks_clear_a_camera_that_scans_suspect(recording):
    """Where depth errs, no scan fits, and the camera is where landmarks say; elsewhere it is put on trial."""
    search, rng = _Says(recording.poses[20]), np.random.default_rng(0)
    scan = scan_from_depth(sparse_depth(recording, 0), 100, rng)
    for far, is_cleared in ((0, True), (40, False)):
        recovery = RelocalizationStateMachine(search, LikelihoodThresholds(low=-1.0, lost=-2.0), is_lost=False)
        belief = Estimate(recording.poses[0], 1e-4 * np.eye(6), 0.0)
        for _ in range(2):
            recovery.note(-5.0, belief, 0.6)
        particles = scatter(recording.poses[0], 50, 0.01, 0.01, 0.0, rng)
        place = recording.poses[far] @ se3_exp([0.0, 0.0, 0.0, 0.0, 0.0 if is_cleared else 1.5, 0.0])
        sighting = LandmarkPose(place, 1e-6 * np.eye(6), np.zeros((80, 3)))
        particles, is_found = recovery.look(particles, scan, 0.1, rng, lambda sighting=sighting: sighting)
        assert not is_found and search.asked == 0  # it was not lost: what is believed goes on
        assert recovery.is_lost == recovery.is_on_trial == (not is_cleared)
        near = pose_errors(particles.poses, np.repeat(place[None], 50, axis=0)).position_m
        assert near.max() < 0.1


@pytest.mark.parametrize("log_scale", [0.0, -0.05])
def test_a_camera_whose_depth_is_misjudged_is_found_by_landmarks(mixture, recording, healthy, log_scale):
    """The place is theirs at once; its scan is judged at the scale that the depth asks for."""
    built = RoomRecording(Room(), recording.poses[:60:2])
    landmarks, sighted = build_landmarks(built, built.depth, NoProgress())
    settings = with_found(0.2, 0.1).model_copy(update={"log_scale_sd": 0.05, "sighted": sighted})
    localizer = make_localizer(
        mixture, healthy, None, recording.poses[:60:10], settings=settings, landmarks=landmarks
    )
    steps = []
    for index in range(30, FRAMES):
        exact = sparse_depth(recording, index)
        depth = DepthPrediction(np.exp(log_scale).astype(np.float32) * exact.depth_m, exact.camera)
        steps.append(localizer.step(recording.color(index), FRAME_S, depth))
    told = [index for index, step in enumerate(steps) if step.state != "lost"]
    assert told and told[0] < 20
    assert errors_m(steps, recording, range(30, FRAMES))[told[0] :].max() < 0.02
    # Not as wide as scans would leave it: 20 cm.
    assert np.sqrt(np.trace(steps[told[0]].estimate.covariance[:3, :3])) < 0.05


def test_in_another_room_it_stays_lost(recording, healthy):
    localizer = make_localizer(room_mixture(Room(stretch=1.5)), healthy, None, recording.poses[::10])
    assert set(states(follow(localizer, recording, range(40)))) == {"lost"}


@pytest.mark.parametrize(("viewpoints", "relocalization_sd_m"), [(0, 0.1), (10, 0.6)])
def test_without_a_start_there_has_to_be_a_room_to_find_the_camera_in(
    mixture, recording, healthy, viewpoints, relocalization_sd_m
):
    settings = with_found(relocalization_sd_m, 0.1)
    with pytest.raises(ValueError, match="without a start there has to be a room in which a camera can be found"):
        make_localizer(mixture, healthy, None, recording.poses[:viewpoints], settings=settings)


def test_where_places_are_hard_to_tell_apart_none_is_looked_for(mixture, recording, healthy):
    """After a darkness the particles are on their own then, as they are without viewpoints."""
    start = scatter(recording.poses[0], SETTINGS.particles, 0.03, 0.02, 0.0, np.random.default_rng(0))
    ways = []
    for viewpoints, relocalization_sd_m in ((recording.poses[::10], 0.6), (recording.poses[:0], 0.0)):
        settings = with_found(relocalization_sd_m, 0.1).model_copy(update={"motion": "random-walk"})
        localizer = make_localizer(mixture, healthy, start, viewpoints, settings=settings)
        for _ in range(40):
            localizer.step(BLACK, FRAME_S, NO_DEPTH)
        ways.append([step.located.pose for step in follow(localizer, recording, range(3))])
    np.testing.assert_array_equal(*ways)


@pytest.mark.parametrize("motion", ["visual", "random-walk"])
def test_where_a_camera_was_found_is_as_uncertain_as_was_measured(mixture, recording, healthy, motion):
    settings = with_found(0.2, 0.1).model_copy(update={"motion": motion})
    localizer = make_localizer(mixture, healthy, None, recording.poses[10::15], settings=settings)
    steps = follow(localizer, recording, range(40))
    first = states(steps).index("tracking")
    sd = np.sqrt(np.diag(steps[first].estimate.covariance))
    np.testing.assert_allclose(sd, np.repeat([0.2, 0.1], 3), rtol=0.3)
    # It is forgotten on the way, and not at once.
    next_sd, last_sd = (np.sqrt(np.diag(step.estimate.covariance)) for step in (steps[first + 1], steps[-1]))
    assert np.all(next_sd > 0.8 * sd) and np.all(last_sd < sd)


def test_without_odometry_a_camera_is_found_after_a_long_darkness_too(mixture, recording, healthy):
    """However fast the particles spread in the dark, on trial they are moved by scans."""
    start = scatter(recording.poses[0], SETTINGS.particles, 0.03, 0.02, 0.0, np.random.default_rng(0))
    settings = SETTINGS.model_copy(update={"motion": "random-walk"})
    localizer = make_localizer(mixture, healthy, start, recording.poses[::10], settings=settings)
    for _ in range(5):
        localizer.step(BLACK, 10.0, NO_DEPTH)
    steps = follow(localizer, recording, range(30, FRAMES))
    assert steps[-1].state == "tracking"
    assert errors_m(steps, recording, range(30, FRAMES))[-1] < 0.08


def with_found(relocalization_sd_m: float, relocalization_sd_rad: float) -> LocalizerConfig:
    lasting = SETTINGS.lasting.model_copy(
        update={"relocalization_sd_m": relocalization_sd_m, "relocalization_sd_rad": relocalization_sd_rad}
    )
    return SETTINGS.model_copy(update={"lasting": lasting})


# How far off a camera is found, measured.


class _Astray:
    """Stands for a search: finds each camera off by what is known, and tells cameras by how far off a wall is."""

    def __init__(self, truth: FloatArray, off_m: FloatArray, off_rad: FloatArray) -> None:
        turns = np.outer(off_rad, [0.0, 0.6, 0.8])
        self.truth = truth
        self.found = make_pose(truth[:, :3, :3] @ so3_exp(turns), truth[:, :3, 3] + np.outer(off_m, [0.0, -0.8, 0.6]))
        self.looked_from: dict[int, FloatArray] = {}

    def __call__(self, measurement: Measurement, viewpoints: FloatArray, log_scale_sd: float) -> Callable:
        assert measurement.config == SETTINGS.measurement and log_scale_sd == SETTINGS.log_scale_sd

        def search(scan: Scan, here: Estimate, rng: np.random.Generator) -> tuple[Estimate, float]:
            index = round((float(scan.points[0, 2]) - 1.0) / 0.1)
            assert any(np.array_equal(here.pose, viewpoint) for viewpoint in viewpoints)
            self.looked_from[index] = viewpoints
            return Estimate(self.found[index], np.eye(6), 0.0), 0.0

        return search


def wall(index: int) -> DepthPrediction:
    """What :class:`_Astray` tells cameras by."""
    return DepthPrediction(np.full((16, 20), 1.0 + 0.1 * index, dtype=np.float32), CAMERA.resized(20, 16))


def along_a_line(count: int, step_m: float) -> FloatArray:
    """Poses one step apart, a tenth of which is of rotation."""
    along = np.arange(count) * step_m
    return make_pose(so3_exp(np.outer(0.1 * along, [0.0, 1.0, 0.0])), np.outer(0.9 * along, [1.0, 0.0, 0.0]))


def test_how_far_off_a_camera_is_found_from_elsewhere_is_measured(mixture, monkeypatch):
    """Four errors of five are within what a standard deviation an axis makes of three axes."""
    rng = np.random.default_rng(0)
    viewpoints = along_a_line(101, 0.03)
    off_m, off_rad = rng.uniform(0.1, 0.9, 25), rng.uniform(0.02, 0.2, 25)
    search = _Astray(viewpoints[12:87:3], off_m, off_rad)
    monkeypatch.setattr("monoloc.builder.relocalization_error.Search", search)
    samples = [Sample(index, wall(index), search.truth[index]) for index in range(25)]
    samples.insert(4, Sample(25, NO_DEPTH, viewpoints[0]))
    measured = measure_relocalization_error(mixture, samples, viewpoints, SETTINGS, rng, NoProgress())
    chi = np.sqrt(chi2.ppf(0.8, 3))
    expected = np.percentile(off_m, 80.0) / chi, np.percentile(off_rad, 80.0) / chi
    assert measured == pytest.approx(expected, rel=1e-3)
    assert sorted(search.looked_from) == list(range(25))
    for index, looked_from in search.looked_from.items():
        apart = pose_distance_m(search.truth[index], viewpoints)
        assert apart.min() == 0.0
        np.testing.assert_array_equal(looked_from, viewpoints[apart >= 0.5])


def test_where_no_viewpoint_is_half_a_metre_away_a_camera_is_looked_for_from_the_farthest(mixture, monkeypatch):
    viewpoints = along_a_line(4, 0.11)
    search = _Astray(viewpoints[:1], np.array([0.1]), np.array([0.1]))
    monkeypatch.setattr("monoloc.builder.relocalization_error.Search", search)
    rng = np.random.default_rng(0)
    measure_relocalization_error(
        mixture, [Sample(0, wall(0), viewpoints[0])], viewpoints, SETTINGS, rng, NoProgress()
    )
    np.testing.assert_array_equal(search.looked_from[0], viewpoints[3:])


def test_exact_depth_tells_places_apart_and_scans_of_nothing_nothing(mixture, recording):
    samples = [Sample(index, sparse_depth(recording, index), recording.poses[index]) for index in (3, 13)]
    empty = [Sample(20, NO_DEPTH, recording.poses[20])]
    results = [
        measure_relocalization_error(
            mixture, some, recording.poses[::10], SETTINGS, np.random.default_rng(0), NoProgress()
        )
        for some in (samples, samples + empty)
    ]
    assert results[0] == results[1]
    # Over seeds 0..5: 8 to 13 cm and 0.024 to 0.043.
    assert 0.0 < results[0][0] < 0.2 and 0.0 < results[0][1] < 0.1


# The search.


def test_the_search_finds_where_a_scan_was_taken(mixture, recording):
    measurement = Measurement(mixture, SETTINGS.measurement)
    search = Search(measurement, recording.poses[::10], SETTINGS.log_scale_sd)
    far = Estimate(make_pose(np.eye(3), np.array([0.0, 0.0, -1.5])), np.eye(6), 0.0)
    rng = np.random.default_rng(0)
    for index in (5, 25, 45):
        scan = scan_of(recording, index, rng)
        found, fit = search(scan, far, rng)
        error = pose_errors(found.pose[None], recording.poses[index][None])
        assert error.position_m[0] < 0.3 and error.rotation_rad[0] < 0.2
        there = measurement.mean_log_likelihood(found.pose[None], np.array([found.log_scale]), scan)[0]
        assert fit == pytest.approx(there, abs=1e-4)  # particles that are weighed together share what is looked at
        # The truth fits better than what was found, so among those judged it is what is found.
        true = Estimate(recording.poses[index], np.eye(6), 0.0)
        assert search(scan, true, rng)[0] is true


def scan_of(recording: RoomRecording, index: int, rng: np.random.Generator) -> Scan:
    return scan_from_depth(sparse_depth(recording, index), SETTINGS.scan_points, rng)


@trials(max_examples=30, deadline=None)
@given(count=st.integers(1, 60), spread_m=st.floats(0.0, 3.0), seed=st.integers(0, 1000))
def test_particles_anywhere_are_near_a_viewpoint_and_near_every_viewpoint(count, spread_m, seed):
    rng = np.random.default_rng(seed)
    viewpoints = se3_exp(rng.standard_normal((count, 6)) * np.repeat([spread_m, 0.3 * spread_m], 3))
    anywhere = Search(None, viewpoints, 0.05).anywhere(3000, rng)
    assert len(anywhere) == 3000 and anywhere.weights.sum() == pytest.approx(1.0)
    apart = np.stack([pose_distance_m(pose, anywhere.poses) for pose in viewpoints])
    # Drawn by 20 cm and 10 degrees an axis from viewpoints that are 30 cm from any other at most.
    assert apart.min(axis=0).max() < 6.0 * (0.2 * np.sqrt(3.0) + np.deg2rad(10.0) * np.sqrt(3.0))
    assert apart.min(axis=1).max() < 0.3 + 0.8


# When it is looked for, and when it is believed; by a search whose answers are given.


class _Answers:
    """Stands for a search: one answer after another; an index along x and a fit."""

    def __init__(self, *answers: tuple[float, float]) -> None:
        self.left = list(answers)

    def __call__(self, scan, here, rng):
        x, fit = self.left.pop(0)
        return at(x), fit

    def around(self, found, count, rng):
        return Particles(np.repeat(found.pose[None], count, axis=0), np.zeros(count), np.full(count, -np.log(count)))


def at(x: float, sd_m: float = 0.1) -> Estimate:
    return Estimate(make_pose(np.eye(3), np.array([x, 0.0, 0.0])), np.eye(6) * sd_m**2, 0.0)


def particles_at(x: float) -> Particles:
    return _Answers().around(at(x), 10, None)


def look(
    recovery: RelocalizationStateMachine, x: float, scan: Scan = SCAN, elapsed_s: float = 1.0
) -> tuple[float, bool]:
    particles, is_found = recovery.look(particles_at(x), scan, elapsed_s, np.random.default_rng(0))
    assert len(particles) == 10
    return float(particles.poses[:, 0, 3].mean()), is_found


def test_what_is_found_twice_running_is_believed():
    recovery = RelocalizationStateMachine(_Answers((3.0, 2.0), (3.1, 2.0)), HEALTHY, is_lost=True)
    assert recovery.is_lost and not recovery.is_followed
    assert look(recovery, 0.0) == (3.0, False)
    assert recovery.is_lost and recovery.is_followed
    assert look(recovery, 3.2, elapsed_s=0.5) == (pytest.approx(3.2), False)  # not looked for yet
    assert look(recovery, 3.2, elapsed_s=0.5) == (pytest.approx(3.2), True)
    assert not recovery.is_lost and recovery.is_followed


def test_what_is_found_elsewhere_is_on_trial_anew():
    recovery = RelocalizationStateMachine(_Answers((3.0, 2.0), (5.0, 2.0), (5.0, 2.0)), HEALTHY, is_lost=True)
    assert look(recovery, 0.0) == (3.0, False)
    assert look(recovery, 3.0) == (5.0, False)
    assert recovery.is_lost
    assert look(recovery, 5.0) == (5.0, True)


def test_what_does_not_fit_is_not_followed_and_what_is_doubted_not_believed():
    recovery = RelocalizationStateMachine(
        _Answers((3.0, -0.1), (3.0, 0.1), (3.0, 0.9), (3.0, -0.1), (3.0, 0.1)), HEALTHY, is_lost=True
    )
    assert look(recovery, 0.0) == (0.0, False)
    assert not recovery.is_followed
    assert look(recovery, 0.0) == (3.0, False)
    assert look(recovery, 3.0) == (3.0, False)  # doubted, but followed on
    assert recovery.is_lost and recovery.is_followed
    assert look(recovery, 3.0) == (3.0, False)  # it fits nowhere: the trial is over
    assert recovery.is_lost and not recovery.is_followed
    assert look(recovery, 2.0) == (3.0, False) and recovery.is_followed


def test_a_scan_of_nothing_says_nothing():
    recovery = RelocalizationStateMachine(_Answers((3.0, 2.0)), HEALTHY, is_lost=True)
    assert look(recovery, 0.0, EMPTY_SCAN) == (0.0, False)
    assert look(recovery, 0.0, elapsed_s=0.0) == (3.0, False)  # at the first that shows something


def test_a_camera_is_lost_by_a_wide_belief_and_looked_for_where_scans_do_not_fit_for_a_second():
    recovery = RelocalizationStateMachine(_Answers((3.0, 2.0)), HEALTHY, is_lost=False)
    for fit in (-1.0, np.nan, -1.0, 0.1, -1.0):  # in all a second, but not at a stretch
        recovery.note(fit, at(0.0), 0.4)
        assert look(recovery, 0.0) == (0.0, False)
    recovery.note(-1.0, at(0.0), 0.4)
    assert look(recovery, 0.0) == (0.0, False)
    recovery.note(-1.0, at(0.0), 0.4)
    assert not recovery.is_lost  # its belief is worth what it was, until there is another
    assert look(recovery, 0.0) == (3.0, False)
    assert recovery.is_lost

    recovery = RelocalizationStateMachine(_Answers((3.0, 2.0)), HEALTHY, is_lost=False)
    recovery.note(2.0, at(0.0, sd_m=0.49), 0.1)
    assert not recovery.is_lost
    recovery.note(2.0, at(0.0, sd_m=0.51), 0.1)
    assert recovery.is_lost and not recovery.is_followed
    assert look(recovery, 0.0, elapsed_s=0.0) == (3.0, False)  # at once

    recovery = RelocalizationStateMachine(_Answers((3.0, 2.0)), HEALTHY, is_lost=False)
    recovery.lose()
    assert recovery.is_lost and look(recovery, 0.0, elapsed_s=0.0) == (3.0, False)


def test_where_there_is_nothing_to_look_around_no_camera_is_lost():
    recovery = RelocalizationStateMachine(None, HEALTHY, is_lost=False)
    recovery.note(-9.0, at(0.0, sd_m=5.0), 10.0)
    recovery.lose()
    assert not recovery.is_lost and recovery.is_followed
    assert look(recovery, 0.0) == (0.0, False)
