"""Sequential reading of little-endian binary files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc.io.file_access import read_bytes


class BinaryReader:
    """Reads the values of a file one after another.

    Args:
        path: the file.
        fix: what to do about a file that is cut short.

    Raises:
        DataError: the file cannot be read; from all methods: it ends too early.
    """

    def __init__(self, path: Path, fix: str) -> None:
        self.path = path
        self._fix = fix
        self._data = read_bytes(path)
        self._at = 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """Values of a layout of :mod:`struct`, without its byte order."""
        start = self._at
        self.skip(struct.calcsize(f"<{layout}"))
        return struct.unpack_from(f"<{layout}", self._data, start)

    def skip(self, count: int) -> None:
        """Pass over ``count`` bytes."""
        self._at += count
        if self._at > len(self._data):
            raise DataError(self.path, "is cut short", self._fix)

    def text(self) -> str:
        """Text that a zero byte ends."""
        end = self._data.find(b"\0", self._at)
        start, self._at = self._at, end + 1
        if end < 0:
            raise DataError(self.path, "is cut short", self._fix)
        return self._data[start:end].decode("utf-8", errors="surrogateescape")
