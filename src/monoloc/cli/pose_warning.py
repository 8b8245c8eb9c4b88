"""Whether errors against a recording's poses would mean anything."""

from __future__ import annotations

from monoloc.cli.common import warn
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.recording_check.pose_check import check_poses
from monoloc.recording_check.world_agreement import agreeing_reading

# In 59 windows of 50 to 500 frames of two rooms, right poses gave no warning with so many pairs of frames, and each
# of 15 conventions, in the kitchen, was named. It takes about a second.
_PAIRS = 14
# Fewer frames decide only by a large error: ten of the kitchen, with right poses, had 14 %, and 6 % at another scale.
_LEAST_FRAMES = 50
_COMPARED = 24  # frames whose poses are compared with estimated ones
_LARGE = 0.25  # share of the corners' motion; wrong conventions gave 0.48 and more


def other_reading(estimated: FloatArray, true: FloatArray, fix: str = "give {}") -> str | None:
    """A sentence that says as what true poses (N, 4, 4) agree with the estimated ones; None if they do, or never do.

    Args:
        fix: what to do, with a place for the option.
    """
    chosen = evenly_spaced(len(estimated), _COMPARED)
    reading = agreeing_reading(estimated[chosen], true[chosen])
    if reading is None:
        return None
    return f"the true poses agree with the estimated ones as {reading.what}; {fix.format(reading.option)}"


def warn_of_poses(recording: Recording) -> None:
    """Print a warning on stderr if poses contradict images and depth, with the option that would fit.

    It is no refusal: images are localised without poses. Other intrinsics are not named here, for with them the poses
    may be right.

    Raises:
        DataError: a frame cannot be read.
    """
    check = check_poses(recording, pairs=_PAIRS)
    is_otherwise = check.explanation is not None and "--fix-" in check.explanation.option
    if is_otherwise or check.verdict == "disagree":
        if len(recording) >= _LEAST_FRAMES or check.share is None or check.share > _LARGE:
            line = f"errors against its poses mean nothing: {check.sentence}; {check.fix}"
        else:
            fix = f"{len(recording)} frames do not decide this; check at least {_LEAST_FRAMES} by: monoloc check"
            line = f"errors against its poses may mean nothing: {check.sentence}; {fix}"
        warn(recording.name, line)
    elif check.jump_sentence is not None:
        warn(recording.name, check.jump_sentence)
