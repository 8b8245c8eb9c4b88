"""The bundle that a command writes: what its name must be, and what it replaces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from monoloc.bundle import check_target, replaced_edits
from monoloc.cli.common import note
from monoloc.cli.output_checks import check_apart
from monoloc.errors import SettingError

SIGNATURE_REMOVED = "its signature is void and was removed; sign it again"
"""What is said of a signed bundle that was changed."""


def check_bundle_output(out: Path, inputs: Sequence[str | Path]) -> None:
    """Reject an ``--out`` that is no bundle's name, cannot be written, or is read.

    Args:
        out: the bundle to be written.
        inputs: see :func:`monoloc.cli.output_checks.check_apart`.

    Raises:
        BundleError: as :func:`monoloc.bundle.check_target`.
        SettingError: it has another name, or is an input.
    """
    check_target(out)
    check_apart(out, "--out", inputs)
    if out.suffix != ".monoloc":
        raise SettingError("--out", f"{out} is not named as a bundle", "name it NAME.monoloc")


def note_replaced(out: Path, evidence: Path | None = None, advice: str = "") -> None:
    """Say what goes with the bundle that is to be replaced by one of another origin.

    Args:
        out: the bundle to be replaced, if there is one.
        evidence: the file of what flights showed of it, if that is replaced too.
        advice: the end of the sentence.
    """
    parts = []
    if edits := replaced_edits(out):
        parts.append(f"its edits ({edits})")
    if evidence is not None and evidence.is_file():
        parts.append(f"what flights showed of it ({evidence.name})")
    if parts:
        note(out, f"the new bundle replaces {' and '.join(parts)}, too{advice}")
