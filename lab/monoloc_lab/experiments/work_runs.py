"""Localisation with a bundle, and the accuracy of its depth and map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.bundle import Bundle, read_bundle, read_network
from monoloc.config import override
from monoloc.depth.predictor import DepthPredictor
from monoloc.errors import DataError
from monoloc.evaluation.cloud_metrics import compare_clouds
from monoloc.evaluation.depth_metrics import depth_metrics
from monoloc.geometry import FloatArray, so3_exp
from monoloc.io.recording import Recording
from monoloc.progress import NoProgress
from monoloc.run import depth_pair, localize
from monoloc.start import Start
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import BUNDLE, Settings, evaluation_frames, relighting, write_trajectory

_ATTITUDE_BIAS_RAD, _ATTITUDE_NOISE_RAD = np.deg2rad(0.5), np.deg2rad(0.3)  # standard deviation per axis


def run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    bundle, recording = _read(needs[0]), evaluation_frames(settings)
    rng = np.random.default_rng(settings["seed"])
    if settings["start"] is None and not bundle.supports_relocalization:
        problem = "is flown without a start, and neither scans nor landmarks can find the camera in this room"
        raise DataError(recording.name, problem, "build it from more frames, or with landmarks")
    start = None if settings["start"] is None else start_of(settings, recording, rng)
    changed = override(bundle.settings, motion=settings["motion"], without=settings["without"])
    flown = replace(bundle, settings=changed)
    relight = relighting(settings["evaluation"]["light"], settings["seed"])
    down = _simulated_down(bundle, recording, settings["seed"]) if settings["gravity"] else None
    result = localize(flown, recording, start, rng, NoProgress(), settings["sensor"], relight=relight, down=down)
    further = {"covariances": result.covariances}
    if result.odometry is not None:
        further["odometry"] = result.odometry
    write_trajectory(folder, recording, result.poses, result.unseen, **further)
    return result.metrics()


def depth(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    recording = evaluation_frames(settings)
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth", "give a recording whose depth can be compared")
    model = _read(needs[0]).depth_model if needs else read_network(settings["network"])
    predictor = DepthPredictor(model, recording.camera)
    relight = relighting(settings["evaluation"]["light"], settings["seed"])
    names = ("absrel", "delta1", "ssim")
    per_frame: dict[str, list[Any]] = {name: [] for name in ("index", *names)}
    pictures: dict[str, list[Any]] = {name: [] for name in ("index", "color", "predicted", "truth")}
    for index in sorted({*range(0, len(recording), settings["stride"]), *settings["shown"]}):
        color = relight(recording.color(index)) if relight else recording.color(index)
        predicted, truth = depth_pair(predictor(color), recording.depth(index))
        if index % settings["stride"] == 0 and truth.any():
            metrics = depth_metrics(predicted, truth)
            for name in names:
                per_frame[name].append(getattr(metrics, name))
            per_frame["index"].append(index)
        if index in settings["shown"]:
            for name, value in zip(pictures, (index, color, predicted, truth), strict=True):
                pictures[name].append(value)
    if not per_frame["index"]:
        raise DataError(recording.name, "has no frame with depth", "give one that can be compared")
    arrays: dict[str, Any] = {name: np.array(values) for name, values in pictures.items()}
    np.savez_compressed(folder / "depth.npz", **arrays)
    # SSIM is undefined for a frame whose valid depth covers no whole window.
    means = {name: _mean([value for value in per_frame[name] if value is not None]) for name in names}
    return {**means, "frames": len(per_frame["index"]), "per_frame": per_frame}


def clouds(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    room = _read(needs[0])
    rng = np.random.default_rng(settings["seed"])
    compared = compare_clouds(room.original, room.adapted, settings["points"], rng)
    np.savez_compressed(
        folder / "clouds.npz",
        original=compared.original.astype(np.float32),
        adapted=compared.adapted.astype(np.float32),
        distances_m=compared.distances_m.astype(np.float32),
        down_world=np.array(room.provenance.down_world),
    )
    return compared.figures


def start_of(settings: Settings, recording: Recording, rng: np.random.Generator) -> Start:
    """The start of a run: beside the first true pose, in a random direction."""
    assert recording.poses is not None
    position_m, rotation_rad = settings["start"]["position_m"], np.deg2rad(settings["start"]["rotation_deg"])
    return Start.disturbed(recording.poses[0], rng, position_m, rotation_rad)


def _simulated_down(bundle: Bundle, recording: Recording, seed: int) -> FloatArray:
    """(N, 3) direction of gravity in the camera's frame, as a flight controller measures it.

    Its error has a part that is constant for a run and a part that is new in every frame.
    """
    if bundle.down is None:
        raise DataError(recording.name, "does not show which way is down", "give one with a floor or a ceiling")
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    twists = _ATTITUDE_BIAS_RAD * rng.normal(size=3)
    twists = twists + _ATTITUDE_NOISE_RAD * rng.normal(size=(len(recording), 3))
    true_down = bundle.down @ recording.poses[:, :3, :3]
    return np.asarray(so3_exp(twists) @ true_down[..., None])[..., 0]


def _read(needed: Result) -> Bundle:
    return read_bundle(needed.folder / BUNDLE)


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None
