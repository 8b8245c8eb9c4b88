"""A simulated drone that stops before obstacles by its own depth: in a rendered room, in several lights.

The drone flies straight ahead at constant speed. Every frame is localised and joined to the local occupancy. The drone
brakes as soon as the free space that is left would be needed to stop. Truth is the way to the first contact, and for
the distances of sectors the renderer's exact depth at the true pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from monoloc.bundle import Bundle
from monoloc.depth.predictor import DepthPrediction
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording
from monoloc.localizer import Localizer, Step
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.obstacles import DepthError, LocalOccupancy, MapKnowledge, depth_points, sector_distances_m
from monoloc.particle_filter.estimate import Estimate
from monoloc.progress import Progress
from monoloc.start import Start
from monoloc_lab.synth.approaches import Approach

BRAKE_M_S2 = 1.5
CLEARANCE_M = 0.15
"""What is to be left between vehicle and obstacle."""

BINS_M = (0.3, 0.75, 1.5, 2.5, 5.0)
"""Edges of the true distances over which errors are summarised."""

_REACTION_S = 0.2  # from the capture of an image to the first effect of the brakes
_MISSED = 1.3  # times the true distance, from which an obstacle is missed


@dataclass(frozen=True)
class Stop:
    """One approach in one light.

    Attributes:
        is_new: whether the obstacle was not in the map.
        stopped: whether the drone stopped before it touched anything.
        gap_m: way that was left from the stop to the contact; negative where it touched.
        early_m: way that was left at the command to brake beyond what braking and clearance needed.
        knew: whether what it stopped for was told as new by the joined map; None if it never braked.
        lost_frames: before the command, or all.
    """

    is_new: bool
    stopped: bool
    gap_m: float
    early_m: float
    knew: bool | None
    lost_frames: int


@dataclass
class Sectors:
    """True and told distances of sectors in view that have both, in all frames; told are of the frame and joined."""

    true_m: list[FloatArray] = field(default_factory=list)
    frame_m: list[FloatArray] = field(default_factory=list)
    joined_m: list[FloatArray] = field(default_factory=list)


@dataclass(frozen=True)
class DistanceFigures:
    """Errors of told distances where the truth is in one bin.

    Attributes:
        sectors: number of them.
        median_error: median of told over true, less one.
        p5_error, p95_error: percentiles of the same.
        missed_rate: share that is told 30 % farther or more, or as free.
        missed_rate_of_frame: the same of the newest frame alone, without the last second.
        within_2_sd: share whose error is within two stated standard deviations.
    """

    sectors: int
    median_error: float
    p5_error: float
    p95_error: float
    missed_rate: float
    missed_rate_of_frame: float
    within_2_sd: float


@dataclass(frozen=True)
class LightFigures:
    """Stops and errors in one light.

    Attributes:
        stops, approaches: how many ended before a contact, of how many.
        new_stops, new_approaches: of those with an obstacle that is not in the map.
        told_new: of the stops before new obstacles, how many were told as new.
        told_new_falsely: of the stops before mapped obstacles.
        gap_least_m, gap_median_m, gap_most_m: way that was left.
        early_median_m: way left at the command beyond what it needed.
        lost_frames: of all frames flown.
        by_distance: by the true distance, in metres.
    """

    stops: int
    approaches: int
    new_stops: int
    new_approaches: int
    told_new: int
    told_new_falsely: int
    gap_least_m: float
    gap_median_m: float
    gap_most_m: float
    early_median_m: float
    lost_frames: int
    by_distance: dict[str, DistanceFigures]


@dataclass(frozen=True)
class StoppingFigures:
    """What ``monoloc bench stop`` prints.

    Attributes:
        speed_m_s, radius_m: of the drone.
        stated_relative_sd: of a distance, by the bundle.
        lights: by name.
    """

    speed_m_s: float
    radius_m: float
    stated_relative_sd: float
    lights: dict[str, LightFigures]


def bench_stops(
    bundle: Bundle,
    approaches: Sequence[tuple[Approach, Mapping[str, Path]]],
    radius_m: float,
    speed_m_s: float,
    seed: int,
    progress: Progress,
) -> StoppingFigures:
    """Fly all approaches in all lights.

    Args:
        bundle: of the room as it was mapped; its direction of gravity must be known.
        approaches: each with its recordings by light.
        radius_m, speed_m_s: of the drone.
        seed: of the localizers and their starts.
    """
    lights = list(approaches[0][1])
    knowledge = MapKnowledge(bundle)
    error = DepthError.of(bundle)
    figures, done = {}, 0
    with progress.task("approaches", len(lights) * len(approaches)) as show:
        for light in lights:
            stops, sectors = [], Sectors()
            for number, (approach, recordings) in enumerate(approaches):
                flight = _Flight(bundle, knowledge, error, radius_m, speed_m_s, seed + number)
                stops.append(flight.fly(approach, open_recording(f"folder:{recordings[light]}"), sectors))
                done += 1
                show(done)
            figures[light] = summarised(stops, sectors, error)
    return StoppingFigures(speed_m_s, radius_m, error.relative_sd, figures)


class _Flight:
    def __init__(
        self,
        bundle: Bundle,
        knowledge: MapKnowledge,
        error: DepthError,
        radius_m: float,
        speed_m_s: float,
        seed: int,
    ) -> None:
        assert bundle.down is not None
        self._bundle, self._knowledge, self._error = bundle, knowledge, error
        self._radius_m, self._speed_m_s, self._seed = radius_m, speed_m_s, seed
        self._frames = AutopilotFrames(Mount().T_body_camera, bundle.down, 0.0)

    def fly(self, approach: Approach, recording: Recording, sectors: Sectors) -> Stop:
        """One approach; the distances of all its frames are added to ``sectors``."""
        rng = np.random.default_rng([self._seed, 0x570])
        start = Start.disturbed(approach.poses[0], rng)
        localizer = Localizer(self._bundle, recording.camera, start, seed=self._seed)
        occupancy = LocalOccupancy(self._error)
        braked: Stop | None = None
        lost = 0
        for index, time_s in enumerate(approach.times_s.tolist()):
            elapsed_s = time_s - float(approach.times_s[max(0, index - 1)])
            step = localizer.step(recording.color(index), elapsed_s)
            if step.restarted or step.state == "lost":
                occupancy.clear()
            T_level_camera = self._frames.T_level_camera(step.estimate)
            around = occupancy.update(time_s, step.depth, step.estimate, T_level_camera)
            self._compare(approach.poses[index], recording, index, step, around.distances_m, sectors)
            lost += step.state == "lost" and braked is None
            # A drone that does not know where it is has no depth scale to believe, and stops as well.
            free_m = 0.0 if step.state == "lost" else around.free_ahead(self._radius_m).least_m
            if braked is None and free_m < self.needed_m:
                joined = self._knowledge.joined(around, step.estimate.pose @ invert(T_level_camera))
                ahead = np.r_[0:4, -3:0]
                nearest = ahead[np.nanargmin(np.append(joined.distances_m[ahead], np.inf)[:-1])]
                braked = self._braked(approach, time_s, bool(joined.is_new[nearest]), lost)
        return braked or Stop(approach.is_new, False, 0.0, 0.0, None, lost)

    @property
    def needed_m(self) -> float:
        """Free space from the vehicle's centre that it needs to stop in, with its clearance."""
        return self._radius_m + CLEARANCE_M + self._way_to_stop_m

    @property
    def _way_to_stop_m(self) -> float:
        return self._speed_m_s * _REACTION_S + self._speed_m_s**2 / (2.0 * BRAKE_M_S2)

    def _braked(self, approach: Approach, time_s: float, knew: bool, lost: int) -> Stop:
        gap_m = approach.contact_m - self._speed_m_s * time_s - self._way_to_stop_m
        return Stop(approach.is_new, gap_m > 0.0, gap_m, gap_m - CLEARANCE_M, knew, lost)

    def _compare(
        self, pose: FloatArray, recording: Recording, index: int, step: Step, joined_m: FloatArray, sectors: Sectors
    ) -> None:
        """Add the sectors of a frame whose true distance is known, and that the frame or the last second tells."""
        exact = DepthPrediction(recording.depth(index), recording.camera)
        T_level_camera = self._frames.T_level_camera(Estimate(pose, np.zeros((6, 6)), 0.0))
        true_m = sector_distances_m(transform(T_level_camera, depth_points(exact, 0.0)))
        T_level_camera = self._frames.T_level_camera(step.estimate)
        frame_m = sector_distances_m(transform(T_level_camera, depth_points(step.depth, step.estimate.log_scale)))
        both = np.isfinite(true_m) & ~np.isnan(frame_m)
        sectors.true_m.append(true_m[both])
        sectors.frame_m.append(frame_m[both])
        sectors.joined_m.append(joined_m[both])


