"""A simulated drone that stops before obstacles by its own depth: in a rendered room, in several lights.

The drone flies straight ahead at constant speed. Every frame is localised and joined to the local occupancy. The
drone brakes as soon as it would need the free space that is left to stop. Truth is the way to the first contact, and
for the distances of sectors the renderer's exact depth at the true pose.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from monoloc.bundle import Bundle, fingerprint
from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import DataError
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, transform
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording
from monoloc.localizer import Localizer
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.obstacles import (
    MOST_M,
    DepthError,
    Knowledge,
    MapKnowledge,
    ObstacleWatch,
    Surroundings,
    depth_points,
    sector_distances_m,
)
from monoloc.particle_filter.estimate import Estimate
from monoloc.progress import Progress
from monoloc.start import Start
from monoloc.step import Step
from monoloc_lab.make.rendered_room import CAMERA, FLIGHTS, ROOM_SEED
from monoloc_lab.rooms import BUILD
from monoloc_lab.synth.approaches import Approach, plan_approach, render_approach
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.light import LIGHTS
from monoloc_lab.synth.sequence import RenderConfig

BRAKE_M_S2 = 1.5
CLEARANCE_M = 0.15
"""What is to be left between vehicle and obstacle."""

BINS_M = (0.3, 0.75, 1.5, 2.5, 5.0)
"""Edges of the true distances over which errors are summarised."""

SPEED_M_S, RADIUS_M = 0.8, 0.25
"""Of the drone."""

_RATE_HZ = 5.0  # of its camera, as in the room's build flight
_SAMPLES = 8  # paths a pixel and light group
_REACTION_S = 0.2  # from the capture of an image to the first effect of the brakes
_TO_STOP_M = SPEED_M_S * _REACTION_S + SPEED_M_S**2 / (2.0 * BRAKE_M_S2)
_MISSED = 1.3  # times the true distance, from which an obstacle is missed


@dataclass(frozen=True)
class Stop:
    """One approach in one light.

    Attributes:
        is_new: whether the obstacle was not in the map.
        stopped: whether the drone stopped before it touched anything.
        by_distance: whether distances alone, whatever the state, would have stopped it too.
        gap_m: way that was left from the stop to the contact; negative where it touched, 0 where it never braked.
        why: it braked: ``map`` or ``live depth``, whichever had the nearest obstacle ahead, or the state.
    """

    is_new: bool
    stopped: bool
    by_distance: bool
    gap_m: float
    why: str


@dataclass
class Sectors:
    """Distances of the sectors whose true one is known and that the newest frame measures, over all frames.

    Attributes:
        true_m: by exact depth at the true pose.
        frame_m: by the newest frame alone.
        live_m: by the frames of the last second.
        joined_m: by these and the map.
    """

    true_m: list[FloatArray] = field(default_factory=list)
    frame_m: list[FloatArray] = field(default_factory=list)
    live_m: list[FloatArray] = field(default_factory=list)
    joined_m: list[FloatArray] = field(default_factory=list)


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of distances where the truth is in one bin.

    Attributes:
        median, p5, p95: percentiles of measured over true, less one; what is measured as free counts as 5 m.
        missed_rate: share that is measured 30 % farther or more.
        within_2_sd: share whose error is within two stated standard deviations.
    """

    median: float
    p5: float
    p95: float
    missed_rate: float
    within_2_sd: float


@dataclass(frozen=True)
class DistanceFigures:
    """Errors by what measures the distances, see :class:`Sectors`, over a number of sectors."""

    sectors: int
    frame: ErrorFigures
    live: ErrorFigures
    joined: ErrorFigures


@dataclass(frozen=True)
class StopFigures:
    """Stops of several approaches.

    Attributes:
        stops, approaches: how many ended before a contact, of how many.
        stops_by_distance: how many would have, if the drone did not brake for its state.
        gap_least_m, gap_median_m, gap_most_m: way that was left; of approaches without a stop 0 or less.
        why: how often the drone braked for each reason.
    """

    stops: int
    approaches: int
    stops_by_distance: int
    gap_least_m: float
    gap_median_m: float
    gap_most_m: float
    why: dict[str, int]


@dataclass(frozen=True)
class LightFigures:
    """Stops and errors in one light.

    Attributes:
        mapped, new: stops before what the map knows, and before what is new; None without such approaches.
        mapped_errors, new_errors: errors by the true distance, in metres, on the same approaches.
    """

    mapped: StopFigures | None
    new: StopFigures | None
    mapped_errors: dict[str, DistanceFigures]
    new_errors: dict[str, DistanceFigures]


