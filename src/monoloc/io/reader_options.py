"""What a user may say about a recording that its files do not, or say wrongly."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from monoloc.camera import Camera
from monoloc.errors import SettingError

# Depth is divided in float32; these are far from its ends, and farther from what any camera stores.
_LEAST_DEPTH_SCALE, _MOST_DEPTH_SCALE = 1e-6, 1e9


def depth_scale_problem(value: float) -> str | None:
    """What is wrong with a stored value of one metre; None where depth can be divided by it."""
    if _LEAST_DEPTH_SCALE <= value <= _MOST_DEPTH_SCALE:  # which is not true of NaN
        return None
    return f"is {value!r}, not from {_LEAST_DEPTH_SCALE:g} to {_MOST_DEPTH_SCALE:g}"


@dataclass(frozen=True)
class ReaderOptions:
    """Overrides of what a reader would take from the files or from the format's definition.

    Attributes:
        camera: intrinsics of the colour images as stored.
        keeps_distortion: whether the distortion of the files or the format stays when ``camera`` is given.
        depth_scale: stored depth value per metre (``metres = value / depth_scale``).

    Raises:
        SettingError: a scale that depth cannot be divided by.
    """

    camera: Camera | None = None
    keeps_distortion: bool = False
    depth_scale: float | None = None

    def __post_init__(self) -> None:
        problem = None if self.depth_scale is None else depth_scale_problem(self.depth_scale)
        if problem is not None:
            raise SettingError("depth_scale", problem, "give the stored value of one metre, such as 1000")

    def camera_or(self, own: Camera) -> Camera:
        """The camera given, or the recording's ``own``."""
        if self.camera is None:
            return own
        return replace(self.camera, distortion=own.distortion) if self.keeps_distortion else self.camera

    def allow_only(self, reader: str, *names: str) -> None:
        """Refuse overrides that the reader would silently ignore.

        Raises:
            SettingError: an option outside ``names`` differs from its default.
        """
        for field in fields(self):
            # keeps_distortion only says how a camera is taken, where one is.
            if field.name not in (*names, "keeps_distortion") and getattr(self, field.name) != field.default:
                raise SettingError(field.name, f"has no meaning for a {reader} recording", "leave this option out")
