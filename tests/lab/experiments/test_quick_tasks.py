"""The guide says how many tasks each figure of --quick needs."""

from __future__ import annotations

import pytest

from document_numbers import agree_all, tables_of
from monoloc_lab.experiments.engine import in_order
from monoloc_lab.experiments.figures import chosen_figures
from monoloc_lab.experiments.study import builtin

PLACE = ("What a figure needs", 0)
(TABLE,) = (table for table in tables_of("docs/how-to/reproduce-the-paper.md") if table.place == PLACE)
STUDY = builtin(quick=True)


def test_every_figure_that_quick_draws_has_a_row() -> None:
    drawn = [f"`{figure.name}`" for figure in chosen_figures([]) if figure.tasks(STUDY) is not None]
    assert [row[0] for row in TABLE.rows] == [*drawn, "all"]


@pytest.mark.parametrize("row", TABLE.rows, ids=lambda row: row[0])
def test_tasks_of_a_figure(row: tuple[str, ...]) -> None:
    name, *shown = row
    figures = chosen_figures([] if name == "all" else [name.strip("`")])
    kinds = [task.kind for task in in_order([task for figure in figures for task in figure.tasks(STUDY) or ()])]
    posenets = kinds.count("posenet") + kinds.count("posenet-search")
    flights = sum(kind.endswith("run") for kind in kinds)
    agree_all(shown, [[len(kinds)], [kinds.count("bundle")], [posenets], [flights]])
