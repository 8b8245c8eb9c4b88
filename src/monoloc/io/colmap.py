"""Reader of COLMAP's models (structure from motion): posed images without depth, text or binary.

A model is ``cameras.txt`` and ``images.txt``, or ``.bin``, often in ``sparse/0`` beside the folder ``images``. Poses
are world to camera with w first in quaternions and OpenCV's axes; the centre of the top-left pixel is (0.5, 0.5).
Format: https://colmap.github.io/format.html; parameters of the cameras: COLMAP's ``sensor/models.h``. A model's scale
is arbitrary unless it was aligned. ``points3D`` is a cloud, see :mod:`monoloc.io.cloud_files`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np

from monoloc.camera import Camera
from monoloc.distortion import DistortionModel
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert
from monoloc.io.binary_reader import BinaryReader
from monoloc.io.file_access import read_text
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import one_camera, stated_by
from monoloc.io.images import ImageRecording, natural_order
from monoloc.io.pose_files import UNTIMED, UNTIMED_RATE_HZ, poses_from_quaternions
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Remark

_PLACES = ("", "sparse", "colmap/sparse")  # of a model, or of its numbered parts
_POINT_BYTES = 24  # of a point of an image
_AGAIN = "export the model again (colmap model_converter)"
_SCALE = Remark("the model's unit is taken to be one metre; if it is not, scale the model with colmap model_aligner")


@dataclass(frozen=True)
class _Lens:
    """A camera model: its number of parameters, and which of them are fx, fy, cx, cy and the distortion."""

    parameters: int
    intrinsics: tuple[int, int, int, int]
    distortion: tuple[int, ...] = ()
    model: DistortionModel = "brown"


_LENSES = {
    "SIMPLE_PINHOLE": _Lens(3, (0, 0, 1, 2)),
    "PINHOLE": _Lens(4, (0, 1, 2, 3)),
    "SIMPLE_RADIAL": _Lens(4, (0, 0, 1, 2), (3,)),
    "RADIAL": _Lens(5, (0, 0, 1, 2), (3, 4)),
    "OPENCV": _Lens(8, (0, 1, 2, 3), (4, 5, 6, 7)),
    "OPENCV_FISHEYE": _Lens(8, (0, 1, 2, 3), (4, 5, 6, 7), "fisheye"),
    "FULL_OPENCV": _Lens(12, (0, 1, 2, 3), tuple(range(4, 12)), "rational"),
}
_NAMES = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV"),
    *("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"),
)  # by the number in binary files


@dataclass(frozen=True)
class _Image:
    name: str
    camera: int
    quaternion_wxyz: tuple[float, ...]
    translation_m: tuple[float, ...]


def recognises(path: Path) -> bool:
    """Whether a folder contains a model or ``sparse``, in which :func:`read` asks for one."""
    return _model_of(path) is not None or (path / "sparse").is_dir()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open a model's folder, or a workspace with ``sparse/0`` and ``images``. Frames are sorted by name.

    COLMAP numbers the parts of a room that it could not connect; the largest of them is read. Images whose file is
    missing are left out, and so are those of another size or lens than most.

    Raises:
        DataError: there is no model, a file is malformed, a camera model is not supported, or no image is found.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("colmap", "camera")
    model = _model_of(path)
    if model is None:
        fix = "give the folder of cameras.bin and images.bin (or .txt), or the one that holds sparse/0"
        raise DataError(path.absolute(), "has no COLMAP model" if path.exists() else "does not exist", fix)
    cameras_path, images_path = (_file_of(model, name) for name in ("cameras", "images"))
    cameras = (_binary_cameras if cameras_path.suffix == ".bin" else _text_cameras)(cameras_path)
    images = (_binary_images if images_path.suffix == ".bin" else _text_images)(images_path)
    if not images:
        raise DataError(images_path, "holds no images", "give a model with registered images")
    images.sort(key=lambda image: natural_order(image.name))
    strange = next((image for image in images if image.camera not in cameras), None)
    if strange is not None:
        problem = f"{strange.name} is of camera {strange.camera}, which {cameras_path.name} lacks"
        raise DataError(images_path, problem, _AGAIN)
    folder = _image_folder(path, model, images)
    frames = FrameFilter(len(images))
    frames.require([(folder / image.name).is_file() for image in images], "without an image file")
    camera, own_cameras = one_camera([cameras[image.camera] for image in images], options, frames)
    used = frames.positions(images_path, f"put the images into {path / 'images'}")
    return ImageRecording(
        name=path.resolve().name,
        folder=folder,
        camera=camera,
        frame_names=[images[p].name for p in used],
        timestamps_s=np.arange(len(used)) / UNTIMED_RATE_HZ,
        poses=_poses(images, images_path)[used],
        color_paths=[folder / images[p].name for p in used],
        depth_paths=None,
        depth_scale=1.0,
        cameras=None if own_cameras is None else [own_cameras[p] for p in used],
        notes=[*(_other_parts(model) if model != path else []), *frames.notes(), UNTIMED, _SCALE],
    )


def _model_of(path: Path) -> Path | None:
    """Folder of the model: the path or a usual place in it, and the largest part of a model in parts."""
    for folder in (path / place for place in _PLACES):
        parts = [folder, *(each for each in sorted(folder.glob("*")) if each.name.isdecimal())]
        models = [each for each in parts if _has(each, "cameras") and _has(each, "images")]
        if models:
            return max(models, key=lambda model: _file_of(model, "images").stat().st_size)
    return None


def _other_parts(model: Path) -> list[str]:
    others = [each.name for each in model.parent.glob("*") if each.name.isdecimal() and each.name != model.name]
    if not (model.name.isdecimal() and others):
        return []
    return [f"the model has {len(others) + 1} parts; the largest, {model.name}, is used"]


def _has(folder: Path, name: str) -> bool:
    return any((folder / f"{name}{suffix}").is_file() for suffix in (".bin", ".txt"))


def _file_of(model: Path, name: str) -> Path:
    binary = model / f"{name}.bin"
    return binary if binary.is_file() else model / f"{name}.txt"


def _image_folder(path: Path, model: Path, images: list[_Image]) -> Path:
    """Folder that the names are relative to: the first of the usual ones that holds one of the images."""
    roots = [path, model, *model.resolve().parents[:2]]
    folders = [root / name for root in roots for name in ("images", "")]
    found = (each for each in folders if any((each / image.name).is_file() for image in images))
    return next(found, path / "images")


def _poses(images: list[_Image], path: Path) -> FloatArray:
    """``T_world_camera`` of all images, (N, 4, 4)."""
    quaternions_wxyz = np.array([image.quaternion_wxyz for image in images])
    translations_m = np.array([image.translation_m for image in images])
    return invert(poses_from_quaternions(np.roll(quaternions_wxyz, -1, axis=1), translations_m, path))


def camera_of(name: str, width: int, height: int, values: list[float], path: Path) -> Camera:
    """A camera by COLMAP's name of its model and the model's parameters.

    Args:
        path: the file that states them, for error messages.

    Raises:
        DataError: the model is not supported, or the parameters are those of no camera.
    """
    lens = _LENSES.get(name)
    if lens is None:
        fix = "undistort the images: colmap image_undistorter, and give the folder that it writes"
        raise DataError(path, f"camera model {name} is not supported", fix)
    if len(values) != lens.parameters:
        raise DataError(path, f"a {name} has {len(values)} parameters instead of {lens.parameters}", _AGAIN)
    fx, fy, cx, cy = (values[position] for position in lens.intrinsics)
    distortion = [values[position] for position in lens.distortion]
    if lens.model == "brown" and distortion:
        distortion += [0.0] * (4 - len(distortion))
    with stated_by(path):
        return Camera(width, height, fx, fy, cx - 0.5, cy - 0.5, tuple(distortion), lens.model)


def parameters_of(camera: Camera, name: str | None = None) -> tuple[str, list[float]]:
    """COLMAP's name of a camera's model, and the model's parameters.

    Args:
        name: a model that leaves out coefficients of the camera; None chooses one that has them all.
    """
    if name is None:
        has_k3 = camera.distortion_model == "brown" and camera.distortion[4] != 0.0
        rational = has_k3 or camera.distortion_model == "rational"
        name = (
            "FULL_OPENCV" if rational else {"brown": "OPENCV", "fisheye": "OPENCV_FISHEYE"}[camera.distortion_model]
        )
    lens = _LENSES[name]
    values = [0.0] * lens.parameters
    for position, value in zip(
        lens.intrinsics, (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5), strict=True
    ):
        values[position] = value
    for position, value in zip(lens.distortion, camera.distortion, strict=False):
        values[position] = value
    return name, values


def _text_cameras(path: Path) -> dict[int, Camera]:
    cameras = {}
    for words in (line.split() for line in _lines(path)):
        try:
            number, name, width, height, *values = words
            arguments = (name, int(width), int(height), [float(value) for value in values], path)
            identity = int(number)
        except ValueError as error:
            raise DataError(path, f"{' '.join(words)[:80]!r} is not a camera", _AGAIN) from error
        cameras[identity] = camera_of(*arguments)
    return cameras


def _text_images(path: Path) -> list[_Image]:
    """Images of a text file: each has a line, and a line of its points, which may be empty."""
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    while lines and not lines[0].strip():
        del lines[0]
    images = []
    for line, points in zip_longest(lines[::2], lines[1::2], fillvalue=""):
        if not line.strip():
            continue
        if len(points.split()) % 3:  # x, y and the point's number; an image, where other programs leave out points
            problem = f"has {points[:80]!r} where the points of an image belong"
            raise DataError(path, problem, "write a line after each image, which may be empty")
        words = line.split(maxsplit=9)
        try:
            numbers = tuple(float(word) for word in words[1:8])
            images.append(_Image(words[9].strip(), int(words[8]), numbers[:4], numbers[4:]))
        except (ValueError, IndexError) as error:
            raise DataError(path, f"{line[:80]!r} is not an image", _AGAIN) from error
    return images


def _lines(path: Path) -> list[str]:
    return [line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]


def _binary_cameras(path: Path) -> dict[int, Camera]:
    file = BinaryReader(path, _AGAIN)
    cameras = {}
    for _ in range(*file.take("Q")):
        number, model, width, height = file.take("iiQQ")
        name = _NAMES[model] if 0 <= model < len(_NAMES) else f"number {model}"
        values = file.take(f"{_LENSES[name].parameters}d") if name in _LENSES else ()
        cameras[number] = camera_of(name, width, height, list(values), path)
    return cameras


def _binary_images(path: Path) -> list[_Image]:
    file = BinaryReader(path, _AGAIN)
    images = []
    for _ in range(*file.take("Q")):
        _, *numbers, camera = file.take("i7di")
        images.append(_Image(file.text(), camera, tuple(numbers[:4]), tuple(numbers[4:])))
        file.skip(_POINT_BYTES * file.take("Q")[0])
    return images
