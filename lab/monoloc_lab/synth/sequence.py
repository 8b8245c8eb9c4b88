"""A flight rendered to recordings in several lights, in the ``folder`` format.

::

    OUT/L1/dataset.toml, color/000000.jpg    one recording per light
    OUT/poses.txt, depth/000000.png          shared by the lights
    OUT/room.json, settings.json             the room and the settings
    OUT/linear/000000.npz                    light by group, so another light needs no rendering
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc.geometry import FloatArray
from monoloc.io.dataset_description import FILE_NAME
from monoloc.io.tum_trajectory import write_tum
from monoloc.progress import Progress
from monoloc_lab.synth.blur import motion_blurred
from monoloc_lab.synth.light import Light
from monoloc_lab.synth.materials import LightGroup
from monoloc_lab.synth.render import Picture, Renderer, illuminance, mixed
from monoloc_lab.synth.rooms import Room, write_room
from monoloc_lab.synth.sensor import (
    DepthSensorConfig,
    SensorConfig,
    metered,
    photograph,
    structured_light,
    white_balance,
)

ROOM = "room.json"
_SETTINGS = "settings.json"
_BALANCE_FRAMES = 8  # number of frames that determine the white balance


@dataclass(frozen=True)
class RenderConfig:
    """Settings of a rendering.

    Attributes:
        samples: paths per pixel and light group.
        depth: "exact", or "sensor" for a simulated structured-light sensor.
        depth_scale: stored value of one metre.
        jpeg_quality: of the colour images, 1 to 100.
        is_even: whether to render in even light, see :class:`monoloc_lab.synth.render.Renderer`.
    """

    samples: int = 48
    depth: Literal["exact", "sensor"] = "exact"
    depth_scale: float = 1000.0
    jpeg_quality: int = 92
    sensor: SensorConfig = field(default_factory=SensorConfig)
    depth_sensor: DepthSensorConfig = field(default_factory=DepthSensorConfig)
    is_even: bool = False


def render_sequence(
    room: Room,
    poses: FloatArray,
    timestamps_s: FloatArray,
    velocities: FloatArray,
    camera: Camera,
    lights: Sequence[Light],
    config: RenderConfig,
    seed: int,
    out: Path,
    progress: Progress,
) -> list[Path]:
    """Render a flight; frames that an earlier call rendered are reused.

    Args:
        poses: ``T_world_camera``, (N, 4, 4).
        timestamps_s: (N,).
        velocities: of the camera at each image, twists per second in its frame, (N, 6).

    Returns:
        One recording per light.

    Raises:
        DataError: the folder has another rendering, or cannot be written.
        MissingExtraError: frames have to be rendered and Mitsuba is not installed.
    """
    settings = {
        "room": hashlib.sha256(room.to_json().encode()).hexdigest(),
        "poses": hashlib.sha256(np.ascontiguousarray(np.round(poses, 9)).tobytes()).hexdigest(),
        "camera": asdict(camera),
        "samples": config.samples,
        "seed": seed,
        **({"light": "even"} if config.is_even else {}),
    }
    claim(out, settings)
    write_room(out / ROOM, room)
    (out / "linear").mkdir(exist_ok=True)
    frames = [out / "linear" / f"{index:06d}.npz" for index in range(len(poses))]
    lux_file = out / "linear" / "lux.json"
    missing = [index for index, frame in enumerate(frames) if not frame.is_file()]
    if missing or not lux_file.is_file():
        renderer = Renderer(room, config.samples, config.is_even)
        if not lux_file.is_file():
            write_whole(lux_file, json.dumps(illuminance(renderer, room)).encode())
        with progress.task("render", len(frames)) as step:
            step(len(frames) - len(missing))
            for done, index in enumerate(missing, start=len(frames) - len(missing) + 1):
                picture = renderer.picture(camera, poses[index], seed + index)
                write_whole(frames[index], _packed(picture))
                step(done)
    lux: dict[LightGroup, float] = json.loads(lux_file.read_text())
    write_tum(out / "poses.txt", timestamps_s, poses)
    _write_depth(frames, poses, camera, config, seed, out / "depth")
    with progress.task("develop", len(lights) * len(frames)) as step:
        for number, light in enumerate(lights):
            develop(frames, velocities, camera, light, lux, config, seed, out / light.name)
            step((number + 1) * len(frames))
            write_whole(out / light.name / FILE_NAME, _description(camera, len(frames), config).encode())
    return [out / light.name for light in lights]


def claim(out: Path, settings: Mapping[str, object]) -> None:
    """Make an output folder with its settings, and refuse to mix two renderings.

    Raises:
        DataError: the folder has a rendering with other settings, or cannot be written.
    """
    out.mkdir(exist_ok=True)
    text, path = json.dumps(settings, indent=1), out / _SETTINGS
    if path.is_file() and path.read_text() != text:
        raise DataError(out, "has a rendering with other settings", "name another folder, or remove that one")
    write_whole(path, text.encode())


def _packed(picture: Picture) -> bytes:
    buffer = io.BytesIO()
    # Half precision is exact to 0.05 %, less than the noise; its range of 65504 cd/m^2 exceeds any window.
    light = {f"light_{group}": np.minimum(image, 6e4).astype(np.float16) for group, image in picture.light.items()}
    normals = picture.normals.astype(np.float16)
    arrays: dict[str, Any] = {**light, "depth_m": picture.depth_m, "normals": normals, "glass": picture.glass}
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def develop(
    frames: Sequence[Path],
    velocity: FloatArray,
    camera: Camera,
    light: Light,
    lux: dict[LightGroup, float],
    config: RenderConfig,
    seed: int,
    out: Path,
) -> None:
    """Simulate camera images of rendered frames in one light; velocity (N, 6) is a twist per second."""
    (out / "color").mkdir(parents=True, exist_ok=True)
    sensor, factors = light.exposed(config.sensor), light.factors(lux)
    chosen = np.unique(np.linspace(0, len(frames) - 1, _BALANCE_FRAMES).astype(int))
    # White balance is constant over a flight; exposure is set for every frame.
    balance = np.median([white_balance(_seen(frames[i], factors)[0], sensor.adapted) for i in chosen], axis=0)
    for index, frame in enumerate(frames):
        rng = np.random.default_rng([seed, index, int(1000.0 * light.lux)])
        still, depth = _seen(frame, factors)
        moved = motion_blurred(still, depth, camera, velocity[index], sensor.exposure_s(metered(still)))
        image = photograph(moved, sensor, rng, balance.astype(np.float32))
        quality = [cv2.IMWRITE_JPEG_QUALITY, config.jpeg_quality]
        write_whole(out / "color" / f"{index:06d}.jpg", cv2.imencode(".jpg", image[..., ::-1], quality)[1].tobytes())


def _seen(frame: Path, factors: dict[LightGroup, float]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Light (H, W, 3) and depth (H, W) of a rendered frame."""
    with np.load(frame) as stored:
        light = {group: stored[f"light_{group}"].astype(np.float32) for group in factors}
        return mixed(light, factors), stored["depth_m"]


