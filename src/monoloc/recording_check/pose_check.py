"""Whether a recording's poses agree with its images and depth, and if not, what they would agree as."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, so3_log
from monoloc.io.images import ImageRecording
from monoloc.io.pose_fixes import AXES
from monoloc.io.recording import Recording, Selection
from monoloc.io.upright import Turned
from monoloc.recording_check.correspondences import PAIRS
from monoloc.recording_check.evidence import Evidence, gather_evidence, other_readings
from monoloc.recording_check.factors import Factor, fit_depth_scale, fit_focal, fit_image_size
from monoloc.recording_check.pose_hypotheses import as_stated, conventions, delays
from monoloc.recording_check.pose_jumps import PoseJump, find_jumps

# Median error, share of the corners' motion. On RedKitchen (0:200), whose poses have 2 cm of noise, it is 0.07, on
# the desk (0:350) 0.08; later parts of both have up to 0.14. There, wrong conventions gave 0.48 and more, poses one
# frame late 0.17 and 0.22, a focal length or depth 20 % off 0.12 to 0.22, and independent noise of 2 cm and 1 degree
# over the whole recordings 0.45 and 0.90.
_MANY_TIMES = 10.0  # share from which it is written as a factor
_RIGHT = 0.12  # with at most this, no other reading is tried
_FITS = 0.15  # a hypothesis must come to this,
_IMPROVEMENT = 0.6  # and to this share of the stated poses' error
_POOR = 0.25  # without an explanation, a larger error gives a warning
_HOPELESS = 0.5  # as large as that of wrong conventions
# Correlation of the motions by the poses with those by the corners. Right poses gave 0.87 and more, noise of 2 cm and
# 1 degree 0.49 and more; of 46 wrong camera axes and directions, at most one in a room came to 0.4 in both.
_RELATED = 0.4
_CLEAR = 0.35  # a convention that brings the error so far down needs no comparison with fitted factors
_TIE = 1.15  # hypotheses within this factor of the best are equal, and the simplest is named
_EXACT_POSES = 0.05  # smaller errors are equal too
_LEAST_PAIRS = 8

REFINE = "--refine-poses may help"
"""What a build can do about noisy poses."""

_COMMON_SCALES = (1.0, 100.0, 256.0, 1000.0, 4000.0, 5000.0, 6553.5, 10000.0)
_SAME = 0.04  # relative difference of an estimated factor from a common value that it is taken for


@dataclass(frozen=True)
class Explanation:
    """What a recording agrees as.

    Attributes:
        what: "camera axes of OpenGL".
        option: command-line option that applies it.
        parts: number of things that are other than stated.
        share: median error under it, share of the corners' motion.
    """

    what: str
    option: str
    parts: int
    share: float


@dataclass(frozen=True)
class PoseCheck:
    """Agreement of poses with images and depth.

    Attributes:
        verdict: ``unknown`` where too few frames have corners, depth and motion.
        pairs, corners: number of pairs and matches that were compared.
        share: median error of the corners under the poses, share of their motion; None if unknown.
        free_share: the same under the motion that the corners themselves give.
        correlation: of the motions by the poses with those that the corners give, the lower one of rotation and
            translation; None if unknown.
        explanation: what the poses would agree as; None if nothing is found, or nothing is wrong.
        jumps: steps of poses that agree otherwise, which the images contradict.
    """

    verdict: Literal["unknown", "agree", "doubtful", "explained", "disagree"]
    pairs: int
    corners: int
    share: float | None = None
    free_share: float | None = None
    correlation: float | None = None
    explanation: Explanation | None = None
    jumps: tuple[PoseJump, ...] = ()

    @property
    def jump_sentence(self) -> str | None:
        """The largest jump, and what to do about it, for a message; None if there is none."""
        if not self.jumps:
            return None
        largest = max(self.jumps, key=lambda jump: jump.distance_m + jump.angle_rad)
        by = f"{100.0 * largest.distance_m:.0f} cm and {np.rad2deg(largest.angle_rad):.0f} degrees"
        most = "" if len(self.jumps) == 1 else f", the largest of {len(self.jumps)} jumps,"
        found = f"poses jump by {by}{most} from frame {largest.before} to {largest.after}, and the images do not"
        at = largest.position
        return f"{found}; if they go on in another world, give --frames :{at} or {at}:, else leave these frames out"

    @property
    def sentence(self) -> str:
        """The finding, for a message."""
        if self.share is None:
            if self.explanation is not None:
                found = f"by the poses, {self.pairs} pairs of frames see the cloud"
                away = f"{_percent(self.explanation.share)} of their motion away from where they are seen"
                return f"{found}; corners land {away} as {self.explanation.what}"
            seen = f"{self.pairs} pairs of frames show corners that move and whose depth is known"
            return f"poses are not compared with the images: {seen}"
        of = "" if self.share >= _MANY_TIMES else " of"  # "66 times their motion"
        away = f"{_percent(self.share)}{of} their motion away from where they are seen"
        found = f"by poses and depth, corners land {away}"
        if self.explanation is not None:
            return f"{found}, and {_percent(self.explanation.share)} as {self.explanation.what}"
        related = "" if self.correlation is None else f", and motions correlate by {self.correlation:.2f}"
        return f"{found} ({_percent(self.free_share)} by their own motion{related})"

    @property
    def fix(self) -> str:
        if self.explanation is not None:
            return f"give {self.explanation.option}"
        return "check the poses' convention, their times, the depth's scale and the intrinsics"


def check_poses(recording: Recording, cloud: FloatArray | None = None, pairs: int = PAIRS) -> PoseCheck:
    """Compare a recording's poses with its images and depth.

    Args:
        recording: with poses.
        cloud: (N, 3) of the room, world frame, metres, which gives depth where the recording has none.
        pairs: most pairs of frames that are compared.

    Raises:
        DataError: a frame cannot be read.
    """
    if recording.poses is None or not (recording.has_depth or cloud is not None):
        return PoseCheck("unknown", 0, 0)
    return judge(gather_evidence(recording, cloud, pairs))


def judge(evidence: Evidence) -> PoseCheck:
    """As :func:`check_poses`, of corners that are matched already."""
    stated = as_stated(evidence)
    corners = len(evidence.matches.pair)
    if stated.pairs < _LEAST_PAIRS and not _enough_otherwise(evidence):
        explanation = _of_unseen_cloud(evidence)
        return PoseCheck("explained" if explanation else "unknown", stated.pairs, corners, explanation=explanation)
    share = stated.median
    depth_m = evidence.depth_m(evidence.poses)
    free_motion = evidence.reproject.free_motion(depth_m)
    free = evidence.reproject(free_motion, depth_m)
    correlation = _correlation(evidence.relative(evidence.poses), free_motion)
    check = PoseCheck("agree", stated.pairs, corners, share, free.median if free.pairs else None, correlation)
    check = _with_verdict(check, evidence)
    return replace(check, jumps=tuple(find_jumps(evidence))) if check.verdict == "agree" else check


def _with_verdict(check: PoseCheck, evidence: Evidence) -> PoseCheck:
    share, correlation = check.share, check.correlation
    assert share is not None
    if share <= _RIGHT:
        return check
    explanation = _explain(evidence, share)
    if explanation is not None:
        return replace(check, verdict="explained", explanation=explanation)
    if share > _HOPELESS and (correlation is None or correlation < _RELATED):
        return replace(check, verdict="disagree")
    return replace(check, verdict="doubtful") if share > _POOR else check


def _correlation(stated: FloatArray, free: FloatArray) -> float | None:
    """Lower correlation of turns and of translations of relative poses (N, 4, 4); None if few are known."""
    known = np.isfinite(free).all(axis=(1, 2))
    if known.sum() < _LEAST_PAIRS:
        return None
    stated, free = stated[known], free[known]
    vectors = [(T[:, :3, 3], so3_log(T[:, :3, :3])) for T in (stated, free)]
    return min(_alike(a, b) for a, b in zip(*vectors, strict=True))


def _alike(a: FloatArray, b: FloatArray) -> float:
    """Correlation of vectors (N, 3); 0 if one side is all zero, as placeholders for poses are."""
    length = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / length if length > 0.0 else 0.0


def require_agreement(name: str, check: PoseCheck, poses_are_refined: bool, if_poor: str = REFINE) -> list[str]:
    """Warnings of a check before a recording becomes a part of a map.

    Args:
        name: of the recording.
        check: of it.
        poses_are_refined: whether the build aligns noisy poses with the map.
        if_poor: what to do about noisy poses.

    Raises:
        DataError: another reading of the recording agrees, or the poses have nothing to do with the images.
    """
    if check.verdict == "explained" or (check.verdict == "disagree" and not poses_are_refined):
        raise DataError(name, f"poses and images disagree: {check.sentence}", check.fix)
    if check.verdict in ("doubtful", "disagree") and not poses_are_refined:
        return [f"poses fit the images poorly: {check.sentence}; {if_poor}"]
    return [] if check.jump_sentence is None else [check.jump_sentence]


def _explain(evidence: Evidence, share: float) -> Explanation | None:
    """The simplest of the best explanations; None if none brings the error down to that of a right recording."""
    evidence = evidence.for_search()
    readings = other_readings(evidence)
    exact = [*_exact(evidence), *(_by_reading(reading) for reading in readings)]
    plain = _best(exact, _CLEAR * share)
    if plain is not None:
        return plain
    stages: tuple[Iterable[Explanation], ...] = (
        (*exact, *_fitted(evidence)),
        (explanation for reading in readings for explanation in _exact(reading)),
        _in_another_scale(evidence),
    )
    found = (_best(list(explanations), _IMPROVEMENT * share) for explanations in stages)
    return next((explanation for explanation in found if explanation is not None), None)


def _of_unseen_cloud(evidence: Evidence) -> Explanation | None:
    """A convention by which poses that see nothing of the cloud do see it, and agree; None if there is none."""
    if evidence.recording.has_depth or len(evidence.matches) < _LEAST_PAIRS:
        return None
    return _best(list(_exact(evidence.for_search())), float("inf"))


def _best(explanations: list[Explanation], most: float) -> Explanation | None:
    """The simplest of those that are about as good as the best, if their error is that of a right recording."""
    fitting = [each for each in explanations if each.share <= min(_FITS, most)]
    if not fitting:
        return None
    equal = _TIE * max(_EXACT_POSES, min(each.share for each in fitting))
    return min((each for each in fitting if each.share <= equal), key=lambda each: (each.parts, each.share))


def _exact(evidence: Evidence) -> Iterator[Explanation]:
    """Explanations without unknown numbers, by one reading of the depth."""
    for hypothesis in (*conventions(), *(delays() if evidence.recording.has_depth else ())):
        measured = hypothesis.measure(evidence)
        share = measured.median if 2 * measured.pairs >= min(_LEAST_PAIRS, len(evidence.matches)) else float("inf")
        yield Explanation(*_joined(evidence, hypothesis.what, hypothesis.option), hypothesis.parts, share)


def _fitted(evidence: Evidence) -> Iterator[Explanation]:
    """Explanations by one factor; they have it as a further part."""
    if evidence.recording.has_depth:
        yield _by_scale(evidence, fit_depth_scale(evidence), "", 2)
    focal = fit_focal(evidence)
    yield Explanation(*_focal_words(evidence, focal), 2, focal.fit.median)
    size = fit_image_size(evidence)
    resized = _resized(evidence.recording.camera, size.value)
    if resized is not None:
        what = f"intrinsics of images {_digits(1.0 / size.value)} times as large{_sd_words(size)}"
        yield Explanation(what, f"--camera {intrinsics_text(resized)}", 3, size.fit.median)


def _by_reading(reading: Evidence) -> Explanation:
    """By another reading of the depth alone."""
    if reading.focal_is_unknown:
        focal = fit_focal(reading)
        return Explanation(*_joined(reading, *_focal_words(reading, focal)), 1, focal.fit.median)
    return Explanation(reading.what, reading.option, 1, as_stated(reading).median)


def _in_another_scale(evidence: Evidence) -> Iterator[Explanation]:
    """Camera axes of another convention together with an unknown scale."""
    if not evidence.recording.has_depth:
        return
    for name, convention in AXES.items():
        yield _by_scale(evidence, fit_depth_scale(evidence, convention.convert), name, 3)


def _by_scale(evidence: Evidence, scale: Factor, axes: str, parts: int) -> Explanation:
    """Depth and poses that differ by a factor; which of the two is wrong, images do not tell."""
    what = f"depth and poses of scales that differ by a factor of {_digits(max(scale.value, 1.0 / scale.value))}"
    of_poses = f"--fix-poses {axes}{',' * bool(axes)}scaled:{_digits(scale.value)}"
    rescaled = depth_scale_option(evidence.recording, scale.value)
    option = f"{of_poses} if the depth is right"
    if rescaled is not None:
        axes_too = f"--fix-poses {axes} " if axes else ""
        option = f"{axes_too}{rescaled} if the poses are right, or {option}"
    if axes:
        what = f"{AXES[axes].what} and {what}"
    return Explanation(*_joined(evidence, what, option), parts, scale.fit.median)


def _focal_words(evidence: Evidence, focal: Factor) -> tuple[str, str]:
    camera = evidence.recording.camera
    what = (
        f"a focal length of {focal.value * camera.focal_px:.0f} px{_sd_words(focal)} instead of {camera.focal_px:.0f}"
    )
    is_other_lens = evidence.matches.camera.distortion != camera.distortion
    return what, f"--camera {intrinsics_text(camera, focal.value)}{',0,0,0,0,0' * is_other_lens}"


def _sd_words(factor: Factor) -> str:
    return f" (to {_percent(factor.log_sd)})" if np.isfinite(factor.log_sd) else ""


def intrinsics_text(camera: Camera, factor: float = 1.0) -> str:
    """Value of ``--camera`` for a camera with its focal lengths multiplied by a factor, without its distortion."""
    values = [camera.width, camera.height, camera.fx * factor, camera.fy * factor, camera.cx, camera.cy]
    return ",".join(f"{value:.5g}" for value in values)


def _resized(camera: Camera, factor: float) -> Camera | None:
    """The camera of images that were resized by a factor, with the stated size; None if it is impossible."""
    cx, cy = (factor * (value + 0.5) - 0.5 for value in (camera.cx, camera.cy))
    try:
        return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor, cx=cx, cy=cy)
    except SettingError:
        return None


def _joined(evidence: Evidence, what: str, option: str) -> tuple[str, str]:
    """What the evidence and a hypothesis change, in one."""
    if not evidence.what:
        return what, option
    if option.startswith("--fix-poses ") and "--fix-poses" in evidence.option:
        return f"{evidence.what}, and {what}", f"{evidence.option},{option.removeprefix('--fix-poses ')}"
    return f"{evidence.what}, and {what}", f"{evidence.option} {option}"


def _enough_otherwise(evidence: Evidence) -> bool:
    """Whether corners have depth if it is read otherwise, although few have as it is stated."""
    return any(as_stated(reading).pairs >= _LEAST_PAIRS for reading in other_readings(evidence))


def depth_scale_option(recording: Recording, factor: float) -> str | None:
    """The option that corrects depth which is a factor too far; None where no stored value of one metre is known."""
    source = recording.source if isinstance(recording, Selection) else recording
    source = source.source if isinstance(source, Turned) else source
    return f"--depth-scale {_common(source.depth_scale * factor):g}" if isinstance(source, ImageRecording) else None


def _common(value: float) -> float:
    """The common depth scale near a value, or the value with three digits."""
    nearest = min(_COMMON_SCALES, key=lambda common: abs(np.log(value / common)))
    return nearest if abs(value / nearest - 1.0) < _SAME else float(_digits(value))


def _digits(value: float) -> str:
    """A value with three significant digits, without an exponent."""
    return f"{float(f'{value:.3g}'):g}"


def _percent(share: float | None) -> str:
    if share is None:
        return "unknown"
    return f"{share:.0%}" if share < _MANY_TIMES else f"{share:.0f} times"
