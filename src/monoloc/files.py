"""Files written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from monoloc.errors import DataError


def write_whole(path: Path, content: bytes) -> None:
    """Put ``content`` at ``path``; what was there stays as it was if anything fails.

    Raises:
        DataError: the file cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        fix = "name a file in a folder you can write to"
        raise DataError(path, f"cannot be written ({error.strerror})", fix) from error
    finally:
        partial.unlink(missing_ok=True)
