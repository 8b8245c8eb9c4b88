"""monoloc: indoor localisation of a drone with one camera.

The public names are :func:`load`, :func:`save`, :class:`Camera`, :class:`Start`, :class:`Localizer`,
:func:`build_bundle` and :func:`calibrate`. They are imported when they are first used.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from monoloc.version import __version__

if TYPE_CHECKING:
    from monoloc.builder.calibrate import calibrate
    from monoloc.builder.pipeline import build_bundle
    from monoloc.bundle import read_bundle as load
    from monoloc.bundle import write_bundle as save
    from monoloc.camera import Camera
    from monoloc.localizer import Localizer
    from monoloc.start import Start

__all__ = ["Camera", "Localizer", "Start", "__version__", "build_bundle", "calibrate", "load", "save"]

# Since 1.29, onnxruntime sends its maker what it runs on and what it runs, and keeps an identifier in the home folder
# and in TMPDIR. It looks when it is imported, so this comes before every import of ours.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

_HOMES = {
    "Camera": ("monoloc.camera", "Camera"),
    "Localizer": ("monoloc.localizer", "Localizer"),
    "Start": ("monoloc.start", "Start"),
    "build_bundle": ("monoloc.builder.pipeline", "build_bundle"),
    "calibrate": ("monoloc.builder.calibrate", "calibrate"),
    "load": ("monoloc.bundle", "read_bundle"),
    "save": ("monoloc.bundle", "write_bundle"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'monoloc' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    return getattr(import_module(module), attribute)
