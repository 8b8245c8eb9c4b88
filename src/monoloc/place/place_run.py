"""A recording, localised in a place frame by frame, and its figures."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from monoloc.errors import DataError
from monoloc.evaluation.trajectory import summarise
from monoloc.flight.in_place import Switch
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.place.place_files import Place
from monoloc.place.place_localizer import PlaceLocalizer, PlaceStep
from monoloc.place.place_table import PlaceTable
from monoloc.progress import Progress
from monoloc.settled_objects import settled
from monoloc.supervision.state import State


@dataclass(frozen=True)
class PlaceRun:
    """Results of N frames.

    Attributes:
        rooms: in whose world each pose is; None while the place was searched.
        states: of the frames.
        poses: ``T_world_camera``, (4, 4), in that room's world, or None.
        switches: entries into rooms.
        step_ms: (N,).
        loaded: rooms in memory after each frame, at most.
        unreadable: why rooms could not be read at last, by name.
    """

    rooms: list[str | None]
    states: list[State]
    poses: list[FloatArray | None]
    switches: list[Switch]
    step_ms: FloatArray
    loaded: int
    unreadable: Mapping[str, str] = field(default_factory=dict)

    def metrics(self) -> dict[str, object]:
        """The figures, ready for JSON."""
        believed = Counter(room for room, state in zip(self.rooms, self.states, strict=True) if state != "lost")
        return {
            "frames": len(self.rooms),
            "rooms": {str(room): count for room, count in believed.items()},
            "states": dict(Counter(self.states)),
            "searched_frames": self.rooms.count(None),
            "switches": [asdict(switch) for switch in self.switches],
            "rooms_loaded_most": self.loaded,
            "step_ms_median": float(np.median(self.step_ms)),
            "step_ms_p95": float(np.percentile(self.step_ms, 95.0)),
            "step_ms_max": float(self.step_ms.max()),
        }

    def errors(self, place: Place, truth: FloatArray, truth_room: str) -> dict[str, object]:
        """Errors of the frames that are not lost, in the world of the room that the truth is in.

        Args:
            truth: (N, 4, 4) ``T_world_camera``.
            truth_room: in whose world it is. Rooms that no doors join to it are left out.
        """
        estimated, true = [], []
        for room, state, pose, truth_pose in zip(self.rooms, self.states, self.poses, truth, strict=True):
            T_truth_room = None if room is None or state == "lost" else place.T_other_room(truth_room, room)
            if T_truth_room is not None and pose is not None:
                estimated.append(T_truth_room @ pose)
                true.append(truth_pose)
        figures: dict[str, object] = {"truth_room": truth_room, "compared_frames": len(true)}
        return figures | (asdict(summarise(np.stack(estimated), np.stack(true))) if true else {})


def localize_in_place(
    place: Place, recording: Recording, seed: int, progress: Progress, table: PlaceTable | None = None
) -> PlaceRun:
    """Localise every frame of a recording, of whose start nothing is known; a table takes all of them.

    Raises:
        DataError: there are no frames, or one cannot be read.
    """
    if len(recording) == 0:
        raise DataError(recording.name, "gives no frames", "give a recording with at least one")
    localizer = PlaceLocalizer(place, recording.camera, seed=seed)
    steps: list[PlaceStep] = []
    switches: list[Switch] = []
    step_ms, loaded, room = [], 0, None
    elapsed = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    with settled(), progress.task("localize", len(recording)) as show:
        for index in range(len(recording)):
            color = recording.color(index)
            began = time.perf_counter()
            step = localizer.step(color, float(elapsed[index]))
            step_ms.append((time.perf_counter() - began) * 1e3)
            if step.entered and step.room is not None:
                time_s = float(recording.timestamps_s[index] - recording.timestamps_s[0])
                switches.append(Switch(index, time_s, room, step.room))
            room = step.room
            if table is not None:
                table.add(float(recording.timestamps_s[index]), recording.frame_names[index], step)
            steps.append(step)
            loaded = max(loaded, len(localizer.loaded))
            show(index + 1)
    return PlaceRun(
        rooms=[step.room for step in steps],
        states=[step.state for step in steps],
        poses=[None if step.step is None else step.step.estimate.pose for step in steps],
        switches=switches,
        step_ms=np.array(step_ms),
        loaded=loaded,
        unreadable=localizer.unreadable,
    )
