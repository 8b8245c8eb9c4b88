"""A flight on disk, from which it can be computed again: ``monoloc fly --record`` and ``monoloc replay``.

::

    flight.json      bundle or place, camera, start, seed and settings
    frames.jsonl     one line a localised frame: times, gravity, rotation; and one whenever no frame came or one was
                     dropped
    images/          the frames, PNG
    poses.csv        what was computed, see :mod:`monoloc.flight.pose_log`
    messages.tlog    what was sent to the autopilot, where there was one
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from monoloc.camera import Camera
from monoloc.component_checks import MOST_ELAPSED_S
from monoloc.config import describe
from monoloc.errors import DataError, SettingError
from monoloc.files import write_whole
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.pose_log import PoseLog
from monoloc.flight.writer_thread import WriterThread
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_text
from monoloc.io.image_files import read_color
from monoloc.io.recorded_flight import FRAMES, HEADER, IMAGES, image_path, read_lines
from monoloc.mavlink.firmware import Firmware
from monoloc.odometry.motion import Motion
from monoloc.start import Start
from monoloc.step_budget import Level
from monoloc.version import __version__

POSES, MESSAGES = "poses.csv", "messages.tlog"
_QUEUED = 32  # frames that wait for the disk, before the flight waits for it
_MOST_WAIT_S = 0.5  # for the disk, before the recording ends: the pose matters more
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class RecordedStart(BaseModel):
    """A :class:`~monoloc.start.Start`, whose pose is 16 numbers, row by row."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    pose: tuple[float, ...] = Field(min_length=16, max_length=16)
    error_m: float = Field(ge=0.0, le=1e3)
    error_rad: float = Field(ge=0.0, le=1e3)

    @classmethod
    def of(cls, start: Start | None) -> RecordedStart | None:
        if start is None:
            return None
        return cls(
            pose=tuple(start.pose.ravel().tolist()), error_m=float(start.error_m), error_rad=float(start.error_rad)
        )

    @property
    def start(self) -> Start:
        """Raises ValueError if it is none."""
        return Start(np.reshape(self.pose, (4, 4)), self.error_m, self.error_rad)


class FlightHeader(BaseModel):
    """What a flight began with.

    Attributes:
        monoloc_version: that computed it.
        bundle: path of the bundle, or of the place.
        digest: of either, see :func:`monoloc.place.flown_map.digest_of_map`.
        camera: of the images.
        start: of the localizer; None without one.
        seed: of the localizer.
        settings: of the flight.
        firmware: that messages were written for; None without an autopilot.
        stands_upright: whether the images are known to be upright, by ``[mount]`` or by gravity.
        waits_for_marker: whether no frame was localised before a marker was seen.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    monoloc_version: str = __version__
    bundle: str
    digest: str
    camera: Camera
    start: RecordedStart | None
    seed: int = Field(ge=0)
    settings: FlightSettings
    firmware: Firmware | None = None
    stands_upright: bool = False
    waits_for_marker: bool = False


class RecordedRotation(BaseModel):
    """A motion of which only the rotation is known: nine numbers, row by row, and its standard deviation."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    R_previous_current: tuple[float, ...] = Field(min_length=9, max_length=9)
    sd_rad: float

    @classmethod
    def of(cls, motion: Motion | None) -> RecordedRotation | None:
        if motion is None or motion.rotation_sd_rad is None:
            return None
        rotation = motion.T_previous_current[:3, :3]
        return cls(R_previous_current=tuple(rotation.ravel().tolist()), sd_rad=motion.rotation_sd_rad)

    @model_validator(mode="after")
    def _check(self) -> RecordedRotation:
        self.motion  # noqa: B018 - raises where it is no rotation
        return self

    @property
    def motion(self) -> Motion:
        return Motion.rotation(np.reshape(self.R_previous_current, (3, 3)), self.sd_rad)


_TimeS = Annotated[float, Field(ge=-MOST_ELAPSED_S, le=MOST_ELAPSED_S)]


class RecordedFrame(BaseModel):
    """A localised frame.

    Attributes:
        captured_s, elapsed_s, done_s: see :class:`~monoloc.flight.flight_loop.FlightStep`.
        down_camera: direction of gravity that was used, or None.
        start: from which the localizer began anew at this frame, or None.
        rotation: since the previous frame by the autopilot's attitude that was used, or None.
        level: what the step left out to keep its budget, which the clock decided.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    captured_s: _TimeS
    elapsed_s: float = Field(ge=0.0, le=MOST_ELAPSED_S)
    done_s: _TimeS
    down_camera: tuple[float, float, float] | None
    start: RecordedStart | None = None
    rotation: RecordedRotation | None = None
    level: Level = Level.FULL

    @model_validator(mode="after")
    def _check(self) -> RecordedFrame:
        if self.start is not None:
            self.start.start  # noqa: B018 - raises where it is none
        if self.down_camera is not None and not 1e-6 < math.hypot(*self.down_camera) < 1e6:
            raise ValueError("down_camera has no direction")
        return self

    @property
    def motion(self) -> Motion | None:
        return None if self.rotation is None else self.rotation.motion

    @property
    def down(self) -> FloatArray | None:
        return None if self.down_camera is None else np.array(self.down_camera)


class RecordedIdle(BaseModel):
    """A tenth of a second in which no frame came, or a frame that was dropped."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    idle_s: _TimeS


