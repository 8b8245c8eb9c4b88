"""Checks for optional libraries."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Literal

from monoloc.errors import MissingExtraError

Extra = Literal["report", "view", "mavlink", "mcap", "stream", "sign", "ros"]
# Of each extra, what needs it and a module that it installs.
_NEEDED: dict[Extra, tuple[str, str]] = {
    "report": ("plots", "matplotlib"),
    "view": ("the viewer", "rerun"),
    "mavlink": ("MAVLink", "pymavlink"),
    "mcap": ("writing MCAP", "mcap_ros2.writer"),
    "stream": ("streams over a network", "av"),
    "sign": ("a signature", "cryptography"),
    "ros": ("reading ROS bags", "rosbags"),
}


def require_extra(extra: Extra) -> None:
    """Check that an extra is installed, before long work starts or a file or link is opened.

    Raises:
        MissingExtraError: it is not installed.
    """
    if extra == "view":
        os.environ.setdefault("RUST_LOG", "off")  # monoloc reports problems itself, once
    what, module = _NEEDED[extra]
    try:
        import_module(module)
    except ImportError as error:
        raise MissingExtraError(what, extra) from error


def require_structure_from_motion() -> None:
    """Check that pycolmap is installed, before long work starts.

    Raises:
        MissingExtraError: pycolmap is not installed.
    """
    on_termination = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("a map from images without poses", "sfm") from error
    # Its logging library takes SIGTERM for a crash: it prints a stack, and temporary files stay.
    if threading.current_thread() is threading.main_thread() and on_termination is not None:
        signal.signal(signal.SIGTERM, on_termination)


@contextmanager
def training_extra() -> Iterator[None]:
    """Context for imports of PyTorch and related libraries.

    Raises:
        MissingExtraError: one of them is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"this command ({error.name})", "train") from error
