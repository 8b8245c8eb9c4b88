"""NumPy twins of the native kernels of landmarks: readable reference implementations for tests.

Tests check that ``monoloc._core`` gives the same results.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray

_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


def match_descriptors(
    expected: FloatArray,
    known: NDArray[np.uint8],
    pixels: FloatArray,
    descriptors: NDArray[np.uint8],
    radius_px: float,
    most_bits: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """As :func:`monoloc.landmarks.features.match_descriptors`, of descriptors that differ by fewer than some bits."""
    by_x = np.argsort(pixels[:, 0], kind="stable")
    first, last = (np.searchsorted(pixels[by_x, 0], expected[:, 0] + side * radius_px) for side in (-1.0, 1.0))
    counts = last - first
    which = np.repeat(np.arange(len(expected)), counts)
    where = by_x[np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts - first, counts)]
    is_near = np.abs(expected[which, 1] - pixels[where, 1]) < radius_px
    which, where = which[is_near], where[is_near]
    bits = _ONES[known[which] ^ descriptors[where]].sum(axis=1, dtype=np.int64)
    matches = bits < most_bits
    which, where, bits = which[matches], where[matches], bits[matches]
    order = np.argsort(bits, kind="stable")
    first_which, first_where = np.full(len(expected), -1), np.full(len(pixels), -1)
    first_which[which[order[::-1]]] = order[::-1]  # the last to be written is the best match
    first_where[where[order[::-1]]] = order[::-1]
    both = np.flatnonzero(
        (first_which[which] == np.arange(len(which))) & (first_where[where] == np.arange(len(which)))
    )
    return which[both], where[both]
