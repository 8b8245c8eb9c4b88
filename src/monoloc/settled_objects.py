"""Objects that stay for a whole flight, kept from Python's search for reference cycles.

The search looks at all objects of the process. With those of modules and bundles it takes up to 16 ms, in the middle
of a step, every few seconds.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def settled() -> Iterator[None]:
    """Leave the objects that exist now out of the search until the end of the context."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
