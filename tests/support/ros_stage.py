"""A stage for the ROS 2 node: messages in, messages out, by the stand-in for ROS."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import ros_stand_in
from monoloc.camera import Camera
from monoloc.geometry import FloatArray
from monoloc.ros.message_contents import camera_info, pose_with_covariance, transforms
from monoloc.ros.ros_frames import pose_of
from monoloc.ros.step_messages import TF
from synthetic_room import FRAME_S, RoomRecording

BEGIN_NS, PERIOD_NS = 1_700_000_000_123_456_789, round(FRAME_S * 1e9)
"""Time of the first image, and from one to the next."""

COVARIANCE = np.diag([0.003, 0.003, 0.003, 0.001, 0.001, 0.001])
"""Of a start."""


class Stage:
    """A node in its room, and what it receives.

    Args:
        monkeypatch: puts the stand-in in the place of ROS.
        recording: whose images are given.
        settings: flight.toml.

    Attributes:
        ros: the stand-in.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, recording: RoomRecording, settings: Path) -> None:
        self.ros, self._recording = ros_stand_in.install(monkeypatch), recording
        self._module = importlib.import_module("monoloc_ros.node")
        self.ros.parameters |= {"settings": str(settings)}

    def begin(self, **parameters: Any) -> None:
        self.ros.parameters |= parameters
        self._module.MonolocNode()

    def message(self, kind: str, content: dict[str, Any]) -> Any:
        package, name = kind.split("/")
        filled = sys.modules["monoloc_ros.conversion"].filled
        return filled(getattr(sys.modules[f"{package}.msg"], name)(), content)

    def give_camera(self, camera: Camera | None = None, **changes: Any) -> None:
        """The recording's camera, or another, with changes of the message's fields."""
        content = camera_info(BEGIN_NS, "cam_optical", camera or self._recording.camera) | changes
        self.ros.give("camera_info", self.message("sensor_msgs/CameraInfo", content))

    def give_image(self, index: int, age_s: float = 0.02, compressed: bool = False) -> None:
        stamp_ns = BEGIN_NS + index * PERIOD_NS
        self.ros.now_ns = stamp_ns + round(age_s * 1e9)
        color = self._recording.color(index)
        header = camera_info(stamp_ns, "cam_optical", self._recording.camera)["header"]
        if compressed:
            data = cv2.imencode(".png", color[..., ::-1])[1].tobytes()
            content = {"header": header, "format": "png", "data": data}
            self.ros.give("image/compressed", self.message("sensor_msgs/CompressedImage", content))
            return
        height, width = color.shape[:2]
        content = {"header": header, "height": height, "width": width, "encoding": "rgb8", "step": 3 * width}
        self.ros.give("image", self.message("sensor_msgs/Image", {**content, "data": color.tobytes()}))

    def give_start(self, T_map_base: FloatArray, covariance: FloatArray = COVARIANCE, frame: str = "map") -> None:
        content = pose_with_covariance(BEGIN_NS, frame, T_map_base, covariance)
        self.ros.give("/initialpose", self.message("geometry_msgs/PoseWithCovarianceStamped", content))

    def set_transform(self, parent: str, child: str, pose: FloatArray) -> None:
        (content,) = transforms(BEGIN_NS, [(parent, child, pose)])["transforms"]
        self.ros.transforms[parent, child] = self.message("geometry_msgs/TransformStamped", content)

    def tree(self, index: int) -> dict[tuple[str, str], FloatArray]:
        message = self.ros.of(TF)[index]
        return {(each.header.frame_id, each.child_frame_id): pose_of(each) for each in message.transforms}