def summarised(stops: Sequence[Stop], sectors: Sectors, error: DepthError) -> LightFigures:
    """Figures of one light; there is at least one stop and one sector."""
    gaps = np.array([stop.gap_m for stop in stops])
    new = [stop for stop in stops if stop.is_new]
    true_m, frame_m, joined_m = (np.concatenate(each) for each in (sectors.true_m, sectors.frame_m, sectors.joined_m))
    by_distance = {}
    for low, high in zip(BINS_M[:-1], BINS_M[1:], strict=True):
        is_in = (true_m >= low) & (true_m < high)
        if is_in.any():
            by_distance[f"{low:g}-{high:g}"] = _distances(true_m[is_in], frame_m[is_in], joined_m[is_in], error)
    return LightFigures(
        stops=sum(stop.stopped for stop in stops),
        approaches=len(stops),
        new_stops=sum(stop.stopped for stop in new),
        new_approaches=len(new),
        told_new=sum(bool(stop.knew) for stop in new),
        told_new_falsely=sum(bool(stop.knew) for stop in stops if not stop.is_new),
        gap_least_m=float(gaps.min()),
        gap_median_m=float(np.median(gaps)),
        gap_most_m=float(gaps.max()),
        early_median_m=float(np.median([stop.early_m for stop in stops])),
        lost_frames=sum(stop.lost_frames for stop in stops),
        by_distance=by_distance,
    )


def _distances(true_m: FloatArray, frame_m: FloatArray, joined_m: FloatArray, error: DepthError) -> DistanceFigures:
    ratio = np.minimum(joined_m, BINS_M[-1]) / true_m
    low, median, high = np.percentile(ratio - 1.0, [5.0, 50.0, 95.0])
    return DistanceFigures(
        sectors=len(true_m),
        median_error=float(median),
        p5_error=float(low),
        p95_error=float(high),
        missed_rate=float(np.mean(joined_m > _MISSED * true_m)),
        missed_rate_of_frame=float(np.mean(frame_m > _MISSED * true_m)),
        within_2_sd=float(np.mean(np.abs(joined_m - true_m) <= 2.0 * error.sd_m(np.minimum(joined_m, BINS_M[-1])))),
    )