_EVENT: TypeAdapter[RecordedFrame | RecordedIdle] = TypeAdapter(RecordedFrame | RecordedIdle)


class FlightRecorder:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that writes a flight's folder.

    A thread writes, a frame's line after its image and its pose: what has a line is whole, even after a kill. Where
    the disk is slower than the camera the flight waits for it, and the source drops frames; where it stands still the
    recording ends, and the flight goes on.

    Args:
        folder: new or empty.
        header: is written at once.
        has_rooms: as :class:`~monoloc.flight.pose_log.PoseLog`.

    Raises:
        DataError: the folder is not empty, or cannot be written to, at once or later.
    """

    def __init__(self, folder: Path, header: FlightHeader, has_rooms: bool = False) -> None:
        self.folder = folder
        self._make_folder()
        try:
            write_whole(folder / HEADER, header.model_dump_json(indent=2).encode())
        except DataError:  # such as on a full disk: the same command must work once there is room
            (folder / IMAGES).rmdir()
            raise
        self._poses = PoseLog(folder / POSES, has_rooms)
        self._frames = (folder / FRAMES).open("w", encoding="utf-8")
        self._count = 0
        self._thread: WriterThread[FlightStep | RecordedIdle] = WriterThread("flight recorder", self._write, _QUEUED)

    def take(self, result: FlightStep) -> None:
        """Raises DataError if an earlier frame could not be written."""
        self._hand_over(result)

    def idle(self, now_s: float) -> None:
        """Raises DataError as :meth:`take`: what is sent to an autopilot depends on it too."""
        self._hand_over(RecordedIdle(idle_s=now_s))

    def close(self) -> None:
        """Raises DataError if a frame could not be written and neither :meth:`take` nor :meth:`idle` said so."""
        self._thread.close(self._release)

    def _release(self) -> None:
        with contextlib.suppress(OSError):  # only what a write that failed has left is not yet in the file
            self._frames.close()
        self._poses.close()

    def _make_folder(self) -> None:
        try:
            if self.folder.exists() and any(self.folder.iterdir()):
                raise DataError(self.folder, "is not empty", "name a new folder for this flight")
            (self.folder / IMAGES).mkdir(parents=True)
        except OSError as error:
            fix = "name a new folder in one you can write to"
            raise DataError(self.folder, f"cannot be made ({error.strerror})", fix) from error

    def _hand_over(self, event: FlightStep | RecordedIdle) -> None:
        if not self._thread.put(event, _MOST_WAIT_S):
            problem = "cannot be written as fast as the frames come"
            self._thread.fail(DataError(self.folder, problem, "use a faster disk"))

    def _write(self, event: FlightStep | RecordedIdle) -> None:
        if isinstance(event, RecordedIdle):
            self._write_line(event)
            return
        bgr = cv2.cvtColor(event.frame.color, cv2.COLOR_RGB2BGR)
        content = cv2.imencode(".png", bgr, _FAST_PNG)[1].tobytes()
        write_whole(image_path(self.folder, self._count), content, is_synced=False)
        self._count += 1
        self._poses.take(event)
        down = event.down_camera
        self._write_line(
            RecordedFrame(
                captured_s=event.frame.captured_s,
                elapsed_s=event.elapsed_s,
                done_s=event.done_s,
                down_camera=None if down is None else (float(down[0]), float(down[1]), float(down[2])),
                start=RecordedStart.of(event.start),
                rotation=RecordedRotation.of(event.measured_motion),
                level=event.step.level,
            )
        )

    def _write_line(self, line: RecordedFrame | RecordedIdle) -> None:
        try:
            self._frames.write(line.model_dump_json() + "\n")
            self._frames.flush()
        except OSError as error:
            fix = "make room, or choose another disk"
            raise DataError(self.folder / FRAMES, f"cannot be written ({error.strerror})", fix) from error


def read_header(folder: Path) -> FlightHeader:
    """What a recorded flight began with.

    Raises:
        DataError: it is missing, or not as written.
    """
    path = folder / HEADER
    if not path.is_file():
        raise DataError(folder, f"is no recorded flight (no {HEADER})", "give a folder of monoloc fly --record")
    try:
        header = FlightHeader.model_validate_json(read_text(path))
        if header.start is not None:
            header.start.start  # noqa: B018 - raises where it is none
    except (ValueError, SettingError) as error:
        what = describe(error) if isinstance(error, ValidationError) else " ".join(str(error).split())
        raise DataError(path, f"is damaged ({what})", "give another flight") from error
    return header


def read_events(folder: Path, camera: Camera) -> Iterator[tuple[NDArray[np.uint8], RecordedFrame] | RecordedIdle]:
    """Images (H, W, 3) uint8 RGB with their times, and idle times of a recorded flight, in order.

    They end where the disk had taken no more when the computer was killed or lost its power: at a line that is cut,
    or at an image that is empty or missing.

    Args:
        folder: of the flight.
        camera: of the images.

    Raises:
        DataError: a file is damaged, there are no lines, or an image has another size.
    """
    for line in read_lines(folder):
        if not line.is_kept:
            return
        try:
            event = _EVENT.validate_python(line.content)
        except ValidationError as error:
            raise DataError(folder / FRAMES, f"is damaged in line {line.number}", "give another flight") from error
        if line.image is None:
            assert isinstance(event, RecordedIdle)
            yield event
        else:
            assert isinstance(event, RecordedFrame)
            yield read_color(line.image, camera), event
