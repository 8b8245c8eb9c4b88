"""The interface of recordings."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Indexable
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, is_rigid

LEAST_RATE_HZ, MOST_RATE_HZ = 1e-3, 1e4  # of a camera

# Simulates an image under different lighting: (H, W, 3) uint8 RGB -> the same.
Relight = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]


@runtime_checkable
class Recording(Protocol):
    """Frames of one camera in order of time, which are read on demand.

    Attributes:
        name: short name for reports.
        camera: intrinsics of the colour image; depth is registered to it and has the same size.
        frame_names: one name per frame, from its files.
        timestamps_s: (N,) seconds, increasing.
        poses: ``T_world_camera`` of the colour camera, (N, 4, 4) float64, or None if unknown.
        has_depth: whether the recording supports :meth:`depth`.
    """

    name: str
    camera: Camera
    frame_names: list[str]
    timestamps_s: FloatArray
    poses: FloatArray | None
    has_depth: bool

    def __len__(self) -> int: ...

    def color(self, index: int) -> NDArray[np.uint8]:
        """Image of frame ``index``: (height, width, 3) uint8, RGB.

        Raises:
            DataError: the file is missing, truncated, or of another size.
        """
        ...

    def depth(self, index: int) -> NDArray[np.float32]:
        """Depth of frame ``index``: (height, width) float32, metres along z, 0 where it is unknown.

        Raises:
            DataError: see :meth:`color`.
        """
        ...


def require_recording(recording: object) -> None:
    """Refuse what is no recording.

    Raises:
        TypeError: it is a path, or anything else.
    """
    if not isinstance(recording, Recording):
        way = "as monoloc.io.registry.open_recording(SOURCE) gives it"
        raise TypeError(f"recording must be a recording, {way}, got {type(recording).__name__}")


def check_arrays(recording: Recording) -> None:
    """Check that the arrays of a recording belong together, and its first images to its camera.

    Those of the readers do; a recording of a user's own may hold anything.

    Raises:
        ValueError: names, time stamps or poses are not one a frame or of another type, time runs backwards, a pose is
            not rigid, or the first frame's image or depth does not have the camera's size or the type of
            :class:`Recording`.
        DataError: the first frame cannot be read.
    """
    count, poses = len(recording), recording.poses
    _check_frame_names(recording.frame_names, count)
    for name, values in (("timestamps_s", recording.timestamps_s), ("poses", poses)):
        if not (values is None or isinstance(values, np.ndarray)):
            raise ValueError(f"{name} must be an array, got {type(values).__name__}; write np.array({name})")
    times_s = np.asarray(recording.timestamps_s)
    if times_s.shape != (count,):
        raise ValueError(f"timestamps_s must have shape ({count},), got {times_s.shape}")
    if not np.isfinite(times_s).all() or np.any(np.diff(times_s) < 0.0):
        raise ValueError("timestamps_s must be finite, and none before the previous one")
    if poses is not None and np.shape(poses) != (count, 4, 4):
        raise ValueError(f"poses must have shape ({count}, 4, 4), got {np.shape(poses)}")
    if poses is not None and not np.all(is_rigid(poses)):
        raise ValueError("poses must be rigid, T_world_camera")
    if count > 0:
        _check_first_frame(recording)


def _check_frame_names(names: Indexable[str], count: int) -> None:
    if len(names) != count:
        raise ValueError(f"frame_names must be {count}, one a frame, got {len(names)}")
    for name in names:
        if not isinstance(name, str):
            raise ValueError(f"frame_names must be strings, got {type(name).__name__}")


def _check_first_frame(recording: Recording) -> None:
    size = (recording.camera.height, recording.camera.width)
    color = np.asarray(recording.color(0))
    if color.shape != (*size, 3) or color.dtype != np.uint8:
        got = f"{color.shape} {color.dtype}"
        raise ValueError(f"color must have the camera's shape {(*size, 3)} as uint8, RGB, got {got}")
    if not recording.has_depth:
        return
    depth_m = np.asarray(recording.depth(0))
    if depth_m.shape != size or depth_m.dtype.kind != "f":
        got = f"{depth_m.shape} {depth_m.dtype}"
        raise ValueError(f"depth must have the camera's shape {size} as float32, metres, got {got}")


class Remark(str):
    """A note on how a recording was read that casts no doubt on it.

    For example which topics of a bag were taken, or what is assumed of all recordings of a format.
    """


class StoredRecording(Recording, Protocol):
    """A :class:`Recording` that was read from files.

    Attributes:
        notes: sentences on what a user may not expect: frames that are left out and why, metadata that was assumed;
            :class:`Remark` where nothing may be wrong.
    """

    notes: list[str]


class Selection:
    """A :class:`Recording` of some frames of another, selected by their ``positions`` in the source."""

    def __init__(self, source: Recording, positions: Indexable[int] | NDArray[np.int64]) -> None:
        self.source = source
        self.positions = np.asarray(positions, dtype=np.int64)
        self.name = source.name
        self.camera = source.camera
        self.frame_names = [source.frame_names[p] for p in self.positions]
        self.timestamps_s = source.timestamps_s[self.positions]
        self.poses = None if source.poses is None else source.poses[self.positions]
        self.has_depth = source.has_depth
        self.scale_sd, self.down_world = scale_sd_of(source), recorded_down(source)

    def __len__(self) -> int:
        return len(self.positions)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self.source.color(int(self.positions[index]))

    def depth(self, index: int) -> NDArray[np.float32]:
        return self.source.depth(int(self.positions[index]))


def selected_from(recording: Recording) -> Recording:
    """The recording that frames are selected from; itself, if it is no selection."""
    return recording.source if isinstance(recording, Selection) else recording


def narrowed(recording: Recording, frames: NDArray[np.int64]) -> Selection:
    """Some frames of a recording. Those of a selection are selected from its source, with the selection's poses.

    A subclass of :class:`Selection` alters what it selects, so that it is a source itself.
    """
    if type(recording) is not Selection:
        return Selection(recording, frames)
    chosen = Selection(recording.source, recording.positions[frames])
    chosen.poses = None if recording.poses is None else recording.poses[frames]
    return chosen


def scale_sd_of(recording: Recording) -> float | None:
    """Relative standard deviation of the scale of poses and depth; None where a sensor measured them in metres."""
    return getattr(recording, "scale_sd", None)


def recorded_down(recording: Recording) -> FloatArray | None:
    """Direction of gravity in the world of the poses, (3,) unit vector; None where the format does not tell it."""
    return getattr(recording, "down_world", None)


def evenly_spaced(count: int, most: int) -> NDArray[np.int64]:
    """Indices of at most ``most`` of ``count`` frames, spread evenly over them."""
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.int64))
