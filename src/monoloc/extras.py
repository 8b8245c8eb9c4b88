"""Libraries that only some users need."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from monoloc.errors import MissingExtraError


@contextmanager
def training_extra() -> Iterator[None]:
    """Imports of PyTorch and its company, with a clear word where they are missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"this command ({error.name})", "train") from error
