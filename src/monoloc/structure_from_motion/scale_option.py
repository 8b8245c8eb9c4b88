"""The option ``--scale``."""

from __future__ import annotations

from typing import get_args

from monoloc.errors import SettingError
from monoloc.files import at_home
from monoloc.relocalization.marker import DEFAULT_DICTIONARY, Dictionary
from monoloc.structure_from_motion.depth_scale import DepthScale, NetworkScale
from monoloc.structure_from_motion.distance_scale import DistanceScale
from monoloc.structure_from_motion.marker_scale import MarkerScale
from monoloc.structure_from_motion.metric_scale import ScaleSource

SCALE_FORMS = "network[:NAME]|depth|marker:ID:SIZE_M[:DICTIONARY]|distance:FILE.toml"
_MOST_SIZE_M = 5.0


def parse_scale(text: str | None, has_depth: bool) -> ScaleSource:
    """What the scale is measured by; without a choice the recording's depth, or else a network's.

    Raises:
        SettingError: it is none of the forms.
    """
    if text is None:
        return DepthScale() if has_depth else NetworkScale()
    kind, _, rest = text.partition(":")
    if text == "depth":
        return DepthScale()
    if text == "network" or (kind == "network" and rest):
        return NetworkScale(str(at_home(rest))) if rest else NetworkScale()
    if kind == "distance" and rest:
        return DistanceScale(at_home(rest))
    if kind == "marker":
        return _marker(text, rest)
    raise SettingError("scale", f"is {text!r}", f"write {SCALE_FORMS}")


def _marker(text: str, rest: str) -> MarkerScale:
    number, size_m, *named = rest.split(":", 2) if ":" in rest else (rest, "")
    dictionary = named[0] if named else DEFAULT_DICTIONARY
    known: dict[str, Dictionary] = {name: name for name in get_args(Dictionary)}
    if dictionary not in known:
        raise SettingError("scale", f"names the dictionary {dictionary!r}", f"choose from {', '.join(known)}")
    try:
        marker = MarkerScale(int(number), float(size_m), known[dictionary])
    except ValueError as error:
        raise SettingError("scale", f"is {text!r}", "write marker:ID:SIZE_M, such as marker:7:0.16") from error
    if not (marker.number >= 0 and 0.0 < marker.size_m <= _MOST_SIZE_M):
        raise SettingError("scale", f"is {text!r}", f"give the black square's side, up to {_MOST_SIZE_M:g} metres")
    return marker
