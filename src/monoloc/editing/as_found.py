"""Files that a command reads, works on and writes again: what another command wrote meanwhile is not undone."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from monoloc.bundle_manifest import MANIFEST
from monoloc.errors import DataError
from monoloc.files import read_regular
from monoloc.partial_files import locked_folder


@dataclass(frozen=True)
class AsFound:
    """Bundles and files as they were before a command read them.

    Attributes:
        digests: SHA-256 of each file, and of each bundle's manifest, which holds those of its files; None of what is
            not there.
    """

    digests: Mapping[Path, str | None]

    @classmethod
    def of(cls, *paths: Path) -> AsFound:
        """As they are now.

        Args:
            paths: with their links resolved, as by :func:`monoloc.files.target_of`.
        """
        return cls({path: _digest(path) for path in paths})

    @contextmanager
    def held(self) -> Iterator[None]:
        """Context in which they are still as found, and no other such context is open: write them here.

        Raises:
            DataError: one of them was written meanwhile.
        """
        with ExitStack() as stack:
            for folder in sorted({path.parent for path in self.digests}):
                stack.enter_context(locked_folder(folder))
            for path, digest in self.digests.items():
                if _digest(path) != digest:
                    problem = "was changed meanwhile by another command, so nothing is written"
                    raise DataError(path, problem, "run this one again")
            yield


def _digest(path: Path) -> str | None:
    try:
        content = read_regular(path / MANIFEST if path.is_dir() else path)
    except (OSError, ValueError):  # which the command reports when it reads or writes it
        return None
    return hashlib.sha256(content).hexdigest()
