"""The particles' word joined with odometry: against a batch solution, and honest where errors are as stated."""

from __future__ import annotations

import numpy as np
import pytest

from map_helpers import motion_of
from monoloc.fusion.bias_filter import BiasAugmentedFilter, BiasAugmentedState
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, adjoint, invert, is_rigid, pose_distance_m, se3_exp, se3_log
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd

LASTING = BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03, sd_growth_m=0.1, sd_growth_rad=0.05)
START_SD = np.repeat([0.1, 0.05], 3)
STEP = se3_exp([0.03, -0.01, 0.05, 0.01, 0.04, -0.02])
ODOMETRY_SD = np.repeat([0.004, 0.003], 3)
SPREAD_SD = np.repeat([0.01, 0.006], 3)
TOGETHER, ODOMETRY_TOGETHER = 2.0, 4.0  # so many times the particles' spread and odometry's noise, see the module


def begun(pose: FloatArray, lasting: BiasModel = LASTING) -> BiasAugmentedState:
    return BiasAugmentedState.begin(Estimate(pose, np.diag(START_SD**2), 0.0), lasting.widths(0.0)[None])


def said(pose: FloatArray) -> Estimate:
    return Estimate(pose, np.diag(SPREAD_SD**2) / TOGETHER**2, 0.0)


def moved(joined: BiasAugmentedState, delta: FloatArray, lasting: BiasModel = LASTING) -> BiasAugmentedState:
    kept = lasting.kept(float(pose_distance_m(np.eye(4), delta[None])[0]))
    return joined.moved(delta, np.diag(ODOMETRY_SD**2), kept, lasting.widths(0.0)[None])


def test_it_is_the_batch_solution_along_a_line() -> None:
    """Without rotation all is linear: the last belief is that of least squares over all poses and biases at once."""
    rng = np.random.default_rng(0)
    frames, along = 12, 0.1
    lasting = BiasModel(sd_at_reference_m=0.05)
    words = along * np.arange(frames) + rng.normal(0.0, 0.06, frames)
    step = np.eye(4)
    step[0, 3] = along
    kept = lasting.kept(along)
    joined = begun(np.eye(4), lasting)
    # Rows of a weighted system in positions and biases.
    rows, values = [], []

    def row(value: float, sd: float, **columns: float) -> None:
        found = np.zeros(2 * frames)
        for name, factor in columns.items():
            found[(0 if name[0] == "x" else frames) + int(name[1:])] = factor / sd
        rows.append(found)
        values.append(value / sd)

    row(0.0, START_SD[0], x0=1.0)
    row(0.0, 0.05, b0=1.0)
    for k in range(frames):
        if k > 0:
            joined = moved(joined, step, lasting)
            row(along, ODOMETRY_SD[0], **{f"x{k}": 1.0, f"x{k - 1}": -1.0})
            row(0.0, 0.05 * np.sqrt(1.0 - kept**2), **{f"b{k}": 1.0, f"b{k - 1}": -kept})
        located = np.eye(4)
        located[0, 3] = words[k]
        joined = joined.told(said(located))
        row(words[k], SPREAD_SD[0], **{f"x{k}": 1.0, f"b{k}": 1.0})
    solution, *_ = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)
    covariance = np.linalg.inv(np.array(rows).T @ np.array(rows))
    last = [frames - 1, 2 * frames - 1]
    np.testing.assert_allclose([joined.pose[0, 3], joined.biases[0, 0]], solution[last], atol=1e-6)
    np.testing.assert_allclose(
        joined.covariance[np.ix_([0, 6], [0, 6])], covariance[np.ix_(last, last)], rtol=1e-4, atol=1e-9
    )


def test_a_wider_bias_moves_the_pose_less() -> None:
    told = said(np.eye(4) @ se3_exp([0.2, 0.0, 0.0, 0.0, 0.1, 0.0]))
    shifts = [
        float(
            np.linalg.norm(
                se3_log(begun(np.eye(4), BiasModel(sd_at_reference_m=sd, sd_at_reference_rad=sd)).told(told).pose)
            )
        )
        for sd in (0.0, 0.05, 0.2, 1.0)
    ]
    assert shifts == sorted(shifts, reverse=True)
    assert shifts[0] == pytest.approx(float(np.linalg.norm(se3_log(told.pose))), rel=0.03)
    assert shifts[-1] < 0.02


