"""Reader of Record3D's ``.r3d`` files (iPhone or iPad): JPEG images, LZFSE-compressed depth and ARKit's poses.

A ``.r3d`` is a zip archive, and may be unpacked, or packed again with the folder around its files: ``metadata``
(JSON) and ``rgbd/N.jpg``, ``rgbd/N.depth`` (float32 metres, dh x dw) and ``rgbd/N.conf`` (uint8: 0, 1, 2), of the
same field of view as colour (h x w). ``poses`` holds ``qx, qy, qz, qw, x, y, z``, camera to world, with OpenGL's
camera axes; the first pose is the identity, so the world is not level. ``K`` is stored by columns, and
``perFrameIntrinsicCoeffs`` holds ``fx, fy, cx, cy`` of each image.

Only depth of the highest confidence is used, for the reason in :mod:`monoloc.io.stray_scanner`.
"""

from __future__ import annotations

import importlib
import lzma
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, MissingExtraError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import decode_json, json_number, json_rows, numbers_of, read_bytes, require_file
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import one_camera, stated_by
from monoloc.io.image_files import decode_color, fit_depth, metric_depth
from monoloc.io.image_resampling import Resampler
from monoloc.io.pose_files import OPENGL_AXES, check_increasing, poses_from_quaternions
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import LEAST_RATE_HZ, MOST_RATE_HZ, Remark
from monoloc.io.stray_scanner import HIGH_CONFIDENCE, NO_CONFIDENCE

_METADATA = "metadata"
_MOST_BYTES = 1 << 26  # of a member of the archive
_UNCOMPRESSIBLE_BYTES = 4096  # most that LZFSE adds to data that it cannot compress
_AGAIN = "export the .r3d from Record3D again"
UNKNOWN_UPRIGHT = Remark(
    "its images are taken to stand upright, as the format does not tell how the phone was held; if they lie on their "
    "side, record again with a phone that is turned by a quarter"
)


def recognises(path: Path) -> bool:
    """Whether a file is named ``*.r3d``, or a folder contains ``metadata`` and ``rgbd``."""
    return (path.is_file() and path.suffix.lower() == ".r3d") or (
        (path / _METADATA).is_file() and (path / "rgbd").is_dir()
    )


def read(path: Path, options: ReaderOptions) -> Record3DRecording:
    """Open a ``.r3d`` file or the folder of an unpacked one. Frames without image, depth or confidence are left out.

    Raises:
        DataError: the file is not such an archive, its metadata is malformed, or no frame remains.
        MissingExtraError: it has depth, and the decoder of LZFSE is not installed.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("record3d", "camera")
    return Record3DRecording(_Archive(path), options)


class Record3DRecording:
    """A :class:`~monoloc.io.recording.StoredRecording` of a ``.r3d``."""

    def __init__(self, archive: _Archive, options: ReaderOptions) -> None:
        path = archive.path
        self._archive = archive
        metadata_path = path / _METADATA
        metadata = decode_json(archive.read(_METADATA).decode("utf-8", errors="replace"), metadata_path)
        poses = _poses(metadata, metadata_path)
        times_s, cameras = _times(metadata, len(poses), metadata_path), _cameras(metadata, len(poses), metadata_path)
        frames = FrameFilter(len(poses))
        frames.require([archive.has(f"rgbd/{n}.jpg") for n in range(len(poses))], "without an image")
        with_depth = [archive.has(f"rgbd/{n}.depth") for n in range(len(poses))]
        self.has_depth = frames.require_if_any(with_depth, "without depth")
        self.notes: list[str] = [UNKNOWN_UPRIGHT]
        self._depth_size = (0, 0)
        if self.has_depth:
            _decoder()
            with_confidence = [archive.has(f"rgbd/{n}.conf") for n in range(len(poses))]
            if not frames.require_if_any(with_confidence, "without confidence"):
                self.notes.append(NO_CONFIDENCE)
            self._depth_size = (_size(metadata, "dw", metadata_path), _size(metadata, "dh", metadata_path))
        self.camera, own_cameras = one_camera(cameras, options, frames)
        self._numbers = frames.positions(path, _AGAIN)
        self._resampler = None
        if own_cameras is not None:
            self._resampler = Resampler(self.camera, [own_cameras[n] for n in self._numbers])
        self.name = path.resolve().stem
        self.frame_names = [f"{number:06d}" for number in self._numbers]
        self.timestamps_s = times_s[self._numbers]
        check_increasing(self.timestamps_s, metadata_path)
        self.poses: FloatArray | None = poses[self._numbers]
        self.notes += frames.notes()
        self.color(0)

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        member = f"rgbd/{self._numbers[index]}.jpg"
        image = decode_color(self._archive.read(member), self._archive.path / member, self.camera)
        return image if self._resampler is None else self._resampler.color(index, image)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        if not self.has_depth:
            raise DataError(
                self._archive.path, "has no depth", "record with the LiDAR sensor, or use predicted depth"
            )
        stem = f"rgbd/{self._numbers[index]}"
        depth_m = metric_depth(self._decompressed(f"{stem}.depth", np.float32), 1.0)
        if self._archive.has(f"{stem}.conf"):
            depth_m[self._decompressed(f"{stem}.conf", np.uint8) < HIGH_CONFIDENCE] = 0.0
        depth_m = fit_depth(depth_m, self._archive.path / f"{stem}.depth", self.camera)
        return depth_m if self._resampler is None else self._resampler.depth(index, depth_m)

    def _decompressed(self, member: str, dtype: type[np.float32 | np.uint8]) -> NDArray[Any]:
        """Array (dh, dw) of a member that LZFSE compresses."""
        width, height = self._depth_size
        path = self._archive.path / member
        expected = width * height * np.dtype(dtype).itemsize
        data = self._archive.read(member)
        if len(data) > expected + _UNCOMPRESSIBLE_BYTES:
            raise DataError(path, f"holds {len(data)} bytes for {width}x{height} pixels", _AGAIN)
        decoder = _decoder()
        try:
            content = decoder.decompress(data)
        except (decoder.error, MemoryError) as error:
            raise DataError(path, "cannot be decompressed", _AGAIN) from error
        if len(content) != expected:
            raise DataError(
                path, f"holds {len(content)} bytes, but the metadata's {width}x{height} pixels are {expected}", _AGAIN
            )
        return np.frombuffer(content, dtype=dtype).reshape(height, width)


class _Archive:
    """Members of a ``.r3d``, zipped or unpacked.

    It is opened once by each process that uses it: a list of tens of thousands of members is read for a second.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._members: dict[str, int] | None = None  # uncompressed size of each; None of a folder
        self._opened: tuple[int, zipfile.ZipFile] | None = None  # by the process of this number
        self._within = ""  # folder of the archive that holds the members, where it was packed again with one
        if not path.is_dir():
            require_file(path.absolute(), "give a .r3d file of Record3D, or the folder of an unpacked one")
            try:
                self._members = {each.filename: each.file_size for each in self._file().infolist()}
            except (zipfile.BadZipFile, OSError) as error:
                raise DataError(path, f"cannot be read as a .r3d archive ({error})", _AGAIN) from error
            inner = [name for name in self._members if name.endswith(f"/{_METADATA}")]
            if _METADATA not in self._members and len(inner) == 1:
                self._within = inner[0].removesuffix(_METADATA)
        if not self.has(_METADATA):
            raise DataError(path, f"has no {_METADATA}", _AGAIN)

    def has(self, member: str) -> bool:
        if self._members is None:
            return (self.path / member).is_file()
        return self._within + member in self._members

    def read(self, member: str) -> bytes:
        """Content of a member; its size is checked first."""
        if self._members is None:
            return read_bytes(self.path / member)
        stored = self._within + member
        if self._members[stored] > _MOST_BYTES:
            raise DataError(self.path / member, f"says it is {self._members[stored] / 1e6:.0f} MB", _AGAIN)
        try:
            return self._file().read(stored)
        # RuntimeError: encrypted, or compressed by a method that this Python lacks.
        except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, RuntimeError) as error:
            raise DataError(self.path / member, "cannot be unpacked", "copy the .r3d file again") from error

    def _file(self) -> zipfile.ZipFile:
        """The archive, opened by this process: with its parent it would share the place that is read."""
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = (os.getpid(), zipfile.ZipFile(self.path))
        return self._opened[1]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": None}


