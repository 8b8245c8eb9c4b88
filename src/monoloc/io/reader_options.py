"""Options of the readers, for metadata that is missing or wrong in the files."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from monoloc.camera import Camera
from monoloc.errors import SettingError

# The division is in float32. The limits are well within its range, and well beyond the scale of any camera.
_MIN_DEPTH_SCALE, _MAX_DEPTH_SCALE = 1e-6, 1e9


def depth_scale_problem(value: float) -> str | None:
    """Describe what is wrong with a depth scale (stored value of one metre); None if it is valid."""
    if _MIN_DEPTH_SCALE <= value <= _MAX_DEPTH_SCALE:  # false for NaN
        return None
    return f"is {value!r}, not from {_MIN_DEPTH_SCALE:g} to {_MAX_DEPTH_SCALE:g}"


@dataclass(frozen=True)
class ReaderOptions:
    """Overrides of metadata from the files or from the definition of the format.

    Attributes:
        camera: intrinsics of the stored colour images.
        keeps_distortion: whether ``camera`` leaves the distortion of the files or the format unchanged.
        depth_scale: stored depth value per metre (``metres = value / depth_scale``).
        guesses_camera: whether a video without ``camera`` gets a guess, for structure from motion to refine.

    Raises:
        SettingError: the depth scale is outside the valid range.
    """

    camera: Camera | None = None
    keeps_distortion: bool = False
    depth_scale: float | None = None
    guesses_camera: bool = False

    def __post_init__(self) -> None:
        problem = None if self.depth_scale is None else depth_scale_problem(self.depth_scale)
        if problem is not None:
            raise SettingError("depth_scale", problem, "give the stored value of one metre, such as 1000")

    def camera_or(self, own: Camera) -> Camera:
        """The overriding camera, or the recording's ``own`` if there is no override."""
        if self.camera is None:
            return own
        if not self.keeps_distortion:
            return self.camera
        return replace(self.camera, distortion=own.distortion, distortion_model=own.distortion_model)

    def allow_only(self, reader: str, *names: str) -> None:
        """Reject overrides that the reader would ignore.

        Raises:
            SettingError: an option that is not in ``names`` differs from its default.
        """
        for field in fields(self):
            # keeps_distortion only matters together with a camera, and guesses_camera without one.
            if (
                field.name not in (*names, "keeps_distortion", "guesses_camera")
                and getattr(self, field.name) != field.default
            ):
                raise SettingError(field.name, f"has no meaning for a {reader} recording", "leave this option out")
