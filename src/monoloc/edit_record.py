"""A line of the list of edits that a bundle keeps, with what undoes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

EditKind = Literal["remove", "add", "move", "extend", "merge", "update"]


class EditRecord(BaseModel):
    """What was done to a bundle's map.

    Attributes:
        time: UTC, ISO 8601.
        kind: of the edit.
        parameters: that it was given, as on the command line.
        changes: what it changed: numbers of components, landmarks and reference poses, and what else it measured.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    time: str
    kind: EditKind
    parameters: dict[str, Any]
    changes: dict[str, Any]


@dataclass(frozen=True)
class Edit:
    """An edit and what undoes it.

    Attributes:
        record: what was done.
        undo: see :mod:`monoloc.editing.undo`; compressed.
    """

    record: EditRecord
    undo: bytes = field(repr=False)
