"""A figure or table of the report: what it needs to be known, and how it is drawn from that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task


@dataclass(frozen=True)
class Claim:
    """A claim of the source paper, held against what was measured; one entry of ``claims`` in the JSON.

    Attributes:
        name: the claim in a few words.
        holds: whether it does, by the bound in ``settings``.
        figure: what was measured, in a sentence with its unit.
        spread: smallest and largest over seeds, of the number the sentence turns on.
        settings: split, light, sizes, seeds, bound.
        analysis: why it does not hold, where it does not; None where it does.
    """

    name: str
    holds: bool
    figure: str
    spread: tuple[float, float]
    settings: dict[str, Any]
    analysis: str | None = None


@dataclass(frozen=True)
class Drawn:
    """What a figure came to.

    Attributes:
        numbers: all that the picture shows, ready for JSON; lies beside it.
        pictures: PNG files, within the report's folder.
        tables: in the report, each a header and rows, under its title.
        text: one or two plain sentences: what is seen, and whether it agrees with the source paper.
        claims: of the source paper, decided by this figure.
    """

    numbers: dict[str, Any]
    pictures: Sequence[Path] = ()
    tables: dict[str, tuple[Sequence[str], Sequence[Sequence[str]]]] = field(default_factory=dict)
    text: str = ""
    claims: Sequence[Claim] = ()


@dataclass(frozen=True)
class Figure:
    """One figure or table.

    Attributes:
        name: on the command line, as ``fig4d``.
        title: in the report; source: which one of the source paper's it is, None for what goes beyond it.
        tasks: what must be known to draw it in a study; None where it is left out, for what it costs.
        draw: from their results into a folder: ``NAME.png``, or ``NAME-SPLIT.png`` where there are several.
    """

    name: str
    title: str
    source: str | None
    tasks: Callable[[Study], Sequence[Task] | None]
    draw: Callable[[Study, Results, Path], Drawn]
