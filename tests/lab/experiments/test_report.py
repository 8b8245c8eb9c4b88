"""The report as a self-contained page, as a PDF and as JSON."""

from __future__ import annotations

import base64
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from monoloc.errors import MissingExtraError
from monoloc_lab.experiments.figure import Claim, Drawn, Figure
from monoloc_lab.experiments.report import REPORT_HTML, REPORT_JSON, REPORT_PDF, write_report
from monoloc_lab.experiments.study import Study, builtin
from monoloc_lab.rooms import BUILD

pypdf = pytest.importorskip("pypdf")

HELD = Claim("Held <claim>", True, "11.4 cm & more.", (1.0, 1.2), {"bound": "at most 1.15", "spread_of": "ratio"})
FAILED = Claim(
    "Failed claim", False, "0.6 of it.", (0.5, 0.7), {"bound": "at most 0.5"}, "The nearest is 1.7 cm off."
)
RESOURCES = {"src", "srcset", "data", "poster", "action", "background"}


def figure(name: str, title: str, source: str | None) -> Figure:
    return Figure(name, title, source, lambda study: (), lambda study, results, folder: Drawn({}))


@pytest.fixture(scope="module")
def study() -> Study:
    return builtin(True)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, study: Study) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("report")
    picture = out / "figures" / "fig1.png"
    picture.parent.mkdir()
    tall = np.full((3000, 900, 3), 200, dtype=np.uint8)  # higher than a page
    assert cv2.imwrite(str(picture), tall)
    rows = [("extrapolation", "PoseNet", str(number), "λ ≥ 2 × 3°, δ1 <b>") for number in range(90)]
    table = (("split", "method", "number", "a header that is longer than its cells"), rows)
    drawn = [
        (
            figure("fig1", "First picture", "Figure 1"),
            Drawn({"x": float("nan")}, [picture], {"A table": table}, "Text.", [HELD]),
        ),
        (figure("lambda", "Second", None), Drawn({"y": 2.0}, text="More.", claims=[FAILED])),
    ]
    return out, write_report(out, study, drawn, [figure("frames", "Number of frames", None)], 754.0, 9000.0)


class _Page(HTMLParser):
    """Links and text of a page."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.resources: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.tags: list[str] = []
        self.text = ""
        self.feed(content)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in RESOURCES or (tag == "link" and name == "href"):
                self.resources.append(value or "")
            elif name == "href":
                self.links.append(value or "")
            elif name == "id":
                self.anchors.add(value or "")

    def handle_data(self, data: str) -> None:
        if self.tags[-1:] != ["style"]:
            self.text += data.replace("\N{NO-BREAK SPACE}", " ")


@pytest.fixture(scope="module")
def page(written: tuple[Path, dict[str, Any]]) -> _Page:
    return _Page((written[0] / REPORT_HTML).read_text(encoding="utf-8"))


def test_page_is_self_contained(written: tuple[Path, dict[str, Any]], page: _Page) -> None:
    content = (written[0] / REPORT_HTML).read_text(encoding="utf-8")
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert page.resources and all(resource.startswith("data:image/png;base64,") for resource in page.resources)
    assert not re.search(r"url\(|@import", content)
    assert base64.b64decode(page.resources[0].partition(",")[2]) == (written[0] / "figures/fig1.png").read_bytes()
    assert set(page.links) <= {f"#{anchor}" for anchor in page.anchors} and "#fig1" in page.links


def test_page_has_all_content(page: _Page) -> None:
    for text_ in (
        "monoloc in the rendered living room", "1 of 2 measurements satisfy the bound", "Held <claim>",
        "✓ Bound satisfied;", "11.4 cm & more.", "✗ Bound not satisfied;", "The nearest is 1.7 cm off.",
        "Ratio: 1 to 1.2. Bound: at most 1.15.", "Figure 1 of the paper. Text.", "Not in the paper. More.",
        "λ ≥ 2 × 3°, δ1 <b>", "Made with",
        "This command took 13 minutes. All work together took 2.5 hours on one core.",
        "A quick study leaves out number of frames (frames).", "seeds", "0 to 4", "Python",
    ):  # fmt: skip
        assert text_ in page.text, text_


def test_pdf_has_the_same_content(written: tuple[Path, dict[str, Any]]) -> None:
    document = pypdf.PdfReader(written[0] / REPORT_PDF)
    assert len(document.pages) >= 4  # with a table of 90 rows and a picture higher than a page
    assert document.metadata is not None and document.metadata.title == "monoloc in the rendered living room"
    text = " ".join(" ".join(page.extract_text() for page in document.pages).split())
    for text_ in (
        "Held <claim>",
        "Bound not satisfied; over builds undecided.",
        "λ ≥ 2 × 3°",
        "First picture",
        "Bound: at most 0.5.",
    ):
        assert text_ in text, text_
    assert sum(len(page.images) for page in document.pages) == 1
    for number, page in enumerate(document.pages, start=1):
        width, height = (float(side) for side in page.mediabox[2:])
        assert (round(width), round(height)) == (595, 842)
        assert page.extract_text().split()[-1] == str(number) or str(number) in page.extract_text().split()


def test_json_has_the_same_content(written: tuple[Path, dict[str, Any]]) -> None:
    out, returned = written
    content = json.loads((out / REPORT_JSON).read_text())
    assert [claim["holds"] for claim in content["claims"]] == [True, False]
    assert content["claims"][0].keys() == {"name", "holds", "figure", "spread", "settings", "analysis", "verdict"}
    assert content["figures"]["fig1"] == {
        "title": "First picture", "pictures": ["figures/fig1.png"], "numbers": {"x": None},
    }  # fmt: skip
    assert content["left_out"] == ["frames"] and (content["seconds"], content["worked_s"]) == (754.0, 9000.0)
    assert content["report"] == REPORT_HTML and returned["report"] == str(out / REPORT_HTML)
    assert {path.name for path in out.iterdir()} == {"figures", REPORT_HTML, REPORT_PDF, REPORT_JSON}


def test_report_has_no_path_of_this_machine(written: tuple[Path, dict[str, Any]], study: Study) -> None:
    assert study.splits[0].source == f"folder:{BUILD}"
    for name in (REPORT_HTML, REPORT_JSON):
        assert str(BUILD.parent) not in (written[0] / name).read_text(encoding="utf-8")


def test_missing_reportlab_names_the_extra(
    written: tuple[Path, dict[str, Any]], study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    from monoloc_lab.experiments.report_pdf import pdf_file

    for name in [name for name in sys.modules if name.startswith("reportlab")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "reportlab", None)
    with pytest.raises(MissingExtraError, match=r'the report as PDF needs the extra "report"'):
        pdf_file(study, [])
