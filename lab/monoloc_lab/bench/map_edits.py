"""Flights in rooms whose map is wrong in one place: what a localizer says of it.

The map is edited in place of the room: what is in a box is moved, so that the room's content is no longer where the
map says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, transform
from monoloc.io.recording import Recording
from monoloc.localizer import Localizer
from monoloc.map.depth_rendering import map_depth
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress
from monoloc.start import Start
from monoloc.step import Step
from monoloc.supervision.map_change import ChangedRegion
from monoloc_lab.bench.judged_flight import FlightFrame, Image, fly
from monoloc_lab.bench.unseen_frames import Frames, UnseenFrames

EDITED_S = 8.0
"""Seconds that are flown over an edited map."""

LEAST_SHARE, MOST_SHARE = 0.1, 0.3
"""Of the view, on average over the flight, that the content of the box covers."""

MOVED_M = 0.5
"""How far the content of the box is moved, horizontally."""

_HALF_EDGES_M = (0.2, 0.7)  # of the box
_CLOUD_POINTS = 30_000  # of the map, from which views are rendered
_VIEW_SIZE = (40, 30)  # pixels
_EVERY = 5  # frames of which one is looked at for the share of the view
_MOST_BOXES = 500  # that are tried


@dataclass(frozen=True)
class MapEdit:
    """Components and landmarks in a box, moved.

    Attributes:
        lower, upper: corners of the box, (3,), world frame, metres.
        shift_m: (3,) world frame.
    """

    lower: FloatArray
    upper: FloatArray
    shift_m: FloatArray

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether points (N, 3) are in the box, (N,)."""
        return np.asarray(np.all((points > self.lower) & (points < self.upper), axis=1))

    def overlaps(self, region: ChangedRegion) -> bool:
        """Whether a region touches the box, or where the box has been moved to."""
        return any(
            bool(np.all(region.lower < self.upper + shift) and np.all(region.upper > self.lower + shift))
            for shift in (np.zeros(3), self.shift_m)
        )

    def of(self, bundle: Bundle) -> Bundle:
        """The bundle with its map edited."""
        landmarks = bundle.landmarks
        points = self._moved(landmarks.points.astype(np.float64)).astype(np.float32)
        return replace(
            bundle,
            original=self._edited(bundle.original),
            adapted=self._edited(bundle.adapted),
            landmarks=replace(landmarks, points=points),
        )

    def _edited(self, mixture: GaussianMixture) -> GaussianMixture:
        return replace(mixture, means=self._moved(mixture.means))

    def _moved(self, points: FloatArray) -> FloatArray:
        return np.asarray(points + self.holds(points)[:, None] * self.shift_m)


@dataclass(frozen=True)
class EditedFlight:
    """What was said in one flight over an edited map, and in the same flight over the true one.

    Attributes:
        names_edit: whether a *map-changed* frame over the edited map names a region of the edit.
        is_false: whether a frame over the true map is *map-changed*.
    """

    names_edit: bool
    is_false: bool


class EditDrawer:
    """Draws edits of a bundle's map that flights see enough of.

    Args:
        recording: of the flights.
    """

    def __init__(self, bundle: Bundle, recording: Recording, rng: np.random.Generator) -> None:
        assert recording.poses is not None
        self._name, self._poses, self._rng = recording.name, recording.poses, rng
        self._depth_of = map_depth(recording, bundle.original.sample(_CLOUD_POINTS, rng))
        self._camera = recording.camera.resized(*_VIEW_SIZE)
        self._landmarks = bundle.landmarks.points.astype(np.float64)
        self._down = np.asarray(bundle.provenance.down_world)

    def draw(self, frames: Frames) -> MapEdit:
        """An edit around a random point that one of the frames sees.

        It holds at most half of the landmarks: else the rest is what has moved.

        Raises:
            DataError: no box that was tried covers the right share of the view.
        """
        views = [view for view in map(self._view, frames[::_EVERY].tolist()) if len(view)]
        for _ in range(_MOST_BOXES if views else 0):
            view = views[self._rng.integers(len(views))]
            middle = view[self._rng.integers(len(view))]
            half = self._rng.uniform(*_HALF_EDGES_M, 3)
            edit = MapEdit(middle - half, middle + half, self._shift_m())
            share = np.mean([np.mean(edit.holds(view)) for view in views])
            if LEAST_SHARE <= share <= MOST_SHARE and 2 * edit.holds(self._landmarks).sum() <= len(self._landmarks):
                return edit
        raise DataError(
            self._name,
            f"sees no part of the map that fills {LEAST_SHARE:.0%} of the view",
            "give other frames, or --map-edits 0",
        )

    def _view(self, frame: int) -> FloatArray:
        """Points (N, 3) of the map that a frame sees, evenly over its pixels, world frame."""
        depth_m = cv2.resize(self._depth_of(frame), _VIEW_SIZE, interpolation=cv2.INTER_NEAREST)
        return transform(self._poses[frame], self._camera.back_project(depth_m)[depth_m > 0.0])

    def _shift_m(self) -> FloatArray:
        direction = np.cross(self._down, self._rng.normal(size=3))
        return np.asarray(MOVED_M * direction / np.linalg.norm(direction))


class _Listener:
    """Notes which regions a localizer says have changed."""

    def __init__(self, localizer: Localizer) -> None:
        self._localizer = localizer
        self.regions: list[ChangedRegion] = []

    def step(self, color: Image, elapsed_s: float) -> Step:
        step = self._localizer.step(color, elapsed_s)
        if step.state == "map-changed" and step.changed_region is not None:
            self.regions.append(step.changed_region)
        return step


def draw_edits(
    bundle: Bundle, recording: Recording, frames: UnseenFrames, count: int, seed: int
) -> list[tuple[Frames, MapEdit]]:
    """Stretches of frames, each with an edit of the map that it sees.

    Args:
        frames: of the recording.

    Raises:
        DataError: the recording has too few unseen frames in a row, or no edit is seen enough of.
    """
    if not count:
        return []
    windows = frames.windows_lasting(EDITED_S)
    if not windows:
        raise DataError(frames.name, f"has no {EDITED_S:.0f} s of unseen frames in a row", "give more frames")
    rng = np.random.default_rng((seed, 2))
    drawer = EditDrawer(bundle, recording, rng)
    chosen = (windows[rng.integers(len(windows))] for _ in range(count))
    return [(window, drawer.draw(window)) for window in chosen]


def fly_edits(
    bundle: Bundle, frames: UnseenFrames, drawn: Sequence[tuple[Frames, MapEdit]], seed: int, progress: Progress
) -> list[EditedFlight]:
    """Fly over edited maps, and over the true map.

    Args:
        drawn: by :func:`draw_edits`; each is flown once with the edit, and once without it.
        seed: of the starts and localizers.
    """
    flights = []
    with progress.task("edited maps", len(drawn)) as show:
        for number, (window, edit) in enumerate(drawn):
            flown = frames.flight(window)
            start = Start.disturbed(frames.poses[window[0]], np.random.default_rng((seed, 2, number)))
            edited, unedited = (
                _regions(Localizer(each, frames.camera, start, seed=np.random.default_rng((seed, 2, number))), flown)
                for each in (edit.of(bundle), bundle)
            )
            flights.append(EditedFlight(any(map(edit.overlaps, edited)), len(unedited) > 0))
            show(number + 1)
    return flights


def _regions(localizer: Localizer, frames: Sequence[FlightFrame]) -> list[ChangedRegion]:
    listener = _Listener(localizer)
    fly(listener, frames)
    return listener.regions
