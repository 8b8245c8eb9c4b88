"""Synthetic results of tasks, for tests of figures: plausible and known."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from map_helpers import make_mixture
from monoloc.bundle import Bundle, Provenance, write_bundle
from monoloc.camera import Camera
from monoloc.depth.spec import DepthModel, monoloc_spec
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import se3_exp
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc_lab.experiments.gather import frames_of
from monoloc_lab.experiments.task import RESULT, Result, Task
from onnx_networks import onnx_network

# A task that localises a recording -> its position RMSE on unseen frames, metres.
Error = Callable[[Task], float]

_RMSE = {"posenet-run": 0.5, "filtered-run": 0.3, "keypoints-run": 0.04}
_BUILT = {("none", False): 0.4, ("last", False): 0.2, ("none", True): 0.25, ("last", True): 0.15}


def plausible_rmse(task: Task) -> float:
    """A centimetre more per seed, three times as much in near darkness, a tenth more for a smaller network."""
    settings = task.settings
    error = _RMSE.get(task.kind, 0.1)
    if task.kind == "run":
        bundle = task.needs[0]
        if "config" in bundle.settings:
            adapt = bundle.settings["config"]["adapt"]
            error = 0.03 if settings["sensor"] else _BUILT.get((adapt["tune"], adapt["map_transform"]), 0.08)
            error *= 1.0 if bundle.settings.get("network", "full").startswith("full") else 1.1
    return (error + 0.01 * settings["seed"]) * (3.0 if is_dark(task) else 1.0)


def is_dark(task: Task) -> bool:
    recording = task.settings["evaluation"]
    return recording["light"] == "L3" or "L3" in recording["source"]


def synthetic_results(
    tasks: Iterable[Task], out: Path, rmse: Error = plausible_rmse, results: dict[Task, Result] | None = None
) -> dict[Task, Result]:
    """Results of tasks and of all that they need, added to existing ones."""
    results = {} if results is None else results

    def make(task: Task) -> None:
        if task in results:
            return
        for need in task.needs:
            make(need)
        folder = out / "results" / task.key
        folder.mkdir(parents=True, exist_ok=True)
        figures = _MAKERS[task.kind](task, folder, rmse)
        (folder / RESULT).write_text(json.dumps(figures))
        results[task] = Result(folder, figures)

    for task in tasks:
        make(task)
    return results


def _bundle(task: Task, folder: Path, rmse: Error) -> dict[str, Any]:
    room = make_mixture(12, 0)
    camera = Camera(640, 480, 525.0, 525.0, 320.0, 240.0)
    provenance = Provenance(recording="room", frames={}, tune="all", map_transform=True, lambda_kl=0.1, seed=0)
    spec = monoloc_spec(136.0)
    model = DepthModel(onnx_network(spec), spec, "none")
    write_bundle(
        folder / "room.monoloc",
        Bundle(
            original=room,
            adapted=room,
            depth_model=model,
            settings=LocalizerConfig(),
            camera=camera,
            provenance=provenance,
            thresholds=LikelihoodThresholds(low=-2.0, lost=-4.0),
            reference_poses=ReferencePoses.without_bias(np.eye(4)[None]),
        ),
    )
    return {
        "components": 200,
        "map_bytes": 8000,
        "network_bytes": 1_950_000,
        "depth_absrel_before": 0.2 + 0.01 * task.settings["seed"],
        "shift_median_m": 0.02,
        "known_bias_used": True,
    }


def _remapped(task: Task, folder: Path, rmse: Error) -> dict[str, Any]:
    size = task.settings["size"]
    components = int(size) if task.settings["map"] == "mixture" else int(10.0 / size**2)
    each = {"mixture": 40, "voxels": 2, "points": 12}[task.settings["map"]]
    return {"components": components, "map_bytes": each * components}


def _run(task: Task, folder: Path, rmse: Error) -> dict[str, Any]:
    recording = task.settings["evaluation"]
    truth = frames_of(recording["source"], recording["frames"]).poses
    assert truth is not None
    error, count = rmse(task), len(truth)
    rng = np.random.default_rng(task.settings["seed"])
    twists = np.zeros((count, 6))
    twists[:, :3] = error / np.sqrt(3.0) * rng.standard_normal((count, 3))
    arrays = {"poses": truth @ se3_exp(twists), "truth": truth, "unseen": np.ones(count, dtype=np.bool_)}
    if task.kind == "keypoints-run":
        arrays["poses"][::7] = np.nan
    np.savez(folder / "trajectory.npz", seconds=np.arange(count) / 15.0, **arrays)
    return {
        "unseen_ate_rmse_m": error,
        "unseen_ate_median_m": 0.9 * error,
        "unseen_rot_median_deg": 2.0,
        "unseen_frames": count,
        "unseen_failed_frames": int(np.isnan(arrays["poses"]).any(axis=(1, 2)).sum()),
        "unseen_odometry_ate_rmse_m": 0.12 * (2.0 if is_dark(task) else 1.0),
        "unseen_odometry_from_start_ate_rmse_m": 0.2,
        "unseen_coverage_95": 0.9,
        "unseen_depth_absrel": 0.1,
        "frames": count,
        "states": {"tracking": count},
    }


def _depth(task: Task, folder: Path, rmse: Error) -> dict[str, Any]:
    settings = task.settings
    evaluation = settings["evaluation"]
    adapted = bool(task.needs)
    shown = settings["shown"]
    recording = frames_of(evaluation["source"], evaluation["frames"])
    color = np.stack([recording.color(index)[::4, ::4] for index in shown])
    height, width = color.shape[1:3]
    truth = np.tile(np.linspace(1.0, 4.0, width, dtype=np.float32), (len(shown), height, 1))
    truth[:, :10, :10] = 0.0
    network = task.needs[0].settings["network"] if adapted else settings["network"]
    absrel = (0.08 if adapted else 0.3) * (1.0 if network.startswith("full") else 1.2)
    predicted = np.float32(1.0 + absrel) * np.tile(
        np.linspace(1.0, 4.0, width, dtype=np.float32), (len(shown), height, 1)
    )
    np.savez(folder / "depth.npz", index=np.array(shown), color=color, predicted=predicted, truth=truth)
    compared = list(range(0, len(recording), settings["stride"]))
    values = {"absrel": absrel, "delta1": 1.0 - absrel, "ssim": 0.9 - absrel}
    per_frame = {"index": compared} | {name: [value] * len(compared) for name, value in values.items()}
    per_frame["ssim"][0] = None  # as for a frame whose valid depth covers no whole window
    return {**values, "frames": len(compared), "per_frame": per_frame}


def _clouds(task: Task, folder: Path, rmse: Error) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    original = rng.uniform([-2.0, -1.0, -2.0], [2.0, 1.0, 2.0], (2000, 3))
    adapted = original + 0.05 * rng.standard_normal((2000, 3))
    distances = np.linalg.norm(adapted - original, axis=1)
    np.savez(
        folder / "clouds.npz",
        original=original,
        adapted=adapted,
        distances_m=distances,
        down_world=np.array([0, 1.0, 0]),
    )
    median = 0.05 + 0.01 * task.needs[0].settings["seed"]
    return {"c2c_median_m": median, "c2c_p95_m": 0.15, "c2c_max_m": 0.4, "correspondence_share": 0.98}


def _posenet(task: Task, folder: Path, rmse: Error) -> dict[str, Any]:
    return {"parameters": 440_614, "bytes": 1_762_456, "multiply_adds": 21_000_000}


_MAKERS: dict[str, Callable[[Task, Path, Error], dict[str, Any]]] = {
    "bundle": _bundle,
    "remapped": _remapped,
    "run": _run,
    "posenet-search": _posenet,
    "posenet": _posenet,
    "posenet-run": _run,
    "filtered-run": _run,
    "keypoints-run": _run,
    "depth": _depth,
    "clouds": _clouds,
}
