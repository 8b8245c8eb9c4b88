"""Addresses of pages, and the errors that name them."""

from __future__ import annotations

import re
from email.message import Message

import pytest

from monoloc import documentation
from monoloc.cli.main import invoke
from monoloc.documentation import page_address
from repository import REPOSITORY


def test_pages_are_on_the_site_if_it_is_known_else_in_the_source(monkeypatch: pytest.MonkeyPatch) -> None:
    facts = Message()
    monkeypatch.setattr(documentation, "metadata", lambda _: facts)
    assert page_address("how-to/install") == "docs/how-to/install.md"
    facts["Project-URL"] = "Source, https://example.org/code"
    facts["Project-URL"] = "Documentation, https://example.org/monoloc/"
    assert page_address("how-to/install") == "https://example.org/monoloc/how-to/install/"


def test_every_page_that_an_error_names_exists() -> None:
    sources = (REPOSITORY / "src").rglob("*.py")
    named = {page for file in sources for page in re.findall(r'\bpage\s*=\s*"([^"]+)"', file.read_text())}
    assert len(named) >= 5
    assert [page for page in sorted(named) if not (REPOSITORY / "docs" / f"{page}.md").is_file()] == []


def test_list_of_decisions_is_complete() -> None:
    folder = REPOSITORY / "docs" / "decisions"
    listed = re.findall(r"\]\(([\w-]+\.md#[\w-]+)\)", (folder / "index.md").read_text("utf-8"))
    records = {
        file.name + "#" + re.sub(r"[^\w\s-]", "", title.lower()).replace(" ", "-")
        for file in folder.glob("*.md")
        if file.name != "index.md"
        for title in re.findall(r"(?m)^## (.+)$", file.read_text("utf-8"))
    }
    assert sorted(listed) == sorted(records)


def test_tables_of_the_concepts_name_what_is_in_the_files() -> None:
    rows = [
        line.strip("|").split("|")
        for page in (REPOSITORY / "docs" / "concepts").glob("*.md")
        for line in page.read_text("utf-8").splitlines()
        if "`src/monoloc" in line and line.count("|") == 4
    ]
    assert len(rows) > 40
    for _, names, files in rows:
        first, *others = re.findall(r"`([^`]+)`", files)
        paths = [REPOSITORY / first, *((REPOSITORY / first).with_name(other) for other in others)]
        code = "\n".join(path.read_text("utf-8") for path in paths)
        for name in re.findall(r"`(?:\w+\.)*(\w+)`", names):
            assert re.search(rf"(?m)(?:def|class) {name}\b|^{name}\b", code), (name, files)


def test_modules_that_pages_import_are_in_the_reference() -> None:
    docs = REPOSITORY / "docs"
    text = "\n".join(page.read_text("utf-8") for page in docs.rglob("*.md"))
    imported = set(re.findall(r"(?m)^from (monoloc\.[\w.]+) import", text))
    described = tuple(f"{name}." for name in re.findall(r"(?m)^::: (monoloc\.[\w.]+)$", text))
    assert len(imported) > 8 and len(described) > 30
    assert [name for name in sorted(imported) if not f"{name}.".startswith(described)] == []


def test_a_file_is_piped_into_a_flight_at_its_own_pace() -> None:
    """Frames of a pipe are timed on arrival, and all but the newest are skipped."""
    pages = [REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md"), *(REPOSITORY / "src").rglob("*.py")]
    piped = [line for page in pages for line in re.findall(r"ffmpeg .*monoloc fly", page.read_text("utf-8"))]
    assert piped and [line for line in piped if not line.startswith("ffmpeg -re ")] == []


def test_command_line_adds_the_page_to_the_line(capfd: pytest.CaptureFixture[str]) -> None:
    assert invoke(["inspect", str(REPOSITORY / "docs")]) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and err.endswith(f"(see: {page_address('how-to/record-a-room')})\n")
