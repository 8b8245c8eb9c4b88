"""The bundle that ``monoloc map edit`` changes: it is read, changed and written, and what changed is printed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from monoloc.bundle import Bundle, check_target, read_bundle, write_bundle
from monoloc.bundle_signature import SIGNATURE
from monoloc.cli.bundle_output import SIGNATURE_REMOVED, check_bundle_output, note_replaced
from monoloc.cli.common import note, print_figures, stderr, warn
from monoloc.edit_record import EditRecord
from monoloc.editing.as_found import AsFound
from monoloc.files import target_of

_COUNTS = ("components", "landmarks", "reference_poses")  # of an edit's changes: numbers before and after it


@dataclass(frozen=True)
class EditTarget:
    """The bundle that the command line names before the subcommand."""

    path: Path

    def edit(self, out: Path | None, json: bool, change: Callable[[Bundle], Bundle], *inputs: Path | str) -> None:
        """Read, change and write the bundle, and print what changed."""
        target = out or self.path
        if out is not None:
            check_bundle_output(out, inputs)
            if target_of(out) != target_of(self.path):
                note_replaced(out)
        found = AsFound.of(target_of(target))
        bundle = read_bundle(self.path)
        check_target(target)  # before the change is made, which may take minutes
        began = time.perf_counter()
        edited = change(bundle)
        seconds = time.perf_counter() - began
        with found.held():
            was_signed = (target / SIGNATURE).is_file()
            size = write_bundle(target, edited)
        if was_signed:
            note(target, SIGNATURE_REMOVED)
        content: dict[str, object] = {"bundle": str(target), "bytes": size, "seconds": round(seconds, 3)}
        if len(edited.edits) >= len(bundle.edits):  # as many where the first one was dropped
            last = edited.edits[-1]
            content |= {**last.record.model_dump(mode="json"), "undo_bytes": len(last.undo)}
            _remark(last.record, target)
        else:
            undone_edit = bundle.edits[-1].record
            content |= {"kind": "undo", "undone": undone_edit.model_dump(mode="json")}
            if undone_edit.kind == "update":
                stderr.print("note: what its flights showed is used up; two new flights can propose it again")
        print_figures(str(target), content if json else readable(content), json)


def edit_target(context: typer.Context) -> EditTarget:
    target = context.obj
    assert isinstance(target, EditTarget)
    return target


def readable(values: dict[str, Any]) -> dict[str, Any]:
    """The same for a text, with numbers before and after an edit, in dicts of it too, as ``before -> after``."""
    shown = dict(values)
    for name, value in values.items():
        if name in _COUNTS:
            shown[name] = " -> ".join(map(str, value))
        elif isinstance(value, dict):
            shown[name] = readable(value)
    return shown


def _remark(record: EditRecord, bundle: Path) -> None:
    """Say what the record of an edit holds against it: against what was added, or against the bundle."""
    changes, source = record.changes, record.parameters.get("source", record.parameters.get("cloud", bundle))
    for warning in changes.get("warnings", []):
        warn(source, warning)
    if left_out := changes.get("frames_left_out"):
        note(source, f"frames that the map was made of are left out ({left_out})")
    names = ("confirmed_by_landmarks", "contradicted_by_landmarks", "looked_at")
    confirmed, contradicted, looked_at = (changes.get(f"frames_{name}", 0) for name in names)
    if confirmed and confirmed <= contradicted:
        found = f"landmarks of the map confirm the poses of {confirmed} of {looked_at} frames"
        fix = f"and contradict {contradicted}; if they are in another world, undo, and extend with --align"
        warn(source, f"{found}, {fix}")
