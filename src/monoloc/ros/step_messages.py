"""What a result of the localizer says in ROS: pose, transforms, state and obstacles; and the camera's images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray, invert
from monoloc.obstacles.sectors import MOST_M, depth_points
from monoloc.rate_limiter import RateLimiter
from monoloc.ros.message_contents import (
    TopicMessage,
    camera_info,
    compressed_image,
    point_cloud,
    pose_with_covariance,
    state,
    transforms,
)
from monoloc.ros.ros_frames import RosFrames
from monoloc.step import Step
from monoloc.supervision.state import BLIND

POSE, TF, STATE, OBSTACLES = "/monoloc/pose", "/tf", "/monoloc/state", "/monoloc/obstacles"
IMAGE, INFO = "/camera/image/compressed", "/camera/camera_info"
OBSTACLES_HZ, IMAGE_HZ = 10.0, 5.0


class StepMessages:
    """Makes the messages of a localizer's results, in order of time.

    ``base_link`` has one parent, ``odom``, as REP 105 asks: ``odom -> base_link`` is odometry, which is smooth and
    drifts, and ``map -> odom`` is what the belief corrects. While the camera is lost, or its image shows nothing,
    there is neither a pose nor ``map -> odom`` nor obstacles: nobody may take an old pose for a new one.

    Args:
        frames: of vehicle and room.
        with_obstacles: whether the depth network was tuned to the room, so that its depth may be taken for obstacles.
        with_mount: whether to publish ``base_link -> camera``, which a vehicle's own description may do.
    """

    def __init__(self, frames: RosFrames, with_obstacles: bool, with_mount: bool = True) -> None:
        self._frames, self._with_obstacles, self._with_mount = frames, with_obstacles, with_mount
        self._T_odom_base: FloatArray = np.eye(4)
        self._obstacles = RateLimiter(OBSTACLES_HZ)

    def of(
        self, stamp_ns: int, step: Step, T_odom_base: FloatArray | None = None, room: str | None = None
    ) -> list[TopicMessage]:
        """The messages of a frame.

        Args:
            stamp_ns: time of capture.
            step: the localizer's result.
            T_odom_base: (4, 4), where another node publishes ``odom -> base_link``; None takes monoloc's odometry,
                and publishes it.
            room: of a place, which the camera is in; None says nothing of rooms.
        """
        names = self._frames.names
        is_usable = _is_usable(step)
        T_map_base, covariance = self._frames.base_pose(step.estimate)
        tree = [(names.map, names.room, self._frames.T_map_room)]
        if self._with_mount:
            tree.append((names.base, names.camera, self._frames.T_base_camera))
        if T_odom_base is None:
            self._predict(step)
            T_odom_base = self._T_odom_base
            tree.append((names.odom, names.base, T_odom_base))
        if is_usable:
            tree.append((names.map, names.odom, T_map_base @ invert(T_odom_base)))
        messages = [
            TopicMessage(TF, "tf2_msgs/TFMessage", stamp_ns, transforms(stamp_ns, tree)),
            TopicMessage(STATE, "diagnostic_msgs/DiagnosticArray", stamp_ns, state(stamp_ns, names.base, step, room)),
        ]
        if is_usable:
            content = pose_with_covariance(stamp_ns, names.map, T_map_base, covariance)
            messages.append(TopicMessage(POSE, "geometry_msgs/PoseWithCovarianceStamped", stamp_ns, content))
        time_s = 1e-9 * stamp_ns
        if is_usable and self._with_obstacles and step.depth is not None and self._obstacles.is_due(time_s):
            self._obstacles.use(time_s)
            content = point_cloud(stamp_ns, names.camera, obstacle_points(step.depth, step.estimate.log_scale))
            messages.append(TopicMessage(OBSTACLES, "sensor_msgs/PointCloud2", stamp_ns, content))
        return messages

    def _predict(self, step: Step) -> None:
        """Move ``odom -> base_link`` on by the frame's motion, in metres; where there is none, it stays."""
        if step.motion is not None:
            T_base_camera = self._frames.T_base_camera
            motion = T_base_camera @ step.motion.in_metres(step.estimate.log_scale) @ invert(T_base_camera)
            self._T_odom_base = self._T_odom_base @ motion


def _is_usable(step: Step) -> bool:
    """Whether the pose is one of this frame: known, of an image that shows something, and a number."""
    is_finite = np.isfinite(step.estimate.pose).all() and np.isfinite(step.estimate.covariance).all()
    return bool(is_finite and step.state != "lost" and not step.reasons & BLIND)


def obstacle_points(depth: DepthPrediction, log_scale: float) -> FloatArray:
    """Points of a step's depth in the camera's frame, (N, 3) metres, as far as it is reliable.

    The depth is corrected by corners, and by the scale that the belief has found.
    """
    points = depth_points(depth, log_scale)
    return points[points[:, 2] <= MOST_M]


class ImageMessages:
    """Makes the messages of the camera's images, at a reduced rate.

    Args:
        camera: of the images.
        frame: name of the camera's frame.
    """

    def __init__(self, camera: Camera, frame: str) -> None:
        self._camera, self._frame = camera, frame
        self._images = RateLimiter(IMAGE_HZ)

    def of(self, stamp_ns: int, color: NDArray[np.uint8]) -> list[TopicMessage]:
        """The messages of an image (H, W, 3) uint8 RGB, none where it is not its turn."""
        if not self._images.is_due(1e-9 * stamp_ns):
            return []
        self._images.use(1e-9 * stamp_ns)
        image = compressed_image(stamp_ns, self._frame, color)
        info = camera_info(stamp_ns, self._frame, self._camera)
        return [
            TopicMessage(IMAGE, "sensor_msgs/CompressedImage", stamp_ns, image),
            TopicMessage(INFO, "sensor_msgs/CameraInfo", stamp_ns, info),
        ]
