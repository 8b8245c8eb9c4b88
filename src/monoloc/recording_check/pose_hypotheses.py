"""What the poses of a recording may be, other than ``T_world_camera`` in metres with OpenCV's axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

from monoloc.geometry import FloatArray
from monoloc.io.pose_fixes import AXES, DIRECTIONS, QUATERNIONS, UNITS, Convention
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.reprojection import Reprojection

_MOST_LATE = 10  # frames
_FEW = 2  # conventions that are wrong together more often than more of them


@dataclass(frozen=True)
class Hypothesis:
    """One way to read the poses.

    Attributes:
        what: for messages: "the poses fit as ...".
        option: command-line option that applies it.
        parts: number of things that are other than stated; the simplest of equal hypotheses is named.
        measure: errors of the evidence under it.
    """

    what: str
    option: str
    parts: int
    measure: Callable[[Evidence], Reprojection]


def as_stated(evidence: Evidence) -> Reprojection:
    """Errors of the poses as they are stated."""
    return evidence.reproject(evidence.relative(evidence.poses), evidence.depth_m(evidence.poses))


def conventions(many: bool = False) -> Iterator[Hypothesis]:
    """Single conventions and pairs of them, or three and more at once, in the order in which they are undone."""
    groups = (QUATERNIONS, DIRECTIONS, AXES, UNITS)
    choices: list[list[tuple[str, Convention | None]]] = [[("", None), *group.items()] for group in groups]
    for combination in product(*choices):
        chosen = {name: convention for name, convention in combination if convention is not None}
        if chosen and (len(chosen) > _FEW) == many:
            yield _as_conventions(chosen)


def _as_conventions(chosen: dict[str, Convention]) -> Hypothesis:
    def measure(evidence: Evidence) -> Reprojection:
        poses: FloatArray = evidence.poses
        for convention in chosen.values():
            poses = convention.convert(poses)
        return evidence.reproject(evidence.relative(poses), evidence.depth_m(poses))

    what = " and ".join(convention.what for convention in chosen.values())
    return Hypothesis(what, f"--fix-poses {','.join(chosen)}", len(chosen), measure)


def delays() -> Iterator[Hypothesis]:
    """Poses late or early by some frames, with sensor depth."""
    for frames in range(1, _MOST_LATE + 1):
        for word, sign in (("late", 1), ("early", -1)):
            yield Hypothesis(
                f"poses {word} by {frames} frame{'s' * (frames > 1)}",
                f"--fix-poses {word}:{frames}",
                1,
                _delayed_by(sign * frames),
            )


def _delayed_by(frames: int) -> Callable[[Evidence], Reprojection]:
    def measure(evidence: Evidence) -> Reprojection:
        return evidence.reproject(evidence.relative_late(frames), evidence.depth_m(evidence.poses))

    return measure
