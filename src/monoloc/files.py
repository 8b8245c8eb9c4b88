"""Atomic file writes."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path

from monoloc.errors import DataError


def partial_of(path: Path) -> Path:
    """Temporary path that is written and then renamed to ``path``."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def target_of(path: Path) -> Path:
    """The file that a write to ``path`` replaces: ``path`` with all links resolved.

    Raises:
        DataError: the path exists and is neither a file nor a folder, such as a device, which a file would replace.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise DataError(path, "is neither a file nor a folder", "name a file")
    return Path(os.path.realpath(path))


def write_whole(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` atomically, following links; on failure an existing file is unchanged.

    Raises:
        DataError: the file cannot be written.
    """
    target = target_of(path)
    partial = partial_of(target)
    try:
        partial.write_bytes(content)
        partial.replace(target)
    except OSError as error:
        fix = "name a file in a folder you can write to"
        raise DataError(path, f"cannot be written ({error.strerror})", fix) from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


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
