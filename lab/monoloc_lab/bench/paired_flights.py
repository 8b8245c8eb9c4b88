"""Two ways of flying compared over the same frames, build by build.

Flights are the files of ``monoloc localize --json``. The rules are those of docs/beyond-the-paper.md: builds are the
statistical unit, and an effect is decided where the interval of their ratios excludes 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from monoloc.errors import DataError
from monoloc.run_json import GIVE_RUN, figures_of, read_run_json
from monoloc.supervision.state import VOUCHED_FOR, State
from monoloc_lab.experiments.interval import Interval, Step, interval_of, step_of

_FLY_ALIKE = "fly both over the same frames, from the same start"
_BUILD_ALIKE = "build both from the same frames, or fly over frames that built neither"
_EQUAL = dict.fromkeys(("selection", "frames", "start", "seed"), _FLY_ALIKE) | {"unseen_frames": _BUILD_ALIKE}
"""What the two flights of a pair have in common, and what to do where they do not."""


class Flight(BaseModel):
    """A flight, as ``monoloc localize --json`` reports it; errors are over frames that did not build the bundle."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    digest: str
    source: str
    selection: str
    start: str
    seed: int
    frames: int
    unseen_frames: int
    states: dict[State, int]
    ate_rmse_m: float
    ate_median_m: float
    rot_median_deg: float
    silent_frames_30cm: int
    silent_frames_3_5_sigma: int

    @property
    def vouched_for(self) -> int:
        """Number of *tracking* and *map-changed* frames."""
        return sum(self.states.get(state, 0) for state in VOUCHED_FOR)


@dataclass(frozen=True)
class FlightPair:
    """A flight before and after a change, of one name."""

    before: Flight
    after: Flight

    @property
    def build(self) -> str:
        """The bundle before the change, by its content: bundles of several folders may have one name."""
        return self.before.digest

    @property
    def is_same(self) -> bool:
        """Whether errors and states are the same to the last digit."""
        ignored = {"digest", "source"}
        return self.before.model_dump(exclude=ignored) == self.after.model_dump(exclude=ignored)


@dataclass(frozen=True)
class Change:
    """An error before and after a change: over builds, of the median over the flights of each.

    Attributes:
        ratio: after over before, build by build; None where an error before the change is 0.
        verdict: by the ratio.
    """

    before: Interval
    after: Interval
    ratio: Interval | None
    verdict: Step


@dataclass(frozen=True)
class Count:
    """Number of frames of all flights, before and after a change."""

    before: int
    after: int


@dataclass(frozen=True)
class Comparison:
    """All pairs of flights over the same frames of a source.

    Attributes:
        source, selection: the frames, as they were given to the flights before the change.
        builds, flights: number of bundles, and of pairs of flights.
        same_flights: pairs whose errors and states are the same to the last digit.
        rmse_m, median_m, rotation_deg: errors of the position, and the median error of the rotation.
        frames: of all flights.
        vouched_for: of these, *tracking* or *map-changed*.
        silent_30cm, silent_3_5_sigma: silently wrong ones, as in the JSON of ``monoloc localize``.
    """

    source: str
    selection: str
    builds: int
    flights: int
    same_flights: int
    rmse_m: Change
    median_m: Change
    rotation_deg: Change
    frames: int
    vouched_for: Count
    silent_30cm: Count
    silent_3_5_sigma: Count


def paired(before: Path, after: Path) -> tuple[list[FlightPair], list[str]]:
    """Flights of two folders that have one file name, and the names that only one of the folders has.

    Raises:
        DataError: a folder has no such files, none of their names is in both, a file is not the JSON of a flight with
            reference poses, or two files of one name differ in frames, in those that built the bundle, or in the
            start.
    """
    names = [{file.name for file in folder.glob("*.json")} for folder in (before, after)]
    for folder, found in zip((before, after), names, strict=True):
        if not found:
            raise DataError(folder, "has no .json files", f"{GIVE_RUN}, a file for each flight")
    common = sorted(names[0] & names[1])
    if not common:
        raise DataError(after, f"has no file of a name that is in {before}", "give both flights of a pair one name")
    pairs = []
    for name in common:
        pair = FlightPair(read_flight(before / name), read_flight(after / name))
        for field, fix in _EQUAL.items():
            values = [getattr(each, field) for each in (pair.before, pair.after)]
            if values[0] != values[1]:
                raise DataError(after / name, f"{field}: is {values[1]}, in {before / name} it is {values[0]}", fix)
        pairs.append(pair)
    return pairs, sorted(names[0] ^ names[1])


def read_flight(path: Path) -> Flight:
    """Read the JSON of ``monoloc localize``.

    Raises:
        DataError: it is not that, or the recording had no reference poses.
    """
    content = read_run_json(path)
    if isinstance(content, dict) and "digest" in content and "ate_rmse_m" not in content:
        fix = "compare flights over recordings with poses"
        raise DataError(path, "has no errors, because its recording has no poses", fix)
    return figures_of(path, _unseen(content), Flight)


def _unseen(content: Any) -> Any:
    """The figures, errors over all frames replaced by those over unseen ones, where there are such."""
    if not isinstance(content, dict):
        return content
    # States are of all frames, and so is their number.
    return {
        name: value if name == "frames" else content.get(f"unseen_{name}", value) for name, value in content.items()
    }


def compared(pairs: list[FlightPair]) -> Iterator[Comparison]:
    """A comparison for each selection of frames of each source, in order of their names."""
    groups: dict[tuple[str, str], list[FlightPair]] = {}
    for pair in pairs:
        groups.setdefault((pair.before.source, pair.before.selection), []).append(pair)
    for (source, selection), group in sorted(groups.items()):
        yield Comparison(
            source=source,
            selection=selection,
            builds=len({pair.build for pair in group}),
            flights=len(group),
            same_flights=sum(pair.is_same for pair in group),
            rmse_m=_change(group, lambda flight: flight.ate_rmse_m),
            median_m=_change(group, lambda flight: flight.ate_median_m),
            rotation_deg=_change(group, lambda flight: flight.rot_median_deg),
            frames=sum(pair.before.frames for pair in group),
            vouched_for=_count(group, lambda flight: flight.vouched_for),
            silent_30cm=_count(group, lambda flight: flight.silent_frames_30cm),
            silent_3_5_sigma=_count(group, lambda flight: flight.silent_frames_3_5_sigma),
        )


def _change(pairs: list[FlightPair], error: Callable[[Flight], float]) -> Change:
    flights: dict[str, list[FlightPair]] = {}
    for pair in pairs:
        flights.setdefault(pair.build, []).append(pair)
    before = [float(np.median([error(pair.before) for pair in each])) for each in flights.values()]
    after = [float(np.median([error(pair.after) for pair in each])) for each in flights.values()]
    ratio = interval_of([new / old for old, new in zip(before, after, strict=True)]) if all(before) else None
    return Change(interval_of(before), interval_of(after), ratio, "undecided" if ratio is None else step_of(ratio))


def _count(pairs: list[FlightPair], number: Callable[[Flight], int]) -> Count:
    return Count(sum(number(pair.before) for pair in pairs), sum(number(pair.after) for pair in pairs))
