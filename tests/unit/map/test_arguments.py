"""Arguments of native code: one message for every function of the map."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.map.arguments import check_outlier_share, float32, float64


def test_valid_array_is_converted_and_contiguous() -> None:
    array = float32("points", [[1, 2, 3]], None, 3)
    assert array.dtype == np.float32 and array.flags.c_contiguous
    given = np.zeros((4, 3))
    assert float64("points", given, 4, 3) is given


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros(3), r"points must have shape \(N, 3\), got \(3,\)"),
        (np.zeros((5, 2)), r"points must have shape \(N, 3\), got \(5, 2\)"),
        (np.full((2, 3), np.nan), "points must be finite, got 6 values that are not"),
        (np.array([[0.0, np.inf, 0.0]]), "points must be finite, got 1 values that are not"),
    ],
)
def test_invalid_array_is_refused(value: np.ndarray, message: str) -> None:
    for convert in (float32, float64):
        with pytest.raises(ValueError, match=message):
            convert("points", value, None, 3)


@pytest.mark.parametrize("share", [0.0, 1.1, np.nan])
def test_invalid_outlier_share_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match=rf"outlier_share must be in \(0, 1\], got {share}"):
        check_outlier_share(share)
