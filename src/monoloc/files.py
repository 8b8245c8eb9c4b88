"""Files written whole or not at all."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path

from monoloc.errors import DataError


def partial_of(path: Path) -> Path:
    """Where a file is written before it is renamed into its place."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def target_of(path: Path) -> Path:
    """The file that is replaced in writing to ``path``: of a link, what it leads to.

    Raises:
        DataError: something else is there, such as a device, in whose place a file would be put.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise DataError(path, "is neither a file nor a folder", "name a file")
    return Path(os.path.realpath(path))


def write_whole(path: Path, content: bytes) -> None:
    """Put ``content`` at ``path``, through links; what was there stays as it was if anything fails.

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
    """One JSON object; figures that are not numbers become null, as JSON has no NaN."""
    return json.dumps(_finite(content), indent=1)


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
