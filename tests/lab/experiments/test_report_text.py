"""The content of the report."""

from __future__ import annotations

import pytest

from monoloc_lab.experiments.figure import Claim, Drawn, Figure
from monoloc_lab.experiments.report_text import (
    Heading,
    Paragraph,
    Table,
    report_blocks,
    study_settings,
    without_repeats,
)
from monoloc_lab.experiments.study import Study, builtin

HELD = Claim("Held claim", True, "11.4 cm.", (1.0, 1.2), {"bound": "at most 1.15"})
FAILED = Claim(
    "Failed claim", False, "0.6 of it.", (0.5, 0.7), {"bound": "at most 0.5"}, "The nearest is 1.7 cm off."
)


def figure(name: str, title: str, source: str | None) -> Figure:
    return Figure(name, title, source, lambda study: (), lambda study, results, folder: Drawn({}))


@pytest.fixture(scope="module")
def study() -> Study:
    return builtin(True)


def test_column_of_a_single_split_is_left_out(study: Study) -> None:
    def tables(splits: list[str]) -> Table:
        rows = [(split, "a") for split in splits]
        drawn = [(figure("fig1", "T", None), Drawn({}, tables={"t": (("split", "method"), rows)}))]
        blocks = report_blocks(study, drawn, [], {}, 1.0, 1.0)
        return next(block for block in blocks if isinstance(block, Table) and block.title == "t")

    assert list(tables(["extrapolation", "extrapolation"]).head) == ["method"]
    assert list(tables(["extrapolation", "interpolation"]).head) == ["split", "method"]


def test_report_without_claims_has_no_summary_of_them(study: Study) -> None:
    blocks = report_blocks(study, [(figure("fig2", "T", None), Drawn({}))], [], {}, 20.0, 20.0)
    assert [block.text for block in blocks if isinstance(block, Heading)] == ["T", "Settings"]
    assert isinstance(blocks[0], Paragraph) and "This command took 20 seconds." in blocks[0].text


@pytest.mark.parametrize("claims", [[HELD], [FAILED], [HELD, FAILED]])
def test_summary_counts_bounds_and_leaves_the_method_undecided(study: Study, claims: list[Claim]) -> None:
    blocks = report_blocks(study, [(figure("fig3", "T", None), Drawn({}, claims=claims))], [], {}, 1.0, 1.0)
    (summary,) = (block for block in blocks if isinstance(block, Paragraph) and "satisfy" in block.text)
    assert summary.text.startswith(f"{claims.count(HELD)} of {len(claims)} measurements satisfy the bound")
    assert "the method of the paper is undecided" in summary.text


def test_settings_name_builds_and_frames(study: Study) -> None:
    settings = study_settings(study)
    assert settings["builds"].startswith("1; ")
    assert settings["living room: built from"].endswith(", ::2, 75 frames")


def test_repeated_leading_cells_are_empty() -> None:
    rows = [("a", "b", "x"), ("a", "b", "x"), ("a", "c", "x"), ("d", "c", "x")]
    assert without_repeats(rows) == [["a", "b", "x"], ["", "", "x"], ["", "c", "x"], ["d", "c", "x"]]
    assert without_repeats([("a",), ("a",)]) == [["a"], ["a"]]
