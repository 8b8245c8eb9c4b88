"""A place whose bundles were edited since it was made.

Edits keep a room's world, and so its doors stay right. A bundle that was built anew may have another world. So one is
taken in only if taking back its edits gives the bundle that the place knows, to the last byte.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from monoloc.bundle import contents_of, read_bundle
from monoloc.bundle_manifest import MANIFEST
from monoloc.editing.undo import states
from monoloc.errors import DataError
from monoloc.place.place_files import Place, bundle_of, described_room, read_unchecked


def updated_place(path: Path, public_key: Path | None = None) -> tuple[Place, Mapping[str, int]]:
    """The place with its bundles as they are now, not yet written, and the number of edits of each that changed.

    Args:
        path: of the place.
        public_key: of who must have signed the bundles; None takes those of anybody.

    Raises:
        BundleError: a bundle is missing, damaged or not signed with the key.
        DataError: not a place, damaged, or of an unknown schema; a bundle is not an edited one of those that the
            place knows, or has too few landmarks; the key is none.
        MissingExtraError: as :func:`monoloc.bundle_signature.read_public_key`, with a key only.
    """
    place = read_unchecked(path, public_key)
    edits: dict[str, int] = {}
    rooms, descriptors = list(place.manifest.rooms), list(place.descriptors)
    for number, room in enumerate(place.manifest.rooms):
        bundle = bundle_of(path, room)
        digest, selected = described_room(bundle, public_key)
        if digest == room.sha256:
            continue
        edits[room.name] = _edits_since(bundle, room.sha256)
        rooms[number], descriptors[number] = room.model_copy(update={"sha256": digest}), selected
    manifest = place.manifest.model_copy(update={"rooms": tuple(rooms)})
    return replace(place, manifest=manifest, descriptors=tuple(descriptors)), edits


def _edits_since(path: Path, sha256: str) -> int:
    """How many of a bundle's edits were made since it had a digest."""
    for count, earlier in enumerate(states(read_bundle(path))):
        if hashlib.sha256(contents_of(earlier)[MANIFEST]).hexdigest() == sha256:
            return count
    problem = "is not the bundle that the place knows, with edits made since"
    fix = "put that one back, edited or not, or make the place again: monoloc place new"
    raise DataError(path, problem, fix)
