"""The trajectory of a localised recording as a file, whose suffix says the format."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.extras import require_extra
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.mcap_log import step_recorder
from monoloc.geometry import FloatArray
from monoloc.io.pose_table import COLUMNS
from monoloc.io.recording import Recording
from monoloc.io.tum_trajectory import write_tum
from monoloc.obstacles import tells_obstacles
from monoloc.pose_rows import WholeTable, row
from monoloc.step import LocalizedFrame, Step
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


class TableOutput(WholeTable):
    """A table of poses, :mod:`monoloc.io.pose_table`, with every frame."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, COLUMNS)

    def add(self, time_s: float, name: str, color: NDArray[np.uint8], step: Step) -> None:
        self.take(row(time_s, name, step))

    def close(self) -> None:
        """Nothing: it is written at once."""


class McapOutput:
    """An MCAP file of ROS 2 messages, see :mod:`monoloc.ros.step_messages`, of a camera that looks forward.

    Raises:
        DataError, SettingError: as :func:`monoloc.flight.mcap_log.step_recorder`.
    """

    def __init__(self, path: Path, bundle: Bundle, camera: Camera) -> None:
        self._recorder = step_recorder(path, False, bundle, camera, FlightSettings(), tells_obstacles(bundle))
        self._failure: DataError | None = None

    def add(self, time_s: float, name: str, color: NDArray[np.uint8], step: Step) -> None:
        if self._failure is None:
            try:
                self._recorder.add(time_s, color, step)
            except DataError as error:
                self._failure = error  # the run goes on for the other outputs

    def write(self) -> None:
        if self._failure is not None:
            raise self._failure
        self._recorder.file.finish()

    def close(self) -> None:
        self._recorder.file.close()


TABLE, MCAP, TRAJECTORY = ".csv", ".mcap", (".txt", ".tum")
SUFFIXES = (*TRAJECTORY, TABLE, MCAP)


def is_without_lost(path: Path) -> bool:
    """Whether a trajectory's format has no place for frames that are lost."""
    return path.suffix.lower() in TRAJECTORY


def check_trajectory(path: Path) -> None:
    """Reject an ``--out`` that has no suffix of a trajectory, or that cannot be written, before long work starts.

    Raises:
        SettingError: the suffix is another.
        MissingExtraError: a library for the format is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SettingError("--out", f"{path} has no suffix of a trajectory", f"choose from {', '.join(SUFFIXES)}")
    if suffix == MCAP:
        require_extra("mcap")


def trajectory_output(path: Path, bundle: Bundle, camera: Camera) -> TrajectoryOutput:
    """The output of a path that :func:`check_trajectory` accepts.

    Args:
        path: the file.
        bundle: of the room.
        camera: of the images.

    Raises:
        DataError, SettingError: the file cannot be made.
    """
    suffix = path.suffix.lower()
    if suffix == MCAP:
        return McapOutput(path, bundle, camera)
    return TableOutput(path) if suffix == TABLE else TumOutput(path)


class WritingViewer:
    """A :class:`~monoloc.viz.viewer.Viewer` that hands every frame to an output, and shows it by another viewer."""

    def __init__(self, viewer: Viewer, output: TrajectoryOutput) -> None:
        self._viewer, self._output = viewer, output
        self._recording: Recording | None = None

    def begin(self, room: Bundle, recording: Recording) -> None:
        self._recording = recording
        self._viewer.begin(room, recording)

    def show(self, frame: LocalizedFrame) -> None:
        self._viewer.show(frame)
        assert self._recording is not None
        time_s = float(self._recording.timestamps_s[frame.index])
        self._output.add(time_s, self._recording.frame_names[frame.index], frame.color, frame.step)
