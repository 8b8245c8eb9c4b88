"""A stand-in for ROS 2's Python packages, which cannot be installed here: enough to run a node without a middleware.

Messages are made of the definitions that the package rosbags has, and check what is assigned as the classes that ROS
generates do: a float is no int, a byte is bytes of length one, a list of messages holds messages.
"""

from __future__ import annotations

import sys
from array import array
from dataclasses import dataclass, field
from enum import Enum
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from repository import REPOSITORY

_TYPES = get_typestore(Stores.ROS2_JAZZY).fielddefs
_PACKAGES = ("builtin_interfaces", "std_msgs", "geometry_msgs", "tf2_msgs", "diagnostic_msgs", "sensor_msgs")
_BASE, _NAME, _ARRAY = 1, 2, 3  # of rosbags' Nodetype; a sequence is 4
_CLASSES: dict[str, type] = {}


def message_class(name: str) -> type:
    """The class of a message such as ``std_msgs/msg/Header``."""
    if name not in _CLASSES:
        fields = dict(_TYPES[name][1])

        def begin(self: Any, **values: Any) -> None:
            for each, kind in fields.items():
                object.__setattr__(self, each, values.get(each, _default(kind)))

        def assign(self: Any, each: str, value: Any) -> None:
            assert each in fields, f"{name} has no field {each}"
            object.__setattr__(self, each, _checked(fields[each], value, f"{name}.{each}"))

        _CLASSES[name] = type(name.rpartition("/")[2], (), {"__init__": begin, "__setattr__": assign})
    return _CLASSES[name]


def _default(kind: Any) -> Any:
    node, detail = int(kind[0].value), kind[1]
    if node == _BASE:
        base = detail[0]
        return {"string": "", "bool": False, "byte": b"\0"}.get(base, 0.0 if base.startswith("float") else 0)
    if node == _NAME:
        return message_class(detail)()
    (_, inner), count = detail
    if detail[0][0].value == _NAME:
        return []
    if node == _ARRAY:
        return np.zeros(count)
    return array("B") if inner[0] == "uint8" else array("d")


def _checked(kind: Any, value: Any, what: str) -> Any:
    node, detail = int(kind[0].value), kind[1]
    if node == _NAME:
        assert isinstance(value, message_class(detail)), what
        return value
    if node == _BASE:
        _check_base(detail[0], value, what)
        return value
    inner, count = detail
    assert not isinstance(value, str), what
    assert node != _ARRAY or len(value) == count, what
    if isinstance(value, array):
        assert value.typecode == {"uint8": "B", "float64": "d"}[inner[1][0]], what
        return value
    for each in value:
        _checked(inner, each, what)
    return np.array(value) if node == _ARRAY else value


def _check_base(base: str, value: Any, what: str) -> None:
    if base == "byte":
        assert isinstance(value, bytes) and len(value) == 1, what
    elif base.startswith("float"):
        assert isinstance(value, float), what
    elif base in ("string", "bool"):
        assert isinstance(value, {"string": str, "bool": bool}[base]), what
    else:
        bits, least = int(base.lstrip("uint")), -1 if base[0] == "i" else 0
        assert type(value) is int and least * 2 ** (bits - 1) <= value < 2 ** (bits + least), what


