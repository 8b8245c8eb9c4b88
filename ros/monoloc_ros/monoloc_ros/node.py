"""A ROS 2 node that localises a camera: topics in, monoloc's step, topics out."""

from __future__ import annotations

import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu
from tf2_ros import Buffer, TransformException, TransformListener

from monoloc import Camera, Start
from monoloc.errors import MonolocError, SettingError
from monoloc.flight.flight_file import FlightFile, read_flight_file
from monoloc.flight.flight_settings import down_of_map
from monoloc.geometry import FloatArray
from monoloc.image_turns import T_camera_turned, in_words, turned_image
from monoloc.io.rosbag_messages import camera_of, color_of, size_of
from monoloc.obstacles import tells_obstacles
from monoloc.place.flown_map import MapLocalizer, open_map
from monoloc.ros.ros_frames import FrameNames, RosFrames, down_camera, pose_of
from monoloc.ros.step_messages import OBSTACLES, POSE, STATE, TF, StepMessages
from monoloc.settled_objects import settled
from monoloc_ros.conversion import KINDS, filled

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # images that wait would be old
_PUBLISHED = {
    POSE: "geometry_msgs/PoseWithCovarianceStamped",
    TF: "tf2_msgs/TFMessage",
    STATE: "diagnostic_msgs/DiagnosticArray",
    OBSTACLES: "sensor_msgs/PointCloud2",
}
_MOST_IMU_AGE_NS, _CLOCKS_APART_NS = 50_000_000, 10**9  # the latter by which a camera's clock may be ahead
_WARN_PERIOD_S = 5.0  # of all that each image may bring again, since rclpy counts by the line that says it


