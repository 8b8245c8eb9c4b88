"""Checks of arguments for native code, with the same messages for all functions of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


def checked_array(
    name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: DTypeLike
) -> NDArray[np.generic]:
    """Convert ``value`` to a contiguous array of ``dtype``, and check that it is finite.

    None in ``shape`` allows any length.

    Raises:
        ValueError: the shape is wrong ("X must have shape (N, 3), got (4,)") or a value is not finite.
    """
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = ", ".join("N" if want is None else str(want) for want in shape)
        raise ValueError(f"{name} must have shape ({wanted}{',' if len(shape) == 1 else ''}), got {np.shape(value)}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {int((~np.isfinite(array)).sum())} values that are not")
    return array


def float64(name: str, value: ArrayLike, *shape: int | None) -> NDArray[np.float64]:
    """:func:`checked_array` in double precision."""
    return checked_array(name, value, shape, np.float64).astype(np.float64, copy=False)


def float32(name: str, value: ArrayLike, *shape: int | None) -> NDArray[np.float32]:
    """:func:`checked_array` in single precision."""
    return checked_array(name, value, shape, np.float32).astype(np.float32, copy=False)


def check_outlier_share(outlier_share: float) -> None:
    """Check an argument of all likelihood functions.

    Raises:
        ValueError: the share is not in (0, 1].
    """
    if not 0.0 < outlier_share <= 1.0:
        raise ValueError(f"outlier_share must be in (0, 1], got {outlier_share}")
