"""Memory reuse within the process, for loops that repeatedly allocate the same large arrays."""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_LARGEST = 2**30


def keep_freed_memory() -> None:
    """Ask glibc not to return freed blocks to the system; without glibc this does nothing.

    A training step allocates and frees a few hundred megabytes. If that memory is returned and allocated again, every
    page faults and is zeroed; a decoder step then took twice as long.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGEST)
        mallopt(_M_TRIM_THRESHOLD, 2 * _LARGEST - 1)
