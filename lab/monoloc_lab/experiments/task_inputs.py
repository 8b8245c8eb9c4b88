"""What tasks of several kinds read and write: frames, lights, ways."""

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
from monoloc_lab.synth.light import LIGHTS, relit

Settings = dict[str, Any]

BUNDLE, POSENET, WAY_FILE = "room.monoloc", "posenet.safetensors", "way.npz"
_NOISE = 1  # of images, apart from the random numbers that a filter draws from the same seed


def describe_recording(source: str, frames: str) -> Settings:
    """Where frames are, and what is there, so that two recordings at one place, one after another, are told apart.

    Raises:
        DataError, SettingError: it cannot be read.
    """
    recording = select_frames(open_recording(source), frames)
    return {"source": source, "frames": frames, **recording_identity(recording)}


def _open(described: Settings) -> Selection:
    """The frames that a task was named after, and no others: they may have changed, or be others on this machine."""
    source, frames = described["source"], described["frames"]
    found = describe_recording(source, frames)
    if any(described[name] != value for name, value in found.items()):
        raise DataError(
            source, "is not what it was when this run began", "run it again, with the same data everywhere"
        )
    return select_frames(open_recording(source), frames)


def network_file(network: str) -> Path:
    """Of a network that comes with monoloc, by its name, or of one's own."""
    return shipped_file(network) if is_shipped(network) else Path(network)


def built_from(settings: Settings) -> Recording:
    """The build frames: all of the split's, or so many, evenly out of them."""
    described, count = settings["build"], settings.get("count")
    recording = _open(described)
    if count is None:
        return recording
    if count > len(recording):
        raise DataError(recording.name, f"has {len(recording)} build frames, not {count}", "ask for fewer")
    return Selection(recording, np.linspace(0, len(recording) - 1, count).round().astype(np.int64))


def walked(settings: Settings) -> Recording:
    """The frames to be localised; they have poses."""
    recording = _open(settings["walk"])
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "give a recording with poses, to be judged by")
    return recording


def write_way(
    folder: Path, recording: Recording, poses: FloatArray, unseen: NDArray[np.bool_], **further: FloatArray
) -> None:
    """``way.npz``, see :data:`monoloc_lab.experiments.tasks.WAY`."""
    seconds = recording.timestamps_s - recording.timestamps_s[0]
    arrays: dict[str, Any] = {"poses": poses, "truth": recording.poses, "unseen": unseen, "seconds": seconds}
    np.savez_compressed(folder / WAY_FILE, **arrays | further)


def relighting(light: str | None, seed: int) -> Relight | None:
    """What brings images, one after another, to a light of :data:`monoloc_lab.synth.light.LIGHTS`; None for None."""
    if light is None:
        return None
    rng = np.random.default_rng([seed, _NOISE])
    return lambda color: relit(color, LIGHTS[light], rng)
