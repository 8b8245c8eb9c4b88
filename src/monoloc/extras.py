"""Libraries that only some users need."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from monoloc.errors import MissingExtraError


def require_plotting() -> None:
    """Say that there is nothing to draw with before the work is done, not after it.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("plots", "report") from error


def require_viewing() -> None:
    """Say that there is no viewer before the work is done.

    Raises:
        MissingExtraError: Rerun is not installed.
    """
    os.environ.setdefault("RUST_LOG", "off")  # what goes wrong is said once, by us
    try:
        import rerun  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("the viewer", "view") from error


@contextmanager
def training_extra() -> Iterator[None]:
    """Imports of PyTorch and its company, with a clear word where they are missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"this command ({error.name})", "train") from error
