"""Text files of numbers, and what is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from monoloc.io.file_access import read_rows
from refusals import refuses_data


@pytest.mark.parametrize(
    ("content", "problem", "fix"),
    [
        (b"1 2\n", "line 1 is not 3 numbers", "each line holds: a b c"),
        (b"1 2 three\n", "line 1 is not 3 numbers", "each line holds: a b c; a heading begins with #"),
        (b"1,5 2 3\n", "line 1 is not 3 numbers", "a b c, separated by spaces, with decimal points"),
        (b"1;2;3\n", "line 1 is not 3 numbers", "a b c, separated by spaces, with decimal points"),
        (b"# fine\n1 2 3 4\n", "line 2 is not 3 numbers", "each line holds: a b c"),
        (b"# only a comment\n", "has no lines of numbers", "each line holds: a b c"),
        (b"\xff\xfe\x00\x80", "is not a text file", "copy the file again, or save it as UTF-8"),
    ],
)
def test_file_without_rows_of_numbers_is_refused(tmp_path: Path, content: bytes, problem: str, fix: str) -> None:
    path = tmp_path / "rows.txt"
    path.write_bytes(content)
    refuses_data(lambda: read_rows(path, 3, "a b c"), path, problem, fix)
