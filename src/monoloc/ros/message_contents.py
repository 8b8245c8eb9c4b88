"""Contents of ROS 2 messages, as dictionaries of their fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, rotation_to_quaternion
from monoloc.io.rosbag_messages import DISTORTION_MODELS
from monoloc.step import Step

Content = dict[str, Any]

_NS = 10**9
_LEVELS = {"tracking": 0, "map-changed": 1, "uncertain": 1, "lost": 2}  # OK, WARN, ERROR of DiagnosticStatus
_FLOAT32, _FLOAT32_BYTES = 7, 4  # of PointField
_JPEG_QUALITY = 80


@dataclass(frozen=True)
class TopicMessage:
    """A message on its topic.

    Attributes:
        topic: its name.
        kind: type of the message, such as ``tf2_msgs/TFMessage``.
        stamp_ns: time of capture of the image that it rests on, nanoseconds.
        content: its fields by name; messages in it are dictionaries too.
    """

    topic: str
    kind: str
    stamp_ns: int
    content: Content


def header(stamp_ns: int, frame: str) -> Content:
    """std_msgs/Header."""
    return {"stamp": {"sec": stamp_ns // _NS, "nanosec": stamp_ns % _NS}, "frame_id": frame}


def pose_with_covariance(stamp_ns: int, frame: str, pose: FloatArray, covariance: FloatArray) -> Content:
    """geometry_msgs/PoseWithCovarianceStamped of a pose (4, 4) and its covariance (6, 6) as ROS takes it."""
    position, orientation = _place_and_turn(pose)
    inner = {"pose": {"position": position, "orientation": orientation}, "covariance": covariance.ravel().tolist()}
    return {"header": header(stamp_ns, frame), "pose": inner}


def transforms(stamp_ns: int, poses: Sequence[tuple[str, str, FloatArray]]) -> Content:
    """tf2_msgs/TFMessage of parent, child and ``T_parent_child`` (4, 4) each."""
    content = []
    for parent, child, pose in poses:
        translation, rotation = _place_and_turn(pose)
        transform = {"translation": translation, "rotation": rotation}
        content.append({"header": header(stamp_ns, parent), "child_frame_id": child, "transform": transform})
    return {"transforms": content}


def _place_and_turn(pose: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
    quaternion = rotation_to_quaternion(pose[:3, :3])
    return dict(zip("xyz", pose[:3, 3].tolist(), strict=True)), dict(zip("xyzw", quaternion.tolist(), strict=True))


def state(stamp_ns: int, frame: str, step: Step, room: str | None = None) -> Content:
    """diagnostic_msgs/DiagnosticArray of the state, its reasons, and the probability that the position is far off.

    In a place it also says the room.
    """
    reasons = ", ".join(sorted(reason.value for reason in step.reasons))
    values = {
        "state": step.state,
        "reasons": reasons,
        "probability_far": repr(step.probability_far),
        "restarted": str(int(step.restarted)),
        "level": step.level.words,
    }
    if room is not None:
        values["room"] = room
    status = {
        "level": _LEVELS[step.state],
        "name": "monoloc: localisation",
        "message": f"{step.state}: {reasons}" if reasons else step.state,
        "hardware_id": "monoloc",
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }
    return {"header": header(stamp_ns, frame), "status": [status]}


def point_cloud(stamp_ns: int, frame: str, points: FloatArray) -> Content:
    """sensor_msgs/PointCloud2 of points (N, 3) metres."""
    size = 3 * _FLOAT32_BYTES
    fields = [
        {"name": axis, "offset": index * _FLOAT32_BYTES, "datatype": _FLOAT32, "count": 1}
        for index, axis in enumerate("xyz")
    ]
    return {
        "header": header(stamp_ns, frame),
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": size,
        "row_step": size * len(points),
        "data": points.astype("<f4").tobytes(),
        "is_dense": True,
    }


def compressed_image(stamp_ns: int, frame: str, color: NDArray[np.uint8]) -> Content:
    """sensor_msgs/CompressedImage: JPEG of an image (H, W, 3) uint8 RGB."""
    bgr = cv2.cvtColor(color, cv2.COLOR_RGB2BGR)
    data = cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))[1].tobytes()
    return {"header": header(stamp_ns, frame), "format": "jpeg", "data": data}


def camera_info(stamp_ns: int, frame: str, camera: Camera) -> Content:
    """sensor_msgs/CameraInfo of a camera's images, which are not rectified."""
    (name,) = (name for name, model in DISTORTION_MODELS.items() if model == camera.distortion_model)
    window = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {
        "header": header(stamp_ns, frame),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": name,
        "d": [float(value) for value in camera.distortion],
        "k": camera.matrix.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.hstack([camera.matrix, np.zeros((3, 1))]).ravel().tolist(),
        "binning_x": 0,
        "binning_y": 0,
        "roi": window,
    }
