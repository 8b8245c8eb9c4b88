"""What there is to be done, each with all that its result depends on; :mod:`monoloc_lab.experiments.work` does it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from monoloc import __version__
from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.build_config import BuildConfig
from monoloc.config import override
from monoloc.evaluation.cloud_metrics import COMPARED_POINTS
from monoloc.extras import training_extra
from monoloc.io.identity import file_sha256
from monoloc.start import START_ERROR_DEG, START_ERROR_M
from monoloc_lab.baselines.keypoints import KeypointConfig
from monoloc_lab.experiments.source_version import source_sha256
from monoloc_lab.experiments.study import WIDTH, Split, Study, Walk
from monoloc_lab.experiments.task import Task
from monoloc_lab.experiments.task_inputs import describe_recording, network_file
from monoloc_lab.experiments.work import KINDS

VARIANTS: dict[str, dict[str, Any]] = {
    "unadapted": {"tune": "none", "map_transform": False},
    "last": {"tune": "last", "map_transform": False},
    "map": {"tune": "none", "map_transform": True},
    "last+map": {"tune": "last", "map_transform": True},
    "network": {"tune": "all", "map_transform": False},
    "joint": {"tune": "all", "map_transform": True},
}
"""What is tuned: ``last+map`` is the source paper's joint training, ``joint`` is monoloc's default."""

DEPTH_STRIDE = 5
"""Of how many frames of a walk one is judged, where depth alone is in question."""

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
    **adapt: Any,
) -> Task:
    """A bundle built from a split: ``room.monoloc``.

    Its figures are those of ``monoloc build``, and ``network_bytes``, ``map_bytes``.

    Args:
        variant: key of :data:`VARIANTS`.
        frames: how many of the split's build frames, evenly out of them; None for all.
        landmarks: whether they are kept; they find a camera whatever its depth is like, so what depth is worth is
            told without them.
        adapt: settings of adaptation beside the variant's and, before them, the study's.
    """
    untuned = variant == "unadapted"  # so no setting of tuning is any of its result
    settings = {**({} if untuned else study.adapt | adapt), **VARIANTS[variant]}
    config = override(BuildConfig(), components=components, landmarks=landmarks, adapt=settings)
    return _task(
        "bundle",
        build=_recording(split.source, split.frames),
        count=frames,
        network=network,
        network_sha256=_content_of(network),
        config=config.model_dump(mode="json"),
        seed=seed,
    )


def remapped(bundle: Task, kind: Literal["mixture", "voxels", "points"], size: float) -> Task:
    """A bundle's network on another map of its room: ``room.monoloc``.

    Its figures are ``components`` and ``map_bytes``, as such a map would be stored.

    Args:
        bundle: of the variant ``network``, which bends no map.
        kind: ``mixture``, ``size`` components; ``voxels``, occupied ones with an edge of ``size`` metres, stored as
            an octree with a byte a node; ``points``, ``size`` metres apart, stored as three float32.
    """
    settings = bundle.settings
    kept = {name: settings[name] for name in ("build", "count", "config", "seed")}
    return _task("remapped", needs=(bundle,), map=kind, size=size, **kept)


def run(bundle: Task, walk: Walk, seed: int, motion: str = "visual", sensor: bool = False) -> Task:
    """A walk followed in a bundle's map: ``way.npz``, see :data:`WAY`.

    Its figures are those of ``monoloc localize``, ``unseen_...`` on frames that built nothing.

    Args:
        motion: of the filter; with ``random-walk`` there is no odometry in the file.
        sensor: whether depth is the recording's, not the network's.
    """
    return _task("run", needs=(bundle,), walk=_walk(walk), seed=seed, start=_START, motion=motion, sensor=sensor)


WAY = ("poses", "truth", "unseen", "seconds", "covariances", "odometry")
"""Arrays of ``way.npz``: ``T_world_camera`` (N, 4, 4), NaN where there is none; the same, true; (N,) whether a frame
built nothing; (N,) times from the first. Of :func:`run` alone: (N, 6, 6), and (N, 4, 4) dead reckoning from the first
true pose.
"""


def posenet_search(study: Study, split: Split, size: str, views: bool = False) -> Task:
    """The learning rate that is best for a PoseNet; figures ``learning_rate``, ``trials``, ``error`` of the best."""
    built = _recording(split.source, split.frames)
    return _task("posenet-search", build=built, **_training(study, size, views), seed=0)


def posenet(study: Study, split: Split, size: str, seed: int, views: bool = False) -> Task:
    """A PoseNet with as many parameters as the depth network of a size, trained on a split: ``posenet.safetensors``.

    Its figures are ``parameters``, ``bytes`` of the file, ``multiply_adds`` at the depth network's input size as the
    catalogue has it, ``learning_rate`` and ``trials``. A quick study trains for fewer epochs, at one learning rate.

    Args:
        seed: of weights, order and exposures. The learning rate is the same for all, see :func:`posenet_search`.
        views: whether it also learns from views synthesised of the recording, as the depth network does.
    """
    search = posenet_search(study, split, size, views)
    built = _recording(split.source, split.frames)
    return _task("posenet", needs=(search,), build=built, **_training(study, size, views), seed=seed)


def posenet_run(posenet: Task, walk: Walk) -> Task:
    """A walk located by a PoseNet, frame by frame: ``way.npz``, and figures as :func:`run`, failed frames beside.

    The noise of a changed light is of the PoseNet's seed.
    """
    built, seed = (posenet.settings[name] for name in ("build", "seed"))
    return _task("posenet-run", needs=(posenet,), build=built, walk=_walk(walk), seed=seed)


def filtered_run(posenet: Task, bundle: Task, walk: Walk, seed: int) -> Task:
    """The same smoothed by the filter and odometry that a bundle's localizer has: ``way.npz``."""
    built = posenet.settings["build"]
    needs = (posenet, bundle)
    return _task("filtered-run", needs=needs, build=built, walk=_walk(walk), seed=seed, start=_START)


