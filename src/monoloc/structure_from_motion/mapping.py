"""Structure from motion by COLMAP: keypoints, matches of neighbours and of loops, incremental mapping.

Sources: Lowe 2004 (SIFT); Schönberger and Frahm, *Structure-from-Motion Revisited* (CVPR 2016).
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, invert
from monoloc.io.colmap import camera_of, parameters_of
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.progress import Progress, Step
from monoloc.structure_from_motion.sparse_model import SparseModel

_MOST_SIDE_PX, _KEYPOINTS = 960, 1500
_NEIGHBOURS = (1, 2, 3, 4, 5, 6, 8, 12, 16, 24, 32)  # keyframes apart that are matched
_LOOP_FRAMES = 40  # spread evenly, all of which are matched with each other, so that loops close
_PAIRS_AT_ONCE = 100
LEAST_TRACK = 3
"""Observations of a point."""

LEAST_FRAMES = 8
"""Keyframes that are placed."""

_LEAST_SHARE = 1.0 / 3.0  # placed of the keyframes
_TURNING = 0.5  # share of matched pairs that one homography explains, from which the camera only turns
_REFINED = ("f", "k1", "k2")
# Focal lengths from videos of RedKitchen and the desk were 1.4 % and 1.8 % below those of other calibrations, and
# distortion made up for it: k1 was 0.07 and 0.14 above. The bundle adjustment's own errors were 0.1 % and 0.3 %.
_FOCAL_SD, _DISTORTION_SD = 0.015, 0.1

_SLOWER = "walk slower and sideways, with light and texture in view, so that neighbouring frames overlap"


def map_keyframes(
    recording: Recording, keyframes: NDArray[np.int64], refine: bool, seed: int, progress: Progress
) -> SparseModel:
    """Place keyframes and points.

    Args:
        recording: its camera is taken as it is, or as a first guess.
        keyframes: (K,) ascending indices.
        refine: whether focal length and radial distortion are refined.
        seed: the same seed gives the same model on the same machine.

    Raises:
        DataError: too few keyframes, too few of them could be placed, the camera only turned, the refined intrinsics
            are no camera's, or a frame cannot be read.
    """
    import pycolmap

    if len(keyframes) < LEAST_FRAMES:
        problem = f"moves so little that it has {len(keyframes)} keyframe{'' if len(keyframes) == 1 else 's'}"
        raise DataError(recording.name, problem, f"at least {LEAST_FRAMES} are needed: walk through the room")
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value  # monoloc reports problems itself, once
    pycolmap.set_random_seed(seed)
    with tempfile.TemporaryDirectory(prefix="monoloc-") as folder:
        workspace = Path(folder)
        with progress.task("keypoints", len(keyframes)) as step:
            _extract(workspace, recording, keyframes, refine, step)
        pairs = _pairs(len(keyframes))
        with progress.task("matches", len(pairs)) as step:
            _match(workspace, pairs, step)
        with progress.task("mapping", len(keyframes)) as step:
            model = _map(workspace, refine, seed, step)
        placed = 0 if model is None else model.num_reg_images()
        if model is None or placed < max(LEAST_FRAMES, _LEAST_SHARE * len(keyframes)):
            only_turned = _only_turned(workspace, len(keyframes))
            raise _too_few(recording.name, placed, len(keyframes), only_turned)
    camera, camera_sd = recording.camera, dict[str, float]()
    if refine:
        camera, camera_sd = _refined_camera(model, recording.name)
    return _sparse_model(model, camera, camera_sd, keyframes)


def _name(position: int) -> str:
    return f"{position:06d}.png"


def _extract(workspace: Path, recording: Recording, keyframes: NDArray[np.int64], refine: bool, step: Step) -> None:
    import pycolmap

    model, parameters = parameters_of(recording.camera, "RADIAL" if refine else None)
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model, reader.camera_params = model, ",".join(map(repr, parameters))
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu, options.max_image_size = 1, False, _MOST_SIDE_PX
    options.sift.max_num_features = _KEYPOINTS
    for position, index in enumerate(keyframes.tolist()):
        image = cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2GRAY)
        (workspace / _name(position)).write_bytes(cv2.imencode(".png", image)[1].tobytes())
        if position == 1:  # all images are of the camera that the first one brought
            reader.existing_camera_id = 1
        pycolmap.extract_features(
            workspace / "database.db", workspace, [_name(position)], pycolmap.CameraMode.SINGLE, reader, options
        )
        step(position + 1)


def _pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of keyframes that are matched: neighbours, and an even selection with each other."""
    near = {(first, first + apart) for apart in _NEIGHBOURS for first in range(count - apart)}
    spread = evenly_spaced(count, _LOOP_FRAMES).tolist()
    loops = {(first, second) for first in spread for second in spread if first < second}
    return sorted(near | loops)