@dataclass
class Runtime:
    """What a test says to a node and hears of it.

    Attributes:
        parameters: values given to the node.
        now_ns: its clock.
        transforms: what the buffer knows, by parent and child: geometry_msgs/TransformStamped.
        published: messages by topic.
        said: what was logged.
        throttled: of it, what ROS may leave out if it comes soon after another.
        subscriptions: callbacks by topic.
        spin: what happens while the node spins.
    """

    parameters: dict[str, Any] = field(default_factory=dict)
    now_ns: int = 0
    transforms: dict[tuple[str, str], Any] = field(default_factory=dict)
    published: list[tuple[str, Any]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    throttled: list[str] = field(default_factory=list)
    subscriptions: dict[tuple[str, str], Any] = field(default_factory=dict)
    spin: Any = None

    def give(self, topic: str, message: Any) -> None:
        """Hand a message to whoever listens."""
        self.subscriptions[topic, type(message).__name__](message)

    def of(self, topic: str) -> list[Any]:
        return [message for name, message in self.published if name == topic]


_RUNTIME: list[Runtime] = []  # the one that was installed last


@dataclass
class Time:
    nanoseconds: int = 0

    @classmethod
    def from_msg(cls, stamp: Any) -> Time:
        return cls(stamp.sec * 10**9 + stamp.nanosec)


class ReliabilityPolicy(Enum):
    RELIABLE, BEST_EFFORT = 1, 2


@dataclass
class QoSProfile:
    depth: int
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE


class Logger:
    def warning(self, text: str, *, throttle_duration_sec: float = 0.0) -> None:
        _RUNTIME[-1].said.append(text)
        if throttle_duration_sec > 0.0:
            _RUNTIME[-1].throttled.append(text)

    fatal = warning


@dataclass
class Publisher:
    kind: type
    topic: str

    def publish(self, message: Any) -> None:
        assert isinstance(message, self.kind)
        _RUNTIME[-1].published.append((self.topic, message))


@dataclass
class Parameter:
    value: Any


class Clock:
    def now(self) -> Time:
        return Time(_RUNTIME[-1].now_ns)


class Node:
    def __init__(self, node_name: str) -> None:
        self.name = node_name

    def declare_parameter(self, name: str, value: Any) -> Parameter:
        return Parameter(_RUNTIME[-1].parameters.get(name, value))

    def create_publisher(self, msg_type: type, topic: str, qos_profile: Any) -> Publisher:
        return Publisher(msg_type, topic)

    def create_subscription(self, msg_type: type, topic: str, callback: Any, qos_profile: Any) -> None:
        _RUNTIME[-1].subscriptions[topic, msg_type.__name__] = callback

    def get_clock(self) -> Clock:
        return Clock()

    def get_logger(self) -> Logger:
        return Logger()

    def destroy_node(self) -> None:
        _RUNTIME[-1].said.append("destroyed")


class TransformException(Exception):
    pass


class ExternalShutdownException(Exception):
    pass


class Buffer:
    def lookup_transform(self, target_frame: str, source_frame: str, time: Time) -> Any:
        transforms = _RUNTIME[-1].transforms
        if (target_frame, source_frame) not in transforms:
            raise TransformException(f"{source_frame} is not connected to {target_frame}")
        return transforms[target_frame, source_frame]


_MODULES: dict[str, dict[str, Any]] = {
    "rclpy": {
        "init": lambda: None,
        "spin": lambda node: _RUNTIME[-1].spin(node),
        "try_shutdown": lambda: _RUNTIME[-1].said.append("shut down"),
    },
    "rclpy.node": {"Node": Node},
    "rclpy.time": {"Time": Time},
    "rclpy.qos": {"QoSProfile": QoSProfile, "ReliabilityPolicy": ReliabilityPolicy},
    "rclpy.logging": {"get_logger": lambda name: Logger()},
    "rclpy.executors": {"ExternalShutdownException": ExternalShutdownException},
    "tf2_ros": {
        "Buffer": Buffer,
        "TransformException": TransformException,
        "TransformListener": lambda buffer, node: None,
    },
}


def install(patch: pytest.MonkeyPatch) -> Runtime:
    """Make the stand-in and the node importable."""
    _RUNTIME.append(Runtime())
    modules: dict[str, dict[str, Any]] = {package: {} for package in _PACKAGES} | _MODULES
    for package in _PACKAGES:
        prefix = f"{package}/msg/"
        names = [name for name in _TYPES if name.startswith(prefix)]
        modules[f"{package}.msg"] = {name.removeprefix(prefix): message_class(name) for name in names}
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        patch.setitem(sys.modules, name, module)
    patch.syspath_prepend(str(REPOSITORY / "ros" / "monoloc_ros"))
    for name in ("monoloc_ros", "monoloc_ros.conversion", "monoloc_ros.node"):
        patch.delitem(sys.modules, name, raising=False)
    return _RUNTIME[-1]