@dataclass(frozen=True)
class StoppingFigures:
    """What ``monoloc bench stop`` prints.

    Attributes:
        speed_m_s, radius_m: of the drone.
        stated_relative_sd: of a distance, by the bundle.
        nearest_depth_m: below which the bundle states no error.
        lights: by name.
    """

    speed_m_s: float
    radius_m: float
    stated_relative_sd: float
    nearest_depth_m: float
    lights: dict[str, LightFigures]


def rendered_approaches(
    mapped: int, new: int, seed: int, out: Path, progress: Progress
) -> list[tuple[Approach, dict[str, Path]]]:
    """Random approaches in the rendered living room, each with its recordings by light.

    Args:
        mapped: number of approaches to what the room's build flight saw.
        new: number of approaches to a cabinet or a column that was put in the way.
        seed: of all of them.
        out: folder that keeps the renderings; those of an earlier call are reused.

    Raises:
        DataError, MissingExtraError: as :func:`monoloc_lab.synth.sequence.render_sequence`.
    """
    room, made = generate_room(ROOM_SEED), []
    lights, config = list(LIGHTS.values()), RenderConfig(samples=_SAMPLES)
    look_down_deg = FLIGHTS["build"].flight.look_down_deg
    out.mkdir(exist_ok=True)
    # Even and odd numbers, so that more of one kind do not change the others.
    for number in [*range(0, 2 * mapped, 2), *range(1, 2 * new, 2)]:
        rng = np.random.default_rng([seed, number])
        approach = plan_approach(room, number % 2 == 1, RADIUS_M, SPEED_M_S, _RATE_HZ, look_down_deg, rng)
        folder = out / f"{number:02d}"
        paths = render_approach(approach, CAMERA, lights, config, seed + number, folder, progress)
        made.append((approach, {light.name: path for light, path in zip(lights, paths, strict=True)}))
    return made


def check_room(bundle: Bundle, path: Path) -> None:
    """Reject a bundle of another room than the rendered living room.

    Raises:
        DataError: no frame of the room's build flight built the bundle, or the direction of gravity is not known.
    """
    built, fix = open_recording(f"folder:{BUILD}"), f"make it by: monoloc build {BUILD} --out living.monoloc"
    if not set(bundle.provenance.frames.values()) & {fingerprint(built.color(i)) for i in range(len(built))}:
        raise DataError(path, "is not of the rendered living room", fix)
    if bundle.down is None:
        raise DataError(path, "does not give the direction of gravity", fix)


def bench_stops(
    bundle: Bundle, approaches: Sequence[tuple[Approach, Mapping[str, Path]]], seed: int, progress: Progress
) -> StoppingFigures:
    """Fly all approaches in all lights.

    Args:
        bundle: of the room as it was mapped; its direction of gravity must be known.
        approaches: as :func:`rendered_approaches` makes them, at least one.
        seed: of the localizers and their starts.
    """
    lights = list(approaches[0][1])
    knowledge = MapKnowledge(bundle)
    error = DepthError.of(bundle)
    figures, done = {}, 0
    with progress.task("approaches", len(lights) * len(approaches)) as show:
        for light in lights:
            stops: dict[bool, list[Stop]] = {False: [], True: []}
            sectors = {False: Sectors(), True: Sectors()}
            for number, (approach, recordings) in enumerate(approaches):
                is_new, recording = approach.is_new, open_recording(f"folder:{recordings[light]}")
                flight = _Flight(bundle, knowledge, error, seed + number)
                stops[is_new].append(flight.fly(approach, recording, sectors[is_new]))
                done += 1
                show(done)
            figures[light] = LightFigures(
                mapped=stop_figures(stops[False]),
                new=stop_figures(stops[True]),
                mapped_errors=distance_figures(sectors[False], error),
                new_errors=distance_figures(sectors[True], error),
            )
    return StoppingFigures(SPEED_M_S, RADIUS_M, error.relative_sd, error.nearest_m, figures)