def test_particles_that_are_all_one_are_taken_in() -> None:
    """No spread, no bias: a singular covariance, and still a belief."""
    pose = se3_exp([0.1, 0.2, 0.3, 0.1, 0.0, -0.2])
    joined = begun(np.eye(4), BiasModel()).told(Estimate(pose, np.zeros((6, 6)), 0.0))
    np.testing.assert_allclose(joined.pose, pose, atol=1e-6)
    assert np.isfinite(joined.covariance).all() and np.linalg.eigvalsh(joined.covariance)[0] > -1e-15


# --- From frame to frame ---

ELAPSED_S = 1.0 / 15.0


def joiner(viewpoint: FloatArray, lasting: BiasModel = LASTING) -> BiasAugmentedFilter:
    start = Estimate(np.eye(4), np.diag(START_SD**2), 0.0)
    return BiasAugmentedFilter(start, lasting, MotionConfig(), ReferencePoses.of(viewpoint[None]))


def drawn_way(rng: np.random.Generator, steps: FloatArray, lasting: BiasModel) -> tuple[FloatArray, Estimate]:
    """The last true pose of a way from a viewpoint, and the belief, where all errors are drawn as they are stated."""
    viewpoint = true = se3_exp(rng.normal(size=6))
    start = Estimate(true @ se3_exp(-rng.normal(size=6) * START_SD), np.diag(START_SD**2), 0.0)
    follower = BiasAugmentedFilter(start, lasting, MotionConfig(), ReferencePoses.of(viewpoint[None]))
    variances = lasting.widths(0.0) ** 2
    bias = rng.normal(size=6) * np.sqrt(variances)
    for k, step in enumerate([np.eye(4), *steps]):
        apart = float(pose_distance_m(np.eye(4), step[None])[0])
        odometry_sd = ODOMETRY_TOGETHER * motion_sd(motion_of(step), ELAPSED_S, 0.0, MotionConfig())
        true = true @ step @ se3_exp(rng.normal(size=6) * odometry_sd * (k > 0))
        kept = lasting.kept(apart)
        # As wide as is stated, or wider by what is brought along.
        brought, here = kept**2 * variances, lasting.widths(float(pose_distance_m(true, viewpoint[None])[0])) ** 2
        variances = np.maximum(brought + (1.0 - kept**2) * here, here)
        bias = kept * bias + np.sqrt(variances - brought) * rng.normal(size=6)
        told = said(true @ se3_exp(bias) @ se3_exp(rng.normal(size=6) * SPREAD_SD))
        belief = follower.step(motion_of(step) if k > 0 else None, ELAPSED_S, told, is_told=True)
    return true, belief


ALONG = se3_exp([0.04, -0.01, 0.03, 0.002, 0.004, -0.002])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "lasting"),
    [
        ([STEP] * 25, BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03)),
        (
            [ALONG] * 25,
            BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.02, sd_growth_m=0.2, sd_growth_rad=0.1),
        ),
        (
            [ALONG] * 15 + [invert(ALONG)] * 15,
            BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.02, sd_growth_m=0.2),
        ),
    ],
    ids=["as wide everywhere", "away", "away and back"],
)
def test_errors_are_as_large_as_stated(steps: FloatArray, lasting: BiasModel) -> None:
    """Squared errors in units of the covariance have six degrees of freedom; of 200 ways, the mean's sd is 0.25."""
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(200):
        true, belief = drawn_way(rng, steps, lasting)
        assert is_rigid(belief.pose).all()
        error = se3_log(invert(belief.pose) @ true)
        squares.append(error @ np.linalg.solve(belief.covariance, error))
    assert np.mean(squares) == pytest.approx(6.0, abs=0.8)


def test_odometry_goes_as_far_as_depth_is_wrong() -> None:
    """Its translation was measured in predicted depth, which the particles say is too small by a fifth."""
    follower = joiner(np.eye(4))
    follower.step(None, 0.0, Estimate(np.eye(4), np.diag(SPREAD_SD**2), np.log(1.25)), is_told=True)
    belief = follower.step(motion_of(ALONG), ELAPSED_S, said(np.eye(4)), is_told=False)
    np.testing.assert_allclose(belief.pose[:3, 3], 1.25 * ALONG[:3, 3], atol=1e-12)


