"""Recordings whose images lie on their side, such as those of a phone in portrait, turned until they stand upright.

A depth network has learnt rooms that stand upright, and so does a drone's camera; a phone stores what its sensor
sees, however it is held. The direction of gravity tells, where the format does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.image_turns import T_camera_turned, in_words, turned_image, turns_upright
from monoloc.io.recording import Recording, Remark, Selection, StoredRecording, recorded_down, scale_sd_of

_LEAST_SHARE = 0.75  # of the frames that tell; a phone that was turned on the way has no upright


class Turned:
    """A recording whose images and depth are turned counter-clockwise by quarter turns, with camera and poses.

    Args:
        source: with poses.
        quarter_turns: 1 to 3.
    """

    def __init__(self, source: Recording, quarter_turns: int) -> None:
        assert source.poses is not None
        self.source, self.quarter_turns = source, quarter_turns
        self.name, self.has_depth = source.name, source.has_depth
        self.camera = source.camera.turned(quarter_turns)
        self.frame_names, self.timestamps_s = source.frame_names, source.timestamps_s
        self.poses: FloatArray | None = source.poses @ T_camera_turned(quarter_turns)
        how = "upside down" if quarter_turns == 2 else "sideways"
        note = Remark(f"the camera was held {how}: its images are turned by {in_words(quarter_turns)}")
        self.notes: list[str] = [*getattr(source, "notes", []), note]
        self.scale_sd, self.down_world = scale_sd_of(source), recorded_down(source)

    def __len__(self) -> int:
        return len(self.source)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        return turned_image(self.source.color(index), self.quarter_turns)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        return turned_image(self.source.depth(index), self.quarter_turns)


def upright(recording: StoredRecording) -> StoredRecording:
    """The recording as it is, or turned until its images stand upright, where it tells the direction of gravity."""
    turns = _quarter_turns(recording)
    return Turned(recording, turns) if turns else recording


def quarter_turns_of(recording: Recording) -> int:
    """How often the images were turned by 90 degrees counter-clockwise when the recording was read, 0 to 3."""
    source = recording.source if isinstance(recording, Selection) else recording
    return source.quarter_turns if isinstance(source, Turned) else 0


def is_upright(recording: Recording) -> bool:
    """Whether gravity tells that the images stand upright, as they are or as they were turned when they were read."""
    return _quarter_turns(recording.source if isinstance(recording, Selection) else recording) == 0


def _quarter_turns(recording: Recording) -> int | None:
    """How often the images are to be turned by 90 degrees counter-clockwise; None where that is not known."""
    down_world = recorded_down(recording)
    if recording.poses is None or down_world is None:
        return None
    turns = turns_upright(np.einsum("nij,i->nj", recording.poses[:, :3, :3], down_world))
    if len(turns) == 0:
        return None
    counts = np.bincount(turns, minlength=4)
    most = int(counts.argmax())
    return most if counts[most] >= _LEAST_SHARE * len(turns) else None
