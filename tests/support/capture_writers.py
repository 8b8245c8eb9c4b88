"""Captures of a room as phones and mapping tools write them, from the formats' documents alone.

Rotations go through SciPy and axes are written out, so that nothing here shares code with the readers.
"""

from __future__ import annotations

import json
import struct
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from monoloc.camera import Camera
from monoloc.io.recording import Recording
from synthetic_recordings import write_color, write_depth

FloatArray = NDArray[np.float64]

# Camera axes of ARKit and OpenGL: x right, y up, z backward.
_UP_AND_BACK = np.diag([1.0, -1.0, -1.0, 1.0])
# Of the synthetic room's world, whose y axis points down, in worlds of other tools.
Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])
Z_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
LOW, MEDIUM, HIGH = 0, 1, 2  # confidence


@dataclass(frozen=True)
class Capture:
    """What a tool saw: images, depth in millimetres, and poses ``T_world_camera`` with OpenCV's axes."""

    camera: Camera
    times_s: FloatArray
    poses: FloatArray
    colors: list[NDArray[np.uint8]]
    depths_mm: list[NDArray[np.uint16]]

    def __len__(self) -> int:
        return len(self.colors)


def capture_of(recording: Recording, frames: Sequence[int]) -> Capture:
    """Frames of a recording with poses and depth."""
    assert recording.poses is not None
    return Capture(
        recording.camera,
        recording.timestamps_s[list(frames)],
        recording.poses[list(frames)],
        [recording.color(index) for index in frames],
        [np.round(1000.0 * recording.depth(index)).astype(np.uint16) for index in frames],
    )


def in_world(capture: Capture, T_new_world: FloatArray) -> Capture:
    return replace(capture, poses=T_new_world @ capture.poses)


