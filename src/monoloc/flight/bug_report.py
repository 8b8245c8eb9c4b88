"""What a bug report needs of machine, room and flight, without names of places or people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.flight.flight_file import FlightFile
from monoloc.live.opening import is_live
from monoloc.machine import library_versions, machine_facts
from monoloc.version import version_facts

_NAMES_ROOMS = ("rooms", "switches")
_LIBRARIES = ("numpy", "onnxruntime", "opencv-python-headless", "pymavlink", "av")


def bug_report(
    flight: FlightFile, rooms: Iterable[Bundle], camera: Camera | None, found: Mapping[str, object]
) -> dict[str, object]:
    """The report, ready for JSON.

    Addresses, paths and names of recordings and rooms are left out: of a source and a link, only the kind is given.

    Args:
        flight: as it was asked for.
        rooms: the room, or those of the place.
        camera: of the images; None where it could not be opened.
        found: by the doctor.
    """
    return {
        **version_facts(),
        "machine": machine_facts(),
        "libraries": library_versions(_LIBRARIES),
        "source": flight.source.partition("://")[0] if is_live(flight.source) else "recording",
        "link": None if flight.mavlink is None else flight.mavlink.partition(":")[0],
        "firmware": None if flight.firmware is None else flight.firmware.value,
        "markers": len(flight.marker),
        "flight_settings": flight.settings.model_dump(mode="json"),
        "camera": None if camera is None else asdict(camera),
        "maps": [_facts_of(room) for room in rooms],
        **{name: value for name, value in found.items() if name not in _NAMES_ROOMS},
    }


def _facts_of(bundle: Bundle) -> dict[str, object]:
    return {
        "network": bundle.depth_model.name,
        "tune": bundle.provenance.tune,
        "frames": len(bundle.provenance.frames),
        "components": len(bundle.adapted.means),
        "landmarks": len(bundle.landmarks),
        "supports_relocalization": bundle.supports_relocalization,
        "settings": bundle.settings.model_dump(mode="json"),
    }
