from array import array
from collections.abc import Sequence

from geometry_msgs.msg import Quaternion
from std_msgs.msg import Header

class Image:
    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: array[int]

class CompressedImage:
    header: Header
    format: str
    data: array[int]

class CameraInfo:
    header: Header
    height: int
    width: int
    distortion_model: str
    d: Sequence[float]
    k: Sequence[float]
    p: Sequence[float]

class Imu:
    header: Header
    orientation: Quaternion
    orientation_covariance: Sequence[float]

class PointField:
    name: str
    offset: int
    datatype: int
    count: int

class PointCloud2:
    header: Header
    height: int
    width: int
    fields: list[PointField]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: array[int]
    is_dense: bool
