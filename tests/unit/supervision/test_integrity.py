"""The probability that a belief is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.stats import norm

from monoloc.landmarks.landmark_map import FamiliarLandmarks
from monoloc.landmarks.pnp import LandmarkMeasurement
from monoloc.particle_filter.estimate import Estimate
from monoloc.supervision.integrity import LANDMARK_EDGES, Classes, IntegrityModel, IntegrityMonitor

FRAME_S = 1.0 / 15.0
MODEL = IntegrityModel(
    scan=Classes(edges=(0.0, 1.0), right=(0.05, 0.25, 0.7), wrong=(0.7, 0.2, 0.1)),
    landmarks=Classes(edges=LANDMARK_EDGES, right=(0.02, 0.03, 0.05, 0.1, 0.8), wrong=(0.8, 0.1, 0.05, 0.03, 0.02)),
    unseen_share=0.2,
    scan_search_precision=0.9,
    familiar_found=0.6,
    strange_found=0.05,
)
FITS, MISFIT, SILENT = 2.0, -1.0, math.nan
SEEN, ABSENT = LandmarkMeasurement(100, 60), LandmarkMeasurement(100, 0)
TRACKING_BELOW, SUSPECTED = 0.05, 0.5


def familiar(found: int, count: int = 100) -> FamiliarLandmarks:
    return FamiliarLandmarks(np.arange(count), np.arange(count) < found, np.ones(count, np.bool_))


def make_monitor(model: IntegrityModel = MODEL, is_searched: bool = False) -> IntegrityMonitor:
    return IntegrityMonitor(model, is_searched)


def after(
    monitor: IntegrityMonitor,
    seconds: float,
    scan: float = SILENT,
    landmarks: LandmarkMeasurement | None = None,
    odometry_tracked: bool = True,
    image_is_new: bool = True,
    familiar: FamiliarLandmarks | None = None,
) -> float:
    """The probability of a wrong belief after frames that are all alike."""
    for _ in range(round(seconds / FRAME_S)):
        monitor.predict(FRAME_S, odometry_tracked, image_is_new)
        monitor.update(scan, landmarks, familiar)
    return monitor.probability_wrong


# --- Classes ---


def test_classes_are_the_measured_shares() -> None:
    rng = np.random.default_rng(0)
    right, wrong = rng.normal(2.0, 1.0, 4000), rng.normal(0.0, 1.0, 4000)
    classes = Classes.from_values((0.0, 1.0, 2.0), right, wrong)
    assert classes.edges == (0.0, 1.0, 2.0)
    bounds = np.array([-np.inf, 0.0, 1.0, 2.0, np.inf])
    np.testing.assert_allclose(classes.right, np.diff(norm.cdf(bounds - 2.0)), atol=0.02)
    np.testing.assert_allclose(classes.wrong, np.diff(norm.cdf(bounds)), atol=0.02)
    for value, index in ((-5.0, 0), (0.5, 1), (0.99, 1), (1.0, 2), (9.0, 3), (-np.inf, 0)):
        assert classes.likelihoods(value) == (classes.right[index], classes.wrong[index])


def test_no_class_is_impossible() -> None:
    """However few values: the pseudo-count keeps a frame from settling the matter."""
    classes = Classes.from_values((1.0,), [2.0, 2.0], [0.0])
    assert classes.right == pytest.approx((0.5 / 3.0, 2.5 / 3.0)) and classes.wrong == pytest.approx((0.75, 0.25))


def test_single_class_remains_where_wrong_poses_fit_as_well_as_right_ones() -> None:
    values = np.random.default_rng(0).normal(size=200)
    for right, wrong in ((values, values + 0.3), (values, np.full(200, 3.0))):
        classes = Classes.from_values((-1.0, 0.0, 1.0), right, wrong)
        assert classes.likelihoods(-9.0)[0] / classes.likelihoods(-9.0)[1] == pytest.approx(1.0)
        assert classes == Classes()


samples = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40)


@given(samples, samples, st.lists(st.floats(-3.0, 3.0), max_size=6, unique=True).map(sorted))
def test_higher_values_never_speak_less_for_a_right_pose(
    right: list[float], wrong: list[float], edges: list[float]
) -> None:
    classes = Classes.from_values(edges, right, wrong)
    assert set(classes.edges) <= set(edges) and len(classes.right) == len(classes.wrong) == len(classes.edges) + 1
    assert sum(classes.right) == pytest.approx(1.0) and sum(classes.wrong) == pytest.approx(1.0)
    assert min(*classes.right, *classes.wrong) > 0.0
    ratios = np.divide(classes.right, classes.wrong)
    assert np.all(np.diff(ratios) > -1e-9)


def test_edges_between_fits_are_percentiles_of_right_ones() -> None:
    alike = IntegrityModel.scan_classes(np.ones(50), np.zeros(50))
    assert len(alike.edges) <= 1
    apart = IntegrityModel.scan_classes(np.linspace(1.0, 2.0, 101), np.zeros(50))
    assert apart.edges == pytest.approx((1.05, 1.2, 1.5))
    # A value on an edge is above it: of equal fits, none is in the class below.
    assert IntegrityModel.scan_classes([1.0, *np.full(9, 2.0)], np.zeros(10)).likelihoods(2.0)[0] > 0.8
    assert IntegrityModel.landmark_classes([100.0] * 50, [0.0] * 50).edges == LANDMARK_EDGES


# --- The monitor ---


def test_belief_whose_landmarks_are_seen_is_soon_believed() -> None:
    monitor = make_monitor()
    given_start = monitor.probability_wrong
    assert after(monitor, 0.2, landmarks=SEEN) < 0.3 * given_start
    assert after(monitor, 1.0, landmarks=SEEN) < 0.002


def test_scans_that_fit_say_the_same_more_slowly() -> None:
    by_scans, by_landmarks = make_monitor(), make_monitor()
    assert after(by_landmarks, 0.5, landmarks=SEEN) < after(by_scans, 0.5, FITS) < 0.05
    assert after(make_monitor(), 3.0, MISFIT) > SUSPECTED


def test_landmarks_that_are_absent_for_a_second_do_not_end_an_unbroken_chain() -> None:
    """Blur or a dark corner, rather than a displaced camera: odometry followed it all the way."""
    monitor = make_monitor()
    after(monitor, 2.0, landmarks=SEEN)
    assert after(monitor, 1.0, landmarks=ABSENT) < TRACKING_BELOW


def test_given_start_whose_landmarks_are_absent_is_soon_doubted() -> None:
    assert after(make_monitor(), 0.3, landmarks=ABSENT) > TRACKING_BELOW


def test_kidnapped_camera_is_suspected_within_half_a_second() -> None:
    """Odometry breaks once, and goes on elsewhere, where the belief's landmarks are absent."""
    monitor = make_monitor()
    after(monitor, 2.0, FITS, SEEN)
    assert after(monitor, FRAME_S, MISFIT, ABSENT, odometry_tracked=False) > TRACKING_BELOW
    assert after(monitor, 0.4, MISFIT, ABSENT) > 4.0 * TRACKING_BELOW