class _Flight:
    def __init__(self, bundle: Bundle, knowledge: MapKnowledge, error: DepthError, seed: int) -> None:
        assert bundle.down is not None
        self._bundle, self._knowledge, self._error = bundle, knowledge, error
        self._seed = seed
        self._frames = AutopilotFrames(Mount().T_body_camera, bundle.down, 0.0)

    def fly(self, approach: Approach, recording: Recording, sectors: Sectors) -> Stop:
        """One approach; the distances of all its frames are added to ``sectors``."""
        start = Start.disturbed(approach.poses[0], np.random.default_rng([self._seed, 0x570]))
        localizer = Localizer(self._bundle, recording.camera, start, seed=self._seed)
        watch = ObstacleWatch(self._error, self._knowledge)
        braked: dict[bool, Stop] = {}  # by whether the state counts
        for index, time_s in enumerate(approach.times_s.tolist()):
            elapsed_s = time_s - float(approach.times_s[max(0, index - 1)])
            step = localizer.step(recording.color(index), elapsed_s)
            around = watch.update(time_s, step, self._frames.T_level_camera(step.estimate))
            assert step.depth is not None and around is not None  # without a budget, each step has depth
            self._compare(approach.poses[index], recording, index, step, step.depth, around, sectors)
            for counts in (True, False):
                why = _why_braked(step, around, counts)
                if why is not None and counts not in braked:
                    braked[counts] = _braked(approach, time_s, why)
        by_distance = False in braked and braked[False].stopped
        stop = braked.get(True, Stop(approach.is_new, False, False, 0.0, "never braked"))
        return replace(stop, by_distance=by_distance)

    def _compare(
        self,
        pose: FloatArray,
        recording: Recording,
        index: int,
        step: Step,
        depth: DepthPrediction,
        around: Surroundings,
        sectors: Sectors,
    ) -> None:
        """Add the sectors of a frame whose true distance is known, and that the frame or the last second measures."""
        exact = DepthPrediction(recording.depth(index), recording.camera)
        T_level_camera = self._frames.T_level_camera(Estimate(pose, np.zeros((6, 6)), 0.0))
        true_m = sector_distances_m(transform(T_level_camera, depth_points(exact, 0.0)))
        T_level_camera = self._frames.T_level_camera(step.estimate)
        frame_m = sector_distances_m(transform(T_level_camera, depth_points(depth, step.estimate.log_scale)))
        both = np.isfinite(true_m) & ~np.isnan(frame_m)
        sectors.true_m.append(true_m[both])
        sectors.frame_m.append(frame_m[both])
        live_m = around.live_m if isinstance(around, Knowledge) else around.distances_m
        sectors.live_m.append(live_m[both])
        sectors.joined_m.append(around.distances_m[both])


def _why_braked(step: Step, around: Surroundings, state_counts: bool) -> str | None:
    """Why the drone brakes after a frame; None where it goes on.

    A drone that is not sure where it is believes neither the map nor the scale of its depth, and stops as well.

    Args:
        step: the localizer's result.
        around: the vehicle.
        state_counts: whether the state is a reason, or only distances are.
    """
    if around.free_ahead(RADIUS_M).least_m >= RADIUS_M + CLEARANCE_M + _TO_STOP_M or step.state == "lost":
        return step.state if state_counts and step.state not in ("tracking", "map-changed") else None
    assert isinstance(around, Knowledge)
    is_live = replace(around, distances_m=around.live_m).free_ahead(RADIUS_M).distance_m
    is_mapped = replace(around, distances_m=around.mapped_m).free_ahead(RADIUS_M).distance_m
    return "live depth" if is_live < is_mapped else "map"


def _braked(approach: Approach, time_s: float, why: str) -> Stop:
    gap_m = approach.contact_m - SPEED_M_S * time_s - _TO_STOP_M
    return Stop(approach.is_new, gap_m > 0.0, False, gap_m, why)


def stop_figures(stops: Sequence[Stop]) -> StopFigures | None:
    """Summary of stops; None of none."""
    if not stops:
        return None
    gaps_m = np.array([stop.gap_m for stop in stops])
    return StopFigures(
        stops=sum(stop.stopped for stop in stops),
        approaches=len(stops),
        stops_by_distance=sum(stop.by_distance for stop in stops),
        gap_least_m=float(gaps_m.min()),
        gap_median_m=float(np.median(gaps_m)),
        gap_most_m=float(gaps_m.max()),
        why=dict(Counter(stop.why for stop in stops)),
    )


def distance_figures(sectors: Sectors, error: DepthError) -> dict[str, DistanceFigures]:
    """Errors by bins of the true distance; bins without a sector are left out."""
    if not sectors.true_m:
        return {}
    true_m = np.concatenate(sectors.true_m)
    measured = [np.concatenate(each) for each in (sectors.frame_m, sectors.live_m, sectors.joined_m)]
    figures = {}
    for low, high in itertools.pairwise(BINS_M):
        is_in = (true_m >= low) & (true_m < high)
        if is_in.any():
            errors = (_errors(true_m[is_in], each[is_in], error) for each in measured)
            figures[f"{low:g}-{high:g}"] = DistanceFigures(int(is_in.sum()), *errors)
    return figures


def _errors(true_m: FloatArray, measured_m: FloatArray, error: DepthError) -> ErrorFigures:
    within_m = np.minimum(measured_m, MOST_M)
    low, median, high = np.percentile(within_m / true_m - 1.0, [5.0, 50.0, 95.0])
    return ErrorFigures(
        median=float(median),
        p5=float(low),
        p95=float(high),
        missed_rate=float(np.mean(measured_m > _MISSED * true_m)),
        within_2_sd=float(np.mean(np.abs(within_m - true_m) <= 2.0 * error.sd_m(within_m))),
    )
