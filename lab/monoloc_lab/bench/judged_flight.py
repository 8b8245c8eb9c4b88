"""A flight, frame by frame, and what was right about the poses and states that the localizer gave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.evaluation.consistency import FAR_M, Consistency, consistency
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray
from monoloc.step import Step
from monoloc.supervision.state import VOUCHED_FOR

REFUSED = "refused"
"""State of a frame that the localizer refuses to take in; to the user, it has said that it does not know."""

RIGHT_M, RIGHT_DEG = 0.20, 10.0
"""Errors below which a camera that was lost has been found."""

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FlightFrame:
    """One frame of a flight.

    Attributes:
        image: gives (H, W, 3) uint8 RGB; called once, when the frame is flown.
        time_s: since the flight's beginning.
        truth: ``T_world_camera``, (4, 4); None where the camera is not in the bundle's room.
        stated_elapsed_s: time since the previous frame as the localizer is given it; None for the true time since
            the last frame that it took in.
        distance_m: pose distance of the truth to the nearest of the build's frames.
    """

    image: Callable[[], Image]
    time_s: float
    truth: FloatArray | None
    stated_elapsed_s: float | None = None
    distance_m: float = 0.0


class TakesSteps(Protocol):
    """What is judged: a :class:`monoloc.localizer.Localizer`."""

    def step(self, color: Image, elapsed_s: float) -> Step:
        """Take in one frame."""
        ...


@dataclass(frozen=True)
class JudgedFlight:
    """Results of N frames.

    Attributes:
        times_s: (N,) seconds.
        states: (N,) states, or :data:`REFUSED`.
        errors: of the positions and poses; NaN where the frame was refused or the camera is not in the room.
        rotation_deg: (N,) degrees, NaN likewise.
        in_room: (N,) frames of the bundle's room.
        distance_m: (N,) pose distances of the truth to the nearest of the build's frames.
    """

    times_s: FloatArray
    states: NDArray[np.str_]
    errors: Consistency
    rotation_deg: FloatArray
    in_room: Mask
    distance_m: FloatArray

    def __len__(self) -> int:
        return len(self.times_s)

    def part(self, frames: slice | Mask) -> JudgedFlight:
        """Some of the frames."""
        mask = np.zeros(len(self), dtype=np.bool_)
        mask[frames] = True
        return JudgedFlight(
            self.times_s[mask],
            self.states[mask],
            self.errors.of(mask),
            self.rotation_deg[mask],
            self.in_room[mask],
            self.distance_m[mask],
        )

    @property
    def is_tracking(self) -> Mask:
        """(N,) frames whose pose the localizer vouches for: *tracking* or *map-changed*."""
        return np.isin(self.states, list(VOUCHED_FOR))

    @property
    def is_far(self) -> Mask:
        """(N,) frames of :attr:`is_tracking` that are more than :data:`FAR_M` off, or not in the room at all."""
        return self.is_tracking & (self.errors.is_far | ~self.in_room)

    @property
    def is_silent(self) -> Mask:
        """(N,) frames of :attr:`is_tracking` that are far, or whose position lies outside its covariance."""
        return self.is_far | (self.is_tracking & self.errors.is_beyond_covariance)

    @property
    def is_found(self) -> Mask:
        """(N,) frames of :attr:`is_tracking` less than :data:`RIGHT_M` and :data:`RIGHT_DEG` off."""
        return self.is_tracking & (self.errors.position_m < RIGHT_M) & (self.rotation_deg < RIGHT_DEG)

    @property
    def is_near(self) -> Mask:
        """(N,) frames of :attr:`is_tracking` less than :data:`FAR_M` off."""
        return self.is_tracking & (self.errors.position_m < FAR_M)

    @property
    def not_lost(self) -> Consistency:
        """Errors of the frames that have a truth and are not *lost*."""
        return self.errors.of((self.states != "lost") & np.isfinite(self.errors.pose_nees))


def fly(localizer: TakesSteps, frames: Sequence[FlightFrame]) -> JudgedFlight:
    """Fly frames in order, at least one, and judge what the localizer says of each."""
    count = len(frames)
    states = [REFUSED] * count
    poses, covariances = np.tile(np.eye(4), (count, 1, 1)), np.tile(np.eye(6), (count, 1, 1))
    last_s = frames[0].time_s
    for index, frame in enumerate(frames):
        elapsed_s = frame.time_s - last_s if frame.stated_elapsed_s is None else frame.stated_elapsed_s
        try:
            step = localizer.step(frame.image(), elapsed_s)
        except ValueError:
            continue
        last_s = frame.time_s
        states[index] = step.state
        poses[index], covariances[index] = step.estimate.pose, step.estimate.covariance
    in_room = np.array([frame.truth is not None for frame in frames])
    truth = np.stack([np.eye(4) if frame.truth is None else frame.truth for frame in frames])
    is_known = in_room & (np.array(states) != REFUSED)
    errors = consistency(poses, truth, covariances)
    return JudgedFlight(
        times_s=np.array([frame.time_s for frame in frames]),
        states=np.array(states),
        errors=Consistency(
            *(np.where(is_known, e, np.nan) for e in (errors.position_m, errors.pose_nees, errors.position_nees))
        ),
        rotation_deg=np.where(is_known, np.rad2deg(pose_errors(poses, truth).rotation_rad), np.nan),
        in_room=in_room,
        distance_m=np.array([frame.distance_m for frame in frames]),
    )


def pooled(flights: Sequence[JudgedFlight]) -> JudgedFlight:
    """The frames of several flights together, for shares of them."""
    errors = [flight.errors for flight in flights]
    return JudgedFlight(
        times_s=np.concatenate([flight.times_s for flight in flights]),
        states=np.concatenate([flight.states for flight in flights]),
        errors=Consistency(
            np.concatenate([e.position_m for e in errors]),
            np.concatenate([e.pose_nees for e in errors]),
            np.concatenate([e.position_nees for e in errors]),
        ),
        rotation_deg=np.concatenate([flight.rotation_deg for flight in flights]),
        in_room=np.concatenate([flight.in_room for flight in flights]),
        distance_m=np.concatenate([flight.distance_m for flight in flights]),
    )


def seconds_until(flight: JudgedFlight, frames: Mask) -> float | None:
    """Seconds from the flight's first frame to the first of ``frames`` (N,); None if there is none."""
    found = np.flatnonzero(frames)
    return float(flight.times_s[found[0]] - flight.times_s[0]) if len(found) else None


def longest_run_s(flight: JudgedFlight, frames: Mask) -> float:
    """Seconds from the first to the last of the longest run of consecutive ``frames`` (N,); 0 if there is none."""
    borders = np.flatnonzero(np.diff(frames.astype(np.int8), prepend=0, append=0))
    firsts, ends = borders[::2], borders[1::2]
    return float(np.max(flight.times_s[ends - 1] - flight.times_s[firsts], initial=0.0))


def share(frames: Mask) -> float | None:
    """Share of frames, 0..1; None of no frames."""
    return float(np.mean(frames)) if len(frames) else None
