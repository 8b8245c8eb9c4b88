"""The report: a page that needs nothing beside itself, a PDF that opens, and JSON of the same."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from monoloc.errors import MissingExtraError
from monoloc_lab.experiments.figure import Claim, Drawn, Figure
from monoloc_lab.experiments.provenance import provenance
from monoloc_lab.experiments.report import REPORT_HTML, REPORT_JSON, REPORT_PDF, write_report
from monoloc_lab.experiments.report_text import (
    Heading,
    Paragraph,
    Table,
    report_blocks,
    study_settings,
    without_repeats,
)
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
    tall = np.full((3000, 900, 3), 200, dtype=np.uint8)  # more than a page
    assert cv2.imwrite(str(picture), tall)
    rows = [("away", "PoseNet", str(number), "λ ≥ 2 × 3°, δ1 <b>") for number in range(90)]
    table = (("split", "method", "number", "a head that is longer than what it holds"), rows)
    drawn = [
        (
            figure("fig1", "First picture", "Figure 1"),
            Drawn({"x": float("nan")}, [picture], {"A table": table}, "Text.", [HELD]),
        ),
        (figure("lambda", "Second", None), Drawn({"y": 2.0}, text="More.", claims=[FAILED])),
    ]
    return out, write_report(out, study, drawn, [figure("frames", "How many frames", None)], 754.0, 9000.0)


class _Page(HTMLParser):
    """What a page links to, and its text outside of style."""

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


def test_page_needs_nothing_beside_itself(written: tuple[Path, dict[str, Any]], page: _Page) -> None:
    content = (written[0] / REPORT_HTML).read_text(encoding="utf-8")
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert page.resources and all(resource.startswith("data:image/png;base64,") for resource in page.resources)
    assert not re.search(r"url\(|@import", content)
    assert base64.b64decode(page.resources[0].partition(",")[2]) == (written[0] / "figures/fig1.png").read_bytes()
    assert set(page.links) <= {f"#{anchor}" for anchor in page.anchors} and "#fig1" in page.links


def test_page_says_all_there_is(page: _Page) -> None:
    for said in (
        "monoloc in the rendered living room", "1 of 2 are reproduced", "Held <claim>", "✓ Reproduced.",
        "11.4 cm & more.", "✗ Not reproduced.", "The nearest is 1.7 cm off.", "Ratio: 1 to 1.2. Bound: at most 1.15.",
        "Figure 1 of the paper. Text.", "Beyond the paper. More.", "λ ≥ 2 × 3°, δ1 <b>", "Drawn by",
        "This command took 13 minutes. All work together took 2.5 hours of one core.",
        "Left out of a quick study: how many frames (frames).", "seeds", "0 to 4", "Python",
    ):  # fmt: skip
        assert said in page.text, said


def test_pdf_opens_and_says_the_same(written: tuple[Path, dict[str, Any]]) -> None:
    document = pypdf.PdfReader(written[0] / REPORT_PDF)
    assert len(document.pages) >= 4  # a table of 90 rows and a picture taller than a page are in it
    assert document.metadata is not None and document.metadata.title == "monoloc in the rendered living room"
    text = " ".join(" ".join(page.extract_text() for page in document.pages).split())
    for said in ("Held <claim>", "Not reproduced.", "λ ≥ 2 × 3°", "First picture", "Bound: at most 0.5."):
        assert said in text, said
    assert sum(len(page.images) for page in document.pages) == 1
    for number, page in enumerate(document.pages, start=1):
        width, height = (float(side) for side in page.mediabox[2:])
        assert (round(width), round(height)) == (595, 842)
        assert page.extract_text().split()[-1] == str(number) or str(number) in page.extract_text().split()


def test_json_has_what_the_page_has(written: tuple[Path, dict[str, Any]]) -> None:
    out, returned = written
    content = json.loads((out / REPORT_JSON).read_text())
    assert [claim["holds"] for claim in content["claims"]] == [True, False]
    assert content["claims"][0].keys() == {"name", "holds", "figure", "spread", "settings", "analysis"}
    assert content["figures"]["fig1"] == {
        "title": "First picture", "pictures": ["figures/fig1.png"], "numbers": {"x": None},
    }  # fmt: skip
    assert content["left_out"] == ["frames"] and (content["seconds"], content["worked_s"]) == (754.0, 9000.0)
    assert content["report"] == REPORT_HTML and returned["report"] == str(out / REPORT_HTML)
    assert {path.name for path in out.iterdir()} == {"figures", REPORT_HTML, REPORT_PDF, REPORT_JSON}


def test_no_path_of_this_machine_is_told(written: tuple[Path, dict[str, Any]], study: Study) -> None:
    assert study.splits[0].source == f"folder:{BUILD}"
    for name in (REPORT_HTML, REPORT_JSON):
        assert str(BUILD.parent) not in (written[0] / name).read_text(encoding="utf-8")
    settings = study_settings(study)
    assert settings["living room: built from"].endswith(", ::2, 75 frames")


def test_a_column_of_one_split_is_left_out(study: Study) -> None:
    def tables(splits: list[str]) -> Table:
        rows = [(split, "a") for split in splits]
        drawn = [(figure("fig1", "T", None), Drawn({}, tables={"t": (("split", "method"), rows)}))]
        blocks = report_blocks(study, drawn, [], {}, 1.0, 1.0)
        return next(block for block in blocks if isinstance(block, Table) and block.title == "t")

    assert list(tables(["away", "away"]).head) == ["method"]
    assert list(tables(["away", "between"]).head) == ["split", "method"]


def test_without_claims_nothing_is_said_of_them(study: Study) -> None:
    blocks = report_blocks(study, [(figure("fig2", "T", None), Drawn({}))], [], {}, 20.0, 20.0)
    assert [block.text for block in blocks if isinstance(block, Heading)] == ["T", "Settings"]
    assert isinstance(blocks[0], Paragraph) and "This command took 20 seconds." in blocks[0].text


@pytest.mark.parametrize(
    ("claims", "says"),
    [
        ([HELD], "It is reproduced."),
        ([FAILED], "It is not reproduced; the analysis says why."),
        ([HELD, HELD], "All 2 are reproduced."),
    ],
)
def test_verdicts_agree_in_number(study: Study, claims: list[Claim], says: str) -> None:
    blocks = report_blocks(study, [(figure("fig3", "T", None), Drawn({}, claims=claims))], [], {}, 1.0, 1.0)
    assert Paragraph(says) in blocks


def test_builds_are_told_as_figures_use_them(study: Study) -> None:
    assert study_settings(study)["builds"].startswith("1; ")
    assert "Figure 3" not in study_settings(study)["builds"]


def test_repeats_are_left_empty_in_leading_cells_only() -> None:
    rows = [("a", "b", "x"), ("a", "b", "x"), ("a", "c", "x"), ("d", "c", "x")]
    assert without_repeats(rows) == [["a", "b", "x"], ["", "", "x"], ["", "c", "x"], ["d", "c", "x"]]
    assert without_repeats([("a",), ("a",)]) == [["a"], ["a"]]


def test_provenance_knows_machine_and_versions() -> None:
    made = provenance()
    assert made["numpy"] == np.__version__ and int(made["cores"]) >= 1
    assert made["processor"] and re.match(r"^(unknown|[0-9a-f]{12})", made["commit"])


def test_provenance_counts_changes_of_tracked_files_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A report's own folder, in the tree by default, is no change of monoloc's."""

    def git(*arguments: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", *who, *arguments], cwd=tmp_path, capture_output=True, check=True)

    source = tmp_path / "src" / "monoloc" / "experiments" / "provenance.py"
    source.parent.mkdir(parents=True)
    source.write_text("before")
    git("init")
    git("add", "src")
    git("commit", "-m", "first")
    monkeypatch.setattr("monoloc_lab.experiments.provenance.__file__", str(source))
    (tmp_path / "reproduction").mkdir()
    (tmp_path / "reproduction" / "report.json").write_text("{}")
    assert re.fullmatch("[0-9a-f]{12}", provenance()["commit"])
    source.write_text("after")
    assert re.fullmatch("[0-9a-f]{12}, with changes", provenance()["commit"])


def test_missing_reportlab_is_said(
    written: tuple[Path, dict[str, Any]], study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    from monoloc_lab.experiments.report_pdf import pdf_file

    for name in [name for name in sys.modules if name.startswith("reportlab")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "reportlab", None)
    with pytest.raises(MissingExtraError, match=r'the report as PDF needs the extra "report"'):
        pdf_file(study, [])
