from collections.abc import Sequence

from std_msgs.msg import Header

class Point:
    x: float
    y: float
    z: float

class Vector3:
    x: float
    y: float
    z: float

class Quaternion:
    x: float
    y: float
    z: float
    w: float

class Pose:
    position: Point
    orientation: Quaternion

class PoseWithCovariance:
    pose: Pose
    covariance: Sequence[float]

class PoseWithCovarianceStamped:
    header: Header
    pose: PoseWithCovariance

class Transform:
    translation: Vector3
    rotation: Quaternion

class TransformStamped:
    header: Header
    child_frame_id: str
    transform: Transform
