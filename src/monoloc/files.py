"""Files are read within bounds, and written whole or not at all."""

from __future__ import annotations

import errno
import json
import math
import os
import stat
from collections.abc import Mapping
from pathlib import Path

from monoloc.errors import DataError
from monoloc.partial_files import whole_file, whole_folder

MOST_BYTES = 1 << 30
"""Size of a file that is read whole."""


def read_regular(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """All bytes of a file.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is larger, or no regular file: a pipe would block, a device would never end; or its name holds
            a null character.
    """
    with open(path, "rb", opener=_without_waiting) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise ValueError("it is not a regular file")
        if status.st_size > most_bytes:
            raise ValueError(f"it is larger than {most_bytes >> 20} MB")
        return file.read(status.st_size)  # takes memory for as many at once


def _without_waiting(name: str, flags: int) -> int:
    """Opens a pipe without a wait for its writer."""
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))  # Windows has no such flag, nor such pipes


def at_home(path: str | Path) -> Path:
    """The path with the home folder in place of ``~``; that of an unknown user stays, and so is not found."""
    return Path(os.path.expanduser(path))  # noqa: PTH111 - pathlib raises for an unknown user


def target_of(path: Path) -> Path:
    """The file that a write to ``path`` replaces: ``path`` with all links resolved.

    Raises:
        DataError: the path exists and is neither a file nor a folder, such as a device, which a file would replace.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise DataError(path, "is neither a file nor a folder", "name a file")
    return Path(os.path.realpath(path))


def write_whole(path: Path, content: bytes, *, is_synced: bool = True) -> None:
    """Write ``content`` to ``path`` atomically, following links; on failure an existing file is unchanged.

    Args:
        path: of the file.
        content: of the file.
        is_synced: whether the file survives a loss of power too; False for one of many, where the wait is too long.

    Raises:
        DataError: the file cannot be written.
    """
    try:
        with whole_file(target_of(path), is_synced=is_synced) as partial:
            partial.write_bytes(content)
    except OSError as error:
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        fix = "make room, or choose another disk" if is_full else "name a file in a folder you can write to"
        raise DataError(path, f"cannot be written ({error.strerror})", fix) from error


def write_folder(path: Path, contents: Mapping[str, bytes]) -> int:
    """Write a folder of files atomically, following links; on failure an existing folder is unchanged.

    Args:
        path: of the folder; whatever it holds is replaced.
        contents: the files by their names.

    Returns:
        Bytes of all files.

    Raises:
        DataError: the folder cannot be written.
    """
    try:
        with whole_folder(target_of(path)) as folder:
            for name, content in contents.items():
                (folder / name).write_bytes(content)
    except OSError as error:
        fix = "make room for it, or name a place you can write to"
        raise DataError(path, f"cannot be written ({error.strerror})", fix) from error
    return sum(len(content) for content in contents.values())


def json_text(content: Mapping[str, object]) -> str:
    """Serialise to one JSON object; NaN and infinity, which JSON lacks, become null."""
    return json.dumps(_finite(content), indent=1)


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
