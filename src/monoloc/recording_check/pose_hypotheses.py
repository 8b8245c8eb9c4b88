"""What the poses of a recording may be, other than ``T_world_camera`` in metres with OpenCV's axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

from monoloc.geometry import FloatArray
from monoloc.io.pose_fixes import AXES, DIRECTIONS, POSITIONS, QUATERNIONS, UNITS, Convention
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


@dataclass(frozen=True)
class Reading:
    """Poses of other conventions than stated.

    Attributes:
        names: of ``--fix-poses``, in the order in which they are undone.
        conventions: of these names.
    """

    names: tuple[str, ...]
    conventions: tuple[Convention, ...]

    @property
    def what(self) -> str:
        """For messages: "the poses fit as ..."."""
        return " and ".join(convention.what for convention in self.conventions)

    @property
    def option(self) -> str:
        return f"--fix-poses {','.join(self.names)}"

    def convert(self, poses: FloatArray) -> FloatArray:
        """``T_world_camera`` (N, 4, 4) of such poses."""
        for convention in self.conventions:
            poses = convention.convert(poses)
        return poses


def readings() -> Iterator[Reading]:
    """Conventions, any number at once, and positions with other axes than the rotations."""
    groups = (QUATERNIONS, DIRECTIONS, AXES, UNITS)
    choices: list[list[tuple[str, Convention | None]]] = [[("", None), *group.items()] for group in groups]
    for combination in product(*choices):
        chosen = {name: convention for name, convention in combination if convention is not None}
        if chosen:
            yield Reading(tuple(chosen), tuple(chosen.values()))
    for name, convention in POSITIONS.items():
        yield Reading((name,), (convention,))


def conventions(many: bool = False, with_units: bool = True) -> Iterator[Hypothesis]:
    """Single conventions and pairs of them, or three and more at once, in the order in which they are undone."""
    for reading in readings():
        is_of_unit = reading.names[-1] in UNITS
        if reading.names[0] not in POSITIONS and (len(reading.names) > _FEW) == many and with_units >= is_of_unit:
            yield _by_reading(reading)


def positions() -> Iterator[Hypothesis]:
    """Positions with the axes of another world than the rotations, as where only one of them was converted."""
    for reading in readings():
        if reading.names[0] in POSITIONS:
            yield _by_reading(reading)


def _by_reading(reading: Reading) -> Hypothesis:
    def measure(evidence: Evidence) -> Reprojection:
        poses = evidence.converted(reading.convert)
        return evidence.reproject(evidence.relative(poses), evidence.depth_m(poses))

    parts = 2 if reading.names[0] in POSITIONS else len(reading.names)  # of equals, a convention is the simpler one
    return Hypothesis(reading.what, reading.option, parts, measure)


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