def on_its_side(capture: Capture, quarter_turns: int) -> Capture:
    """The same views by a camera that was turned counter-clockwise, so that its images are turned clockwise."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", -90 * quarter_turns, degrees=True).as_matrix()
    return Capture(
        capture.camera.turned(-quarter_turns),
        capture.times_s,
        capture.poses @ turn,
        [np.ascontiguousarray(np.rot90(each, -quarter_turns)) for each in capture.colors],
        [np.ascontiguousarray(np.rot90(each, -quarter_turns)) for each in capture.depths_mm],
    )


def halved(image: NDArray[Any]) -> NDArray[Any]:
    """Every second pixel of every second row: a sensor of half the resolution with the same field of view."""
    return np.ascontiguousarray(image[::2, ::2])


def doubled(image: NDArray[Any]) -> NDArray[Any]:
    return image.repeat(2, axis=0).repeat(2, axis=1)


def confidence_of(depth: NDArray[Any]) -> NDArray[np.uint8]:
    """High, but for a row of medium and a column of low confidence."""
    confidence = np.full(depth.shape, HIGH, dtype=np.uint8)
    confidence[3] = MEDIUM
    confidence[:, 5] = LOW
    return confidence


def check_opened(
    recording: Recording,
    capture: Capture,
    depths_mm: Sequence[NDArray[np.uint16]] | None,
    color_error: float = 4.0,
    pose_error: float = 1e-6,
) -> None:
    """A recording is the capture: images within a mean error, depth exactly, and poses."""
    assert len(recording) == len(capture)
    np.testing.assert_allclose(recording.poses, capture.poses, atol=pose_error)
    assert recording.has_depth == (depths_mm is not None)
    for index in range(len(capture)):
        difference = np.abs(recording.color(index).astype(float) - capture.colors[index])
        assert difference.mean() < color_error
        if depths_mm is not None:
            depth_m = recording.depth(index)
            assert depth_m.dtype == np.float32 and depth_m.any()
            np.testing.assert_allclose(depth_m, depths_mm[index] / 1000.0, atol=1e-6)


def quaternions_xyzw(poses: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(poses[:, :3, :3]).as_quat())


def tum_rows(times_s: FloatArray, poses: FloatArray) -> str:
    rows = np.column_stack([times_s, poses[:, :3, 3], quaternions_xyzw(poses)])
    return "".join(" ".join(f"{value:.9f}" for value in row) + "\n" for row in rows)


def write_video_of(path: Path, colors: Sequence[NDArray[np.uint8]], rate_hz: float = 10.0) -> None:
    """A video, as an .mp4."""
    height, width = colors[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, (width, height))
    assert writer.isOpened()
    for color in colors:
        writer.write(cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
    writer.release()


def tag_rotation(path: Path, quarter_turns: int) -> None:
    """Ask players of an .mp4 to turn it clockwise, as phones do: the matrix of its track header."""
    cosine, sine = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter_turns]
    data = bytearray(path.read_bytes())
    one = 1 << 16
    at = data.index(b"tkhd") + 4 + 4 + 20 + 8 + 8  # version and flags, times and duration, reserved, layer to volume
    struct.pack_into(">6i", data, at, cosine * one, sine * one, 0, -sine * one, cosine * one, 0)
    path.write_bytes(data)


# --- Stray Scanner ---


def write_stray_scanner(
    folder: Path, capture: Capture, early: bool = False, focal_factors: Sequence[float] | None = None
) -> None:
    """A recording with depth of half the size; early versions had NumPy depth and bare poses.

    ``focal_factors`` are of each frame's intrinsics against the camera matrix, as newer versions write them.
    """
    for name in ("depth", "confidence"):
        (folder / name).mkdir(parents=True)
    write_video_of(folder / "rgb.mp4", capture.colors)
    np.savetxt(folder / "camera_matrix.csv", capture.camera.matrix, delimiter=",")
    poses = np.column_stack([capture.poses[:, :3, 3], quaternions_xyzw(capture.poses)])
    lines = [] if early else ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    if focal_factors is not None:
        lines[0] += ", fx, fy, cx, cy, distortion_center_x, distortion_center_y"
    for index, pose in enumerate(poses):
        start = [] if early else [f"{capture.times_s[index] + 5000.0:.6f}", f"{index:06d}"]
        end = []
        if focal_factors is not None:
            camera, factor = capture.camera, focal_factors[index]
            end = [str(camera.fx * factor), str(camera.fy * factor), str(camera.cx), str(camera.cy), "", ""]
        lines.append(", ".join([*start, *map(repr, pose.tolist()), *end]))
        depth_mm = halved(capture.depths_mm[index])
        if early:
            np.save(folder / f"depth/{index:06d}.npy", depth_mm)
        else:
            write_depth(folder / f"depth/{index:06d}.png", depth_mm)
        write_depth(folder / f"confidence/{index:06d}.png", confidence_of(depth_mm))
    (folder / "odometry.csv").write_text("\n".join(lines))


# --- Record3D ---


def record3d_members(capture: Capture, focal_factors: Sequence[float] | None = None) -> dict[str, bytes]:
    """Members of a .r3d: the first pose is the identity, and depth has half the size.

    ``focal_factors`` are of ``perFrameIntrinsicCoeffs`` against ``K``.
    """
    import lzfse

    camera = capture.camera
    arkit = capture.poses @ _UP_AND_BACK
    arkit = np.linalg.inv(arkit[0]) @ arkit
    height, width = halved(capture.depths_mm[0]).shape
    metadata = {
        "w": camera.width,
        "h": camera.height,
        "dw": width,
        "dh": height,
        "fps": 10,
        "K": camera.matrix.T.ravel().tolist(),
        "poses": np.column_stack([quaternions_xyzw(arkit), arkit[:, :3, 3]]).tolist(),
        "frameTimestamps": capture.times_s.tolist(),
    }
    if focal_factors is not None:
        metadata["perFrameIntrinsicCoeffs"] = [
            [camera.fx * factor, camera.fy * factor, camera.cx, camera.cy] for factor in focal_factors
        ]
    members = {"metadata": json.dumps(metadata).encode()}
    for index in range(len(capture)):
        bgr = cv2.cvtColor(capture.colors[index], cv2.COLOR_RGB2BGR)
        members[f"rgbd/{index}.jpg"] = cv2.imencode(".jpg", bgr)[1].tobytes()
        depth_mm = halved(capture.depths_mm[index])
        depth_m = (depth_mm / 1000.0).astype(np.float32)
        depth_m[0, 0] = np.nan
        members[f"rgbd/{index}.depth"] = lzfse.compress(depth_m.tobytes())
        members[f"rgbd/{index}.conf"] = lzfse.compress(confidence_of(depth_mm).tobytes())
    return members


def write_record3d(path: Path, members: dict[str, bytes], unpacked: bool = False) -> None:
    if unpacked:
        for name, content in members.items():
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).write_bytes(content)
        return
    with zipfile.ZipFile(path, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)


# --- Polycam ---


def write_polycam(folder: Path, capture: Capture, corrected: bool = False) -> None:
    """Raw data; with ``corrected``, the uncorrected poses are off by a metre and their images are black."""
    keyframes = folder / "keyframes"
    for index in range(len(capture)):
        stamp = f"{435456552349 + round(1e6 * capture.times_s[index])}"
        offset_m = 1.0 if corrected else 0.0
        _write_polycam_camera(keyframes / f"cameras/{stamp}.json", capture, index, offset_m)
        color = capture.colors[index]
        write_color(keyframes / f"images/{stamp}.jpg", np.zeros_like(color) if corrected else color)
        if corrected:
            _write_polycam_camera(keyframes / f"corrected_cameras/{stamp}.json", capture, index, 0.0)
            write_color(keyframes / f"corrected_images/{stamp}.jpg", color)
        depth_mm = halved(capture.depths_mm[index])
        write_depth(keyframes / f"depth/{stamp}.png", depth_mm)
        levels = np.array([0, 127, 255], dtype=np.uint8)
        write_depth(keyframes / f"confidence/{stamp}.png", levels[confidence_of(depth_mm)])


def _write_polycam_camera(path: Path, capture: Capture, index: int, offset_m: float) -> None:
    camera, matrix = capture.camera, capture.poses[index] @ _UP_AND_BACK
    matrix[0, 3] += offset_m
    content: dict[str, Any] = {"blur_score": 120.0, "manual_keyframe": False, "neighbors": []}
    content |= {key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy", "width", "height")}
    content |= {f"t_{row}{column}": matrix[row, column] for row in range(3) for column in range(4)}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


# --- RTAB-Map ---


def write_rtabmap(
    folder: Path, capture: Capture, *, name: str = "room", poses_format: int = 11, by_stamp: bool = False
) -> None:
    """An export whose nodes are numbered from 9 by threes; one node without an image lies between them."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = ["#timestamp x y z qx qy qz qw" + (" id" if poses_format == 11 else "")]
    for index, line in enumerate(tum_rows(capture.times_s + 1.7e9, capture.poses).splitlines()):
        node, stamp = 9 + 3 * index, f"{capture.times_s[index] + 1.7e9:f}"
        rows.append(f"{stamp} {line.split(maxsplit=1)[1]}" + (f" {node}" if poses_format == 11 else ""))
        if poses_format == 11:
            rows.append(f"{capture.times_s[index] + 1.7e9 + 0.01:f} 0 0 0 0 0 0 1 {node + 1}")
        stem = stamp if by_stamp else str(node)
        write_color(folder / f"{name}_rgb/{stem}.jpg", capture.colors[index])
        write_depth(folder / f"{name}_depth/{stem}.png", halved(capture.depths_mm[index]))
        write_rtabmap_calibration(folder / f"{name}_calib/{stem}.yaml", capture.camera)
    (folder / f"{name}_camera_poses.txt").write_text("\n".join(rows) + "\n")


