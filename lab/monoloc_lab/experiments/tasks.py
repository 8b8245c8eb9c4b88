"""Factories of tasks: the settings of each are all that its result depends on.

:mod:`monoloc_lab.experiments.work` computes the results.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.build_config import BuildConfig
from monoloc.config import override
from monoloc.evaluation.cloud_metrics import COMPARED_POINTS
from monoloc.extras import training_extra
from monoloc.io.identity import file_sha256
from monoloc.localizer_config import Part
from monoloc.start import START_ERROR_DEG, START_ERROR_M
from monoloc.version import __version__
from monoloc_lab.baselines.keypoints import KeypointConfig
from monoloc_lab.experiments.source_version import source_sha256
from monoloc_lab.experiments.study import WIDTH, EvalRecording, Split, Study
from monoloc_lab.experiments.task import Task
from monoloc_lab.experiments.task_inputs import describe_recording, network_file
from monoloc_lab.experiments.work import KINDS

VARIANTS: dict[str, dict[str, Any]] = {
    "unadapted": {"tune": "none", "map_transform": False},
    "last": {"tune": "last", "map_transform": False},
    "map": {"tune": "none", "map_transform": True},
    "last+map": {"tune": "last", "map_transform": True},
    "decoder": {"tune": "decoder", "map_transform": True},
    "network": {"tune": "all", "map_transform": False},
    "joint": {"tune": "all", "map_transform": True},
}
"""What is tuned: ``last+map`` is the joint training of the paper, ``joint`` is monoloc's default."""

DEPTH_STRIDE = 5
"""Depth is compared with the sensor's in one of so many frames."""

_NOT_DARKENED: dict[str, Any] = {"exposure_stops": 0.0, "dim_share": 0.0}
_QUICK_POSENET: dict[str, Any] = {"epochs": 60, "learning_rates": (1e-2,), "search_epochs": 30}


def bundle(
    study: Study,
    split: Split,
    network: str,
    variant: str = "joint",
    seed: int = 0,
    components: int = 200,
    frames: int | None = None,
    landmarks: bool = False,
    refine_poses: bool = False,
    **adapt: Any,
) -> Task:
    """A bundle built from a split: ``room.monoloc``.

    Its figures are those of ``monoloc build``, with ``network_bytes`` and ``map_bytes``.

    Args:
        variant: key of :data:`VARIANTS`.
        frames: number of build frames, evenly spaced in the split; None for all.
        landmarks: whether the bundle has landmarks. They measure the pose whatever the depth is, so experiments on
            depth leave them out.
        refine_poses: whether the build aligns the poses with the map.
        adapt: settings of adaptation; they take precedence over the study's, and the variant's over both.
    """
    untuned = variant == "unadapted"  # its result depends on no setting of tuning
    settings = {**({} if untuned else study.adapt | adapt), **VARIANTS[variant]}
    config = override(
        BuildConfig(), components=components, landmarks=landmarks, refine_poses=refine_poses, adapt=settings
    )
    return built(split, network, config, seed, frames)


def built(split: Split, network: str, config: BuildConfig, seed: int, frames: int | None = None) -> Task:
    """A bundle as :func:`bundle`, with all settings of the build given."""
    return _task(
        "bundle",
        build=_build(split),
        count=frames,
        network=network,
        network_sha256=_content_of(network),
        config=config.model_dump(mode="json"),
        seed=seed,
    )


def remapped(bundle: Task, kind: Literal["mixture", "voxels", "points"], size: float) -> Task:
    """The network of a bundle with another map of its room: ``room.monoloc``.

    Its figures are ``components`` and ``map_bytes``, the bytes that such a map takes when stored.

    Args:
        bundle: of the variant ``network``, which does not change the map.
        kind: ``mixture``: ``size`` components. ``voxels``: occupied voxels with an edge of ``size`` metres, stored as
            an octree with a byte per node. ``points``: points ``size`` metres apart, stored as three float32.
    """
    settings = bundle.settings
    inherited = {name: settings[name] for name in ("build", "count", "config", "seed")}
    return _task("remapped", needs=(bundle,), map=kind, size=size, **inherited)


def run(
    bundle: Task,
    recording: EvalRecording,
    seed: int,
    motion: str = "visual",
    sensor: bool = False,
    gravity: bool = False,
    without: tuple[Part, ...] | None = None,
    start_is_known: bool = True,
) -> Task:
    """A recording localised with a bundle: ``trajectory.npz``, see :data:`TRAJECTORY_ARRAYS`.

    Its figures are those of ``monoloc localize``; ``unseen_...`` are over frames that are not build frames.

    Args:
        motion: motion model of the filter; with ``random-walk`` the file has no odometry.
        sensor: use the depth of the recording, not of the network.
        gravity: give the localizer a simulated roll and pitch.
        without: parts of the localizer that are left out; None for those that the build left out.
        start_is_known: whether it starts beside the first reference pose; else the room is searched.
    """
    return _task(
        "run",
        needs=(bundle,),
        evaluation=_evaluation(recording),
        seed=seed,
        start=_START if start_is_known else None,
        motion=motion,
        sensor=sensor,
        gravity=gravity,
        without=without,
    )


def run_seeds(study: Study, bundle: Task, recording: EvalRecording, sensor: bool = False) -> list[Task]:
    """:func:`run` with a bundle, once per seed."""
    return [run(bundle, recording, seed, sensor=sensor) for seed in range(study.seeds)]


TRAJECTORY_ARRAYS = ("poses", "truth", "unseen", "seconds", "covariances", "odometry")
"""Arrays of ``trajectory.npz``.

``poses`` and ``truth``: ``T_world_camera`` (N, 4, 4), estimated (NaN for frames without a pose) and true. ``unseen``:
(N,) whether a frame is not a build frame. ``seconds``: (N,) time since the first frame. Of :func:`run` alone:
``covariances`` (N, 6, 6), and ``odometry`` (N, 4, 4), dead reckoning from the first true pose.
"""


