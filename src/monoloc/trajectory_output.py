"""The trajectory of a localised recording as a file, whose suffix says the format."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.files import write_whole
from monoloc.flight.pose_log import row
from monoloc.geometry import FloatArray
from monoloc.io.pose_table import COLUMNS
from monoloc.io.recording import Recording
from monoloc.io.tum_trajectory import write_tum
from monoloc.localizer import Step
from monoloc.particle_filter.particles import Particles
from monoloc.viz.viewer import Viewer


class TrajectoryOutput(Protocol):
    """Takes the frames of a localised recording, and writes them once all have come."""

    def add(self, time_s: float, name: str, color: NDArray[np.uint8], step: Step) -> None:
        """Take a frame.

        Args:
            time_s: of the frame.
            name: of the frame in its recording.
            color: (H, W, 3) uint8 RGB.
            step: the localizer's result.
        """
        ...

    def write(self) -> None:
        """Write the file, whole or not at all.

        Raises:
            DataError: it cannot be written.
        """
        ...

    def close(self) -> None:
        """Remove what :meth:`write` did not make whole."""
        ...


class TumOutput:
    """A TUM trajectory, without the frames that are lost: its format cannot say so."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._times_s: list[float] = []
        self._poses: list[FloatArray] = []

    def add(self, time_s: float, name: str, color: NDArray[np.uint8], step: Step) -> None:
        if step.state != "lost":
            self._times_s.append(time_s)
            self._poses.append(step.estimate.pose)

    def write(self) -> None:
        write_tum(self._path, self._times_s, np.reshape(self._poses, (-1, 4, 4)))

    def close(self) -> None:
        """Nothing: it is written at once."""


class TableOutput:
    """A table of poses, :mod:`monoloc.io.pose_table`, with every frame."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text = io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._rows.writerow(COLUMNS)

    def add(self, time_s: float, name: str, color: NDArray[np.uint8], step: Step) -> None:
        self._rows.writerow(row(time_s, name, step))

    def write(self) -> None:
        write_whole(self._path, self._text.getvalue().encode())

    def close(self) -> None:
        """Nothing: it is written at once."""


TABLE, TRAJECTORY = ".csv", (".txt", ".tum")
SUFFIXES = (*TRAJECTORY, TABLE)


def check_suffix(path: Path, option: str) -> None:
    """Raise SettingError, which names the option, unless the path's suffix is that of a trajectory."""
    if path.suffix.lower() not in SUFFIXES:
        problem = f"{path} has no suffix of a trajectory"
        raise SettingError(option, problem, f"choose from {', '.join(SUFFIXES)}")


def trajectory_output(path: Path) -> TrajectoryOutput:
    """The output of a path that :func:`check_suffix` accepts."""
    return TableOutput(path) if path.suffix.lower() == TABLE else TumOutput(path)


class WritingViewer:
    """A :class:`~monoloc.viz.viewer.Viewer` that hands every frame to an output, and shows it by another viewer."""

    def __init__(self, viewer: Viewer, output: TrajectoryOutput) -> None:
        self._viewer, self._output = viewer, output
        self._recording: Recording | None = None

    def begin(self, room: Bundle, recording: Recording) -> None:
        self._recording = recording
        self._viewer.begin(room, recording)

    def show(
        self,
        index: int,
        color: NDArray[np.uint8],
        step: Step,
        particles: Particles,
        odometry: FloatArray,
        step_ms: float,
    ) -> None:
        self._viewer.show(index, color, step, particles, odometry, step_ms)
        assert self._recording is not None
        time_s, name = float(self._recording.timestamps_s[index]), self._recording.frame_names[index]
        self._output.add(time_s, name, color, step)