class MonolocNode(Node):
    """Localises the newest image of a camera.

    Parameters:
        bundle: of the room, or a place of several; empty takes that of the settings.
        settings: a flight.toml, of which room, require_signature, mount, down, obstacles, most_age_s, budget_ms and
            threads are used; empty takes the mount from /tf.
        map_frame, odom_frame, base_frame: names.
        publish_odom: false where another node publishes odom -> base_link.
        rectified: whether the images are.

    Raises:
        MonolocError: bundle or settings cannot be used.
    """

    def __init__(self) -> None:
        super().__init__("monoloc")
        settings = self._parameter("settings", "")
        self._has_mount, self._turns = bool(settings), 0  # turns of images, to stand upright
        flight = read_flight_file(Path(settings)) if settings else FlightFile()
        self._flight, self._settings = flight, flight.settings
        bundle = self._parameter("bundle", "") or flight.room
        if not bundle:
            raise SettingError("bundle", "is missing", "name the bundle that monoloc build wrote")
        self._flown = open_map(Path(bundle), flight.require_signature)
        self._map, self._odom, self._base = (
            self._parameter(name, default)
            for name, default in (("map_frame", "map"), ("odom_frame", "odom"), ("base_frame", "base_link"))
        )
        self._publish_odom: bool = self._parameter("publish_odom", True)
        self._is_rectified: bool = self._parameter("rectified", False)
        self._info: CameraInfo | None = None
        self._camera: Camera | None = None
        self._start: Start | None = None
        self._made: MapLocalizer | None = None
        self._frames: RosFrames | None = None
        self._messages: StepMessages | None = None
        self._imu: Imu | None = None
        self._previous_ns: int | None = None
        self._tf = Buffer()
        self._listener = TransformListener(self._tf, self)
        self._topics = {topic: self.create_publisher(KINDS[kind], topic, 10) for topic, kind in _PUBLISHED.items()}
        subscribe = partial(self.create_subscription, qos_profile=_NEWEST)
        subscribe(Image, "image", self._take_image)
        subscribe(CompressedImage, "image/compressed", self._take_image)
        subscribe(CameraInfo, "camera_info", self._take_camera)
        subscribe(Imu, "imu", self._take_imu)
        self.create_subscription(PoseWithCovarianceStamped, "/initialpose", self._take_start, 1)

    def _parameter(self, name: str, default: Any) -> Any:
        return self.declare_parameter(name, default).value

    # --- What comes in ---

    def _take_camera(self, message: CameraInfo) -> None:
        self._info = message

    def _take_imu(self, message: Imu) -> None:
        self._imu = message

    def _take_start(self, message: PoseWithCovarianceStamped) -> None:
        """Begin anew at the next image; a pose that cannot be used changes nothing."""
        if self._flown.is_place:
            self.get_logger().warning("/initialpose is not used: a place is searched for the camera")
            return
        if message.header.frame_id != self._map:
            self.get_logger().warning(f"/initialpose has frame {message.header.frame_id!r}; give it in {self._map!r}")
            return
        if self._frames is None:
            self.get_logger().warning("/initialpose came before the first image; give it again")
            return
        try:
            covariance = np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)
            self._start = self._frames.start(pose_of(message), covariance)
        except ValueError as error:
            self.get_logger().warning(f"/initialpose cannot be used: {error}")
            return
        if self._made is not None:
            self._made.localizer.reset(self._start)

    def _take_image(self, message: Image | CompressedImage) -> None:
        stamp_ns = _nanoseconds(message.header.stamp)
        camera = self._camera_of(message)
        if camera is not None and self._is_in_time(stamp_ns) and self._is_ready(message.header.frame_id, camera):
            try:
                self._localize(color_of(message, Path("image"), camera), message, stamp_ns)
            except MonolocError as error:  # of the image, or of a room of a place that is entered now
                self._warn(str(error))

    def _camera_of(self, image: Image | CompressedImage) -> Camera | None:
        """The camera: at the first image, by whose size camera_info is understood."""
        if self._camera is None and self._info is None:
            self._warn("no camera_info yet")
        elif self._camera is None:
            try:
                self._camera = camera_of(self._info, self._is_rectified, size_of(image), Path("camera_info"))
            except MonolocError as error:
                self._warn(str(error))
        return self._camera

    def _is_in_time(self, stamp_ns: int) -> bool:
        now_ns = self.get_clock().now().nanoseconds
        age_s = (now_ns - stamp_ns) / 1e9
        if age_s > self._settings.most_age_s:
            self._warn(f"images are {age_s:.2f} s old when they come, and are dropped")
            return False
        if self._previous_ns is None or stamp_ns > self._previous_ns:
            return True
        if self._previous_ns - now_ns < _CLOCKS_APART_NS:
            return False
        self._previous_ns = None  # the clock was set back, or that image had a wrong stamp
        return True

    # --- Begin ---

    def _is_ready(self, camera_frame: str, camera: Camera) -> bool:
        """Whether there is a localizer; at the first image, how the camera is mounted must be known."""
        try:
            if self._frames is None:
                self._frames = self._frames_of(camera_frame)
                room = self._flown.room  # in a place, each frame says whether its depth tells obstacles
                with_obstacles = self._settings.obstacles and (room is None or tells_obstacles(room))
                self._messages = StepMessages(self._frames, with_obstacles, self._has_mount or self._turns > 0)
            if self._made is None:
                if self._start is None and not self._flown.is_searched:
                    self._warn("this room cannot be searched for the camera; publish /initialpose")
                    return False
                limits = self._flight.budget_ms, self._flight.threads
                self._made = self._flown.localizer(camera.turned(self._turns), self._start, 0, *limits)
        except (TransformException, MonolocError) as error:
            self._warn(str(error))
            return False
        return True

    def _frames_of(self, camera_frame: str) -> RosFrames:
        names = FrameNames(map=self._map, odom=self._odom, base=self._base, camera=camera_frame)
        down = down_of_map(self._flown, self._settings)
        if self._has_mount:
            frames = RosFrames(self._flight.mount.T_body_camera, down, names)
        else:
            frames = RosFrames.of_base(self._transform(self._base, camera_frame, Time()), down, names)
        self._turns = frames.quarter_turns
        if self._turns > 0:
            self.get_logger().warning(f"images are turned by {in_words(self._turns)}, to stand upright")
        return frames.upright

    def _localize(self, color: Any, message: Image | CompressedImage, stamp_ns: int) -> None:
        assert self._made is not None and self._messages is not None
        elapsed_s = 0.0 if self._previous_ns is None else (stamp_ns - self._previous_ns) / 1e9
        color = turned_image(color, self._turns)
        step = self._made.localizer.step(color, elapsed_s, down=self._down(stamp_ns, message.header.frame_id))
        self._previous_ns = stamp_ns
        in_place = self._made.in_place()
        step, room = (step, None) if in_place is None else (in_place.in_first_room(step), in_place.room)
        if in_place is not None and in_place.unreadable:
            self._warn(", ".join(in_place.problems))
        try:
            odom_base = None
            if not self._publish_odom:
                odom_base = self._transform(self._odom, self._base, Time.from_msg(message.header.stamp))
        except TransformException as error:
            self._warn(f"no odometry, so that nothing is published: {error}")
            return
        for each in self._messages.of(stamp_ns, step, odom_base, room):
            self._topics[each.topic].publish(filled(KINDS[each.kind](), each.content))

    def _down(self, stamp_ns: int, camera_frame: str) -> FloatArray | None:
        """Direction of gravity in the camera's frame by the IMU; None where either end does not know it."""
        imu = self._imu
        if imu is None or self._flown.down is None or imu.orientation_covariance[0] < 0.0:
            return None
        if abs(_nanoseconds(imu.header.stamp) - stamp_ns) > _MOST_IMU_AGE_NS:
            return None
        try:
            T_imu_camera = self._transform(imu.header.frame_id, camera_frame, Time())
            return down_camera(imu.orientation, T_imu_camera @ T_camera_turned(self._turns))
        except (TransformException, ValueError) as error:
            self._warn(f"the IMU is not used: {error}")
            return None

    def _transform(self, parent: str, child: str, time: Time) -> FloatArray:
        return pose_of(self._tf.lookup_transform(parent, child, time))

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=_WARN_PERIOD_S)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def main() -> None:
    """Run the node until it is stopped."""
    cv2.setNumThreads(1)  # more do not speed up small images
    rclpy.init()
    try:
        node = MonolocNode()
    except MonolocError as error:
        get_logger("monoloc").fatal(str(error))
        rclpy.try_shutdown()
        sys.exit(2)
    try:
        with settled(), suppress(KeyboardInterrupt, ExternalShutdownException):
            rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
