"""Recordings whose images lie on their side, such as those of a phone in portrait, turned until they stand upright.

A depth network has learnt rooms that stand upright, and so does a drone's camera; a phone stores what its sensor
sees, however it is held. The direction of gravity tells, where the format does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.image_turns import T_camera_turned, in_words, turned_image, turns_upright
from monoloc.io.recording import Recording, Remark, StoredRecording, recorded_down, scale_sd_of, selected_from

_LEAST_SHARE = 0.75  # of the frames that tell; a phone that was turned on the way has no upright

# A camera that is carried turns about the vertical, so its image axis along the vertical keeps its direction. Mean of
# that axis' unit vectors, and how much shorter the other axis' mean is. Upright walks of RedKitchen, the desk and
# eight rendered rooms have 0.97 and more for y, however short the mean of x is.
_STEADY, _LEAST_SHORTER = 0.8, 0.2

ON_THEIR_SIDE = "images lie on their side, as the camera turns about their horizontal axis"
STAND_UPRIGHT = "record so that they stand upright, or give down in a dataset.toml"
"""What to do about it where the format does not tell gravity."""


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
    source = selected_from(recording)
    return source.quarter_turns if isinstance(source, Turned) else 0


def T_turned_stored(recording: Recording) -> FloatArray:
    """Pose of the camera of the stored images in the frame of that of the recording's images, (4, 4)."""
    return T_camera_turned(-quarter_turns_of(recording))


def is_upright(recording: Recording) -> bool:
    """Whether the images stand upright, as they are or as they were turned when they were read.

    Gravity tells it, or the format: a flight keeps its images as it turned them.
    """
    source = selected_from(recording)
    return getattr(source, "stands_upright", False) or _quarter_turns(source) == 0


def walk_lies_on_side(recording: Recording) -> bool:
    """Whether the motion tells that images lie on their side, where the recording does not tell gravity.

    It does only if the camera turned far about the vertical, some 150 degrees. To which side the images lie, or
    whether they are upside down, no motion tells.
    """
    if recording.poses is None or recorded_down(recording) is not None:
        return False
    x, y = np.linalg.norm(recording.poses[:, :3, :2].mean(axis=0), axis=0)
    return bool(x > _STEADY and y < x - _LEAST_SHORTER)


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
