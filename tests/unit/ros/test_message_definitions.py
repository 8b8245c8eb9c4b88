"""Definitions of messages: those that the package rosbags has of ROS 2."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from monoloc.ros.message_definitions import definition_of

KINDS = (
    "geometry_msgs/PoseWithCovarianceStamped",
    "tf2_msgs/TFMessage",
    "diagnostic_msgs/DiagnosticArray",
    "sensor_msgs/PointCloud2",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/CameraInfo",
)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distribution", [Stores.ROS2_FOXY, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_fields_are_those_of_ros(kind: str, distribution: Stores) -> None:
    name = kind.replace("/", "/msg/")
    own = get_types_from_msg(definition_of(kind), name)
    ros = get_typestore(distribution).fielddefs
    assert name in own
    for inner, (_, fields) in own.items():
        assert fields == ros[inner][1], inner
