"""Path tracing with Mitsuba 3 (Jakob et al. 2022): linear light by light group, exact depth, normals.

Light is additive, so daylight and lamps are rendered separately, and every mixture is a sum of the two pictures.
Radiance is in cd/m^2 (of each primary; white has equal parts), so exposure can be computed.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import MissingExtraError, SettingError
from monoloc.geometry import FloatArray, invert, make_pose
from monoloc_lab.synth.denoise import Guide, denoised
from monoloc_lab.synth.materials import LightGroup, Material
from monoloc_lab.synth.rooms import Room
from monoloc_lab.synth.scene import linear, room_meshes
from monoloc_lab.synth.shapes import Mesh
from monoloc_lab.synth.textures import texture

LIGHT_GROUPS: tuple[LightGroup, ...] = get_args(LightGroup)

# Older versions cannot compile the code of Dr.Jit 1.x and abort the process.
_LEAST_LLVM = 17
_MATT = 0.85  # rougher surfaces are rendered without a highlight
_GROUP_PAINT = {"daylight": (1.0, 0.0, 0.0), "lamps": (0.0, 1.0, 0.0), None: (0.0, 0.0, 0.0)}
_BOUNCES = 6  # further bounces contribute a few percent in rooms with bright walls
# Of even light: illuminance, and its share by the surface's direction, so that walls differ from each other.
_EVEN_LUX, _EVEN_SHADING = 300.0, np.array([0.15, 0.1, 0.25])
_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba cameras have x to the left and y up


@dataclass(frozen=True)
class Picture:
    """One view in linear light.

    Attributes:
        light: of each light group, (H, W, 3) float32, cd/m^2.
        depth_m: (H, W) float32, z at the centre of the pixel; 0 without a surface.
        normals: (H, W, 3) float32, world frame, of the same points.
        albedo: (H, W, 3) float32, mean over the pixel.
        shines: (H, W) whether the centre of the pixel shows a lamp or a window pane.
        glass: (H, W) whether it shows a window pane.
    """

    light: dict[LightGroup, NDArray[np.float32]]
    depth_m: NDArray[np.float32]
    normals: NDArray[np.float32]
    albedo: NDArray[np.float32]
    shines: NDArray[np.bool_]
    glass: NDArray[np.bool_]


def require_mitsuba() -> str:
    """The variant of Mitsuba for rendering: vectorised if LLVM is available, else scalar.

    Raises:
        MissingExtraError: Mitsuba is not installed.
    """
    try:
        import mitsuba  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("rendering", "synth", "monoloc-lab") from error
    return _variant()


@cache
def _variant() -> str:
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        library = _llvm()
        if library is None:
            return "scalar_rgb"
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    # An incompatible library aborts the process, so another process tries it.
    probe = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import drjit as dr; dr.eval(dr.sin(mi.Float(1, 2)))"
    works = subprocess.run([sys.executable, "-c", probe], capture_output=True, check=False).returncode == 0
    return "llvm_ad_rgb" if works else "scalar_rgb"


def _llvm() -> Path | None:
    """The newest LLVM library of the system, if it is new enough."""
    found: dict[int, Path] = {}
    for folder in (
        "/usr/lib/x86_64-linux-gnu",
        "/usr/lib/aarch64-linux-gnu",
        "/usr/lib64",
        "/usr/lib",
        "/opt/homebrew/opt/llvm/lib",
    ):
        for path in Path(folder).glob("libLLVM*"):
            match = re.fullmatch(r"libLLVM(?:-|\.so\.|\.)(\d+)[\w.-]*", path.name)
            if match and int(match[1]) >= _LEAST_LLVM:
                found.setdefault(int(match[1]), path)
    return found[max(found)] if found else None


class Renderer:
    """Renders pictures of one room.

    Args:
        samples: paths per pixel and light group.
        is_even: whether to render in even light, without shadows and highlights: twenty times faster.

    Raises:
        MissingExtraError: Mitsuba is not installed.
    """

    def __init__(self, room: Room, samples: int, is_even: bool = False) -> None:
        variant = require_mitsuba()
        import mitsuba as mi

        mi.set_variant(variant)
        self._mi: Any = mi
        self._samples, self._is_even = samples, is_even
        meshes = room_meshes(room)
        surfaces = {material: mi.load_dict(_surface(material, self._bitmap)) for material in meshes}
        self._scenes = {group: self._scene(meshes, surfaces, group) for group in LIGHT_GROUPS}
        # Coloured by light group, so the albedo shows which pixels see a lamp or a window.
        painted = {m: mi.load_dict({"type": "diffuse", "reflectance": _rgb(_GROUP_PAINT[m.group])}) for m in meshes}
        self._painted = self._scene(meshes, painted, None)
        path = {"type": "path", "max_depth": _BOUNCES, "rr_depth": 3}
        self._path = mi.load_dict({"type": "aov", "aovs": "of:albedo", "light": path})
        self._albedo = mi.load_dict({"type": "aov", "aovs": "of:albedo,facing:sh_normal"})
        self._geometry = mi.load_dict({"type": "aov", "aovs": "at:position,facing:sh_normal,group:albedo"})

    def picture(self, camera: Camera, T_world_camera: FloatArray, seed: int) -> Picture:
        """Render the view from a pose; the noise depends on the seed.

        Raises:
            SettingError: a camera with distortion or with pixels that are not square.
        """
        sensor = self._sensor(camera, T_world_camera, "independent")
        if self._is_even:
            return self._evenly_lit(camera, T_world_camera, sensor, seed)
        traced = {
            group: self._render(scene, sensor, self._path, seed, self._samples)
            for group, scene in self._scenes.items()
        }
        depth, points, normals, paint = self._surfaces(camera, T_world_camera)
        guide = Guide(traced["lamps"][..., -3:], normals, points, paint.max(axis=-1) > 0.5)
        return Picture(
            light={group: denoised(image[..., :3], guide) for group, image in traced.items()},
            depth_m=depth,
            normals=normals.astype(np.float32),
            albedo=guide.albedo.astype(np.float32),
            shines=guide.shines,
            glass=paint[..., 0] > 0.5,
        )

    def _evenly_lit(self, camera: Camera, T_world_camera: FloatArray, sensor: Any, seed: int) -> Picture:
        seen = self._render(self._scenes["daylight"], sensor, self._albedo, seed, self._samples).astype(np.float32)
        albedo, facing = seen[..., :3], seen[..., 3:6]
        depth, _, normals, paint = self._surfaces(camera, T_world_camera)
        light = albedo * (_EVEN_LUX / np.pi * (1.0 + facing @ _EVEN_SHADING))[..., None]
        return Picture(
            light={"daylight": light.astype(np.float32), "lamps": np.zeros_like(light, dtype=np.float32)},
            depth_m=depth,
            normals=normals.astype(np.float32),
            albedo=albedo,
            shines=paint.max(axis=-1) > 0.5,
            glass=paint[..., 0] > 0.5,
        )

    def _render(self, scene: Any, sensor: Any, integrator: Any, seed: int, samples: int) -> NDArray[Any]:
        try:
            image = self._mi.render(scene, sensor=sensor, integrator=integrator, seed=seed, spp=samples)
        except RuntimeError as error:
            if isinstance(error.__cause__, KeyboardInterrupt):  # which Dr.Jit has wrapped
                raise KeyboardInterrupt from error
            raise
        return np.array(image)

    def _surfaces(
        self, camera: Camera, T_world_camera: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Depth, points, normals and colour of the light group at the centres of the pixels."""
        centres = self._sensor(camera, T_world_camera, "stratified")
        seen = self._render(self._painted, centres, self._geometry, seed=0, samples=1)
        points, normals, paint = np.split(seen, 3, axis=-1)
        T_camera_world = invert(T_world_camera)
        depth = points @ T_camera_world[2, :3] + T_camera_world[2, 3]
        hit = np.linalg.norm(normals, axis=-1) > 0.5
        return np.where(hit, depth, 0.0).astype(np.float32), points, normals, paint

    def _sensor(self, camera: Camera, T_world_camera: FloatArray, sampler: str) -> Any:
        if camera.is_distorted or abs(camera.fx / camera.fy - 1.0) > 1e-6:
            raise SettingError("camera", "has distortion or fx other than fy", "render with a plain camera")
        mi = self._mi
        return mi.load_dict(
            {
                "type": "perspective",
                "fov": float(np.rad2deg(2.0 * np.arctan(camera.width / 2.0 / camera.fx))),
                "fov_axis": "x",
                "near_clip": 0.01,
                "principal_point_offset_x": 0.5 - (camera.cx + 0.5) / camera.width,
                "principal_point_offset_y": 0.5 - (camera.cy + 0.5) / camera.height,
                "to_world": mi.ScalarTransform4f(T_world_camera @ _AXES),
                # One sample at the centre of each pixel, so depth is not averaged over edges.
                "sampler": {
                    "type": sampler,
                    "sample_count": 1,
                    **({"jitter": False} if sampler == "stratified" else {}),
                },
                "film": {
                    "type": "hdrfilm",
                    "width": camera.width,
                    "height": camera.height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
            }
        )

    def _scene(self, meshes: dict[Material, Mesh], surfaces: dict[Material, Any], group: LightGroup | None) -> Any:
        content: dict[str, Any] = {"type": "scene"}
        for number, (material, mesh) in enumerate(meshes.items()):
            radiance = self._bitmap(material, material.luminance) if group and material.group == group else None
            content[f"shape{number}"] = self._shape(f"shape{number}", mesh, surfaces[material], radiance)
        return self._mi.load_dict(content)

    def _shape(self, name: str, mesh: Mesh, surface: Any, radiance: dict[str, Any] | None) -> Any:
        mi = self._mi
        properties = mi.Properties()
        properties["mesh_bsdf"] = surface
        if radiance is not None:
            properties["mesh_emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        counts = {"vertex_count": len(mesh.vertices), "face_count": len(mesh.faces)}
        shape = mi.Mesh(name, **counts, props=properties, has_vertex_normals=True, has_vertex_texcoords=True)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = np.ravel(mesh.vertices).astype(np.float32)
        parameters["vertex_normals"] = np.ravel(mesh.normals).astype(np.float32)
        parameters["vertex_texcoords"] = np.ravel(mesh.span).astype(np.float32)
        parameters["faces"] = np.ravel(mesh.faces).astype(np.uint32)
        parameters.update()
        return shape

    def _bitmap(self, material: Material, factor: float) -> dict[str, Any]:
        image = linear(texture(material))[::-1] * np.float32(factor)  # v runs up, rows run down
        if material.texture == "plain":
            return _rgb(tuple(float(c) for c in image[0, 0]))
        return {"type": "bitmap", "bitmap": self._mi.Bitmap(np.ascontiguousarray(image)), "raw": True}


def _rgb(color: tuple[float, ...]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(color)}


def _surface(material: Material, bitmap: Callable[[Material, float], dict[str, Any]]) -> dict[str, Any]:
    if material.group is not None:
        # A lamp or a window pane: only its own light matters.
        return {"type": "diffuse", "reflectance": _rgb((0.3, 0.3, 0.3))}
    color = bitmap(material, 1.0)
    if material.roughness >= _MATT:
        return {"type": "diffuse", "reflectance": color}
    gloss = {"roughness": material.roughness, "metallic": material.metallic, "specular": 0.5}
    return {"type": "principled", "base_color": color, **gloss}


def illuminance(renderer: Renderer, room: Room) -> dict[LightGroup, float]:
    """Mean illuminance of the surfaces visible from the centre of the room, by light group, lux.

    A matt surface with albedo a and luminance L has the illuminance pi L / a.
    """
    camera = Camera(48, 48, 24.0, 24.0, 23.5, 23.5)
    eye = np.array([room.size[0] / 2.0, room.size[1] / 2.0, 1.2])
    found: dict[LightGroup, list[float]] = {group: [] for group in LIGHT_GROUPS}
    for index in range(4):
        right, forward = ([np.cos(a), np.sin(a), 0.0] for a in (index * np.pi / 2.0, (index + 1) * np.pi / 2.0))
        view = renderer.picture(camera, make_pose(np.stack([right, [0.0, 0.0, -1.0], forward], axis=1), eye), index)
        for group in LIGHT_GROUPS:
            lit = np.pi * view.light[group].mean(axis=2) / np.maximum(view.albedo.mean(axis=2), 0.05)
            found[group].append(float(lit[~view.shines].mean()))
    return {group: float(np.mean(values)) for group, values in found.items()}


def mixed(
    light: Mapping[LightGroup, NDArray[np.float32]], factors: Mapping[LightGroup, float]
) -> NDArray[np.float32]:
    """Weighted sum of the light groups: (H, W, 3) float32, cd/m^2."""
    return np.asarray(sum(np.float32(factors[group]) * image for group, image in light.items()), dtype=np.float32)