def test_the_bias_is_that_of_the_nearest_viewpoint_where_the_camera_has_come_to() -> None:
    """Of what the particles say by themselves, which is off by as much as it is wide there."""
    lasting = BiasModel(sd_at_reference_m=0.02, sd_at_reference_rad=0.01, sd_growth_m=0.1, sd_growth_rad=0.05)
    near, far = np.eye(4), se3_exp([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    place = se3_exp([2.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    for viewpoints, begin, apart in (
        (near[None], near, 2.8),
        (far[None], far, 0.2),
        (np.stack([near, far]), near, 0.2),
    ):
        follower = BiasAugmentedFilter(
            Estimate(begin, np.eye(6), 0.0), lasting, MotionConfig(), ReferencePoses.of(viewpoints)
        )
        follower.step(None, 0.0, said(begin), is_told=False)
        belief = follower.step(motion_of(invert(begin) @ place), ELAPSED_S, said(place), is_told=True)
        sd = np.sqrt(np.diag(belief.covariance))
        np.testing.assert_allclose(sd, np.hypot(SPREAD_SD, lasting.widths(apart)), rtol=0.1)


def test_a_viewpoint_s_error_is_taken_off_and_less_of_it_away() -> None:
    lasting = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.03, sd_growth_m=0.1, sd_growth_rad=0.1)
    viewpoint, error = se3_exp([0.5, -1.0, 2.0, 0.3, 0.2, -0.4]), np.array([0.02, -0.03, 0.01, 0.01, 0.02, -0.02])
    known = ReferencePoses(viewpoint[None], error[None], error[None])
    follower = BiasAugmentedFilter(Estimate(viewpoint, np.eye(6), 0.0), lasting, MotionConfig(), known)
    for away_m, share in ((0.0, 1.0), (0.3, 0.5)):
        true = viewpoint @ se3_exp([0.0, away_m, 0.0, 0.0, 0.0, 0.0])
        told = said(true @ se3_exp(share * error))
        corrected = follower.corrected(told)
        # At a distance that it errs by itself, which is at most a few centimetres beside three decimetres.
        np.testing.assert_allclose(corrected.pose, true, atol=0.004)
        assert corrected.covariance is told.covariance and corrected.log_scale == told.log_scale


@pytest.mark.parametrize("has_odometry", [True, False])
@pytest.mark.parametrize("way_m", [0.04, -0.04])
def test_what_is_taken_off_is_of_the_way_that_the_camera_came(way_m: float, has_odometry: bool) -> None:
    """Along twenty viewpoints in order or in reverse, whose errors are opposite."""
    lasting = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.03)
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, 0, 3] = 0.05 * np.arange(20)
    there = np.tile([0.0, 0.02, 0.0, 0.0, 0.0, 0.0], (20, 1))
    follower = BiasAugmentedFilter(said(poses[10]), lasting, MotionConfig(), ReferencePoses(poses, there, -there))
    np.testing.assert_array_equal(follower.corrected(said(poses[10])).pose, poses[10])  # it has not come any way
    step, pose = se3_exp([way_m, 0.0, 0.0, 0.0, 0.0, 0.0]), poses[10]
    for _ in range(8):
        pose = pose @ step
        follower.step(motion_of(step) if has_odometry else None, ELAPSED_S, said(pose), is_told=True)
    off_m = follower.corrected(said(pose)).pose[1, 3]
    assert off_m == pytest.approx(-np.sign(way_m) * 0.02, rel=0.12)


def test_a_jump_of_the_particles_is_no_way() -> None:
    """Neither the first scan's correction of the start, nor to where a lost camera was found."""
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, 0, 3] = 0.05 * np.arange(20)
    there = np.tile([0.0, 0.02, 0.0, 0.0, 0.0, 0.0], (20, 1))
    follower = BiasAugmentedFilter(said(poses[10]), LASTING, MotionConfig(), ReferencePoses(poses, there, -there))
    follower.step(None, 0.0, said(poses[14]), is_told=True)
    np.testing.assert_array_equal(follower.corrected(said(poses[10])).pose, poses[10])
    follower.step(None, ELAPSED_S, said(se3_exp([4.0, 0.0, 0.0, 0.0, 0.0, 0.0])), is_told=True)
    np.testing.assert_array_equal(follower.corrected(said(poses[10])).pose, poses[10])