def test_without_odometry_doubt_grows_and_more_where_it_breaks_on_an_image() -> None:
    still, broken = make_monitor(), make_monitor()
    for monitor in (still, broken):
        after(monitor, 2.0, landmarks=SEEN)
    dark = [after(still, FRAME_S, odometry_tracked=False, image_is_new=False) for _ in range(20)]
    bright = [after(broken, FRAME_S, odometry_tracked=False) for _ in range(20)]
    assert np.all(np.diff(dark) > 0.0) and np.all(np.diff(bright) > 0.0)
    assert dark[0] < 0.03 < 0.09 < bright[0]
    assert dark[-1] == pytest.approx(1.0 - math.exp(-0.3 * 20 * FRAME_S), abs=0.01)
    # A break is seen at the first image that shows something.
    assert after(still, FRAME_S, odometry_tracked=False) > dark[-1] + 0.5 * (1.0 - dark[-1]) * 0.1
    # With odometry, hardly at all.
    monitor = make_monitor()
    after(monitor, 2.0, landmarks=SEEN)
    assert after(monitor, 10.0) < 0.02


@pytest.mark.parametrize("seconds", [5.0, 600.0])
def test_a_belief_is_soon_believed_again_however_long_the_evidence_against_it(seconds: float) -> None:
    monitor = make_monitor()
    assert after(monitor, seconds, MISFIT, ABSENT) > 0.99
    monitor.predict(1e9, odometry_tracked=False, image_is_new=True)
    assert after(monitor, 1.0, FITS, SEEN) < TRACKING_BELOW


def test_frames_without_evidence_or_with_few_landmarks_in_view_change_nothing() -> None:
    monitor = make_monitor()
    before = monitor.probability_wrong
    monitor.update(SILENT, None)
    monitor.update(SILENT, LandmarkMeasurement(29, 0))
    assert monitor.probability_wrong == pytest.approx(before)
    monitor.update(SILENT, LandmarkMeasurement(30, 0))
    assert monitor.probability_wrong > before


