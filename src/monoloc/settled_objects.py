"""What start-up leaves behind: objects that stay for a whole flight, and memory that it no longer needs.

Python's search for reference cycles looks at all objects of the process. With those of modules and bundles it takes
up to 16 ms, in the middle of a step, every few seconds.

The C library keeps memory that was freed for later. After the imports it is 8 MB, and 50 MB where modules had to be
compiled first, as for a user who may not write the installation.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def settled() -> Iterator[None]:
    """Return freed memory to the system, and leave the objects that exist now out of the search until the end."""
    gc.freeze()
    _return_freed_memory()
    try:
        yield
    finally:
        gc.unfreeze()


def _return_freed_memory() -> None:
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
        if trim is not None:
            trim(0)
