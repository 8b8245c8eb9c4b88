"""Native kernels (C++, see ``cpp/``). Lengths that disagree raise ValueError; all else is checked by the callers."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_F64 = NDArray[np.float64]
_F32 = NDArray[np.float32]
_I32 = NDArray[np.int32]
_I64 = NDArray[np.int64]
_U8 = NDArray[np.uint8]
_U16 = NDArray[np.uint16]
_U32 = NDArray[np.uint32]

def log_density(points: _F64, weights: _F64, means: _F64, covariances: _F64) -> _F64: ...
def expectation(points: _F64, weights: _F64, means: _F64, covariances: _F64) -> tuple[_F64, _F64, _F64, float]: ...

MOST_POOLED_PIXELS: int

# Of float32, or of the bits of bfloat16; all images of one type.
_Images = TypeVar("_Images", _F32, _U16)

def max_pool(values: _Images, threads: int, largest: _Images, from_: _U16) -> None: ...
def max_pool_gradient(gradient: _Images, from_: _U16, threads: int, out: _Images) -> None: ...
def chain_pools(values: _Images, weights: _F32, threads: int, out: _Images) -> None: ...
def chain_pools_gradient(
    values: _Images, gradient: _Images, weights: _F32, threads: int, out: _Images, of_weights: _F32
) -> None: ...
def draw_points(
    points: _F64,
    camera_from_world: _F64,
    camera: _F64,
    is_fisheye: bool,
    sight: _F64,
    behind: float,
    front: _U32,
    depth: _F32,
) -> None: ...
def match_descriptors(
    expected: _F64, known: _U8, pixels: _F64, descriptors: _U8, radius_px: float, most_bits: int
) -> tuple[_I64, _I64]: ...
def nearest_descriptors(descriptors: _U8, known: _U8, kept: int, most_bits: int) -> tuple[_I32, _I64]: ...
def find_consensus(
    points: _F64,
    rays: _F64,
    sd: _F64,
    nearest_m: float,
    most_sd: float,
    most_triples: int,
    confidence: float,
) -> tuple[_F64, _U32]: ...
def fit_pose(
    points: _F64, rays: _F64, sd: _F64, prior: _F64, information: _F64, kernel_sds: _F64, nearest_m: float
) -> tuple[_F64, _F64, _F64, _F64]: ...
def leverages(
    points: _F64, rays: _F64, sd: _F64, pose: _F64, covariance: _F64, weights: _F64, nearest_m: float
) -> _F64: ...
def fit_log_focal(
    points: _F64, rays: _F64, sd: _F64, pose: _F64, information: _F64, kernel_sds: _F64, nearest_m: float
) -> tuple[float, float]: ...
def fit_log_aspect(
    points: _F64, rays: _F64, sd: _F64, pose: _F64, information: _F64, kernel_sds: _F64, nearest_m: float
) -> tuple[float, float]: ...
def adjust_window(
    poses: _F64,
    points: _F64,
    rays: _F64,
    log_depth: _F64,
    ray_sd: float,
    log_depth_sd: float,
    iterations: int,
) -> tuple[_F64, _F64, _F64]: ...
def se3_exp(twists: _F64) -> _F64: ...
def se3_log(poses: _F64) -> _F64: ...
def pose_distances(pose: _F64, others: _F64, turn_worth: float) -> _F64: ...
def instruction_set() -> str: ...
def multiply_add(rounds: int) -> float: ...

class MixtureIndex:
    def __init__(
        self,
        weights: _F64,
        means: _F64,
        covariances: _F64,
        voxel_m: float,
        floor_density: float,
        tolerance: float,
    ) -> None: ...
    def log_density(self, points: _F64) -> _F64: ...
    def evaluations(self, points: _F64) -> int: ...
    def weigh(
        self,
        poses: _F64,
        log_scales: _F64,
        scan: _F32,
        point_weights: _F32 | None,
        outlier_share: float,
        volume_m3: float,
    ) -> _F64: ...
    @property
    def voxel_m(self) -> float: ...
    @property
    def voxels(self) -> int: ...
    @property
    def lists(self) -> int: ...
    @property
    def mean_candidates(self) -> float: ...
    @property
    def nbytes(self) -> int: ...

class RayMixture:
    def __init__(self, weights: _F64, means: _F64, covariances: _F64) -> None: ...
    def weigh(
        self,
        poses: _F64,
        log_scales: _F64,
        scan: _F32,
        point_weights: _F32 | None,
        log_depth_sd: float,
        outlier_share: float,
        log_depth_range: float,
    ) -> _F64: ...