def test_room_without_evidence_leaves_the_probability_to_the_motion() -> None:
    monitor = make_monitor(IntegrityModel())
    before = monitor.probability_wrong
    monitor.update(-np.inf, LandmarkMeasurement(100, 0))
    monitor.update(5.0, LandmarkMeasurement(100, 80))
    assert monitor.probability_wrong == pytest.approx(before)


def test_scan_speaks_for_the_pose_where_its_fit_is_as_probable_there_as_at_wrong_poses() -> None:
    monitor = make_monitor()
    assert [monitor.scan_speaks_for_the_pose(value) for value in (-1.0, 0.5, 2.0)] == [False, True, True]
    assert make_monitor(IntegrityModel()).scan_speaks_for_the_pose(-1e9)  # where nothing was measured


def test_landmarks_deny_a_pose_at_which_many_should_be_in_view_and_few_are_found() -> None:
    monitor = make_monitor()
    assert not monitor.landmarks_deny(None)
    for expected, found, denies in ((100, 0, True), (100, 60, False), (29, 0, False), (0, 0, False)):
        assert monitor.landmarks_deny(LandmarkMeasurement(expected, found)) == denies


def test_evidence_counts_by_time_and_not_by_frames() -> None:
    """A camera of ten times the rate gives no more independent observations."""
    fast, slow = make_monitor(), make_monitor()
    for _ in range(20):
        fast.predict(0.01, True, True)
        fast.update(FITS, SEEN)
    for _ in range(2):
        slow.predict(0.1, True, True)
        slow.update(FITS, SEEN)
    assert math.log(fast.probability_wrong) == pytest.approx(math.log(slow.probability_wrong), abs=0.2)


# --- Landmarks that contradict the belief ---


def contradicted(model: IntegrityModel = MODEL) -> IntegrityMonitor:
    """A belief that was vouched for, at the frame whose landmarks exclude it."""
    monitor = make_monitor(model)
    after(monitor, 2.0, FITS, SEEN)
    monitor.contradicted_by_landmarks()
    return monitor


def test_landmarks_that_contradict_what_was_vouched_for_are_not_believed_at_once() -> None:
    """A bookcase that was moved: its landmarks agree on one pose, and most of the others are missing."""
    monitor = contradicted()
    assert TRACKING_BELOW < monitor.probability_wrong < SUSPECTED
    assert after(monitor, 1.0, landmarks=SEEN, familiar=familiar(25)) > 4.0 * TRACKING_BELOW
    # They are believed if they go on agreeing for long, ...
    assert after(monitor, 12.0, landmarks=SEEN, familiar=familiar(25)) < TRACKING_BELOW


def test_they_are_believed_soon_where_nearly_all_familiar_landmarks_are_found() -> None:
    assert after(contradicted(), 0.5, landmarks=SEEN, familiar=familiar(50)) < 0.4 * TRACKING_BELOW
    # Too few to say so, or a room whose familiar landmarks were not measured:
    assert after(contradicted(), 0.5, landmarks=SEEN, familiar=familiar(20, 25)) > TRACKING_BELOW
    unmeasured = contradicted(MODEL.model_copy(update={"familiar_found": 0.0, "strange_found": 0.5}))
    assert after(unmeasured, 0.5, landmarks=SEEN, familiar=familiar(50)) > TRACKING_BELOW


def test_camera_is_suspected_lost_where_the_landmarks_that_contradicted_leave_the_view() -> None:
    monitor = contradicted()
    after(monitor, 0.3, landmarks=SEEN)
    assert after(monitor, 0.5, landmarks=ABSENT) > SUSPECTED
    # The same absence without a contradiction is a new viewpoint, or blur.
    unbroken = make_monitor()
    after(unbroken, 2.3, FITS, SEEN)
    assert after(unbroken, 0.5, landmarks=ABSENT) < TRACKING_BELOW


def test_belief_that_is_doubted_already_may_be_contradicted() -> None:
    monitor = make_monitor()
    after(monitor, 1.0, SILENT, odometry_tracked=False)
    before = monitor.probability_wrong
    assert before > TRACKING_BELOW
    monitor.contradicted_by_landmarks()
    assert monitor.probability_wrong == before


# --- Searches ---


