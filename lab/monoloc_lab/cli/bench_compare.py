"""``monoloc bench compare``: flights before and after a change."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from monoloc.cli.common import JsonOption, note, print_json, print_table
from monoloc_lab.bench.paired_flights import Change, Comparison, Count, compared, paired
from monoloc_lab.experiments.interval import LEAST_BUILDS

_MOST_NAMED = 5  # files that have no counterpart
_TITLE = 60  # characters of a selection


def compare(
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="Folder of outputs of monoloc localize --json.")],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="Folder of the same flights after a change.")],
    json: JsonOption = False,
) -> None:
    """Compare flights before and after a change, build by build.

    Files of one name in both folders are one flight, over the same frames and from the same start. Flights with one
    bundle are of one build. Errors are over frames that did not build it.

    \b
    Examples:
      monoloc bench compare flights-before flights-after
      monoloc bench compare default without-scans --json
    """
    pairs, left_out = paired(before, after)
    if left_out:
        more = ", ..." if len(left_out) > _MOST_NAMED else ""
        note(after, f"only one folder has {', '.join(left_out[:_MOST_NAMED])}{more}; left out")
    comparisons = list(compared(pairs))
    if json:
        print_json(
            {"before": str(before), "after": str(after), "comparisons": [asdict(each) for each in comparisons]}
        )
        return
    for each in comparisons:
        frames = textwrap.shorten(each.selection.replace(",", ", "), _TITLE, placeholder=" …")
        print_table(f"{each.source}, {frames}", ["", "before", "after", "after / before"], list(_rows(each)))
    if any(each.builds < LEAST_BUILDS for each in comparisons):
        note("compare", f"with fewer than {LEAST_BUILDS} builds there is no interval, and nothing is decided")


def _rows(each: Comparison) -> Iterator[list[str]]:
    number = f"{each.flights} flights of {each.builds} builds"
    same = f"{each.same_flights} are the same" if each.same_flights else ""
    yield [number, "", "", same]
    yield ["RMSE, cm", *_change(each.rmse_m, 100.0)]
    yield ["median error, cm", *_change(each.median_m, 100.0)]
    yield ["median rotation error, °", *_change(each.rotation_deg, 1.0)]
    yield ["tracking or map-changed", *_count(each.vouched_for), f"of {each.frames} frames"]
    yield ["silently over 30 cm", *_count(each.silent_30cm), ""]
    yield ["silently over 3.5 sigma", *_count(each.silent_3_5_sigma), ""]


def _change(change: Change, factor: float) -> list[str]:
    ratio = "undefined" if change.ratio is None else change.ratio.text(digits=2)
    errors = [f"{factor * each.median:.2f}" for each in (change.before, change.after)]
    return [*errors, f"{ratio} {change.verdict}"]


def _count(count: Count) -> list[str]:
    return [str(count.before), str(count.after)]
