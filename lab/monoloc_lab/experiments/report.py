"""The report: claims, figures, tables and settings, as HTML, PDF and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from monoloc.files import json_text, write_whole
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.provenance import provenance
from monoloc_lab.experiments.report_html import html_page
from monoloc_lab.experiments.report_pdf import pdf_file
from monoloc_lab.experiments.report_text import report_blocks, study_settings
from monoloc_lab.experiments.study import Study

REPORT_JSON, REPORT_HTML, REPORT_PDF = "report.json", "report.html", "report.pdf"


def write_report(
    out: Path,
    study: Study,
    drawn: Sequence[tuple[Figure, Drawn]],
    left_out: Sequence[Figure],
    seconds: float,
    worked_s: float,
) -> dict[str, Any]:
    """Write the three files of the report.

    Args:
        out: the folder of the report; it contains the pictures.
        drawn: figures in the order of the report.
        left_out: requested figures that the study leaves out.
        seconds: duration of this command, which may have reused earlier results.
        worked_s: duration of all the work, on one core.

    Returns:
        The content of ``report.json``: ``claims``, ``figures`` by name, ``report``, ``seconds``, ``worked_s``,
        ``left_out``, ``study``, ``provenance``. The path ``report`` is relative to ``out`` in the file only.

    Raises:
        MissingExtraError: ReportLab or matplotlib is not installed.
        DataError: a file cannot be written.
    """
    made = provenance()
    blocks = report_blocks(study, drawn, left_out, made, seconds, worked_s)
    write_whole(out / REPORT_HTML, html_page(study, blocks).encode())
    write_whole(out / REPORT_PDF, pdf_file(study, blocks))
    content: dict[str, Any] = {
        "claims": [asdict(claim) for _, one in drawn for claim in one.claims],
        "figures": {
            figure.name: {
                "title": figure.title,
                "pictures": [str(path.relative_to(out)) for path in one.pictures],
                "numbers": one.numbers,
            }
            for figure, one in drawn
        },
        "report": REPORT_HTML,
        "seconds": seconds,
        "worked_s": worked_s,
        "left_out": [figure.name for figure in left_out],
        "study": {"title": study.title, "quick": study.quick, **study_settings(study)},
        "provenance": made,
    }
    write_whole(out / REPORT_JSON, (json_text(content) + "\n").encode())
    return content | {"report": str(out / REPORT_HTML)}
