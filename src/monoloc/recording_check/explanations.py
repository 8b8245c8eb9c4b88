"""What a recording agrees as, where its poses do not agree with its images and depth as it is stated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.io.images import ImageRecording
from monoloc.io.pose_fixes import AXES
from monoloc.io.recording import Recording, selected_from
from monoloc.io.stray_scanner import StrayScannerRecording
from monoloc.io.upright import Turned, quarter_turns_of
from monoloc.recording_check.evidence import Evidence, other_readings
from monoloc.recording_check.factors import Factor, fit_depth_scale, fit_focal, fit_image_size
from monoloc.recording_check.pose_delay import find_small_delay, fit_delay
from monoloc.recording_check.pose_hypotheses import Hypothesis, as_stated, conventions, delays, positions
from monoloc.recording_check.wide_pairs import match_wide

LEAST_PAIRS = 8
"""Pairs of frames, with fewer of which nothing is compared."""

MANY_TIMES = 10.0
"""Share from which it is written as a factor."""

# Of the median error, share of the corners' motion; pose_check.py has what right and wrong recordings gave.
_FITS = 0.15  # a hypothesis must come to this,
_IMPROVEMENT = 0.6  # and to this share of the stated poses' error
_CLEAR = 0.35  # a convention that brings the error so far down needs no comparison with fitted factors
_TIE = 1.15  # hypotheses within this factor of the best are equal, and the simplest is named
_EXACT_POSES = 0.05  # smaller errors are equal too

_COMMON_SCALES = (1.0, 100.0, 256.0, 1000.0, 4000.0, 5000.0, 6553.5, 10000.0)
_NEAREST_M = 0.1  # median of a room's depth; no depth camera sees so near

# Logarithm by which an estimated scale may differ from a common one that it is taken for: within its uncertainty.
_LEAST_SAME, _SAME_SDS, _MOST_SAME = 0.04, 3.0, 0.1


_LEAVE_OUT = "leave out"


@dataclass(frozen=True)
class Explanation:
    """What a recording agrees as.

    Attributes:
        what: "camera axes of OpenGL".
        option: command-line option that applies it, or "leave out ..." of one that was given.
        parts: number of things that are other than stated.
        share: median error under it, share of the corners' motion.
    """

    what: str
    option: str
    parts: int
    share: float

    @property
    def fix(self) -> str:
        return self.option if self.option.startswith(_LEAVE_OUT) else f"give {self.option}"


def explain(evidence: Evidence, share: float) -> Explanation | None:
    """The simplest of the best explanations; None if none brings the error down to that of a right recording."""
    evidence = evidence.for_search()
    readings = other_readings(evidence)
    others = (_by_reading(reading) for reading in readings)
    timed = list(_late_by_a_time(evidence))
    misplaced = (_by_hypothesis(evidence, hypothesis) for hypothesis in positions())
    exact = [*_without_fix(evidence), *_exact(evidence, whole_frames=not timed), *timed, *others, *misplaced]
    plain = _best(exact, _CLEAR * share)
    if plain is not None:
        return plain
    stages: tuple[Iterable[Explanation], ...] = (
        (*exact, *_fitted(evidence)),
        (explanation for reading in readings for explanation in _exact(reading)),
        _in_another_scale(evidence),
        (_by_hypothesis(evidence, each) for each in conventions(many=True, with_units=_may_be_of_a_room(evidence))),
    )
    found = (_best(list(explanations), _IMPROVEMENT * share) for explanations in stages)
    return next((explanation for explanation in found if explanation is not None), None)


def explain_unseen_cloud(evidence: Evidence) -> Explanation | None:
    """A convention by which poses that see nothing of the cloud do see it, and agree; None if there is none."""
    if evidence.recording.has_depth or len(evidence.matches) < LEAST_PAIRS:
        return None
    evidence = evidence.for_search()
    return _best([*_without_fix(evidence), *_exact(evidence)], float("inf"))


def _best(explanations: list[Explanation], most: float) -> Explanation | None:
    """The simplest of those that are about as good as the best, if their error is that of a right recording."""
    fitting = [each for each in explanations if each.share <= min(_FITS, most)]
    if not fitting:
        return None
    equal = _TIE * max(_EXACT_POSES, min(each.share for each in fitting))
    return min((each for each in fitting if each.share <= equal), key=lambda each: (each.parts, each.share))


def _exact(evidence: Evidence, whole_frames: bool = True) -> Iterator[Explanation]:
    """Explanations without unknown numbers, by one reading of the depth, with or without delays."""
    with_delays = whole_frames and evidence.recording.has_depth
    named = conventions(with_units=_may_be_of_a_room(evidence))
    for hypothesis in (*named, *(delays() if with_delays else ())):
        yield _by_hypothesis(evidence, hypothesis)


def _may_be_of_a_room(evidence: Evidence) -> bool:
    """Whether depth is as far as a sensor sees; if it is nearer, it is the depth that has another unit."""
    if not evidence.recording.has_depth:
        return True
    depth_m = evidence.depth_m(evidence.poses)
    known_m = depth_m[depth_m > 0.0]
    return len(known_m) == 0 or float(np.median(known_m)) > _NEAREST_M


def small_delay(evidence: Evidence) -> tuple[str, str] | None:
    """By how much poses that agree are late even so, and the option that undoes it; None if they are not."""
    delay = find_small_delay(evidence)
    return None if delay is None else _joined(evidence, delay.what, delay.option)


def _late_by_a_time(evidence: Evidence) -> Iterator[Explanation]:
    """A delay that is no whole number of frames, if there is one.

    The nearest whole number may fit as well: interpolated poses lose something of an uneven motion.
    """
    delay = fit_delay(evidence, is_small=False)
    if delay is None or delay.is_whole(evidence.frame_interval_s):
        return
    if delay.is_certain and delay.fit.median <= _FITS:
        yield Explanation(*_joined(evidence, delay.what, delay.option), 1, delay.fit.median)


def _by_hypothesis(evidence: Evidence, hypothesis: Hypothesis) -> Explanation:
    measured = hypothesis.measure(evidence)
    share = measured.median if 2 * measured.pairs >= min(LEAST_PAIRS, len(evidence.matches)) else float("inf")
    return Explanation(*_joined(evidence, hypothesis.what, hypothesis.option), hypothesis.parts, share)


def _without_fix(evidence: Evidence) -> Iterator[Explanation]:
    """Poses or depth as they are stored, or poses with another fix in place of the one that was given."""
    as_read = evidence.without_depth_fix()
    if as_read is not None:
        name, depth_stored = as_read
        yield Explanation(
            "the depth is stored", f"{_LEAVE_OUT} --fix-depth {name}", 0, as_stated(depth_stored).median
        )
        stored = depth_stored.without_fix()
        if stored is not None:
            option = f"{_LEAVE_OUT} --fix-depth {name} and --fix-poses {evidence.pose_fix}"
            yield Explanation("poses and depth are stored", option, 1, as_stated(stored).median)
    stored = evidence.without_fix()
    if stored is None:
        return
    yield Explanation("they are stored", f"{_LEAVE_OUT} --fix-poses {evidence.pose_fix}", 0, as_stated(stored).median)
    for other in _exact(stored):
        yield replace(other, option=f"{other.option} in place of {evidence.pose_fix}")


def _fitted(evidence: Evidence) -> Iterator[Explanation]:
    """Explanations by one factor; they have it as a further part."""
    if evidence.recording.has_depth:
        scale = fit_depth_scale(evidence)
        yield _by_scale(evidence, _refined(evidence, scale), "", 2, scale.fit.median)
    focal = fit_focal(evidence)
    yield Explanation(*_focal_words(evidence, focal), 2, focal.fit.median)
    size = fit_image_size(evidence)
    resized = _resized(evidence.recording.camera, size.value)
    if resized is not None:
        what = f"intrinsics of images {_digits(1.0 / size.value)} times as large{_sd_words(size)}"
        yield Explanation(what, f"--camera {_intrinsics_text(evidence, resized)}", 3, size.fit.median)


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
        scale = fit_depth_scale(evidence, convention.convert)
        yield _by_scale(evidence, scale, name, 3, scale.fit.median)


def _refined(evidence: Evidence, scale: Factor) -> Factor:
    """A scale that explains neighbouring frames, by frames farther apart if there are some."""
    wide = match_wide(evidence, scale.value) if scale.fit.median <= _FITS else None
    return scale if wide is None else fit_depth_scale(wide)


def _by_scale(evidence: Evidence, scale: Factor, axes: str, parts: int, share: float) -> Explanation:
    """Depth and poses that differ by a factor; which of the two is wrong, images do not tell."""
    factor = f"{_digits(max(scale.value, 1.0 / scale.value))}{_sd_words(scale)}"
    what = f"depth and poses of scales that differ by a factor of {factor}"
    of_poses = f"--fix-poses {axes}{',' * bool(axes)}scaled:{_digits(scale.value)}"
    rescaled = depth_scale_option(evidence.recording, scale.value, scale.log_sd)
    option = f"{of_poses} if the depth is right"
    if rescaled is not None:
        axes_too = f"--fix-poses {axes} " if axes else ""
        option = f"{axes_too}{rescaled} if the poses are right, or {option}"
    if axes:
        what = f"{AXES[axes].what} and {what}"
    return Explanation(*_joined(evidence, what, option), parts, share)


def _focal_words(evidence: Evidence, focal: Factor) -> tuple[str, str]:
    camera = evidence.recording.camera
    what = (
        f"a focal length of {focal.value * camera.focal_px:.0f} px{_sd_words(focal)} instead of {camera.focal_px:.0f}"
    )
    is_other_lens = evidence.matches.camera.distortion != camera.distortion
    return what, f"--camera {_intrinsics_text(evidence, camera, focal.value)}{',0,0,0,0,0' * is_other_lens}"


def _sd_words(factor: Factor) -> str:
    return f" (to {in_percent(factor.log_sd)})" if np.isfinite(factor.log_sd) else ""


def _intrinsics_text(evidence: Evidence, camera: Camera, factor: float = 1.0) -> str:
    """Value of ``--camera`` for a camera with its focal lengths multiplied by a factor, without its distortion.

    It is that of the stored images, before these were turned upright.
    """
    camera = camera.turned(-quarter_turns_of(evidence.recording))
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
    """What the evidence and a hypothesis change, in one; a fix of the poses comes after one that was given."""
    if evidence.pose_fix:
        option = option.replace("--fix-poses ", f"--fix-poses {evidence.pose_fix},")
    if not evidence.what:
        return what, option
    if option.startswith("--fix-poses ") and "--fix-poses" in evidence.option:
        return f"{evidence.what}, and {what}", f"{evidence.option},{option.removeprefix('--fix-poses ')}"
    return f"{evidence.what}, and {what}", f"{evidence.option} {option}"


def depth_scale_option(recording: Recording, factor: float, log_sd: float = 0.0) -> str | None:
    """The option that corrects depth which is a factor too far; None where no stored value of one metre is known.

    Args:
        recording: with depth.
        factor: stated over true depth.
        log_sd: standard deviation of its logarithm.
    """
    source = selected_from(recording)
    source = source.source if isinstance(source, Turned) else source
    if not isinstance(source, ImageRecording | StrayScannerRecording):
        return None
    value = source.depth_scale * factor
    others = [common for common in _COMMON_SCALES if common != source.depth_scale]
    nearest = min(others, key=lambda common: abs(np.log(value / common)))
    reach = min(_MOST_SAME, max(_LEAST_SAME, _SAME_SDS * log_sd))
    is_common = abs(np.log(value / nearest)) < reach
    return f"--depth-scale {nearest if is_common else float(_digits(value)):g}"


def _digits(value: float) -> str:
    """A value with three significant digits, without an exponent."""
    return f"{float(f'{value:.3g}'):g}"


def in_percent(share: float | None) -> str:
    if share is None:
        return "unknown"
    return f"{share:.0%}" if share < MANY_TIMES else f"{share:.0f} times"
