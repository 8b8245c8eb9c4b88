"""A flight as an MCAP file of ROS 2 messages, written as it comes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.flight_settings import FlightSettings, LevelMap, down_of_map
from monoloc.flight.writer_thread import WriterThread
from monoloc.ros.mcap_file import McapFile, StepRecorder
from monoloc.ros.ros_frames import RosFrames
from monoloc.step import Step

_MOST_IMAGES = 32  # that wait for the disk, 30 MB at 640x480; with more waiting, frames come without image
_MOST_FRAMES = 300  # that wait for it; more are dropped


def ros_frames_of(map_: LevelMap, settings: FlightSettings) -> RosFrames:
    """How the camera sits on the vehicle and how the room, or the first room of a place, lies in ROS's map.

    Raises:
        SettingError: the direction of gravity is along the room's x axis, or settings and map contradict each other.
    """
    return RosFrames(settings.mount.T_body_camera, down_of_map(map_, settings))


def step_recorder(
    path: Path, as_it_comes: bool, map_: LevelMap, camera: Camera, settings: FlightSettings, tells_obstacles: bool
) -> StepRecorder:
    """A writer of results to a new file.

    Args:
        path, as_it_comes: as :class:`~monoloc.ros.mcap_file.McapFile`.
        map_, camera, settings: of the flight.
        tells_obstacles: whether depth may be taken for obstacles; in a place, each frame says it.

    Raises:
        DataError: the file cannot be written, at once or later.
        MissingExtraError: the extra ``mcap`` is not installed.
        SettingError: as :func:`ros_frames_of`.
    """
    frames = ros_frames_of(map_, settings)
    return StepRecorder(McapFile(path, as_it_comes), frames, camera, settings.obstacles and tells_obstacles)


class McapLog:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that writes the file.

    A thread makes and writes the messages. Where the disk is slower than the camera, images are dropped first, then
    frames; the flight does not wait. A kill takes what waits.

    Args:
        recorder: writes the results.
        clock_offset_s: of ROS's clock, which counts from 1970, against that of the times of capture.
        dropped: counts what was not written, by kind.
    """

    def __init__(self, recorder: StepRecorder, clock_offset_s: float, dropped: Counter[str]) -> None:
        self._recorder, self._clock_offset_s, self._dropped = recorder, clock_offset_s, dropped
        self._thread: WriterThread[tuple[float, NDArray[np.uint8] | None, Step, str | None]] = WriterThread(
            "mcap", lambda frame: recorder.add(*frame), _MOST_FRAMES
        )

    def take(self, result: FlightStep) -> None:
        """Raises DataError if an earlier frame could not be written."""
        time_s = result.frame.captured_s + self._clock_offset_s
        color = result.frame.color if self._thread.waiting < _MOST_IMAGES else None
        step = result.step if result.in_place is None else result.in_place.in_first_room(result.step)
        if not self._thread.put((time_s, color, step, result.room)):
            self._dropped["mcap frames"] += 1
        elif color is None:
            self._dropped["mcap images"] += 1

    def idle(self, now_s: float) -> None:
        """Nothing: there are messages of frames only."""

    def close(self) -> None:
        """Raises DataError if the file cannot be written, and :meth:`take` did not say so."""
        self._thread.close(self._release)

    def _release(self) -> None:
        try:
            if not self._thread.has_failed:
                self._recorder.file.finish()
        finally:
            self._recorder.file.close()
