"""Reader of NYU Depth v2's labelled set (Silberman et al., ECCV 2012): 1449 unposed pairs in one MATLAB 7.3 file.

``nyu_depth_v2_labeled.mat`` is HDF5: ``images`` (N, 3, 640, 480) uint8 and ``depths`` (N, 640, 480) float32
metres, with width before height as in MATLAB. Depth is registered to colour and in-painted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, MissingExtraError
from monoloc.io.file_access import require_file
from monoloc.io.reader_options import ReaderOptions

# Colour camera of the data set's toolbox for the full image; the images are undistorted.
FULL_CAMERA = Camera(width=640, height=480, fx=518.86, fy=519.47, cx=325.58, cy=253.74)
# Undistortion left a white border around the images; this window (left, top, width, height) excludes it.
VALID_WINDOW = (16, 12, 608, 456)

_DAMAGED = (OSError, KeyError, RuntimeError, ValueError, TypeError)  # of h5py, depending on what is damaged


def recognises(path: Path) -> bool:
    """Whether a file is named ``*.mat``."""
    return path.is_file() and path.suffix.lower() == ".mat"


def read(path: Path, options: ReaderOptions) -> NyuRecording:
    """Open the labelled .mat file; a camera override refers to the full 640x480 image.

    Raises:
        DataError: the file is missing or not HDF5, or has no images and depths of one size.
        MissingExtraError: h5py is not installed.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("nyu", "camera")
    return NyuRecording(path, options.camera_or(FULL_CAMERA))


class NyuRecording:
    """A :class:`~monoloc.io.recording.Recording` without poses; its time stamps are frame numbers.

    Images and depth are cropped to exclude the white border. The file is opened for each frame (about 1 ms), so that
    other processes can use the recording.
    """

    def __init__(self, path: Path, full_camera: Camera) -> None:
        require_file(path.absolute(), "give nyu_depth_v2_labeled.mat")
        self._path = path
        with _open_hdf5(path) as file:
            size = (full_camera.width, full_camera.height)
            images, depths = (_shape(file, key) for key in ("images", "depths"))
        if images is None or depths is None or len(images) != 4 or images[0] == 0:
            raise DataError(path, "has no images and depths", "give nyu_depth_v2_labeled.mat")
        if images[1:] != (3, *size) or depths != (images[0], *size):
            raise DataError(
                path,
                f"holds images {images} and depths {depths}",
                f"expected N images of {size[0]}x{size[1]}; copy the file again or give its intrinsics",
            )
        self.name = path.stem
        self.camera = full_camera.cropped(*VALID_WINDOW)
        self.frame_names = [f"{index:04d}" for index in range(images[0])]
        self.timestamps_s = np.arange(images[0], dtype=np.float64)
        self.poses: NDArray[np.float64] | None = None
        self.has_depth = True
        self.notes: list[str] = []

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        return np.ascontiguousarray(self._valid_window("images", index), dtype=np.uint8)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        depth_m = np.ascontiguousarray(self._valid_window("depths", index), dtype=np.float32)
        depth_m[~np.isfinite(depth_m)] = 0.0
        return depth_m

    def _valid_window(self, key: str, index: int) -> NDArray[Any]:
        left, top, width, height = VALID_WINDOW
        try:
            with _open_hdf5(self._path) as file:
                stored = file[key][index, ..., left : left + width, top : top + height]
        except _DAMAGED as error:
            raise DataError(self._path, f"frame {index} cannot be read", "copy the file again") from error
        return np.asarray(stored).T if stored.ndim == 2 else np.asarray(stored).transpose(2, 1, 0)


def _shape(file: Any, key: str) -> tuple[int, ...] | None:
    """Shape of an array of numbers in an open file; None if there is none, or its numbers are in another file."""
    try:
        stored = file[key]
        is_elsewhere = stored.external is not None or stored.is_virtual or stored.file != file
        return None if is_elsewhere or stored.dtype.kind not in "uif" else tuple(stored.shape)
    except (*_DAMAGED, AttributeError):  # a group has no shape
        return None


def _open_hdf5(path: Path) -> Any:
    """Open an ``h5py.File``; untyped, because h5py is optional."""
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("reading NYU's .mat file", "train") from error
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise DataError(path, "is cut short or not an HDF5 .mat file", "copy the file again") from error
