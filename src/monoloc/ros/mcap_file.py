"""MCAP files of ROS 2 messages (https://mcap.dev/spec), by the packages ``mcap`` and ``mcap-ros2-support``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.extras import require_extra
from monoloc.files import target_of
from monoloc.partial_files import PartialFile
from monoloc.ros.message_contents import TopicMessage
from monoloc.ros.message_definitions import definition_of
from monoloc.ros.ros_frames import RosFrames
from monoloc.ros.step_messages import ImageMessages, StepMessages
from monoloc.step import Step

if TYPE_CHECKING:
    from mcap.records import Schema

_CHUNK_BYTES = 64 * 1024  # before compression: what a kill may take away
_MOST_NS = 2**31 * 10**9  # of a stamp of ROS


class McapFile:
    """Writes messages to a file, chunk by chunk.

    Args:
        path: is replaced.
        as_it_comes: whether the file is there at once, and after a kill holds all but the last chunk; otherwise it
            appears whole by :meth:`finish`, or not at all.

    Raises:
        DataError: it cannot be written, at once or later.
        MissingExtraError: the packages are not installed.
    """

    def __init__(self, path: Path, as_it_comes: bool) -> None:
        require_extra("mcap")
        from mcap_ros2.writer import Writer

        self._path, target = path, target_of(path)
        try:
            self._partial = None if as_it_comes else PartialFile(target)
            self._file = (target if self._partial is None else self._partial.path).open("wb")
        except OSError as error:
            raise self._cannot_be_written(error, "name a file in a folder you can write to") from error
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._schemas: dict[str, Schema] = {}

    def write(self, messages: Iterable[TopicMessage]) -> None:
        """Add messages.

        Raises:
            DataError: the file cannot be written, or a stamp is before 1970 or after 2038.
        """
        try:
            for message in messages:
                self._write(message)
            self._file.flush()
        except OSError as error:
            raise self._cannot_be_written(error, "make room, or choose another disk") from error

    def _write(self, message: TopicMessage) -> None:
        if not 0 <= message.stamp_ns < _MOST_NS:
            problem = f"cannot hold the time {message.stamp_ns / 1e9:.3f} s, which is before 1970 or after 2038"
            raise DataError(self._path, problem, "correct the recording's time stamps, or write another format")
        if message.kind not in self._schemas:
            name = message.kind.replace("/", "/msg/")
            self._schemas[message.kind] = self._writer.register_msgdef(name, definition_of(message.kind))
        schema = self._schemas[message.kind]
        self._writer.write_message(message.topic, schema, message.content, log_time=message.stamp_ns)

    def finish(self) -> None:
        """Write the index, and close the file.

        Raises:
            DataError: the file cannot be written.
        """
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
            if self._partial is not None:
                self._partial.finish()
        except OSError as error:
            raise self._cannot_be_written(error, "make room, or choose another disk") from error

    def close(self) -> None:
        """Close the file as it is, and remove it if it was to appear whole; after :meth:`finish`, do nothing."""
        with contextlib.suppress(OSError):  # only what a write that failed has left is not yet in the file
            self._file.close()
        if self._partial is not None:
            self._partial.close()

    def _cannot_be_written(self, error: OSError, fix: str) -> DataError:
        return DataError(self._path, f"cannot be written ({error.strerror})", fix)


class StepRecorder:
    """Writes a localizer's results and its images to an :class:`McapFile`.

    Args:
        file: to write to.
        frames: of vehicle and room.
        camera: of the images.
        with_obstacles: as :class:`~monoloc.ros.step_messages.StepMessages`.
    """

    def __init__(self, file: McapFile, frames: RosFrames, camera: Camera, with_obstacles: bool) -> None:
        self.file = file
        self._steps = StepMessages(frames, with_obstacles)
        self._images = ImageMessages(camera, frames.names.camera)

    def add(self, time_s: float, color: NDArray[np.uint8] | None, step: Step, room: str | None = None) -> None:
        """Write a frame: time of capture, image (H, W, 3) uint8 RGB or None, result, and the room of a place.

        Raises:
            DataError: as :meth:`McapFile.write`.
        """
        stamp_ns = round(time_s * 1e9)
        images = [] if color is None else self._images.of(stamp_ns, color)
        self.file.write([*images, *self._steps.of(stamp_ns, step, room=room)])
