"""Checks for optional libraries."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from monoloc.errors import MissingExtraError


def require_plotting() -> None:
    """Check that matplotlib is installed, before long work starts.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("plots", "report") from error


def require_viewing() -> None:
    """Check that Rerun is installed, before long work starts.

    Raises:
        MissingExtraError: Rerun is not installed.
    """
    os.environ.setdefault("RUST_LOG", "off")  # monoloc reports problems itself, once
    try:
        import rerun  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("the viewer", "view") from error


def require_mavlink() -> None:
    """Check that pymavlink is installed, before a link is opened or messages are written.

    Raises:
        MissingExtraError: pymavlink is not installed.
    """
    try:
        import pymavlink  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("MAVLink", "mavlink") from error


def require_mcap() -> None:
    """Check that mcap and mcap-ros2-support are installed, before a file is written.

    Raises:
        MissingExtraError: one of them is not installed.
    """
    try:
        import mcap_ros2.writer  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("writing MCAP", "mcap") from error


def require_stream() -> None:
    """Check that PyAV is installed, before a stream is opened.

    Raises:
        MissingExtraError: PyAV is not installed.
    """
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("streams over a network", "stream") from error


def require_signing() -> None:
    """Check that cryptography is installed, before a bundle is signed or its signature is checked.

    Raises:
        MissingExtraError: cryptography is not installed.
    """
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("a signature", "sign") from error


def require_ros() -> None:
    """Check that rosbags is installed, before a bag is opened.

    Raises:
        MissingExtraError: rosbags is not installed.
    """
    try:
        import rosbags  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("reading ROS bags", "ros") from error


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
