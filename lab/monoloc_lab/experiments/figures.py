"""All figures and tables, in the order of the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from monoloc.errors import SettingError
from monoloc.files import json_text, write_whole
from monoloc_lab.experiments import (
    ablation,
    adapt_settings,
    claims_by_method,
    fig1,
    fig2,
    fig3,
    fig4ab,
    fig4c,
    fig4d,
    fig5a,
    fig5b,
    fig5top,
    frames,
    kl_weight,
    ladder,
    map_size,
    posenets,
    robustness,
    table1,
    variants,
)
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results

FIGURES: tuple[Figure, ...] = (
    fig1.FIGURE,
    fig2.FIGURE,
    fig3.FIGURE,
    fig4ab.FIGURE,
    fig4c.FIGURE,
    fig4d.FIGURE,
    fig5top.FIGURE,
    fig5a.FIGURE,
    fig5b.FIGURE,
    table1.FIGURE,
    variants.FIGURE,
    map_size.FIGURE,
    kl_weight.FIGURE,
    frames.FIGURE,
    ablation.FIGURE,
    adapt_settings.FIGURE,
    robustness.FIGURE,
    ladder.FIGURE,
    claims_by_method.FIGURE,
    posenets.FIGURE,
)


def chosen_figures(names: Sequence[str]) -> list[Figure]:
    """Figures by name, in the order of the report; without names all but those on request.

    Raises:
        SettingError: no such figure.
    """
    known = [figure.name for figure in FIGURES]
    for name in names:
        if name not in known:
            raise SettingError("FIGURE", f"is {name!r}", f"choose from {', '.join(known)}")
    return [figure for figure in FIGURES if figure.name in names or not (names or figure.on_request)]


def draw_figure(figure: Figure, study: Study, results: Results, folder: Path) -> Drawn:
    """Draw a figure into a folder, and write its numbers to ``NAME.json``.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: a file cannot be written.
    """
    drawn = figure.draw(study, results, folder)
    write_whole(folder / f"{figure.name}.json", (json_text(drawn.numbers) + "\n").encode())
    return drawn
