"""A network, a camera and poses small enough to train and tune on in a test."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.spec import DepthModel
from monoloc.depth.training.export import export_model
from monoloc.depth.training.network import DepthNetwork, NetworkConfig
from monoloc.geometry import make_pose, so3_exp
from synthetic_room import Room, RoomRecording

FloatArray = NDArray[np.float64]

ROOM = Room()
TINY = NetworkConfig(width=0.1, decoder_channels=8, focal_px=46.0)
# The network's 96x64 in both directions twice over, at 2 % above its focal length.
SMALL_CAMERA = Camera(192, 128, 95.0, 93.0, 93.0, 66.0)


def tiny_network(seed: int = 0, config: NetworkConfig = TINY) -> DepthNetwork:
    """A network in evaluation mode whose every tensor matters, running statistics too."""
    torch.manual_seed(seed)
    network = DepthNetwork(config)
    for name, buffer in network.named_buffers():
        if name.endswith("running_mean"):
            buffer.normal_(0.0, 0.1)
        elif name.endswith("running_var"):
            buffer.uniform_(0.5, 1.5)
    return network.eval()


def exported_model(network: DepthNetwork) -> DepthModel:
    """A network as it runs."""
    return export_model(network, "depth.onnx")


def looking_around(count: int, seed: int = 0) -> FloatArray:
    """Cameras about the room's middle that look in all directions in turn, (count, 4, 4)."""
    rng = np.random.default_rng(seed)
    yaw = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    turns = so3_exp(np.stack([np.zeros(count), yaw, np.zeros(count)], axis=1))
    return make_pose(turns @ so3_exp(rng.normal(0.0, 0.1, (count, 3))), rng.uniform(-0.4, 0.4, (count, 3)))


def small_recording(
    frames: int, seed: int = 0, camera: Camera = SMALL_CAMERA, has_depth: bool = True
) -> RoomRecording:
    return RoomRecording(ROOM, looking_around(frames, seed), camera, has_depth)
