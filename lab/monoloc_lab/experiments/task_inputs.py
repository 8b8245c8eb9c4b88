"""What tasks of several kinds read and write: recordings, lights, trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.models import is_shipped, shipped_file
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.identity import recording_identity
from monoloc.io.recording import Recording, Relight, Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc_lab.experiments.altered import ALTERATIONS
from monoloc_lab.synth.light import LIGHTS, relit

Settings = dict[str, Any]

BUNDLE, POSENET, TRAJECTORY_FILE = "room.monoloc", "posenet.safetensors", "trajectory.npz"
_NOISE = 1  # separates the random numbers of image noise from those of a filter with the same seed


def describe_recording(source: str, frames: str) -> Settings:
    """Source, frames and content of a recording, so that a changed recording is another one.

    Raises:
        DataError, SettingError: the recording cannot be read.
    """
    recording = select_frames(open_recording(source), frames)
    return {"source": source, "frames": frames, **recording_identity(recording)}


def _open(described: Settings) -> Selection:
    """The frames that a task is named after. Refuses frames that have changed or differ on this machine."""
    source, frames, alteration = (described[name] for name in ("source", "frames", "alteration"))
    found = describe_recording(source, frames)
    if any(described[name] != value for name, value in found.items()):
        raise DataError(source, "has changed since this run began", "run it again, with the same data everywhere")
    recording = select_frames(open_recording(source), frames)
    return recording if alteration is None else ALTERATIONS[alteration](recording)


def network_file(network: str) -> Path:
    """File of a shipped network, by its name, or of one's own, by its path."""
    return shipped_file(network) if is_shipped(network) else Path(network)


def build_frames(settings: Settings) -> Recording:
    """The build frames: all of the split, or ``count`` of them, evenly spaced."""
    described, count = settings["build"], settings.get("count")
    recording = _open(described)
    if count is None:
        return recording
    if count > len(recording):
        raise DataError(recording.name, f"has {len(recording)} build frames, not {count}", "ask for fewer")
    return Selection(recording, np.linspace(0, len(recording) - 1, count).round().astype(np.int64))


def evaluation_frames(settings: Settings) -> Recording:
    """The frames to be localised; they have poses."""
    recording = _open(settings["evaluation"])
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "give a recording with poses to compare with")
    return recording


def write_trajectory(
    folder: Path, recording: Recording, poses: FloatArray, unseen: NDArray[np.bool_], **further: FloatArray
) -> None:
    """Write ``trajectory.npz``, see :data:`monoloc_lab.experiments.tasks.TRAJECTORY_ARRAYS`."""
    seconds = recording.timestamps_s - recording.timestamps_s[0]
    arrays: dict[str, Any] = {"poses": poses, "truth": recording.poses, "unseen": unseen, "seconds": seconds}
    np.savez_compressed(folder / TRAJECTORY_FILE, **arrays | further)


def relighting(light: str | None, seed: int) -> Relight | None:
    """Simulates images, one after another, in a light of :data:`monoloc_lab.synth.light.LIGHTS`; None for None."""
    if light is None:
        return None
    rng = np.random.default_rng([seed, _NOISE])
    return lambda color: relit(color, LIGHTS[light], rng)
