"""Damaged and hostile content of every kind of file is read, or refused in one line; nothing else happens."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hostile_files import NUMBER, NUMBERS, PIECES, TARGETS, Target, check_finite
from monoloc.errors import MonolocError
from repository import REPOSITORY

CORPUS = REPOSITORY / "tests" / "fuzz" / "corpus"


@st.composite
def damage(draw: st.DrawFn, whole: bytes) -> bytes:
    """The content after a few changes: cuts, repetitions, bytes and numbers that nobody expects."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(data)) | st.integers(0, min(len(data), 200)))
        kind = draw(st.sampled_from(["number", "overwrite", "insert", "delete", "repeat", "cut"]))
        found = list(NUMBER.finditer(data)) if kind == "number" else []
        if found:
            one = draw(st.sampled_from(found))
            data[one.start() : one.end()] = draw(st.sampled_from(NUMBERS))
        elif kind == "cut":
            del data[at:]
        elif kind == "delete":
            del data[at : at + draw(st.sampled_from([1, 4, 100]))]
        elif kind == "repeat":
            data[at:at] = data[at : at + draw(st.sampled_from([4, 64]))] * draw(st.sampled_from([1, 50]))
        else:
            piece = draw(st.sampled_from(PIECES) | st.binary(min_size=1, max_size=8))
            data[at : at + (len(piece) if kind == "overwrite" else 0)] = piece
    return bytes(data)


def test_number_of_kinds_in_the_documentation() -> None:
    page = (REPOSITORY / "docs" / "reliability.md").read_text(encoding="utf-8")
    assert f"damages {len(TARGETS)} kinds of files at random" in page


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of NumPy, about numbers that are then refused
@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_file_is_read_or_refused(tmp_path: Path, target: Target, data: st.DataObject) -> None:
    path = tmp_path / target.file
    whole = tmp_path.parent / f"{tmp_path.name}-whole"
    if not whole.exists():
        target.make(path)
        target.read(path)  # so that what follows can fail
        whole.write_bytes(path.read_bytes())
    path.write_bytes(data.draw(damage(whole.read_bytes())))
    check_read_or_refused(target, path)


def check_read_or_refused(target: Target, path: Path) -> None:
    try:
        check_finite(target.read(path))
    except MonolocError as error:
        assert "\n" not in str(error)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", TARGETS)
def test_files_that_a_longer_search_found_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    target = TARGETS[kind]
    path = tmp_path / "in" / target.file
    (tmp_path / "in").mkdir()
    target.make(path)
    for file in sorted(CORPUS.joinpath(kind.replace(" ", "-")).glob("*")):
        path.write_bytes(file.read_bytes())
        check_read_or_refused(target, path)