def posenet_search(study: Study, split: Split, size: str, views: bool = False, darkened: bool = True) -> Task:
    """The best learning rate of a PoseNet; figures ``learning_rate``, ``trials``, and ``error`` of the best."""
    return _task("posenet-search", build=_build(split), **_training(study, size, views, darkened), seed=0)


def posenet(study: Study, split: Split, size: str, seed: int, views: bool = False, darkened: bool = True) -> Task:
    """A PoseNet with as many parameters as the depth network of a size, trained on a split: ``posenet.safetensors``.

    Its figures are ``parameters``, ``bytes`` of the file, ``multiply_adds`` at the input size of the depth network in
    the catalogue, ``learning_rate`` and ``trials``. A quick study trains for fewer epochs, at one learning rate.

    Args:
        seed: of weights, order and exposures. All seeds share the learning rate of :func:`posenet_search`.
        views: whether it also learns from views synthesised from the recording, as the depth network does.
        darkened: whether it learns from images of random exposure, some of them darkened; else all have the exposure
            that they were recorded with.
    """
    search = posenet_search(study, split, size, views, darkened)
    training = _training(study, size, views, darkened)
    return _task("posenet", needs=(search,), build=_build(split), **training, seed=seed)


def posenet_run(posenet: Task, recording: EvalRecording) -> Task:
    """A recording localised by a PoseNet, frame by frame: ``trajectory.npz``.

    Its figures are those of :func:`run`, with the number of failed frames. The noise of a simulated light has the
    seed of the PoseNet.
    """
    build, seed = (posenet.settings[name] for name in ("build", "seed"))
    return _task("posenet-run", needs=(posenet,), build=build, evaluation=_evaluation(recording), seed=seed)


def filtered_run(posenet: Task, bundle: Task, recording: EvalRecording, seed: int) -> Task:
    """The poses of a PoseNet, filtered with the filter and odometry of a bundle's localizer: ``trajectory.npz``."""
    return _task(
        "filtered-run",
        needs=(posenet, bundle),
        build=posenet.settings["build"],
        evaluation=_evaluation(recording),
        seed=seed,
        start=_START,
    )


def keypoints_run(study: Study, split: Split, recording: EvalRecording, kind: Literal["orb", "sift"]) -> Task:
    """A recording localised by keypoints of the build frames: ``trajectory.npz``; figures also ``map_bytes``."""
    config = KeypointConfig(kind=kind).model_dump(mode="json")
    return _task("keypoints-run", build=_build(split), config=config, evaluation=_evaluation(recording), seed=0)


def depth(
    source: Task | str, recording: EvalRecording, stride: int = DEPTH_STRIDE, shown: Sequence[int] = ()
) -> Task:
    """Predicted depth against the sensor's, in every ``stride``-th frame: ``depth.npz`` with the shown frames.

    Its figures are means ``absrel``, ``delta1`` and ``ssim`` (over a range of 10 m) and, under ``per_frame``, lists
    of the same with ``index``. The file has ``color`` (S, H, W, 3), ``predicted`` and ``truth`` (S, h, w) metres, 0
    where the sensor has none, and ``index`` (S,), positions in the recording.

    Args:
        source: a bundle, or the name of an unadapted network.
        shown: positions in the recording.
    """
    common: dict[str, Any] = {
        "evaluation": _evaluation(recording),
        "stride": stride,
        "shown": list(shown),
        "seed": 0,
    }
    if isinstance(source, Task):
        return _task("depth", needs=(source,), **common)
    return _task("depth", network=source, network_sha256=_content_of(source), **common)


def clouds(bundle: Task) -> Task:
    """The maps of a bundle as clouds: ``clouds.npz``; figures are those of ``monoloc map compare``.

    The file has ``original`` and ``adapted`` (N, 3), metres, world frame; ``distances_m`` (N,), from points of the
    original to the nearest point of the adapted cloud; ``down_world`` (3,).
    """
    return _task("clouds", needs=(bundle,), points=COMPARED_POINTS, seed=0)


_START = {"position_m": START_ERROR_M, "rotation_deg": START_ERROR_DEG}


def _task(kind: str, needs: Sequence[Task] = (), **settings: Any) -> Task:
    return Task.of(kind, {"monoloc": __version__, "code": source_sha256(KINDS[kind].__module__), **settings}, needs)


def _training(study: Study, size: str, views: bool, darkened: bool) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet import posenet_config
        from monoloc_lab.baselines.posenet_training import PoseNetTraining
    config = override(
        PoseNetTraining(network=posenet_config(size, WIDTH)),
        synthesised_views=AdaptConfig.model_validate(study.adapt).synthesised_views if views else 0,
        augment={} if darkened else _NOT_DARKENED,
        **(_QUICK_POSENET if study.quick else {}),
    )
    weights = study.encoder_weights
    return {
        "size": size,
        "width": WIDTH,
        "training": config.model_dump(mode="json"),
        "encoder": weights or f"full-{WIDTH}",
        "encoder_sha256": file_sha256(Path(weights)) if weights else _content_of(f"full-{WIDTH}"),
    }


def _build(split: Split) -> dict[str, Any]:
    return {**_recording(split.source, split.frames), "alteration": split.alteration}


def _evaluation(recording: EvalRecording) -> dict[str, Any]:
    described = _recording(recording.source, recording.frames)
    return {**described, "light": recording.light, "alteration": recording.alteration}


_recording = cache(describe_recording)  # recordings do not change during a study


def _content_of(network: str) -> str:
    return file_sha256(network_file(network))