def test_what_is_foreseen_is_what_comes_of_a_frame_that_tells_nothing() -> None:
    follower = joiner(np.eye(4))
    foreseen = follower.foreseen(2.0)
    np.testing.assert_array_equal(follower.foreseen(2.0).covariance, foreseen.covariance)  # nothing has changed
    belief = follower.step(None, 2.0, said(np.eye(4)), is_told=False)
    np.testing.assert_array_equal(belief.pose, foreseen.pose)
    np.testing.assert_array_equal(belief.covariance, foreseen.covariance)


def test_where_the_camera_was_found_its_rotation_is_as_uncertain_as_that() -> None:
    lasting = BiasModel(
        sd_at_reference_m=0.01, sd_at_reference_rad=0.01, relocalization_sd_m=0.2, relocalization_sd_rad=0.2
    )
    follower, here = joiner(np.eye(4), lasting), said(np.eye(4))
    spread = np.sqrt(here.covariance[3, 3])
    assert follower.rotation_sd(here) == pytest.approx(np.hypot(0.01, spread), rel=1e-6)
    follower.reinitialise(here)
    assert follower.rotation_sd(here) == pytest.approx(np.hypot(0.2, spread), rel=1e-6)


def test_without_odometry_the_bias_is_forgotten_as_far_as_the_particles_went() -> None:
    """What was learnt of it is worth less a metre on."""
    off, biases = se3_exp([0.2, 0.0, 0.0, 0.0, 0.0, 0.0]), []
    for gone_m in (0.0, 1.0):
        follower = joiner(np.eye(4), BiasModel(sd_at_reference_m=0.1, sd_at_reference_rad=0.1))
        for _ in range(8):
            follower.step(motion_of(np.eye(4)), ELAPSED_S, said(off), is_told=True)
        follower.step(None, 0.5, said(off @ se3_exp([gone_m, 0.0, 0.0, 0.0, 0.0, 0.0])), is_told=False)
        biases.append(follower._joined.biases[0, 0])
    assert biases[0] > 0.05 and biases[1] == pytest.approx(LASTING.kept(1.0) * biases[0], rel=1e-6)


def test_the_belief_in_the_dark_is_as_wide_as_an_unknown_velocity_leads_astray() -> None:
    follower, noise = joiner(np.eye(4)), MotionConfig()
    for _ in range(15):
        belief = follower.step(None, ELAPSED_S, said(np.eye(4)), is_told=False)
    expected = np.hypot(START_SD, np.repeat([noise.speed_sd_m_s, noise.turn_sd_rad_s], 3))
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance)), expected, rtol=1e-6)