def write_rtabmap_calibration(
    path: Path, camera: Camera, distortion: Sequence[float] = (0.0,) * 5, projection: Camera | None = None
) -> None:
    """As ``CameraModel::save`` writes it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("camera_name", path.stem)
    file.write("image_width", camera.width)
    file.write("image_height", camera.height)
    matrices = {"camera_matrix": camera.matrix, "distortion_coefficients": np.array([distortion])}
    if projection is not None:
        matrices["projection_matrix"] = np.hstack([projection.matrix, np.zeros((3, 1))])
    for key, matrix in matrices.items():
        file.startWriteStruct(key, cv2.FILE_NODE_MAP)
        file.write("rows", matrix.shape[0])
        file.write("cols", matrix.shape[1])
        file.startWriteStruct("data", cv2.FILE_NODE_SEQ | cv2.FILE_NODE_FLOW)
        for value in matrix.ravel().tolist():
            file.write("", value)
        file.endWriteStruct()
        file.endWriteStruct()
    file.release()


# --- nerfstudio ---


def write_nerfstudio(folder: Path, capture: Capture, **changes: Any) -> dict[str, Any]:
    """A ``transforms.json`` whose frames are out of order, with changes of its keys; returns its content."""
    camera = capture.camera
    frames = []
    for index in range(len(capture)):
        write_color(folder / f"images/frame_{index + 1}.jpg", capture.colors[index])
        write_depth(folder / f"depths/frame_{index + 1}.png", capture.depths_mm[index])
        frames.append(
            {
                "file_path": f"images/frame_{index + 1}.jpg",
                "depth_file_path": f"./depths/frame_{index + 1}.png",
                "transform_matrix": (capture.poses[index] @ _UP_AND_BACK).tolist(),
            }
        )
    content = {
        "camera_model": "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "frames": sorted(frames, key=lambda frame: str(frame["file_path"])),  # frame_10 before frame_2
    } | changes
    (folder / "transforms.json").write_text(json.dumps(content))
    return content


# --- COLMAP ---

COLMAP_NUMBERS = {
    **{"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5},
    **{"FULL_OPENCV": 6, "FOV": 7},
}


@dataclass(frozen=True)
class ColmapCamera:
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


def pinhole_of(camera: Camera) -> ColmapCamera:
    parameters = (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5)
    return ColmapCamera("PINHOLE", camera.width, camera.height, parameters)


def write_colmap(
    workspace: Path, capture: Capture, binary: bool, cameras: Sequence[ColmapCamera], points: FloatArray | None = None
) -> None:
    """A workspace with ``images`` and ``sparse/0``; frame i is of camera i modulo their number, counted from 1."""
    model = workspace / "sparse/0"
    model.mkdir(parents=True)
    world_to_camera = np.linalg.inv(capture.poses)
    wxyz = quaternions_xyzw(world_to_camera)[:, [3, 0, 1, 2]]
    order = np.random.default_rng(0).permutation(len(capture))
    for index in range(len(capture)):
        write_color(workspace / f"images/left/frame {index}.jpg", capture.colors[index])
    images = [
        (100 + i, wxyz[i], world_to_camera[i, :3, 3], 1 + i % len(cameras), f"left/frame {i}.jpg") for i in order
    ]
    (_write_colmap_binary if binary else _write_colmap_text)(
        model, cameras, images, np.empty((0, 3)) if points is None else points
    )


def _write_colmap_text(
    model: Path, cameras: Sequence[ColmapCamera], images: Sequence[Any], points: FloatArray
) -> None:
    lines = ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for number, each in enumerate(cameras, start=1):
        lines.append(" ".join(map(str, [number, each.model, each.width, each.height, *each.parameters])))
    (model / "cameras.txt").write_text("\n".join(lines) + "\n")
    lines = ["# Image list with two lines of data per image:", f"# Number of images: {len(images)}"]
    for number, (identity, wxyz, translation, camera, name) in enumerate(images):
        lines.append(" ".join(map(str, [identity, *wxyz.tolist(), *translation.tolist(), camera, name])))
        lines.append("" if number % 2 else "10.5 20.5 -1 30.5 40.5 7")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    lines = ["# 3D point list with one line of data per point:"]
    for number, point in enumerate(points):
        lines.append(" ".join(map(str, [number, *point.tolist(), 200, 100, 50, 0.7, 100, 1, 101, 4])))
    (model / "points3D.txt").write_text("\n".join(lines) + "\n")


def _write_colmap_binary(
    model: Path, cameras: Sequence[ColmapCamera], images: Sequence[Any], points: FloatArray
) -> None:
    data = struct.pack("<Q", len(cameras))
    for number, each in enumerate(cameras, start=1):
        data += struct.pack("<iiQQ", number, COLMAP_NUMBERS[each.model], each.width, each.height)
        data += struct.pack(f"<{len(each.parameters)}d", *each.parameters)
    (model / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for number, (identity, wxyz, translation, camera, name) in enumerate(images):
        data += struct.pack("<i7di", identity, *wxyz, *translation, camera) + name.encode() + b"\0"
        data += struct.pack("<Q", number % 3) + struct.pack("<ddq", 10.5, 20.5, -1) * (number % 3)
    (model / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for number, point in enumerate(points):
        data += struct.pack("<Q3d3BdQ", number, *point, 200, 100, 50, 0.7, 2) + struct.pack("<4i", 100, 1, 101, 4)
    (model / "points3D.bin").write_bytes(data)
