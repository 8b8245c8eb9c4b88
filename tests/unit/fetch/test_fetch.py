"""``monoloc fetch``, from a server on this machine."""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from archive_server import ArchiveServer, serving, tarred, zipped
from cli_helpers import json_of, listing, outputs, refused, succeeds
from monoloc.cli import fetch
from monoloc.cli.main import invoke
from monoloc.fetch import download as downloading
from monoloc.fetch import unpack as unpacking
from monoloc.fetch.data_sets import DATA_SETS, DataSet
from refusals import refuses_data

TERMS = "https://example.org/terms"
SEQUENCE = {"seq-01/frame-000000.pose.txt": b"pose" * 50}
SCENE = zipped({"scene/seq-01.zip": zipped(SEQUENCE), "scene/TrainSplit.txt": b"sequence1\n"})


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[ArchiveServer]:
    with serving(SCENE) as server:
        known = {
            "scene": DataSet("A scene", TERMS, server.url("scene.zip"), "7scenes:scene"),
            "gone": DataSet("A scene", TERMS, server.url("absent.zip"), "7scenes:gone"),
        }
        monkeypatch.setattr(fetch, "DATA_SETS", known)
        yield server


def encrypted(archive: bytes) -> bytes:
    """A zip archive of one file that claims to be encrypted."""
    marked, central = bytearray(archive), archive.index(b"PK\x01\x02")
    marked[6] |= 1
    marked[central + 8] |= 1
    return bytes(marked)


def fetched(out: Path) -> tuple[str, ...]:
    return ("fetch", "scene", "--out", str(out), "--accept-terms")


def test_scene_is_unpacked_under_its_name_after_its_terms(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer
) -> None:
    _, err = outputs(capfd, *fetched(tmp_path))
    assert err.index(TERMS) < err.index("download scene.zip") and "recorded in" in err
    assert (tmp_path / "scene/scene/seq-01/frame-000000.pose.txt").read_bytes() == b"pose" * 50
    assert f"next: monoloc check 7scenes:{tmp_path / 'scene/scene'}" in err
    assert sorted(path.name for path in (tmp_path / "scene/scene").iterdir()) == ["TrainSplit.txt", "seq-01"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["monoloc-checksums.json", "scene"]
    assert json_of(capfd, *fetched(tmp_path))["source"] == f"7scenes:{tmp_path / 'scene/scene'}"
    assert server.ranges == [None]  # once


@pytest.mark.parametrize(("knows_ranges", "whole"), [(True, False), (False, False), (True, True)])
def test_download_goes_on_where_it_broke_off(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer, knows_ranges: bool, whole: bool
) -> None:
    server.breaks_after, server.knows_ranges = 100, knows_ranges
    assert invoke([*fetched(tmp_path)]) == 2
    assert f"broke off after 100 of {len(SCENE)} bytes; check the connection" in capfd.readouterr().err
    if whole:
        (tmp_path / "scene.zip").write_bytes(SCENE)
    succeeds(capfd, *fetched(tmp_path))
    assert server.ranges == [None, f"bytes={len(SCENE) if whole else 100}-"]
    assert (tmp_path / "scene/scene/seq-01/frame-000000.pose.txt").read_bytes() == b"pose" * 50


def test_archive_that_changed_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer
) -> None:
    succeeds(capfd, *fetched(tmp_path))
    record = json.loads((tmp_path / "monoloc-checksums.json").read_text())
    (tmp_path / "scene").rename(tmp_path / "before")
    server.content = zipped({"scene/other": b"other"})
    before = listing(tmp_path)
    assert invoke([*fetched(tmp_path)]) == 2
    err = capfd.readouterr().err
    assert f"not {record[server.url('scene.zip')]}; fetch it again, or ask its publisher" in err
    assert listing(tmp_path) == before
    assert not (tmp_path / "scene").exists()


def test_page_in_place_of_an_archive_is_not_recorded(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer
) -> None:
    """As of a network that asks to log in; else every whole archive would be refused, and removed, later."""
    server.content = b"<html>Log in</html>"
    assert invoke([*fetched(tmp_path)]) == 2
    assert "scene.zip: is no whole archive" in capfd.readouterr().err
    (tmp_path / "scene.zip").unlink()
    server.content = SCENE
    succeeds(capfd, *fetched(tmp_path))


