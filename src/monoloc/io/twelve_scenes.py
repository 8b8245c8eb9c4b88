"""Reader of 12-Scenes (Valentin et al., 3DV 2016): a Structure sensor's depth beside an iPad's colour camera.

Layout: ``SCENE/{info.txt, split.txt}`` and ``SCENE/data/frame-NNNNNN.{color.jpg, depth.png, pose.txt}``. ``info.txt``
states sizes and intrinsics of both images, and the stored depth value of one metre. ``split.txt`` states which frames
each sequence has. A pose is the 4x4 camera-to-world matrix of both images, and infinite where tracking was lost.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_text, require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import stated_by
from monoloc.io.images import ImageRecording
from monoloc.io.pose_files import checked_poses, read_matrix_pose
from monoloc.io.reader_options import ReaderOptions, depth_scale_problem
from monoloc.io.registration import DepthRegistration

FRAME_RATE_HZ = 30.0  # no file states times
_SEQUENCE_GAP_S = 1.0  # between sequences, as in 7-Scenes

_COLOR_NAME = re.compile(r"frame-(\d+)\.color\.jpg")
_SEQUENCE = re.compile(r"(\w+)\s+\[frames=\d+\]\s*\[start=(\d{1,9})\s*;\s*end=(\d{1,9})\]")
_UNKNOWN_POSE = re.compile(r"inf|nan|ind", re.IGNORECASE)  # 1.#INF and 1.#IND are older compilers' spellings
_MOST_DEPTH_PIXELS = 1 << 22  # the sensor has 640x480
_AGAIN = "unpack the scene's archive again"


@dataclass(frozen=True)
class Sequence:
    """A sequence of a scene: its name in ``split.txt``, and the numbers of its frames."""

    name: str
    frames: range


@dataclass(frozen=True)
class _Calibration:
    color: Camera
    depth: Camera
    depth_scale: float


def recognises(path: Path) -> bool:
    """Whether a folder contains an ``info.txt`` and a folder ``data``."""
    return (path / "info.txt").is_file() and (path / "data").is_dir()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open a scene folder, all its sequences in order. Frames without a pose or depth are left out.

    Depth is registered to the colour camera. The two cameras share a centre, as ``info.txt`` says by extrinsics that
    are the identity. Colour has about twice the pixels of depth a side, so a quarter of the pixels have no depth.
    Frame names include the sequence.

    Raises:
        DataError: a file is missing or malformed, no frame remains, a pose is not rigid, or images have another size.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("12scenes", "camera", "depth_scale")
    require_folder(path)
    calibration = _read_info(path / "info.txt")
    sequences = read_sequences(path / "split.txt")
    require_folder(path / "data")
    matches = ((_COLOR_NAME.fullmatch(p.name), p) for p in (path / "data").iterdir())
    files = dict(sorted((int(match[1]), p) for match, p in matches if match))
    numbers, color_paths = list(files), list(files.values())
    stems = [p.with_name(p.name.removesuffix(".color.jpg")) for p in color_paths]
    places = [_place(number, sequences) for number in numbers]

    frames = FrameFilter(len(files))
    frames.require([place is not None for place in places], "in no sequence of split.txt")
    depth_paths = [stem.with_name(f"{stem.name}.depth.png") for stem in stems]
    frames.require([p.is_file() for p in depth_paths], "without depth")
    pose_paths = [stem.with_name(f"{stem.name}.pose.txt") for stem in stems]
    matrices = [_read_pose(p) for p in pose_paths]
    frames.require([matrix is not None for matrix in matrices], "without a pose")
    used = frames.positions(path, _AGAIN).tolist()

    names = [f"{sequences[place].name}/{stems[p].name}" for p in used if (place := places[p]) is not None]
    gaps_s = [_SEQUENCE_GAP_S * place for p in used if (place := places[p]) is not None]
    known = np.stack([matrix for p in used if (matrix := matrices[p]) is not None])
    camera = options.camera_or(calibration.color)
    return ImageRecording(
        name=path.resolve().name,
        folder=path,
        camera=camera,
        frame_names=names,
        timestamps_s=np.array([numbers[p] / FRAME_RATE_HZ for p in used]) + np.array(gaps_s),
        poses=checked_poses(known, [pose_paths[p] for p in used], names),
        color_paths=[color_paths[p] for p in used],
        depth_paths=[depth_paths[p] for p in used],
        depth_scale=options.depth_scale or calibration.depth_scale,
        registration=DepthRegistration(calibration.depth, camera, np.eye(4)),
        notes=frames.notes(),
    )


def read_sequences(path: Path) -> list[Sequence]:
    """Sequences of a ``split.txt``, whose lines are ``sequence0 [frames=357]  [start=0 ; end=356]``.

    Raises:
        DataError: the file is missing, a line is another, or frames are not in order.
    """
    require_file(path, _AGAIN)
    sequences: list[Sequence] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        match = _SEQUENCE.fullmatch(line.strip())
        first = sequences[-1].frames.stop if sequences else 0
        if match is None or not first <= int(match[2]) <= int(match[3]):
            fix = "each line holds: sequence0 [frames=357] [start=0 ; end=356], in order of frames"
            raise DataError(path, f"line {number} is not the frames of a sequence", fix)
        sequences.append(Sequence(match[1], range(int(match[2]), int(match[3]) + 1)))
    if not sequences:
        raise DataError(path, "names no sequence", _AGAIN)
    return sequences


def _place(number: int, sequences: list[Sequence]) -> int | None:
    """Index of the sequence that has a frame; None if none has."""
    return next((index for index, sequence in enumerate(sequences) if number in sequence.frames), None)


def _read_pose(path: Path) -> FloatArray | None:
    """The matrix (4, 4) of a pose file; None if there is no file, or it says that the pose is unknown."""
    if not path.is_file() or _UNKNOWN_POSE.search(read_text(path)):
        return None
    return read_matrix_pose(path)


def _read_info(path: Path) -> _Calibration:
    """Cameras and depth scale from lines of ``m_name = values``."""
    require_file(path, _AGAIN)
    pairs = (line.split("=", 1) for line in read_text(path).splitlines() if "=" in line)
    entries = {name.strip(): values.split() for name, values in pairs}

    def numbers(name: str, count: int) -> FloatArray:
        try:
            values = np.array([float(word) for word in entries.get(name, [])])
        except ValueError:
            values = np.empty(0)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise DataError(path, f"{name} is not {count} numbers", _AGAIN)
        return values

    def camera(kind: str) -> Camera:
        width, height = (int(numbers(f"m_{kind.lower()}{side}", 1)[0]) for side in ("Width", "Height"))
        matrix = numbers(f"m_calibration{kind}Intrinsic", 16).reshape(4, 4)
        if not np.array_equal(numbers(f"m_calibration{kind}Extrinsic", 16).reshape(4, 4), np.eye(4)):
            problem = f"m_calibration{kind}Extrinsic is not the identity"
            raise DataError(path, problem, "give a scene whose colour and depth camera share a centre")
        with stated_by(path):
            return Camera(width, height, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])

    depth_scale = float(numbers("m_depthShift", 1)[0])
    if (problem := depth_scale_problem(depth_scale)) is not None:
        raise DataError(path, f"m_depthShift {problem}", "give the stored value of one metre, such as 1000")
    color, depth = camera("Color"), camera("Depth")
    if depth.width * depth.height > _MOST_DEPTH_PIXELS:
        raise DataError(path, f"says that depth is {depth.width}x{depth.height}", "give the size of its depth images")
    return _Calibration(color, depth, depth_scale)
