"""What an earlier flight wrote is kept: it cannot be flown again, and a service that restarts in flight must fly."""

from __future__ import annotations

import itertools
from pathlib import Path

from monoloc.errors import DataError
from monoloc.files import target_of


def earlier_name(path: Path) -> Path | None:
    """Where a file is kept once a flight writes in its place, ``NAME-1``, ``NAME-2`` and so on beside it.

    Args:
        path: that a flight is to write; links are followed.

    Returns:
        None where nothing would be lost: there is no file, or an empty one.
    """
    if not path.is_file() or path.stat().st_size == 0:
        return None
    target = target_of(path)
    numbered = (target.with_stem(f"{target.stem}-{number}") for number in itertools.count(1))
    return next(each for each in numbered if not each.exists())


def keep_earlier(path: Path) -> bool:
    """Rename what a flight is to write in the place of; returns whether there was something.

    Raises:
        DataError: it cannot be renamed.
    """
    name = earlier_name(path)
    if name is None:
        return False
    try:
        target_of(path).rename(name)
    except OSError as error:
        problem = f"is of an earlier flight, and cannot be renamed to {name.name} ({error.strerror})"
        raise DataError(path, problem, "name another file") from error
    return True
