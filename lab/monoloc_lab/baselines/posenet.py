"""PoseNet: a network that regresses the camera pose from an image, trained on one room.

Sources: Kendall et al., *PoseNet* (ICCV 2015), encoder, one fully connected layer, position and orientation;
Kendall & Cipolla, *Geometric Loss Functions for Camera Pose Regression* (CVPR 2017), learned weights of the two;
Brahmbhatt et al., *MapNet* (CVPR 2018), orientation as the logarithm of a unit quaternion, half the rotation vector.

The encoder is the MobileNetV2 of the depth network, so its ImageNet weights load here too. Smaller sizes leave out
blocks. PoseNet has more encoder blocks and a fully connected layer where a depth network has its decoder. The width
of that layer makes the number of parameters equal to that of the depth network of the same size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, model_validator
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils.flop_counter import FlopCounterMode

from monoloc.depth.training.family import network_config
from monoloc.depth.training.mobilenet import Encoder, check_encoder_blocks
from monoloc.depth.training.network import DepthNetwork
from monoloc.geometry import FloatArray, make_pose, nearest_rotation, so3_exp, so3_log

# Blocks in the seven stages of MobileNetV2 for each size.
_ENCODER_BLOCKS: dict[str, tuple[int, ...]] = {
    "full": (1, 2, 3, 4, 3, 3, 1),
    "two-thirds": (1, 2, 3, 4, 3, 2, 1),
    "one-third": (1, 2, 3, 4, 3, 1, 0),
    "tiny": (1, 1, 1, 1, 1, 1, 0),
}
_POSE = 6  # three numbers for the position, three for the orientation
_LEAST_SCALE_M = 1e-3  # for a stationary camera
# Initial logarithms of the two variances (Kendall & Cipolla 2017).
_LOG_VARIANCES = (0.0, -3.0)


class PoseNetConfig(BaseModel):
    """Architecture of a PoseNet; stored with its weights.

    Attributes:
        width, encoder_blocks: of the encoder, as in :class:`monoloc.depth.training.network.NetworkConfig`.
        features: width of the fully connected layer.
        focal_px: images are resized to about this focal length, as for the depth network.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: float = Field(0.35, gt=0.0, le=2.0)
    encoder_blocks: tuple[int, int, int, int, int, int, int]
    features: int = Field(ge=1)
    focal_px: float = Field(136.0, gt=0.0)

    @model_validator(mode="after")
    def _check(self) -> PoseNetConfig:
        check_encoder_blocks(self.encoder_blocks)
        return self


class PoseNet(nn.Module):
    """Encoder, global average pooling, fully connected layer, position and orientation."""

    def __init__(self, config: PoseNetConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config.width, config.encoder_blocks)
        self.hidden = nn.Linear(_channels(self.encoder), config.features)
        self.position = nn.Linear(config.features, 3)
        self.orientation = nn.Linear(config.features, 3)

    def forward(self, images: Tensor) -> Tensor:
        """Encoded poses, see :class:`PoseCode`: (B, 3, H, W) in [-1, 1] -> (B, 6)."""
        pooled = self.encoder(images)[-1].mean(dim=(2, 3))
        x = F.relu(self.hidden(pooled))
        return torch.cat([self.position(x), self.orientation(x)], dim=1)

    def parameter_count(self) -> int:
        return sum(p.numel() for p in self.parameters())

    def multiply_adds(self, width: int, height: int) -> int:
        """Multiply-adds for one image, counted as for the depth network."""
        with FlopCounterMode(display=False) as counter, torch.no_grad():
            self(torch.zeros(1, 3, height, width))
        return int(counter.get_total_flops()) // 2


@cache
def posenet_config(size: str, width: float) -> PoseNetConfig:
    """The PoseNet with as many parameters as the depth network of that size and width.

    Raises:
        SettingError: no such size or width.
    """
    depth_config = network_config(size, width)
    with torch.device("meta"):  # only to count parameters: no memory, no random numbers
        wanted = DepthNetwork(depth_config).parameter_count()
        encoder = Encoder(width, _ENCODER_BLOCKS[size])
    # A feature has a weight per channel, a bias, and a weight for each number of the pose.
    left = wanted - sum(p.numel() for p in encoder.parameters()) - _POSE
    features = round(left / (_channels(encoder) + 1 + _POSE))
    return PoseNetConfig.model_validate(
        {"width": width, "encoder_blocks": _ENCODER_BLOCKS[size], "features": features}
    )


def _channels(encoder: Encoder) -> int:
    """Channels of the last output of the encoder."""
    return list(encoder.taps.values())[-1]


class HomoscedasticLoss(nn.Module):
    """``L_p exp(-s_p) + s_p + L_q exp(-s_q) + s_q`` with learned s, L the mean L1 distance of position, orientation.

    Kendall & Cipolla 2017, equation 4: s is the logarithm of a homoscedastic variance.
    """

    def __init__(self) -> None:
        super().__init__()
        self.log_variances = nn.Parameter(torch.tensor(_LOG_VARIANCES))

    def forward(self, predicted: Tensor, target: Tensor) -> Tensor:
        """Loss of poses (B, 6), a scalar."""
        distance = (predicted - target).abs().reshape(-1, 2, 3).sum(dim=2).mean(dim=0)
        return torch.sum(distance * torch.exp(-self.log_variances) + self.log_variances)


@dataclass(frozen=True)
class PoseCode:
    """Encoding of poses as six numbers of about unit size, which the network learns.

    Attributes:
        T_world_middle: mean position and (chordal) mean orientation of the training poses, (4, 4).
        scale_m: root mean square distance of their positions from it, per axis.
    """

    T_world_middle: FloatArray
    scale_m: float

    @classmethod
    def of(cls, poses: ArrayLike) -> PoseCode:
        """The encoding for training poses ``T_world_camera`` (N, 4, 4)."""
        T_world_camera = np.asarray(poses, dtype=np.float64)
        positions = T_world_camera[:, :3, 3]
        middle = make_pose(nearest_rotation(T_world_camera[:, :3, :3].mean(axis=0)), positions.mean(axis=0))
        return cls(middle, max(_LEAST_SCALE_M, float(np.sqrt(np.mean(np.var(positions, axis=0))))))

    def encode(self, poses: ArrayLike) -> FloatArray:
        """``T_world_camera`` (..., 4, 4) -> (..., 6): standardised position, log quaternion from the middle."""
        T_world_camera, middle = np.asarray(poses, dtype=np.float64), self.T_world_middle
        position = (T_world_camera[..., :3, 3] - middle[:3, 3]) / self.scale_m
        log_quaternion = 0.5 * so3_log(middle[:3, :3].T @ T_world_camera[..., :3, :3])
        return np.concatenate([position, log_quaternion], axis=-1)

    def decode(self, code: ArrayLike) -> FloatArray:
        """Poses from their encoding, (..., 6) -> (..., 4, 4)."""
        values, middle = np.asarray(code, dtype=np.float64), self.T_world_middle
        rotation = middle[:3, :3] @ so3_exp(2.0 * values[..., 3:])
        return make_pose(rotation, middle[:3, 3] + self.scale_m * values[..., :3])
