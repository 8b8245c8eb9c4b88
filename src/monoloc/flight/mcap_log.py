"""A flight as an MCAP file of ROS 2 messages, written as it comes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.flight_settings import FlightSettings
from monoloc.ros.mcap_file import McapFile, StepRecorder
from monoloc.ros.ros_frames import RosFrames


def ros_frames_of(bundle: Bundle, settings: FlightSettings) -> RosFrames:
    """How the camera sits on the vehicle and how the room lies in ROS's map.

    Raises:
        SettingError: the direction of gravity is along the room's x axis.
    """
    down = bundle.down if settings.down is None else np.array(settings.down)
    return RosFrames(settings.mount.T_body_camera, down)


def step_recorder(
    path: Path, as_it_comes: bool, bundle: Bundle, camera: Camera, settings: FlightSettings
) -> StepRecorder:
    """A writer of results to a new file.

    Args:
        path, as_it_comes: as :class:`~monoloc.ros.mcap_file.McapFile`.
        bundle, camera, settings: of the flight.

    Raises:
        DataError: the file cannot be written, at once or later.
        MissingExtraError: the extra ``mcap`` is not installed.
        SettingError: as :func:`ros_frames_of`.
    """
    frames = ros_frames_of(bundle, settings)
    with_obstacles = settings.obstacles and bundle.provenance.tune != "none"
    return StepRecorder(McapFile(path, as_it_comes), frames, camera, with_obstacles)


class McapLog:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that writes the file.

    Args:
        recorder: writes the results.
        clock_offset_s: of ROS's clock, which counts from 1970, against that of the times of capture.
    """

    def __init__(self, recorder: StepRecorder, clock_offset_s: float) -> None:
        self._recorder, self._clock_offset_s = recorder, clock_offset_s
        self._failed = False

    def take(self, result: FlightStep) -> None:
        frame = result.frame
        self._failed = True  # unless it succeeds
        self._recorder.add(frame.captured_s + self._clock_offset_s, frame.color, result.step)
        self._failed = False

    def idle(self, now_s: float) -> None:
        """Nothing: there are messages of frames only."""

    def close(self) -> None:
        """Raises DataError if the file cannot be written, and :meth:`take` did not say so."""
        try:
            if not self._failed:
                self._recorder.file.finish()
        finally:
            self._recorder.file.close()
