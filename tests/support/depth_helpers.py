"""A network, a camera and poses small enough to train and tune on in a test."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper
from torch import Tensor

from monoloc.camera import Camera
from monoloc.depth.spec import DepthModel, monoloc_spec
from monoloc.depth.training.augment import AugmentConfig
from monoloc.depth.training.export import export_model
from monoloc.depth.training.network import DepthNetwork, NetworkConfig
from monoloc.geometry import make_pose, so3_exp
from synthetic_room import Room, RoomRecording

FloatArray = NDArray[np.float64]

ROOM = Room()
TINY = NetworkConfig(width=0.1, decoder_channels=8, focal_px=46.0)
UNCERTAIN = TINY.model_copy(update={"uncertainty": True})
# Twice the network's 96x64 in both directions, with a focal length 2 % above its own.
SMALL_CAMERA = Camera(192, 128, 95.0, 93.0, 93.0, 66.0)

# Neither augmentation nor noise.
NEUTRAL_AUGMENT = AugmentConfig(
    zoom_max=1.0,
    roll_deg=0.0,
    aspect=0.0,
    mirror=False,
    exposure_stops=0.0,
    gamma=0.0,
    contrast=0.0,
    white_balance=0.0,
    saturation=0.0,
    dim_share=0.0,
    electrons_min=1e14,
    read_noise=0.0,
    blur_px=0.0,
)


def tiny_network(seed: int = 0, config: NetworkConfig = TINY) -> DepthNetwork:
    """A network in evaluation mode in which every tensor has an effect, running statistics included."""
    torch.manual_seed(seed)
    network = DepthNetwork(config)
    for name, buffer in network.named_buffers():
        if name.endswith("running_mean"):
            buffer.normal_(0.0, 0.1)
        elif name.endswith("running_var"):
            buffer.uniform_(0.5, 1.5)
    return network.eval()


def exported_model(network: DepthNetwork) -> DepthModel:
    """A network as the runtime loads it."""
    return export_model(network, "depth.onnx")


def looking_around(count: int, seed: int = 0) -> FloatArray:
    """Cameras near the room's centre that look in all directions in turn, (count, 4, 4)."""
    rng = np.random.default_rng(seed)
    yaw = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    turns = so3_exp(np.stack([np.zeros(count), yaw, np.zeros(count)], axis=1))
    return make_pose(turns @ so3_exp(rng.normal(0.0, 0.1, (count, 3))), rng.uniform(-0.4, 0.4, (count, 3)))


def small_recording(
    frames: int, seed: int = 0, camera: Camera = SMALL_CAMERA, has_depth: bool = True
) -> RoomRecording:
    return RoomRecording(ROOM, looking_around(frames, seed), camera, has_depth)


def random_image(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def random_input(count: int = 1, height: int = 64, width: int = 64) -> Tensor:
    return torch.rand(count, 3, height, width, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0


def parameter_names(network: torch.nn.Module) -> set[str]:
    return {name for name in network.state_dict() if not name.endswith("num_batches_tracked")}


def encoder_arrays(network: DepthNetwork) -> dict[str, NDArray[np.float32]]:
    """The encoder's tensors, as files of ImageNet weights name them."""
    state = network.encoder.state_dict()
    return {name: state[name].numpy() for name in state if not name.endswith("num_batches_tracked")}


def smooth_images(count: int, seed: int = 0, height: int = 64, width: int = 96) -> list[NDArray[np.float32]]:
    """Coloured clouds, each (1, 3, height, width) in [-1, 1]."""
    rng = np.random.default_rng(seed)
    images = []
    for _ in range(count):
        noise = cv2.GaussianBlur(rng.standard_normal((height, width, 3)), (0, 0), rng.uniform(2.0, 8.0))
        image = np.clip(rng.uniform(-0.4, 0.4, 3) + 0.4 * noise / noise.std(), -1.0, 1.0)
        images.append(np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32))
    return images


def lively_network(seed: int = 0) -> DepthNetwork:
    """A network whose two outputs vary between images as much as in rooms, unlike those of an untrained network."""
    network = tiny_network(seed, UNCERTAIN)
    images = torch.from_numpy(np.concatenate(smooth_images(4, seed=99)))
    with torch.no_grad():
        assert network.error_head is not None
        torch.nn.init.normal_(network.error_head.weight)
        for head, output in zip((network.head, network.error_head), network.with_error(images), strict=True):
            assert output is not None
            head.weight *= 0.3 / output.std()
    return network


@cache
def lively_export() -> tuple[DepthNetwork, bytes]:
    """:func:`lively_network` and its export; nobody may change them."""
    network = lively_network()
    return network, export_model(network, "depth.onnx").content


def stub_network(log_depth: float, focal_px: float) -> DepthModel:
    """A network like ours that predicts a constant, one pixel for 4x4 of the image."""
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"])
    output = helper.make_tensor_value_info("log_depth", TensorProto.FLOAT, [1, 1, "rows", "columns"])
    constants = [
        helper.make_tensor("kernel", TensorProto.FLOAT, [1, 3, 1, 1], [0.0, 0.0, 0.0]),
        helper.make_tensor("bias", TensorProto.FLOAT, [1], [log_depth]),
    ]
    node = helper.make_node("Conv", ["image", "kernel", "bias"], ["log_depth"], strides=[4, 4])
    graph = helper.make_graph([node], "stub", [image], [output], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return DepthModel(model.SerializeToString(), monoloc_spec(focal_px))


def run_onnx(content: bytes, image: NDArray[np.float32], output: str = "log_depth") -> NDArray[np.float32]:
    """An output of an exported network for (1, 3, H, W)."""
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return np.asarray(session.run([output], {"image": image})[0])
