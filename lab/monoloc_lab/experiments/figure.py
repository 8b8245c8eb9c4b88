"""A figure or table of the report: the tasks it needs, and how it is drawn from their results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from monoloc_lab.experiments.interval import Verdict
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task


@dataclass(frozen=True)
class Claim:
    """A claim of the paper compared with a measurement; one entry of ``claims`` in the JSON.

    Attributes:
        name: the claim in a few words.
        holds: whether the median satisfies the bound in ``settings``. This is not a verdict on the paper's method,
            from which monoloc differs in more than one component.
        figure: the measurement, in a sentence with its unit.
        spread: smallest and largest of the number that the bound applies to, over seeds.
        settings: split, light, sizes, seeds, bound.
        verdict: by the interval over builds: *holds*, *fails* or *undecided*; see ``docs/beyond-the-paper.md``.
        analysis: further measurements, if the bound is not satisfied, without a cause; None otherwise.
    """

    name: str
    holds: bool
    figure: str
    spread: tuple[float, float]
    settings: dict[str, Any]
    analysis: str | None = None
    verdict: Verdict = "undecided"


@dataclass(frozen=True)
class Drawn:
    """A figure that has been drawn.

    Attributes:
        numbers: every number in the plots, ready for JSON.
        pictures: PNG files in the report's folder.
        tables: title, header and rows.
        text: one or two sentences about the result.
        claims: claims of the paper that this figure compares with a measurement.
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
        title: in the report.
        source: the figure of the paper that it reproduces; None if the paper has no such figure.
        tasks: tasks that it needs in a study; None if the study leaves the figure out because of its cost.
        draw: draws it from the results into a folder: ``NAME.png``, or ``NAME-SPLIT.png`` for several splits.
        on_request: whether it is drawn only if it is named on the command line.
    """

    name: str
    title: str
    source: str | None
    tasks: Callable[[Study], Sequence[Task] | None]
    draw: Callable[[Study, Results, Path], Drawn]
    on_request: bool = False
