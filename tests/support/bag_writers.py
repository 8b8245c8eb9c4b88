"""ROS bags of both versions and all storages, by rosbags' own writers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from capture_writers import Capture, quaternions_xyzw
from monoloc.camera import Camera

COLOR, DEPTH, ODOM = "/cam/color/image_raw", "/cam/aligned_depth_to_color/image_raw", "/odom"
OPTICAL, BODY, WORLD = "cam_color_optical_frame", "base_link", "map"
# A camera that looks ahead of a body with x forward, y left, z up (REP 103), 10 cm ahead and 5 cm above it.
T_BODY_CAMERA = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.05], [0, 0, 0, 1]])
TF = "tf2_msgs/msg/TFMessage"


class Ros:
    """Messages of one ROS version, from plain values."""

    def __init__(self, version: int) -> None:
        self.version = version
        self.store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_JAZZY)
        if version == 1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, time_s: float, frame: str) -> Any:
        nanoseconds = round(time_s * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        sequence = {"seq": 0} if self.version == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **sequence)

    def image(self, time_s: float, frame: str, pixels: NDArray[Any], encoding: str, padding: int = 0) -> Any:
        rows = pixels.reshape(len(pixels), -1).view(np.uint8)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=7)
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(time_s, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=int(pixels.dtype.byteorder == ">"),
            step=rows.shape[1],
            data=rows.reshape(-1),
        )

    def compressed(self, time_s: float, frame: str, data: bytes, fmt: str) -> Any:
        content = np.frombuffer(data, dtype=np.uint8)
        return self.make(
            "sensor_msgs/msg/CompressedImage", header=self.header(time_s, frame), format=fmt, data=content
        )

    def info(
        self,
        camera: Camera,
        frame: str,
        model: str = "plumb_bob",
        binning: tuple[int, int] = (0, 0),
        roi: tuple[int, int, int, int] = (0, 0, 0, 0),
        **changes: Any,
    ) -> Any:
        """A CameraInfo; ``roi`` is left, top, width and height."""
        region = dict(zip(("x_offset", "y_offset", "width", "height"), roi, strict=True))
        matrices = {
            "d": np.array(camera.distortion),
            "k": camera.matrix.reshape(-1),
            "r": np.eye(3).reshape(-1),
            "p": np.hstack([camera.matrix, np.zeros((3, 1))]).reshape(-1),
        } | changes
        if self.version == 1:
            matrices = {name.upper(): value for name, value in matrices.items()}
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(0.0, frame),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            binning_x=binning[0],
            binning_y=binning[1],
            roi=self.make("sensor_msgs/msg/RegionOfInterest", **region, do_rectify=False),
            **matrices,
        )

    def transform(self, time_s: float, parent: str, child: str, pose: NDArray[np.float64]) -> Any:
        position, rotation = self._parts(pose)
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", **position),
            rotation=rotation,
        )
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time_s, parent),
            child_frame_id=child,
            transform=transform,
        )

    def tf(self, *transforms: Any) -> Any:
        return self.make(TF, transforms=list(transforms))

    def pose(self, pose: NDArray[np.float64]) -> Any:
        position, rotation = self._parts(pose)
        point = self.make("geometry_msgs/msg/Point", **position)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=rotation)

    def pose_stamped(self, time_s: float, world: str, pose: NDArray[np.float64]) -> Any:
        header = self.header(time_s, world)
        return self.make("geometry_msgs/msg/PoseStamped", header=header, pose=self.pose(pose))

    def odometry(self, time_s: float, body: str, pose: NDArray[np.float64]) -> Any:
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(time_s, WORLD),
            child_frame_id=body,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(pose), covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def _parts(self, pose: NDArray[np.float64]) -> tuple[dict[str, float], Any]:
        quaternion = dict(zip("xyzw", quaternions_xyzw(pose[None])[0].tolist(), strict=True))
        position = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
        return position, self.make("geometry_msgs/msg/Quaternion", **quaternion)


@dataclass
class Bag:
    """Messages by topic, each with the time at which it was recorded."""

    ros: Ros
    topics: dict[str, list[tuple[float, Any]]] = field(default_factory=dict)

    def add(self, topic: str, time_s: float, message: Any) -> None:
        self.topics.setdefault(topic, []).append((time_s, message))

    def write(self, path: Path, storage: str = "", compression: str = "") -> Path:
        if self.ros.version == 1:
            path = path.with_suffix(".bag")
            writer: Any = Ros1Writer(path)
            if compression:
                writer.set_compression(Ros1Writer.CompressionFormat[compression])
            serialise = self.ros.store.serialize_ros1
        else:
            plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
            writer = Ros2Writer(path, version=9, storage_plugin=plugin)
            if compression:
                writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
            serialise = self.ros.store.serialize_cdr
        messages = sorted(
            ((time_s, topic, each) for topic, all_of in self.topics.items() for time_s, each in all_of),
            key=lambda item: item[0],
        )
        with writer:
            connections = {
                topic: writer.add_connection(topic, all_of[0][1].__msgtype__, typestore=self.ros.store)
                for topic, all_of in self.topics.items()
            }
            for time_s, topic, message in messages:
                writer.write(connections[topic], round(time_s * 1e9), serialise(message, message.__msgtype__))
        return path


def bag_of(capture: Capture, version: int = 2, poses: bool = True, depth: bool = True) -> Bag:
    """Colour, aligned depth, and odometry of a body that carries the camera, at ten times the rate of images."""
    ros = Ros(version)
    bag = Bag(ros)
    bag.add("/cam/color/camera_info", 0.0, ros.info(capture.camera, OPTICAL))
    for time_s, color, depth_mm in zip(capture.times_s, capture.colors, capture.depths_mm, strict=True):
        bag.add(COLOR, time_s + 0.03, ros.image(time_s, OPTICAL, color, "rgb8", padding=5))  # recorded late
        if depth:
            bag.add(DEPTH, time_s + 0.05, ros.image(time_s + 0.004, OPTICAL, depth_mm, "16UC1"))
    if poses:
        bag.add("/tf_static", 0.0, ros.tf(ros.transform(0.0, BODY, OPTICAL, T_BODY_CAMERA)))
        for time_s, pose in odometry_of(capture):
            bag.add(ODOM, time_s + 0.01, ros.odometry(time_s, BODY, pose))
    return bag


def odometry_of(capture: Capture) -> list[tuple[float, NDArray[np.float64]]]:
    """Poses of the body at the images' times."""
    return list(zip(capture.times_s.tolist(), capture.poses @ np.linalg.inv(T_BODY_CAMERA), strict=True))
