"""A flight on disk, from which it can be computed again: ``monoloc fly --record`` and ``monoloc replay``.

::

    flight.json      bundle, camera, start, seed and settings
    frames.jsonl     one line a localised frame: times, gravity; and one whenever no frame came
    images/          the frames, PNG
    poses.csv        what was computed, see :mod:`monoloc.flight.pose_log`
    messages.tlog    what was sent to the autopilot, where there was one
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from monoloc.camera import Camera
from monoloc.config import describe
from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.pose_log import PoseLog
from monoloc.geometry import FloatArray
from monoloc.mavlink.firmware import Firmware
from monoloc.start import Start
from monoloc.version import __version__

_HEADER, _FRAMES, _IMAGES, POSES, MESSAGES = "flight.json", "frames.jsonl", "images", "poses.csv", "messages.tlog"
_QUEUED = 32  # images that wait for the disk, before the flight waits for it
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class FlightHeader(BaseModel):
    """What a flight began with.

    Attributes:
        monoloc_version: that computed it.
        bundle: path.
        digest: of the bundle, see :func:`monoloc.bundle.digest_of`.
        camera: of the images.
        start: ``T_world_camera`` as 16 numbers, row by row, and its errors in metres and radians; None without one.
        seed: of the localizer.
        settings: of the flight.
        firmware: that messages were written for; None without an autopilot.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    monoloc_version: str = __version__
    bundle: str
    digest: str
    camera: Camera
    start: tuple[tuple[float, ...], float, float] | None
    seed: int
    settings: FlightSettings
    firmware: Firmware | None = None

    def localizer_start(self) -> Start | None:
        """The start, as the localizer takes it."""
        if self.start is None:
            return None
        pose, error_m, error_rad = self.start
        return Start(np.reshape(pose, (4, 4)), error_m, error_rad)


class RecordedFrame(BaseModel):
    """A localised frame.

    Attributes:
        captured_s, elapsed_s, done_s: see :class:`~monoloc.flight.flight_loop.FlightStep`.
        down_camera: direction of gravity that was used, or None.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    captured_s: float
    elapsed_s: float
    done_s: float
    down_camera: tuple[float, float, float] | None

    @property
    def down(self) -> FloatArray | None:
        return None if self.down_camera is None else np.array(self.down_camera)


class RecordedIdle(BaseModel):
    """A tenth of a second in which no frame came."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    idle_s: float


_EVENT: TypeAdapter[RecordedFrame | RecordedIdle] = TypeAdapter(RecordedFrame | RecordedIdle)


class FlightRecorder:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that writes a flight's folder.

    A thread writes the images. Where the disk is slower than the camera for long, the flight waits for it, and the
    source drops frames: what is recorded is whole.

    Args:
        folder: new or empty.
        header: is written at once.

    Raises:
        DataError: the folder is not empty, or cannot be written to.
    """

    def __init__(self, folder: Path, header: FlightHeader) -> None:
        if folder.exists() and any(folder.iterdir()):
            raise DataError(folder, "is not empty", "name a new folder for this flight")
        (folder / _IMAGES).mkdir(parents=True, exist_ok=True)
        write_whole(folder / _HEADER, header.model_dump_json(indent=2).encode())
        self.folder = folder
        self._poses = PoseLog(folder / POSES)
        self._frames = (folder / _FRAMES).open("w", encoding="utf-8")
        self._count = 0
        self._failure: Exception | None = None
        self._images: queue.Queue[tuple[int, NDArray[np.uint8]] | None] = queue.Queue(_QUEUED)
        self._thread = threading.Thread(target=self._write_images, name="flight recorder", daemon=True)
        self._thread.start()

    def take(self, result: FlightStep) -> None:
        """Raises DataError if an image could not be written."""
        if self._failure is not None:
            raise self._failure
        self._images.put((self._count, result.frame.color))
        self._count += 1
        down = result.down_camera
        frame = RecordedFrame(
            captured_s=result.frame.captured_s,
            elapsed_s=result.elapsed_s,
            done_s=result.done_s,
            down_camera=None if down is None else (float(down[0]), float(down[1]), float(down[2])),
        )
        self._write(frame)
        self._poses.take(result)

    def idle(self, now_s: float) -> None:
        self._write(RecordedIdle(idle_s=now_s))

    def close(self) -> None:
        """Raises DataError if an image could not be written."""
        self._images.put(None)
        self._thread.join()
        self._frames.close()
        self._poses.close()
        if self._failure is not None:
            raise self._failure

    def _write(self, line: RecordedFrame | RecordedIdle) -> None:
        self._frames.write(line.model_dump_json() + "\n")
        self._frames.flush()

    def _write_images(self) -> None:
        while (item := self._images.get()) is not None:
            index, color = item
            path = image_path(self.folder, index)
            if self._failure is None and not cv2.imwrite(
                str(path), cv2.cvtColor(color, cv2.COLOR_RGB2BGR), _FAST_PNG
            ):
                self._failure = DataError(path, "cannot be written", "check the space on this disk")


def image_path(folder: Path, index: int) -> Path:
    """Where a flight keeps the image of its frame ``index``."""
    return folder / _IMAGES / f"{index:06d}.png"


def read_header(folder: Path) -> FlightHeader:
    """What a recorded flight began with.

    Raises:
        DataError: it is missing, or not as written.
    """
    path = folder / _HEADER
    try:
        return FlightHeader.model_validate_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(path, "cannot be read", "give a folder that monoloc fly --record wrote") from error
    except (ValidationError, UnicodeDecodeError) as error:
        what = describe(error) if isinstance(error, ValidationError) else str(error)
        raise DataError(path, f"is damaged ({what})", "give another flight") from error


def read_events(folder: Path) -> Iterator[tuple[NDArray[np.uint8], RecordedFrame] | RecordedIdle]:
    """Images (H, W, 3) uint8 RGB with their times, and idle times of a recorded flight, in order.

    A last line that was cut is left out.

    Raises:
        DataError: a file is missing or damaged.
    """
    path, index = folder / _FRAMES, 0
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, start=1):
            if not line.endswith("\n"):
                return
            try:
                event = _EVENT.validate_json(line)
            except ValidationError as error:
                raise DataError(path, f"is damaged in line {number}", "give another flight") from error
            if isinstance(event, RecordedIdle):
                yield event
            else:
                yield _read_image(image_path(folder, index)), event
                index += 1


def _read_image(path: Path) -> NDArray[np.uint8]:
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if bgr is None:
        raise DataError(path, "cannot be read", "restore it, or give another flight")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
