"""Sentences of docs/results.md on recordings that nobody had looked at are those of the kept data."""

from __future__ import annotations

import pytest

from document_numbers import (
    Sentence,
    agree_sentence,
    by_build,
    chosen,
    middle,
    other_numbers,
    over_builds,
    sections_of,
    three,
    total,
)
from kept_flights import (
    FURTHER,
    TURNING,
    TURNING_BEYOND,
    WALK,
    WALK_BEYOND,
    further,
    further_over,
)


def ratios(other: str, *stretches: dict[str, str]) -> list[float]:
    return [number for stretch in stretches for number in three(further_over(other, stretch))]


def rmse_cm(method: str, stretch: dict[str, str], column: str = "rmse_cm") -> float:
    return middle(further(method, stretch), column)[0]


PAGE, HEADING = "docs/results.md", "Two recordings that nobody had looked at"
SENTENCES: tuple[Sentence, ...] = (
    ("**{} of the {} frames of the default", [0, total(chosen(FURTHER, method="default"), "frames")]),
    (
        "By depth alone, {} of {} are",
        [total(further("without landmarks", TURNING), name) for name in ("silent_30cm", "frames")],
    ),
    (
        "is {} ({}–{}) and {} ({}–{}) times that without scans, and {} ({}–{}) and {} ({}–{}) times that of "
        "untuned bundles",
        [*ratios("without scans", TURNING, TURNING_BEYOND), *ratios("untuned", TURNING, TURNING_BEYOND)],
    ),
    (
        "tuning lowers it, to {} ({}–{}) times, and the effect of scans is undecided, {} ({}–{})",
        [*ratios("untuned", WALK), *ratios("without scans", WALK)],
    ),
    (
        "the RMSE is {} cm with them, and {} cm without",
        [rmse_cm(method, WALK_BEYOND) for method in ("default", "without scans")],
    ),
    (
        "Its RMSE is {} cm, where that of odometry is {} cm",
        [rmse_cm("without landmarks", WALK), rmse_cm("without landmarks", WALK, "odometry_rmse_cm")],
    ),
    (
        "and that of the default {} cm ({}–{})",
        over_builds(further("default", TURNING_BEYOND), "rmse_cm"),
    ),
)

NOT_OF_THE_DATA: dict[str, str] = {
    "(Sturm et al., IROS 2012": "a name",
    "over a desk for 24 s, turned about all three axes, by 2 to 3° an image": "of the recording",
    "671 of its 723 images have depth": "of the recording",
    "CVPR 2021": "a name",
    "373 images of 540x360 pixels, 8 cm apart, through 6.6 by 8.6 m": "of the recording",
    "10 images a second were assumed": "a setting",
    "are 1.5 from the nearest of them": "of the recording",
    "in one flight by 0.62, until the pose was 1.2 m off": "looked at frame by frame, not kept",
    "with 38 and 40 times the bytes": "of the tables below, over files of one bundle",
    "the RMSE of SIFT is 1.7 cm": "in the table below",
    "1 build each (seed 0)": "counted",
    "within 0.3 of a build frame": "a definition",
}


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)


def test_every_other_number_is_none_of_kept_runs() -> None:
    assert other_numbers(dict(sections_of(PAGE))[HEADING], SENTENCES, NOT_OF_THE_DATA) == []


def test_no_frame_is_silently_wrong_where_landmarks_are_used() -> None:
    with_landmarks = [row for row in FURTHER if "without landmarks" not in row["method"]]
    assert sum(total(with_landmarks, name) for name in ("silent_30cm", "silent_3_5_sigma")) == 0
    assert {len(by_build(further(row["method"], stretch), "rmse_cm")) for row in FURTHER for stretch in (WALK,)} == {
        5
    }