def test_searches_set_the_probability() -> None:
    monitor = make_monitor(is_searched=True)
    assert monitor.probability_wrong == 1.0
    monitor.found_by_landmarks()
    assert 0.0 < monitor.probability_wrong < TRACKING_BELOW
    monitor.lose()
    assert monitor.probability_wrong == 1.0
    monitor.found_by_scan()  # twice, each right in nine of ten
    assert monitor.probability_wrong == pytest.approx(0.01)


frames = st.lists(
    st.tuples(
        st.floats(0.0, 10.0),
        st.booleans(),
        st.booleans(),
        st.sampled_from([FITS, 0.5, MISFIT, SILENT, -np.inf]),
        st.sampled_from([None, SEEN, ABSENT, LandmarkMeasurement(10, 3), LandmarkMeasurement(60, 20)]),
        st.sampled_from([None, familiar(0), familiar(25), familiar(60)]),
        st.booleans(),
    ),
    max_size=60,
)


@given(frames, st.booleans(), st.sampled_from([MODEL, IntegrityModel()]))
def test_probabilities_are_probabilities_after_any_frames(
    given_frames: list[tuple[float, bool, bool, float, LandmarkMeasurement | None, FamiliarLandmarks | None, bool]],
    is_searched: bool,
    model: IntegrityModel,
) -> None:
    monitor = make_monitor(model, is_searched)
    for elapsed_s, odometry_tracked, image_is_new, scan, landmarks, those, is_contradicted in given_frames:
        monitor.predict(elapsed_s, odometry_tracked, image_is_new)
        assert monitor._probabilities.sum() == pytest.approx(1.0)
        if is_contradicted:
            monitor.contradicted_by_landmarks()
        monitor.update(scan, landmarks, those)
        assert monitor._probabilities.sum() == pytest.approx(1.0)
        assert np.all(monitor._probabilities >= 0.0) and 0.0 <= monitor.probability_wrong <= 1.0


@pytest.mark.parametrize("sd_m", [0.0, 0.01, 0.1, 0.15, 0.3, 2.0])
def test_position_is_far_off_where_the_belief_is_wrong_or_wide(sd_m: float) -> None:
    """By the least certain axis."""
    covariance = np.diag([0.2 * sd_m, sd_m, 0.5 * sd_m, 0.1, 0.1, 0.1]) ** 2
    monitor = make_monitor()
    wrong = monitor.probability_wrong
    beyond = 2.0 * norm.sf(0.3, scale=sd_m) if sd_m > 0.0 else 0.0
    far = monitor.probability_far(Estimate(np.eye(4), covariance, 0.0))
    assert far == pytest.approx(wrong + (1.0 - wrong) * beyond, abs=1e-12)


def test_position_is_far_off_where_its_covariance_is_negative() -> None:
    covariance = np.diag([-1.0, -1.0, -1.0, 1e-4, 1e-4, 1e-4])
    with np.errstate(invalid="ignore"):
        assert make_monitor().probability_far(Estimate(np.eye(4), covariance, 0.0)) == 1.0


def test_doubt_widens_the_covariance_by_its_probability() -> None:
    belief = Estimate(np.eye(4), np.diag([1e-4, 4e-4, 9e-4, 1e-4, 1e-4, 1e-4]), 0.1)
    monitor = make_monitor(is_searched=True)
    monitor.found_by_landmarks()
    for _ in range(2):
        doubtful = monitor.with_doubt(belief)
        added = doubtful.covariance - belief.covariance
        # The second moment of an error of 0.7 m, and of one of 0.7 radians, in any direction.
        assert np.trace(added[:3, :3]) == pytest.approx(monitor.probability_wrong * 0.7**2)
        np.testing.assert_allclose(added, added[0, 0] * np.eye(6), atol=1e-15)
        assert doubtful.pose is belief.pose and doubtful.log_scale == belief.log_scale
        monitor.lose()


@pytest.mark.parametrize(
    ("edges", "right", "wrong", "problem"),
    [
        ((0.0,), (1.0,), (0.5, 0.5), "one probability more"),
        ((0.0,), (1.0, 0.0), (0.5, 0.5), "must be positive"),
        ((0.0,), (0.5, 0.5), (1.5, -0.5), "must be positive"),
        ((1.0, 0.0), (0.2, 0.3, 0.5), (0.2, 0.3, 0.5), "edges ascending"),
    ],
)
def test_probabilities_that_are_none_are_refused(
    edges: tuple[float, ...], right: tuple[float, ...], wrong: tuple[float, ...], problem: str
) -> None:
    with pytest.raises(ValidationError, match=problem):
        Classes(edges=edges, right=right, wrong=wrong)
