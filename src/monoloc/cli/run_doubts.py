"""What speaks against a run as a whole: another room or camera, errors that its state or covariance excludes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from monoloc.bundle import Bundle
from monoloc.cli.pose_warning import other_reading
from monoloc.evaluation.consistency import consistency
from monoloc.io.corrected import without_pose_fix
from monoloc.io.upright import T_turned_stored
from monoloc.run import Run
from monoloc.supervision.state import VOUCHED_FOR, Reason

_MISMATCH_SHARE = 0.1  # of the frames
_LEAST_COVERAGE = 0.5  # of the errors, by the covariance that states 95 %


def doubts_of(run: Run, metrics: Mapping[str, object], room: Bundle) -> Iterator[str]:
    """Sentences for who localised a recording; none where nothing speaks against it.

    Args:
        metrics: of the run.
    """
    frames = len(run.poses)
    has_landmarks = len(room.landmarks) > 0 and "landmarks" not in run.config.without
    if has_landmarks and frames > 1 and not run.landmark_used.any():  # a search for the first frame does not count
        yield f"no frame shows landmarks of this room; {_why_no_landmarks(run, room)}"
    mismatches = sum(Reason.CAMERA_MISMATCH in reasons for reasons in run.reasons)
    if mismatches >= _MISMATCH_SHARE * frames:
        problem = f"in {mismatches} of {frames} frames, landmarks fit another lens than the camera's"
        yield f"{problem}; check --camera, and that images are neither cropped, resized nor stretched"
    if standing := metrics["standing_share_median"]:
        problem = f"{standing:.0%} of the image stands still in half of the frames or more, and is left out"
        yield f"{problem}; clean the lens, or move the camera away from parts of the drone"
    contradicted = int(run.motion_contradicted.sum())
    if contradicted >= _MISMATCH_SHARE * frames:
        problem = f"in {contradicted} of {frames} frames, the other odometry contradicts the motion that images show"
        yield f"{problem}; check its unit, its --odometry-delay, and how the camera is mounted (--mount)"
    yield from _of_errors(run, metrics)


def _of_errors(run: Run, metrics: Mapping[str, object]) -> Iterator[str]:
    silent, coverage = metrics.get("silent_frames_30cm"), metrics.get("coverage_95")
    is_poor = isinstance(coverage, float) and coverage < _LEAST_COVERAGE
    is_as_stored = without_pose_fix(run.recording) is None
    if run.truth is not None and is_as_stored and (silent or is_poor):
        tracked = np.flatnonzero([state in VOUCHED_FOR for state in run.states])
        T = T_turned_stored(run.recording)  # --fix-poses is of the stored poses
        other = other_reading(run.poses[tracked] @ T, run.truth[tracked] @ T) if len(tracked) else None
        if other is not None:
            yield other
            return
    if silent:
        yield f"{silent} of {len(run.poses)} frames are *tracking* or *map-changed*, and more than 30 cm off"
    if is_poor:
        problem = f"{coverage:.0%} of the errors lie within the stated 95 % ellipsoid"
        yield f"{problem}; {_what_to_use(run)}"


def _why_no_landmarks(run: Run, room: Bundle) -> str:
    asks = "monoloc check BUNDLE SOURCE shows whether it is another room"
    if run.start is not None:
        asks = f"leave out --start, and the room is searched; if that finds nothing, {asks}"
    return f"{asks}; monoloc map edit BUNDLE log shows what was edited" if room.edits else asks


def _what_to_use(run: Run) -> str:
    """Which poses of a run with a poor coverage can be used."""
    first = run.states.index("tracking") if "tracking" in run.states else 0
    if run.start is not None and first and run.truth is not None:
        later = consistency(run.poses[first:], run.truth[first:], run.covariances[first:])
        if later.coverage_95 >= _LEAST_COVERAGE:
            share = f"from frame {first} on, where the camera was found, it is {later.coverage_95:.0%}"
            return f"{share}: --start was wrong, and the poses before are not to be used"
    wrong_start = "" if run.start is None else "leave out --start if it may be wrong, and "
    return f"{wrong_start}do not use these poses, unless the recording's own are of another world than the bundle's"
