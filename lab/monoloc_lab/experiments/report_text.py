"""What the report says, in order, apart from how it is set."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from monoloc.start import START_ERROR_DEG, START_ERROR_M
from monoloc_lab.experiments.figure import Claim, Drawn, Figure
from monoloc_lab.experiments.gather import frames_of, joined
from monoloc_lab.experiments.study import WIDTH, Study, Walk

PAPER = (
    "P. Shukla et al., Robust Monocular Localization of Drones by Adapting Domain Maps to Depth Prediction "
    "Inaccuracies (ICASSP 2023, arXiv 2210.15559)"
)


@dataclass(frozen=True)
class Heading:
    """``anchor`` is its name in links; None where nothing links to it."""

    text: str
    anchor: str | None = None


@dataclass(frozen=True)
class Paragraph:
    text: str
    small: bool = False


@dataclass(frozen=True)
class Verdict:
    claim: Claim


@dataclass(frozen=True)
class Picture:
    path: Path
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows are as long as ``head``."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


Block = Heading | Paragraph | Verdict | Picture | Table


def report_title(study: Study) -> str:
    return f"monoloc in the {study.title}" if study.title.startswith("rendered") else f"monoloc on {study.title}"


def report_blocks(
    study: Study,
    drawn: Sequence[tuple[Figure, Drawn]],
    left_out: Sequence[Figure],
    made: Mapping[str, str],
    seconds: float,
    worked_s: float,
) -> list[Block]:
    """All of the report below its title; arguments: :func:`monoloc_lab.experiments.report.write_report`."""
    claims = [claim for _, one in drawn for claim in one.claims]
    blocks: list[Block] = [Paragraph(_introduction(study, seconds, worked_s))]
    if claims:
        blocks += [Heading("The paper's claims", "claims"), Paragraph(_verdicts(claims)), *map(_verdict, claims)]
    for figure, one in drawn:
        blocks.append(Heading(figure.title, figure.name))
        source = f"{figure.source} of the paper." if figure.source else "Beyond the paper."
        blocks.append(Paragraph(f"{source} {_tied(one.text)}"))
        blocks += [Picture(path, figure.title) for path in one.pictures]
        blocks += [_lean(Table(title, head, rows)) for title, (head, rows) in one.tables.items()]
    blocks.append(Heading("Settings", "settings"))
    if left_out:
        names = joined([f"{figure.title.lower()} ({figure.name})" for figure in left_out])
        blocks.append(Paragraph(f"Left out of a quick study: {names}. Run without --quick for these."))
    blocks.append(Table("What was studied", ("setting", "value"), list(study_settings(study).items())))
    blocks.append(Table("Drawn by", ("part", "version"), list(made.items())))
    blocks.append(Paragraph(f"After {PAPER}.", small=True))
    return blocks


def _verdict(claim: Claim) -> Verdict:
    analysis = None if claim.analysis is None else _tied(claim.analysis)
    return Verdict(replace(claim, figure=_tied(claim.figure), analysis=analysis))


def _tied(text: str) -> str:
    """Text whose numbers are never parted from their units by the end of a line."""
    return re.sub(r"(?<=\d) (?=(?:%|cm|m|kB|MB)(?!\w))", "\N{NO-BREAK SPACE}", text)


def study_settings(study: Study) -> dict[str, str]:
    """A study as people read it; recordings by name, for where they lie is of no interest."""
    settings = {
        "networks": f"{', '.join(study.sizes)} (width {WIDTH})",
        "seeds": f"0 to {study.seeds - 1}",
        "builds": f"{study.builds}; a run with seed s is in build s modulo {study.builds}",
        "start": f"{100.0 * START_ERROR_M:g} cm and {START_ERROR_DEG:g}° off, in a direction drawn from the seed",
        "adaptation": ", ".join(f"{name} {value}" for name, value in study.adapt.items()) or "default settings",
        "PoseNets' encoders start from": Path(study.encoder_weights).name
        if study.encoder_weights
        else f"full-{WIDTH}",
    }
    for split in study.splits:
        built = frames_of(split.source, split.frames)
        settings[f"{split.name}: built from"] = f"{built.name}, {split.frames}, {len(built)} frames"
        for light, walk in split.walks.items():
            settings[f"{split.name}: judged on, {light}"] = _described(walk)
    return settings


def _described(walk: Walk) -> str:
    judged = frames_of(walk.source, walk.frames)
    change = f", changed to {walk.light}" if walk.light else ""
    return f"{judged.name}, {walk.frames}, {len(judged)} frames{change}"


def _introduction(study: Study, seconds: float, worked_s: float) -> str:
    kind = "A quick study: fewer sizes, shorter tuning and training. " if study.quick else ""
    return (
        f"{kind}The figures, the table and the claims of {PAPER}, made anew by monoloc reproduce, and what goes "
        "beyond them. Errors are positions' and of frames that built nothing, without any alignment; a number is "
        f"the median over {study.seeds} seeds, with the smallest and the largest. This command took "
        f"{_duration(seconds)}. All work together took {_duration(worked_s)} of one core."
    )


def _duration(seconds: float) -> str:
    minutes = seconds / 60.0
    if minutes < 2.0:
        return f"{seconds:.0f} seconds"
    return f"{minutes:.0f} minutes" if minutes < 120.0 else f"{minutes / 60.0:.1f} hours"


def _verdicts(claims: Sequence[Claim]) -> str:
    held = sum(claim.holds for claim in claims)
    if len(claims) == 1:
        return "It is reproduced." if held else "It is not reproduced; the analysis says why."
    if held == len(claims):
        return f"All {held} are reproduced."
    return f"{held} of {len(claims)} are reproduced; of the others, the analysis says why."


def _lean(table: Table) -> Table:
    """Without a column of splits that says the same in every row."""
    keep = [
        place
        for place, name in enumerate(table.head)
        if name != "split" or len({row[place] for row in table.rows}) > 1
    ]
    return Table(
        table.title, [table.head[place] for place in keep], [[row[place] for place in keep] for row in table.rows]
    )


def without_repeats(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Rows whose leading cells are left empty where they repeat those above; the last cell never is."""
    shown: list[list[str]] = []
    above: Sequence[Any] = ()
    for row in rows:
        same = 0
        while same < min(2, len(row) - 1) and same < len(above) and row[same] == above[same]:
            same += 1
        shown.append([""] * same + list(row[same:]))
        above = row
    return shown


def verdict_word(claim: Claim) -> str:
    return "reproduced" if claim.holds else "not reproduced"


def spread_sentence(claim: Claim) -> str:
    """Smallest and largest of the number that the claim turns on."""
    low, high = claim.spread
    of = claim.settings.get("spread_of", "the figure")
    return f"{of[0].upper()}{of[1:]}: {low:.3g} to {high:.3g}. Bound: {claim.settings.get('bound', 'none')}."
