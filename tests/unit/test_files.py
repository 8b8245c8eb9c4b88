"""Files are written whole or not at all."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from monoloc.errors import DataError
from monoloc.files import json_text, target_of, write_whole


def test_file_is_written_through_links(tmp_path: Path) -> None:
    file, link = tmp_path / "file.txt", tmp_path / "link.txt"
    file.write_bytes(b"old")
    link.symlink_to(file)
    write_whole(link, b"new")
    assert link.is_symlink() and file.read_bytes() == b"new"
    assert sorted(tmp_path.iterdir()) == [file, link]


def test_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file.txt"
    path.write_bytes(b"old")

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(DataError, match=r"file\.txt: cannot be written \(No space left on device\); make room"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "problem"),
    [("none/file.txt", "No such file or directory"), ("w" * 245 + ".txt", "File name too long")],
)
def test_unwritable_file_is_named(tmp_path: Path, name: str, problem: str) -> None:
    with pytest.raises(DataError, match=rf"\.txt: cannot be written \({problem}\); name a file in a folder"):
        write_whole(tmp_path / name, b"new")
    assert list(tmp_path.iterdir()) == []


def test_device_is_refused() -> None:
    with pytest.raises(DataError, match=f"{os.devnull}: is neither a file nor a folder; name a file"):
        target_of(Path(os.devnull))


def test_json_has_null_for_nan_and_infinity() -> None:
    content = {"a": float("nan"), "b": [1.5, float("inf")], "c": {"d": (2, "x")}}
    assert json.loads(json_text(content)) == {"a": None, "b": [1.5, None], "c": {"d": [2, "x"]}}