def keypoints_run(study: Study, split: Split, walk: Walk, kind: Literal["orb", "sift"]) -> Task:
    """A walk located by keypoints of a split's frames: ``way.npz``; figures also ``map_bytes``."""
    config = KeypointConfig(kind=kind).model_dump(mode="json")
    return _task(
        "keypoints-run", build=_recording(split.source, split.frames), config=config, walk=_walk(walk), seed=0
    )


def depth(source: Task | str, walk: Walk, stride: int = DEPTH_STRIDE, shown: Sequence[int] = ()) -> Task:
    """Depth of every so many frames of a walk against the sensor's: ``depth.npz`` with the frames to be shown.

    Its figures are means ``absrel``, ``delta1``, ``ssim`` (over a range of 10 m; against the sensor's depth) and,
    under ``per_frame``, lists of the same with ``index``. The file has ``color`` (S, H, W, 3), ``predicted`` and
    ``truth`` (S, h, w) metres, 0 where the sensor has none, and ``index`` (S,), positions in the walk.

    Args:
        source: a bundle, or the name of a network as it comes.
        shown: positions in the walk.
    """
    common: dict[str, Any] = {"walk": _walk(walk), "stride": stride, "shown": list(shown), "seed": 0}
    if isinstance(source, Task):
        return _task("depth", needs=(source,), **common)
    return _task("depth", network=source, network_sha256=_content_of(source), **common)


def clouds(bundle: Task) -> Task:
    """A bundle's maps as clouds: ``clouds.npz``; figures as those of ``monoloc map compare``.

    The file has ``original`` and ``adapted`` (N, 3), metres, world frame; ``distances_m`` (N,), from points of the
    original to the nearest adapted one; ``down_world`` (3,).
    """
    return _task("clouds", needs=(bundle,), points=COMPARED_POINTS, seed=0)


_START = {"position_m": START_ERROR_M, "rotation_deg": START_ERROR_DEG}


def _task(kind: str, needs: Sequence[Task] = (), **settings: Any) -> Task:
    return Task.of(kind, {"monoloc": __version__, "code": source_sha256(KINDS[kind].__module__), **settings}, needs)


def _training(study: Study, size: str, views: bool) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet import posenet_config
        from monoloc_lab.baselines.posenet_training import PoseNetTraining
    config = override(
        PoseNetTraining(network=posenet_config(size, WIDTH)),
        synthesised_views=AdaptConfig.model_validate(study.adapt).synthesised_views if views else 0,
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


def _walk(walk: Walk) -> dict[str, Any]:
    return {**_recording(walk.source, walk.frames), "light": walk.light}


_recording = cache(describe_recording)  # in a reproduction's lifetime, what lies there does not change


def _content_of(network: str) -> str:
    return file_sha256(network_file(network))
