from collections.abc import Callable
from typing import Any, Generic, TypeVar

from rclpy.logging import Logger
from rclpy.qos import QoSProfile
from rclpy.time import Time

Message = TypeVar("Message")

class Clock:
    def now(self) -> Time: ...

class Parameter:
    @property
    def value(self) -> Any: ...

class Publisher(Generic[Message]):
    def publish(self, msg: Message) -> None: ...

class Subscription: ...

class Node:
    def __init__(self, node_name: str) -> None: ...
    def declare_parameter(self, name: str, value: Any) -> Parameter: ...
    def create_publisher(
        self, msg_type: type[Message], topic: str, qos_profile: QoSProfile | int
    ) -> Publisher[Message]: ...
    def create_subscription(
        self,
        msg_type: type[Message],
        topic: str,
        callback: Callable[[Message], None],
        qos_profile: QoSProfile | int,
    ) -> Subscription: ...
    def get_clock(self) -> Clock: ...
    def get_logger(self) -> Logger: ...
    def destroy_node(self) -> None: ...