def _decoder() -> Any:
    """The module ``lzfse``, which is optional and has no types."""
    try:
        return importlib.import_module("lzfse")
    except ImportError as error:
        raise MissingExtraError("reading Record3D's depth", "record3d") from error


def _size(metadata: dict[str, Any], key: str, path: Path) -> int:
    value = json_number(metadata, key, path)
    if value != int(value) or not 0 < value < 1 << 14:
        raise DataError(path, f"{key} is {value!r}, not an image size", _AGAIN)
    return int(value)


def _poses(metadata: dict[str, Any], path: Path) -> FloatArray:
    """``T_world_camera`` of all frames, (N, 4, 4)."""
    rows = json_rows(metadata, "poses", 7, path)
    return poses_from_quaternions(rows[:, :4], rows[:, 4:], path) @ OPENGL_AXES


def _times(metadata: dict[str, Any], count: int, path: Path) -> FloatArray:
    """Time stamps (N,) seconds; early versions state a frame rate only."""
    if metadata.get("frameTimestamps") is None:
        rate_hz = json_number(metadata, "fps", path)
        if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
            raise DataError(path, f"fps is {rate_hz!r}, the rate of no camera", _AGAIN)
        return np.asarray(np.arange(count) / rate_hz)
    times_s = numbers_of(metadata["frameTimestamps"])
    if times_s.shape != (count,):
        raise DataError(path, f"frameTimestamps are not the {count} numbers of its poses", _AGAIN)
    return times_s


def _cameras(metadata: dict[str, Any], count: int, path: Path) -> list[Camera]:
    """Camera of each image; all the same if there is one K."""
    size = (_size(metadata, "w", path), _size(metadata, "h", path))
    with stated_by(path):
        if metadata.get("perFrameIntrinsicCoeffs"):
            rows = json_rows(metadata, "perFrameIntrinsicCoeffs", 4, path)
            if len(rows) != count:
                raise DataError(path, f"perFrameIntrinsicCoeffs has {len(rows)} rows for {count} poses", _AGAIN)
            return [Camera(*size, *row) for row in rows.tolist()]
        (k,) = json_rows({"K": [metadata.get("K")]}, "K", 9, path).tolist()
        return [Camera(*size, k[0], k[4], k[6], k[7])] * count
