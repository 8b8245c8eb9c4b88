"""Standard streams that may be closed, full, or have lost their reader; only stdout, the result, matters."""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO

from monoloc.errors import SettingError


class ReaderGoneError(SettingError):
    """Nobody reads stdout any more, as in ``monoloc depth list | true``."""


class _Stdout(io.TextIOWrapper):
    """Says that the result cannot be written, in one line."""

    def write(self, text: str, /) -> int:
        try:
            return super().write(text)
        except OSError as error:
            raise self._failure(error) from error

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> SettingError:
        _send_nowhere(self)
        if isinstance(error, BrokenPipeError):
            return ReaderGoneError("stdout", "is no longer read", "read all of it, or write it to a file")
        return SettingError("stdout", f"cannot be written ({error.strerror})", "make room, or write it elsewhere")


class _Stderr(io.TextIOWrapper):
    """Does without progress that cannot be shown: the work goes on."""

    def write(self, text: str, /) -> int:
        try:
            return super().write(text)
        except OSError:
            _send_nowhere(self)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError:
            _send_nowhere(self)


def secure_streams() -> None:
    """Make stdout and stderr ready for what may happen to them, before any file is opened."""
    for number in range(3):  # else a file that is opened would get the number, and what is printed
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = _secured(sys.stdout, 1, _Stdout)
    sys.stderr = _secured(sys.stderr, 2, _Stderr)


def _secured(stream: TextIO | None, number: int, kind: type[_Stdout | _Stderr]) -> TextIO:
    if stream is None:  # it was closed
        return kind(io.BufferedWriter(io.FileIO(number, "w", closefd=False)), encoding="utf-8", errors="replace")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    encoding, is_by_lines = stream.encoding, stream.line_buffering
    # A degree sign must not fail on an ASCII terminal.
    return kind(stream.detach(), encoding=encoding, errors="replace", line_buffering=is_by_lines)


def _send_nowhere(stream: io.TextIOWrapper) -> None:
    """Let what is still in the buffers go, which Python would write when it ends, and fail again."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