def _write_depth(
    frames: Sequence[Path], poses: FloatArray, camera: Camera, config: RenderConfig, seed: int, out: Path
) -> None:
    out.mkdir(exist_ok=True)
    for index, frame in enumerate(frames):
        with np.load(frame) as stored:
            depth, glass = stored["depth_m"], stored["glass"]
            normals = stored["normals"].astype(np.float32) @ poses[index, :3, :3].astype(np.float32)
        if config.depth == "sensor":
            rng = np.random.default_rng([seed, index, 0xDE])
            depth = structured_light(depth, normals, glass, camera, config.depth_sensor, rng)
        write_whole(out / f"{index:06d}.png", depth_png(depth, config.depth_scale))


def depth_png(depth_m: NDArray[np.float32], depth_scale: float) -> bytes:
    """Depth (H, W) metres as a 16-bit PNG; values that are too large are stored as 0."""
    stored = np.round(depth_m * depth_scale)
    stored[stored > 65534.0] = 0.0
    return bytes(cv2.imencode(".png", stored.astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1])


def _description(camera: Camera, count: int, config: RenderConfig) -> str:
    return f"""\
kind = "sequence"
color = "color/{{index:06d}}.jpg"
depth = "../depth/{{index:06d}}.png"
poses = "../poses.txt"
count = {count}
{camera_lines(camera)}
depth_scale = {config.depth_scale}
"""


def camera_lines(camera: Camera) -> str:
    """A camera in the format of ``dataset.toml``."""
    names = ("width", "height", "fx", "fy", "cx", "cy")
    return "\n".join(f"{name} = {getattr(camera, name)}" for name in names)
