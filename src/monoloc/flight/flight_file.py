"""Everything of a flight in one file, ``flight.toml``: what ``monoloc fly`` and ``doctor`` take as options."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from monoloc.config import load_settings
from monoloc.files import at_home
from monoloc.flight.flight_settings import FlightSettings
from monoloc.io.registry import FORMATS
from monoloc.live.opening import is_live
from monoloc.mavlink.firmware import Firmware
from monoloc.relocalization.marker import DEFAULT_DICTIONARY, Dictionary, Marker, Markers, check_markers
from monoloc.start import START_ERROR_DEG, START_ERROR_M

_FORMAT = re.compile(rf"({'|'.join(FORMATS)}):(.+)")


class FlightFile(FlightSettings):
    """A flight. Each field but those of :class:`FlightSettings` and the markers is also an option of ``monoloc fly``.

    Attributes:
        room: bundle, or place.
        require_signature: public key of who must have signed it, or every bundle of the place; or None.
        source: camera, stream or recording.
        camera: file of intrinsics, or numbers as ``--camera`` takes them.
        mavlink, firmware: address and firmware of the autopilot.
        start: pose ``TX,TY,TZ,QX,QY,QZ,QW`` of the first frame, ``unknown`` or ``truth``.
        start_error_cm, start_error_deg: of the start.
        budget_ms: that a step may take, see :mod:`monoloc.step_budget`; None takes the bundle's.
        threads: of a step, 1 or 2; None takes the bundle's.
        out, mcap, record: table, file and folder to write; in all, ``%Y``, ``%m``, ``%d``, ``%H``, ``%M`` and ``%S``
            stand for the time of the start.
        dictionary, marker: markers of known place, see :class:`~monoloc.relocalization.marker.Markers`.
    """

    room: Path | None = None
    require_signature: Path | None = None
    source: str = "camera:0"
    camera: str | None = None
    mavlink: str | None = None
    firmware: Firmware | None = None
    start: str = "unknown"
    start_error_cm: float = Field(100.0 * START_ERROR_M, ge=0.0, le=1e5)
    start_error_deg: float = Field(START_ERROR_DEG, ge=0.0, le=180.0)
    budget_ms: float | None = Field(None, ge=1.0, le=10_000.0)
    threads: Literal[1, 2] | None = None
    out: Path | None = None
    mcap: Path | None = None
    record: Path | None = None
    dictionary: Dictionary = DEFAULT_DICTIONARY
    marker: tuple[Marker, ...] = ()

    @field_validator("room", "require_signature", "source", "camera", "out", "mcap", "record")
    @classmethod
    def _check_name(cls, name: Path | str | None) -> Path | str | None:
        if "\0" in str(name):
            raise ValueError("holds a null character")
        return name

    @model_validator(mode="after")
    def _check_markers(self) -> FlightFile:
        check_markers(self.dictionary, self.marker)
        return self

    @property
    def markers(self) -> Markers | None:
        """The markers of the room, or None without any."""
        return Markers(dictionary=self.dictionary, marker=self.marker) if self.marker else None

    @property
    def settings(self) -> FlightSettings:
        """What poses and messages follow from, beside the images, which are turned upright."""
        content = self.model_dump(include=set(FlightSettings.model_fields))
        return FlightSettings.model_validate(content | {"mount": self.mount.upright})


def read_flight_file(path: Path) -> FlightFile:
    """Read a flight; paths in it are relative to its folder. In those of outputs, what stands for the time stays.

    Raises:
        DataError: the file is unreadable or not TOML, or a field is unknown or out of range; the message names it.
    """
    flight, folder = load_settings(path, FlightFile), path.parent
    changes: dict[str, object] = {"source": _source_beside(flight.source, folder)}
    literal = Path(str(folder).replace("%", "%%"))  # whose own % stands for no time
    beside = {"room": folder, "require_signature": folder, "out": literal, "mcap": literal, "record": literal}
    for name, place in beside.items():
        given = getattr(flight, name)
        changes[name] = None if given is None else place / at_home(given)
    if flight.camera is not None and flight.camera.endswith(".toml"):
        changes["camera"] = str(folder / at_home(flight.camera))
    return flight.model_copy(update=changes)


def _source_beside(source: str, folder: Path) -> str:
    if is_live(source):
        return source
    if known := _FORMAT.fullmatch(source):
        return f"{known[1]}:{folder / at_home(known[2])}"
    return str(folder / at_home(source))
