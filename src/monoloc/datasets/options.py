"""What a user may say about a recording that its files do not, or say wrongly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import SettingError


@dataclass(frozen=True)
class ReaderOptions:
    """Overrides of what a reader would take from the files or from the format's definition.

    Attributes:
        camera: intrinsics of the colour images as stored.
        depth_scale: stored depth value per metre (``metres = value / depth_scale``).

    Raises:
        SettingError: a scale that is not a usable number.
    """

    camera: Camera | None = None
    depth_scale: float | None = None

    def __post_init__(self) -> None:
        if self.depth_scale is not None and not (np.isfinite(self.depth_scale) and self.depth_scale > 0.0):
            raise SettingError("depth_scale", f"is {self.depth_scale}", "give the stored value of one metre, > 0")

    def allow_only(self, reader: str, *names: str) -> None:
        """Refuse overrides that the reader would silently ignore.

        Raises:
            SettingError: an option outside ``names`` differs from its default.
        """
        for field in fields(self):
            if field.name not in names and getattr(self, field.name) != field.default:
                raise SettingError(field.name, f"has no meaning for a {reader} recording", "leave this option out")