def test_without_odometry_the_belief_is_the_particles_and_as_wide_as_their_bias() -> None:
    """Far from the viewpoints that is wide, and no start that was off stays in it; it is forgotten on the way."""
    viewpoint, truth = se3_exp([0.0, 2.0, 0.0, 0.0, 0.0, 0.0]), se3_exp([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    follower = joiner(viewpoint)
    follower.step(None, 0.0, said(truth), is_told=True)
    widths = []
    for _ in range(20):  # longer than odometry is waited for
        truth = truth @ STEP
        belief = follower.step(None, ELAPSED_S, said(truth), is_told=True)
        widths.append(LASTING.widths(float(pose_distance_m(truth, viewpoint[None])[0])))
    np.testing.assert_allclose(belief.pose, truth, atol=1e-12)
    variances = np.diag(belief.covariance) - SPREAD_SD**2
    np.testing.assert_allclose(belief.covariance, np.diag(np.diag(belief.covariance)), atol=1e-12)
    assert np.all(variances >= 0.999 * widths[-1] ** 2) and np.all(variances <= 1.001 * np.max(widths, axis=0) ** 2)


def test_a_frame_without_odometry_loses_no_bias() -> None:
    """Of particles that err by 8 cm since the camera left the build's viewpoints, which odometry has told."""
    step = se3_exp([0.015, -0.005, 0.018, 0.003, 0.01, -0.005])  # 0.36 m/s
    motion = motion_of(step)
    off = se3_exp([0.08, 0.0, 0.0, 0.0, 0.0, 0.0])
    beliefs = []
    for dropped in ((), (15,), (15, 20, 21, 22)):
        follower, truth = joiner(np.eye(4), BiasModel(sd_at_reference_m=0.01, sd_growth_m=0.1)), np.eye(4)
        follower.step(None, 0.0, said(truth), is_told=True)
        for frame in range(25):
            truth = truth @ step
            told = None if frame in dropped else motion
            belief = follower.step(told, ELAPSED_S, said(truth if frame < 8 else truth @ off), is_told=True)
        beliefs.append(np.linalg.norm(belief.pose[:3, 3] - truth[:3, 3]))
    assert beliefs == pytest.approx([beliefs[0]] * 3, abs=0.01) and beliefs[0] < 0.06


def test_batch_solution_after_the_particles_word_alone() -> None:
    """A word whose bias is unknown, then perfect odometry and the same bias: of that, nothing new is learnt."""
    lasting = BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03)
    here = lasting.widths(0.0)[None]
    alone = BiasAugmentedState.alone(said(np.eye(4)), here)
    again = alone.moved(np.eye(4), np.zeros((6, 6)), 1.0, here).told(said(np.eye(4)))
    widths = np.sqrt(np.diag(again.covariance))
    np.testing.assert_allclose(widths[6:], here[0], rtol=1e-6)
    np.testing.assert_allclose(widths[:6], np.hypot(SPREAD_SD / np.sqrt(2.0), here[0]), rtol=1e-4)


SIGHTED = BiasModel(sd_at_reference_m=0.01, sd_at_reference_rad=0.006)


def seen(pose: FloatArray) -> LandmarkPose:
    return LandmarkPose(pose, np.diag((SPREAD_SD / TOGETHER) ** 2), np.zeros((50, 3)))


@pytest.mark.slow
def test_errors_are_as_large_as_stated_with_landmarks_too() -> None:
    """As above; landmarks have a bias of their own, and are seen in every other frame."""
    rng = np.random.default_rng(2)
    squares, alone = [], []
    for _ in range(200):
        viewpoint = true = se3_exp(rng.normal(size=6))
        start = Estimate(true @ se3_exp(-rng.normal(size=6) * START_SD), np.diag(START_SD**2), 0.0)
        follower = BiasAugmentedFilter(start, LASTING, MotionConfig(), ReferencePoses.of(viewpoint[None]), SIGHTED)
        widths = np.stack([lasting.widths(0.0) for lasting in (LASTING, SIGHTED)])
        biases = rng.normal(size=(2, 6)) * widths
        for frame in range(20):
            odometry_sd = ODOMETRY_TOGETHER * motion_sd(motion_of(np.eye(4)), ELAPSED_S, 0.0, MotionConfig())
            true = true @ se3_exp(rng.normal(size=6) * odometry_sd * (frame > 0))
            told, sighted = (true @ se3_exp(bias) @ se3_exp(rng.normal(size=6) * SPREAD_SD) for bias in biases)
            belief = follower.step(motion_of(np.eye(4)) if frame else None, ELAPSED_S, said(told), is_told=True)
            if frame % 2 == 0:
                belief = follower.sighted(seen(sighted))
        error = se3_log(invert(belief.pose) @ true)
        squares.append(error @ np.linalg.solve(belief.covariance, error))
        alone.append(np.linalg.norm(error[:3]))
    assert np.mean(squares) == pytest.approx(6.0, abs=0.9)
    assert np.median(alone) < 0.02  # of landmarks' bias, where the particles' is five times as wide


def test_landmarks_teach_what_the_particles_err_by() -> None:
    """Where none is seen any more, the particles' word is corrected by what was learnt while some were."""
    off = se3_exp([0.08, 0.0, -0.05, 0.0, 0.04, 0.0])
    ends = {}
    for frames in (0, 10):
        start = Estimate(np.eye(4), np.diag(START_SD**2), 0.0)
        follower = BiasAugmentedFilter(start, LASTING, MotionConfig(), ReferencePoses.of(np.eye(4)[None]), SIGHTED)
        for frame in range(60):
            belief = follower.step(motion_of(np.eye(4)), ELAPSED_S, said(off), is_told=True)
            if frame < frames:
                belief = follower.sighted(seen(np.eye(4)))
        ends[frames] = np.linalg.norm(belief.pose[:3, 3])
    assert ends[10] < 0.03 < 0.05 < ends[0]


def test_the_particles_word_alone_says_nothing_of_landmarks() -> None:
    """Whose bias is fresh and independent; what they say then is weighed against it."""
    widths = np.stack([LASTING.widths(0.0), SIGHTED.widths(0.0)])
    alone = BiasAugmentedState.alone(said(np.eye(4)), widths)
    np.testing.assert_array_equal(alone.covariance[:12, 12:], 0.0)
    np.testing.assert_allclose(np.sqrt(np.diag(alone.covariance)[6:]), widths.ravel())
    off = 0.04
    told = alone.sighted(seen(se3_exp([off, 0.0, 0.0, 0.0, 0.0, 0.0])))
    own, other = SPREAD_SD[0] ** 2 + widths[0, 0] ** 2, SPREAD_SD[0] ** 2 + widths[1, 0] ** 2
    assert told.pose[0, 3] == pytest.approx(off * own / (own + other), rel=1e-3)
    # What the particles were off by is now known to be the other way.
    assert told.biases[0, 0] == pytest.approx(-off * widths[0, 0] ** 2 / (own + other), rel=1e-3)


def test_a_sighting_that_cannot_be_hardly_counts() -> None:
    """A metre off a belief of centimetres; but one that says so again and again is believed in the end."""
    follower = BiasAugmentedFilter(
        said(np.eye(4)), LASTING, MotionConfig(), ReferencePoses.of(np.eye(4)[None]), SIGHTED
    )
    wrong = se3_exp([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    follower.step(None, 0.0, said(np.eye(4)), is_told=True)
    once = follower.sighted(seen(wrong))
    assert np.linalg.norm(once.pose[:3, 3]) < 0.1
    for _ in range(100):
        follower.step(motion_of(np.eye(4)), ELAPSED_S, said(wrong), is_told=True)
        again = follower.sighted(seen(wrong))
    assert np.linalg.norm(again.pose[:3, 3] - wrong[:3, 3]) < 0.15


def test_without_odometry_what_landmarks_said_is_kept() -> None:
    """They are something to join the particles with: their word alone is not taken after that."""
    off = se3_exp([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    follower = BiasAugmentedFilter(
        said(np.eye(4)), LASTING, MotionConfig(), ReferencePoses.of(np.eye(4)[None]), SIGHTED
    )
    for frame in range(60):
        belief = follower.step(None, ELAPSED_S, said(off), is_told=True)
        if frame % 3 == 0:
            follower.sighted(seen(np.eye(4)))
    assert np.linalg.norm(belief.pose[:3, 3]) < 0.05


def test_a_camera_that_landmarks_tell_is_not_blind() -> None:
    follower = joiner(np.eye(4))
    follower.step(None, ELAPSED_S, said(np.eye(4)), is_told=False)
    assert follower.time_since_update_s == ELAPSED_S
    follower.sighted(seen(np.eye(4)))
    assert follower.time_since_update_s == 0.0


def test_a_frame_that_tells_nothing_narrows_nothing() -> None:
    """In darkness the particles go on as odometry does: to hear them then would be to hear the old again."""
    motion = motion_of(STEP)
    deaf, hearing = joiner(np.eye(4)), joiner(np.eye(4))
    pose = np.eye(4)
    widths = []
    for _ in range(20):
        pose = pose @ STEP
        for follower, is_told in ((deaf, False), (hearing, True)):
            belief = follower.step(motion, ELAPSED_S, said(pose), is_told)
            widths.append(float(belief.covariance[0, 0]))
    np.testing.assert_allclose(deaf.step(None, ELAPSED_S, said(np.eye(4)), False).pose, pose, atol=1e-12)
    assert deaf.time_since_update_s == ELAPSED_S and hearing.time_since_update_s == 0.0
    assert widths[0::2] == sorted(widths[0::2])
    assert widths[-1] < widths[-2]


@pytest.mark.parametrize("seed", range(3))
def test_adjoint_carries_a_twist_to_the_other_side(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, twists = se3_exp(rng.normal(size=(4, 6))), 0.3 * rng.normal(size=(4, 6))
    carried = np.einsum("nij,nj->ni", adjoint(poses), twists)
    np.testing.assert_allclose(poses @ se3_exp(twists), se3_exp(carried) @ poses, atol=1e-12)
