"""From contents of messages, as monoloc.ros makes them, to ROS's own messages."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from sensor_msgs.msg import PointCloud2, PointField
from tf2_msgs.msg import TFMessage

Message = TypeVar("Message")

KINDS: dict[str, type[Any]] = {
    "tf2_msgs/TFMessage": TFMessage,
    "diagnostic_msgs/DiagnosticArray": DiagnosticArray,
    "geometry_msgs/PoseWithCovarianceStamped": PoseWithCovarianceStamped,
    "sensor_msgs/PointCloud2": PointCloud2,
}
# What the lists of messages hold, by the name of the field.
_ELEMENTS: dict[str, type[Any]] = {
    "transforms": TransformStamped,
    "status": DiagnosticStatus,
    "values": KeyValue,
    "fields": PointField,
}


def filled(message: Message, content: Mapping[str, Any]) -> Message:
    """The message, with its fields set."""
    for name, value in content.items():
        setattr(message, name, _value(name, getattr(message, name), value))
    return message


def _value(name: str, present: Any, value: Any) -> Any:
    """What a field takes, whose value at present is that of a new message."""
    if isinstance(value, Mapping):
        return filled(present, value)
    if name in _ELEMENTS:
        return [filled(_ELEMENTS[name](), each) for each in value]
    if isinstance(value, bytes):
        return array("B", value)
    return bytes([value]) if isinstance(present, bytes) else value  # ROS's byte
