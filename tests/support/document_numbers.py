"""Tables and sentences of a page, compared with kept data to the digits that they show."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from monoloc_lab.experiments.interval import Interval, interval_of
from repository import REPOSITORY

DATA = REPOSITORY / "docs" / "results"
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")
FRAMES = r"\b\d+:\d+(?::\d+)?\b"
NOT_KEPT = "The runs behind this table were not kept."
TIE = 1e-9  # a value halfway between two printed ones may be printed as either

Rows = Sequence[dict[str, str]]
Sentence = tuple[str, Sequence[float]]
"""A text that occurs once on a page, with ``{}`` in place of measured numbers, and these numbers."""


# --- Kept data ---


@cache
def table_of(name: str) -> Rows:
    with (DATA / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@cache
def json_of(name: str) -> Any:
    return json.loads((DATA / name).read_text(encoding="utf-8"))


def chosen(rows: Rows, **labels: str) -> Rows:
    found = [row for row in rows if all(row[name] == value for name, value in labels.items())]
    assert found, labels
    return found


def only(rows: Rows, **labels: str) -> dict[str, str]:
    (row,) = chosen(rows, **labels)
    return row


def numbers(row: dict[str, str], *columns: str) -> list[float]:
    """Those of a row's columns that have one."""
    return [float(row[column]) for column in columns if row[column]]


def values(rows: Rows, column: str) -> list[float]:
    return [float(row[column]) for row in rows]


def extremes(rows: Rows, column: str) -> list[float]:
    return [min(values(rows, column)), max(values(rows, column))]


def median_of(rows: Rows, column: str) -> float:
    return float(np.median(values(rows, column)))


def by_build(rows: Rows, column: str) -> dict[str, float]:
    """Median over the flights of each build."""
    return {build: median_of(chosen(rows, build=build), column) for build in sorted({row["build"] for row in rows})}


def over_builds(rows: Rows, column: str) -> list[float]:
    """Median over builds of the median over flights, and the interval over builds."""
    return three(interval_of([*by_build(rows, column).values()]))


def three(interval: Interval) -> list[float]:
    """Median, low and high."""
    assert interval.low is not None and interval.high is not None
    return [interval.median, interval.low, interval.high]


def middle(rows: Rows, column: str) -> list[float]:
    return over_builds(rows, column)[:1]


def total(rows: Rows, column: str) -> float:
    return sum(values(rows, column))


def tracking_percent(rows: Rows) -> float:
    return 100.0 * float(np.average(values(rows, "tracking"), weights=values(rows, "frames")))


def spread(found: Iterable[float | None], digits: int = 2) -> list[float]:
    """Median, smallest and largest of what is known; one number where they are equal to the digits shown."""
    known = [value for value in found if value is not None]
    three_of_them = [float(np.median(known)), min(known), max(known)] if known else []
    return three_of_them[:1] if len({f"{number:.{digits}f}" for number in three_of_them}) == 1 else three_of_them


# --- Pages ---


@dataclass(frozen=True)
class Table:
    """One table of a page, without its head; ``place`` is the heading above it and its number below that."""

    place: tuple[str, int]
    rows: tuple[tuple[str, ...], ...]
    after: str
    """The text up to the next table or heading."""


def page(document: str) -> str:
    return (REPOSITORY / document).read_text(encoding="utf-8")


def sections_of(document: str) -> Iterator[tuple[str, str]]:
    """Headings and the text directly below each."""
    parts = re.split(r"(?m)^#+ (.+)\n", re.sub(r"(?s)```.*?```", "", page(document)))[1:]
    yield from zip(parts[::2], parts[1::2], strict=True)


def tables_of(document: str) -> list[Table]:
    found = []
    for heading, text in sections_of(document):
        parts = re.split(r"((?:^ *\|.*\n)+)", text, flags=re.MULTILINE)[1:]
        for number, (table, after) in enumerate(zip(parts[::2], parts[1::2], strict=True)):
            found.append(Table((heading, number), tuple(map(cells_of, table.splitlines()[2:])), after))
    return found


def check_table(table: Table, checks: Mapping[tuple[str, int], Callable[[Table], None]]) -> None:
    """A table agrees with its data, or says that its runs were not kept."""
    assert (table.place in checks) != (NOT_KEPT in table.after)
    if table.place in checks:
        checks[table.place](table)


def cells_of(line: str) -> tuple[str, ...]:
    return tuple(cell.strip().replace("**", "") for cell in line.strip().strip("|").split("|"))


def agree(text: str, expected: Iterable[float]) -> None:
    """The numbers in a text are the expected ones, in order, to the digits that they show."""
    shown = NUMBER.findall(text)
    expected = list(expected)
    assert len(shown) == len(expected), (text, expected)
    for number, value in zip(shown, expected, strict=True):
        digits = len(number.partition(".")[2])
        assert abs(float(number) - value) <= 0.5 * 10.0**-digits + TIE, (text, expected)


def agree_all(cells: Sequence[str], expected: Iterable[Sequence[float]]) -> None:
    for cell, found in zip(cells, expected, strict=True):
        agree(cell, found)


def pattern_of(sentence: str) -> str:
    return rf"({NUMBER.pattern})".join(map(re.escape, sentence.split("{}")))


def agree_sentence(document: str, sentence: str, expected: Sequence[float]) -> None:
    (match,) = re.finditer(pattern_of(sentence), page(document))
    agree_all(match.groups(), [[value] for value in expected])


def other_numbers(text: str, sentences: Iterable[Sentence], phrases: Iterable[str]) -> list[str]:
    """Numbers outside code, links, tables, frames, the sentences and the phrases; each phrase must occur."""
    for pattern in (r"(?s)```.*?```", r"(?m)^ *\|.*$", *(pattern_of(sentence) for sentence, _ in sentences)):
        text = re.sub(pattern, "", text)
    text = re.sub(rf"\]\([^)]*\)|`[^`]*`|{FRAMES}", "", text)
    for phrase in sorted(phrases, key=len, reverse=True):
        assert phrase in text, phrase
        text = text.replace(phrase, "")
    return NUMBER.findall(text)
