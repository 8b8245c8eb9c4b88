from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.time import Time

class TransformException(Exception): ...

class Buffer:
    def lookup_transform(self, target_frame: str, source_frame: str, time: Time) -> TransformStamped: ...

class TransformListener:
    def __init__(self, buffer: Buffer, node: Node) -> None: ...
