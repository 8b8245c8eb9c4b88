"""What another command wrote meanwhile is not written over; writers of one folder wait for each other."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from monoloc.editing.as_found import AsFound
from refusals import refuses_data


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    (tmp_path / "room.monoloc").mkdir()
    (tmp_path / "room.monoloc" / "manifest.json").write_text("first")
    return tmp_path / "room.monoloc"


def write(found: AsFound) -> None:
    with found.held():
        pass


def test_what_is_as_it_was_found_is_written(bundle: Path) -> None:
    write(AsFound.of(bundle, bundle.with_suffix(".evidence.npz")))


def test_a_bundle_that_was_changed_gone_or_made_meanwhile_is_refused(bundle: Path) -> None:
    found = AsFound.of(bundle)
    (bundle / "manifest.json").write_text("second")
    refuses_data(lambda: write(found), bundle, "was changed meanwhile by another command", "run this one again")
    (bundle / "manifest.json").unlink()
    refuses_data(lambda: write(found), bundle, "was changed meanwhile", "again")
    new = bundle.with_name("new.monoloc")
    found = AsFound.of(new)
    new.mkdir()
    (new / "manifest.json").write_text("first")
    refuses_data(lambda: write(found), new, "was changed meanwhile", "again")


def test_evidence_that_was_written_meanwhile_is_refused(bundle: Path) -> None:
    evidence = bundle.with_suffix(".evidence.npz")
    found = AsFound.of(bundle, evidence)
    evidence.write_bytes(b"of a flight")
    refuses_data(lambda: write(found), evidence, "was changed meanwhile", "run this one again")


def test_of_two_commands_that_have_read_the_same_one_is_written(bundle: Path) -> None:
    """Both are ready at the same time; the second one looks only when the first one has written."""
    first, second = AsFound.of(bundle), AsFound.of(bundle)
    refused: list[Exception] = []

    def other() -> None:
        try:
            write(second)
        except Exception as error:
            refused.append(error)

    thread = threading.Thread(target=other)
    with first.held():
        thread.start()
        thread.join(0.2)
        assert thread.is_alive()  # it waits
        (bundle / "manifest.json").write_text("by the first")
    thread.join()
    assert len(refused) == 1 and "was changed meanwhile" in str(refused[0])
