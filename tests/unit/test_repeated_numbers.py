"""Pages that repeat a figure of kept data show it as the data has it."""

from __future__ import annotations

import pytest

from document_numbers import agree_sentence, chosen, median_of, table_of, total
from kept_flights import (
    DESK_BETWEEN,
    DESK_BEYOND,
    KITCHEN_BETWEEN,
    KITCHEN_BEYOND,
    flown,
    over_builds_of,
)

BETWEEN, BEYOND = (KITCHEN_BETWEEN, DESK_BETWEEN), (KITCHEN_BEYOND, DESK_BEYOND)


def of_default(column: str, stretches: tuple[int, ...]) -> list[float]:
    return [number for stretch in stretches for number in over_builds_of(column, stretch, "default")]


def in_living_room(light: str) -> float:
    """Median error in centimetres."""
    rows = chosen(table_of("rendered-rooms.csv"), room="living room", light=light, method="default")
    return median_of(rows, "median_cm")


@pytest.mark.parametrize(
    ("document", "sentence", "expected"),
    [
        (
            "docs/is-it-for-me.md",
            "five builds each, the median error was {} and {} cm between the build frames, and {} and {} cm on the "
            "frames after them (RMSE {} and {} cm)",
            [
                *of_default("median_cm", BETWEEN),
                *of_default("median_cm", BEYOND),
                *of_default("rmse_cm", BEYOND),
            ],
        ),
        (
            "docs/beyond-the-paper.md",
            "the RMSE is {} cm untuned and {} cm tuned in RedKitchen beyond them, {} cm and {} cm at the "
            "desk (5 builds each)",
            [number for stretch in BEYOND for number in over_builds_of("rmse_cm", stretch, "untuned", "default")],
        ),
        (
            "docs/decisions/fusion.md",
            "In [this version](../results.md#this-version), whose stated covariance is wider, {} are.",
            [total(flown("untuned", DESK_BEYOND), "silent_3_5_sigma")],
        ),
        (
            "docs/how-to/fly.md",
            "the median error was {} cm in near darkness, against {} cm in medium light (1 build, 2 flights each)",
            [in_living_room("L3"), in_living_room("L2")],
        ),
    ],
)
def test_sentence(document: str, sentence: str, expected: list[float]) -> None:
    agree_sentence(document, sentence, expected)