def test_full_disk_is_not_blamed_on_the_connection(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*arguments: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(downloading, "_write", write)
    assert invoke([*fetched(tmp_path)]) == 2
    assert "scene.zip: cannot be written (No space left on device); make room, and" in capfd.readouterr().err


@pytest.mark.parametrize("content", ["[]", "no JSON", '{"https://example.org": 1}'])
def test_damaged_record_of_checksums_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer, content: str
) -> None:
    (tmp_path / "monoloc-checksums.json").write_text(content)
    assert invoke([*fetched(tmp_path)]) == 2
    assert "monoloc-checksums.json: holds no checksums by address; remove it" in capfd.readouterr().err
    assert not (tmp_path / "scene").exists()


def test_nothing_is_downloaded_before_the_terms_are_accepted(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer
) -> None:
    assert invoke(["fetch", "scene", "--out", str(tmp_path / "out")]) == 2
    err = capfd.readouterr().err
    assert f"A scene; terms: {TERMS}" in err and f"--accept-terms: was not given; read {TERMS}" in err
    assert server.ranges == [] and listing(tmp_path) == {}


def test_what_cannot_be_fetched_is_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], server: ArchiveServer
) -> None:
    refused(capfd, tmp_path, ("fetch", "moon"), "NAME", "'moon' is not known", "known names: scene")
    for name, problem in (
        ("gone", r"absent.zip: is refused \(404"),
        ("scene", r"scene.zip: cannot be downloaded \(.*refused"),
    ):
        if name == "scene":
            server.shutdown()
            server.server_close()
        assert invoke(["fetch", name, "--out", str(tmp_path), "--accept-terms"]) == 2
        err = capfd.readouterr().err
        assert re.search(problem, err), err
    assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.tgz", tarred({"../outside": b"x"}), "outside"),
        ("a.tgz", tarred({}, {"link": "/etc/passwd"}), "absolute"),
        ("a.tgz", tarred({"file": b"x" * 5000})[:60], "is no whole archive"),
        ("a.zip", SCENE[:200], "is no whole archive"),
        ("a.zip", encrypted(zipped({"file": b"x"})), "is no whole archive"),
        ("a.zip", zipped({"large": b"x" * 5000}), "holds 0.0 GB, and 0.0 GB are free"),
    ],
    ids=[
        "parent folder",
        "link",
        "cut tar",
        "cut zip",
        "encrypted zip",
        "large",
    ],  # archives hold the time they were made
)
def test_hostile_and_broken_archives_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: bytes, problem: str
) -> None:
    monkeypatch.setattr(unpacking.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 4000}))
    archive, folder = tmp_path / name, tmp_path / "folder"
    archive.write_bytes(content)
    folder.mkdir()
    refuses_data(lambda: unpacking.unpack(archive, folder), archive, problem, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == [name, "folder"]


def test_zip_stays_in_its_folder(tmp_path: Path) -> None:
    archive, folder = tmp_path / "a.zip", tmp_path / "folder"
    archive.write_bytes(zipped({"../outside": b"x", "/root": b"y"}))
    folder.mkdir()
    unpacking.unpack(archive, folder)
    assert sorted(path.name for path in folder.iterdir()) == ["outside", "root"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zip", "folder"]


def test_known_recordings_name_terms_and_a_format_that_reads_them(capfd: pytest.CaptureFixture[str]) -> None:
    listed = json_of(capfd, "fetch")
    lines = succeeds(capfd, "fetch").splitlines()
    assert f"terms of fr1-desk, fr1-room, fr1-rpy, fr3-office: {DATA_SETS['fr1-desk'].terms}" in lines
    assert list(listed) == list(DATA_SETS) and "redkitchen" in listed
    for data_set in DATA_SETS.values():
        assert data_set.terms.startswith("https://") and data_set.archive.startswith("https://")
        assert data_set.source.partition(":")[0] in ("7scenes", "tum")
    assert "redkitchen" in succeeds(capfd, "fetch")
