"""The content of the report, independent of its format."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from monoloc.start import START_ERROR_DEG, START_ERROR_M
from monoloc_lab.experiments.figure import Claim, Drawn, Figure
from monoloc_lab.experiments.gather import and_list, frames_of
from monoloc_lab.experiments.study import WIDTH, EvalRecording, Study

PAPER = (
    "P. Shukla et al., Robust Monocular Localization of Drones by Adapting Domain Maps to Depth Prediction "
    "Inaccuracies (ICASSP 2023, arXiv 2210.15559)"
)


@dataclass(frozen=True)
class Heading:
    """A heading; ``anchor`` is its name in links, None if nothing links to it."""

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
    """The report below its title; arguments as for :func:`monoloc_lab.experiments.report.write_report`."""
    claims = [claim for _, one in drawn for claim in one.claims]
    blocks: list[Block] = [Paragraph(_introduction(study, seconds, worked_s))]
    if claims:
        blocks += [Heading("The paper's claims", "claims"), Paragraph(_summary(claims)), *map(_verdict, claims)]
    for figure, one in drawn:
        blocks.append(Heading(figure.title, figure.name))
        source = f"{figure.source} of the paper." if figure.source else "Not in the paper."
        blocks.append(Paragraph(f"{source} {_with_fixed_spaces(one.text)}"))
        blocks += [Picture(path, figure.title) for path in one.pictures]
        blocks += [_without_single_split(Table(title, head, rows)) for title, (head, rows) in one.tables.items()]
    blocks.append(Heading("Settings", "settings"))
    if left_out:
        names = and_list([f"{figure.title.lower()} ({figure.name})" for figure in left_out])
        blocks.append(Paragraph(f"A quick study leaves out {names}."))
    blocks.append(Table("Study", ("setting", "value"), list(study_settings(study).items())))
    blocks.append(Table("Made with", ("part", "version"), list(made.items())))
    blocks.append(Paragraph(f"The paper: {PAPER}.", small=True))
    return blocks


def _verdict(claim: Claim) -> Verdict:
    analysis = None if claim.analysis is None else _with_fixed_spaces(claim.analysis)
    return Verdict(replace(claim, figure=_with_fixed_spaces(claim.figure), analysis=analysis))


def _with_fixed_spaces(text: str) -> str:
    """Text with no-break spaces between numbers and units."""
    return re.sub(r"(?<=\d) (?=(?:%|cm|m|kB|MB)(?!\w))", "\N{NO-BREAK SPACE}", text)


def study_settings(study: Study) -> dict[str, str]:
    """A study as text; recordings by name, without their paths."""
    settings = {
        "networks": f"{', '.join(study.sizes)} (width {WIDTH})",
        "seeds": f"0 to {study.seeds - 1}",
        "builds": f"{study.builds}; a run with seed s uses build s modulo {study.builds}",
        "start": f"error of {100.0 * START_ERROR_M:g} cm and {START_ERROR_DEG:g}° in a direction drawn from the seed",
        "adaptation": ", ".join(f"{name} {value}" for name, value in study.adapt.items()) or "default settings",
        "initial encoder of PoseNets": Path(study.encoder_weights).name if study.encoder_weights else f"full-{WIDTH}",
    }
    for split in study.splits:
        build = frames_of(split.source, split.frames)
        settings[f"{split.name}: built from"] = f"{build.name}, {split.frames}, {len(build)} frames"
        for light, recording in split.recordings.items():
            settings[f"{split.name}: evaluated on, {light}"] = _described(recording)
    return settings


def _described(recording: EvalRecording) -> str:
    frames = frames_of(recording.source, recording.frames)
    light = f", {recording.light} simulated" if recording.light else ""
    return f"{frames.name}, {recording.frames}, {len(frames)} frames{light}"


def _introduction(study: Study, seconds: float, worked_s: float) -> str:
    kind = "This is a quick study, with fewer sizes and shorter tuning and training. " if study.quick else ""
    return (
        f"{kind}monoloc reproduce computed the figures, the table and the claims of {PAPER}, and further figures. "
        "Errors are of positions on unseen frames, without alignment. Numbers are medians over "
        f"{study.seeds} seeds, with the smallest and the largest value. This command took {_duration(seconds)}. All "
        f"work together took {_duration(worked_s)} on one core."
    )


def _duration(seconds: float) -> str:
    minutes = seconds / 60.0
    if minutes < 2.0:
        return f"{seconds:.0f} seconds"
    return f"{minutes:.0f} minutes" if minutes < 120.0 else f"{minutes / 60.0:.1f} hours"


def _summary(claims: Sequence[Claim]) -> str:
    held, verdicts = sum(claim.holds for claim in claims), Counter(claim.verdict for claim in claims)
    return (
        f"{held} of {len(claims)} measurements satisfy the bound of the claim. By the intervals over builds, "
        f"{verdicts['holds']} hold, {verdicts['fails']} fail and {verdicts['undecided']} are undecided. What this "
        "says about the method of the paper is undecided: monoloc tunes the network and the map, where the paper "
        "tunes the last layer and the map, and network, likelihood, filter, odometry and rooms differ as well."
    )


def _without_single_split(table: Table) -> Table:
    """A table without its column of splits, if there is only one split."""
    columns = [
        place
        for place, name in enumerate(table.head)
        if name != "split" or len({row[place] for row in table.rows}) > 1
    ]
    return Table(
        table.title,
        [table.head[place] for place in columns],
        [[row[place] for place in columns] for row in table.rows],
    )


def without_repeats(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Rows whose leading cells are empty where they repeat the row above; the last cell is never empty."""
    shown: list[list[str]] = []
    above: Sequence[Any] = ()
    for row in rows:
        same = 0
        while same < min(2, len(row) - 1) and same < len(above) and row[same] == above[same]:
            same += 1
        shown.append([""] * same + list(row[same:]))
        above = row
    return shown


def bound_text(claim: Claim) -> str:
    return f"{'bound satisfied' if claim.holds else 'bound not satisfied'}; over builds {claim.verdict}"


def spread_sentence(claim: Claim) -> str:
    """Smallest and largest of the number that the bound applies to."""
    low, high = claim.spread
    of = claim.settings.get("spread_of", "the figure")
    return f"{of[0].upper()}{of[1:]}: {low:.3g} to {high:.3g}. Bound: {claim.settings.get('bound', 'none')}."