def _match(workspace: Path, pairs: Sequence[tuple[int, int]], step: Step) -> None:
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.num_threads, options.use_gpu = 1, False
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = workspace / "pairs.txt"
    for start in range(0, len(pairs), _PAIRS_AT_ONCE):
        some = pairs[start : start + _PAIRS_AT_ONCE]
        lines = [f"{_name(first)} {_name(second)}" for first, second in some]
        (workspace / "pairs.txt").write_text("\n".join([*lines, ""]))
        pycolmap.match_image_pairs(workspace / "database.db", options, pairing)
        step(start + len(some))


def _map(workspace: Path, refine: bool, seed: int, step: Step) -> Any:
    """The model with the most frames; None if there is none."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = 1, seed, LEAST_FRAMES
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine
    options.ba_refine_principal_point = False
    placed = 0

    def next_image() -> None:
        nonlocal placed
        placed += 1
        step(placed)

    models = pycolmap.incremental_mapping(
        workspace / "database.db", workspace, workspace, options, next_image_callback=next_image
    )
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _only_turned(workspace: Path, count: int) -> bool:
    """Whether neighbouring keyframes match, and one homography explains most pairs: there is no parallax."""
    import pycolmap

    kinds = pycolmap.TwoViewGeometryConfiguration
    with pycolmap.Database.open(workspace / "database.db") as database:
        found = [geometry.config for geometry in database.read_two_view_geometries()[1]]
    matched = [kind for kind in found if kind not in (kinds.UNDEFINED, kinds.DEGENERATE)]
    turning = [kind for kind in matched if kind in (kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)]
    return len(matched) >= count - 1 and len(turning) > _TURNING * len(matched)


def _too_few(name: str, placed: int, count: int, only_turned: bool) -> DataError:
    if only_turned:
        problem = "shows no depth: the camera turns on the spot, or sees one flat surface"
        return DataError(name, problem, "move the camera sideways while it looks around")
    return DataError(name, f"only {placed} of {count} keyframes could be placed", _SLOWER)


def _refined_camera(model: Any, name: str) -> tuple[Camera, dict[str, float]]:
    """The refined camera, and the standard deviations of what was refined.

    These are of the bundle adjustment, whose errors are taken to be independent, and of what other calibrations of
    two cameras differ by.
    """
    import pycolmap

    (found,) = model.cameras.values()
    fix = "calibrate the camera with a board (monoloc calibrate), and give its file as --camera"
    try:
        camera = camera_of(found.model.name, found.width, found.height, found.params.tolist(), Path(name))
    except (SettingError, DataError) as error:
        raise DataError(name, f"determines no camera ({error})", fix) from error
    config, options = pycolmap.BundleAdjustmentConfig(), pycolmap.BundleAdjustmentOptions()
    for image in model.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options.refine_focal_length, options.refine_extra_params, options.refine_principal_point = True, True, False
    options.print_summary = False
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    covariance = pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), model, adjuster)
    known = None if covariance is None else covariance.get_other_params_cov(found.params)
    if known is None:
        raise DataError(name, "does not determine the camera's focal length", fix)
    formal_sd = model.compute_mean_reprojection_error() * np.sqrt(np.diag(known))
    sd = np.hypot(formal_sd, [_FOCAL_SD * camera.fx, _DISTORTION_SD, _DISTORTION_SD])
    return camera, dict(zip(_REFINED, sd.tolist(), strict=True))


def _sparse_model(
    model: Any, camera: Camera, camera_sd: dict[str, float], keyframes: NDArray[np.int64]
) -> SparseModel:
    tracks = {number: point for number, point in model.points3D.items() if point.track.length() >= LEAST_TRACK}
    row_of = {number: row for row, number in enumerate(tracks)}
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    poses, frame, point, pixels = [], [], [], []
    for position, image in enumerate(images):
        T_camera_world = np.eye(4)
        T_camera_world[:3] = image.cam_from_world().matrix()
        poses.append(invert(T_camera_world))
        for seen in image.points2D:
            if seen.has_point3D() and seen.point3D_id in row_of:
                frame.append(position)
                point.append(row_of[seen.point3D_id])
                pixels.append(seen.xy - 0.5)  # COLMAP's first pixel has its centre at 0.5
    points: FloatArray = np.array([each.xyz for each in tracks.values()]).reshape(-1, 3)
    return SparseModel(
        camera=camera,
        camera_sd=camera_sd,
        frames=keyframes[[int(Path(image.name).stem) for image in images]],
        poses=np.array(poses),
        points=points,
        frame=np.array(frame, dtype=np.int64),
        point=np.array(point, dtype=np.int64),
        pixels=np.array(pixels, dtype=np.float64).reshape(-1, 2),
        tried=len(keyframes),
    )
