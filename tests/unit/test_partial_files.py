"""Files and folders appear whole or not at all, and leave nothing beside them for long."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from monoloc import partial_files
from monoloc.files import write_whole
from monoloc.partial_files import whole_file, whole_folder

# A writer that says when it has begun, and then waits to be killed.
WRITER = """
import sys, time
from pathlib import Path
from monoloc.partial_files import whole_file, whole_folder
with globals()[sys.argv[1]](Path(sys.argv[2])) as partial:
    (partial / "part" if partial.is_dir() else partial).write_text("half")
    print("begun", flush=True)
    time.sleep(60)
"""


def begin(kind: str, path: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", WRITER, kind, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    return process


def write_file(path: Path) -> None:
    write_whole(path, b"whole")


def write_folder(path: Path) -> None:
    with whole_folder(path) as partial:
        (partial / "part").write_text("whole")


BOTH = pytest.mark.parametrize(("kind", "write"), [("whole_file", write_file), ("whole_folder", write_folder)])


@BOTH
def test_next_writer_removes_what_a_killed_one_left(tmp_path: Path, kind: str, write: Callable[[Path], None]) -> None:
    path = tmp_path / "room"
    process = begin(kind, path)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=10)
    assert len(list(tmp_path.iterdir())) == 1 and not path.exists()
    write(tmp_path / "other")
    assert len(list(tmp_path.iterdir())) == 2
    write(path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["other", "room"]


@BOTH
def test_writer_that_lives_is_left_alone(tmp_path: Path, kind: str, write: Callable[[Path], None]) -> None:
    path = tmp_path / "room"
    process = begin(kind, path)
    write(path)
    assert len(list(tmp_path.iterdir())) == 2
    process.kill()
    process.communicate(timeout=10)


def test_link_of_the_temporary_name_is_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if somebody guesses the name, as they could when it held the number of the process."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    monkeypatch.setattr(partial_files.secrets, "token_hex", lambda count: "0" * 2 * count)
    (tmp_path / ".file.txt.0000000000000000.partial").symlink_to(victim)
    with pytest.raises(FileExistsError), whole_file(tmp_path / "file.txt"):
        pytest.fail("the file was opened")
    assert victim.read_text() == "mine"


def test_folder_is_there_at_every_moment_while_it_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "room"
    write_folder(path)
    missing, is_done = [], threading.Event()

    def look() -> None:
        while not is_done.is_set():
            if not os.access(path / "part", os.F_OK):
                missing.append(True)

    watcher = threading.Thread(target=look)
    watcher.start()
    for _ in range(60):
        write_folder(path)
    is_done.set()
    watcher.join()
    assert missing == []


def cannot_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(partial_files, "_exchanged", lambda one, other: False)


def test_folder_is_replaced_where_names_cannot_be_exchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cannot_exchange(monkeypatch)
    path = tmp_path / "room"
    path.mkdir()
    (path / "older").touch()
    write_folder(path)
    assert [file.name for file in tmp_path.rglob("*")] == ["room", "part"]


@pytest.mark.parametrize("number", [None, errno.ENOSYS, errno.EINVAL, errno.EIO])
def test_exchange_that_a_system_lacks_is_done_in_two_steps_and_other_errors_are_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int | None
) -> None:
    def renameat2(*arguments: object) -> int:
        ctypes.set_errno(number or 0)
        return -1

    library = SimpleNamespace() if number is None else SimpleNamespace(renameat2=renameat2)
    monkeypatch.setattr(ctypes, "CDLL", lambda name, use_errno: library)
    path = tmp_path / "room"
    path.mkdir()
    (path / "older").touch()
    if number == errno.EIO:
        with pytest.raises(OSError, match="Input/output error"):
            write_folder(path)
        assert [file.name for file in tmp_path.rglob("*")] == ["room", "older"]
    else:
        write_folder(path)
        assert [file.name for file in tmp_path.rglob("*")] == ["room", "part"]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EIO])
def test_locks_that_a_file_system_lacks_are_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """As on some network file systems; a lock that fails otherwise is an error."""

    def fail(descriptor: int, kind: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(partial_files.fcntl, "flock", fail)
    if number == errno.EIO:
        with pytest.raises(OSError, match="Input/output error"):
            write_folder(tmp_path / "room")
        return
    write_folder(tmp_path / "room")
    assert [file.name for file in tmp_path.rglob("*")] == ["room", "part"]


@pytest.mark.parametrize("error", [OSError(errno.EIO, "Input/output error"), KeyboardInterrupt()])
def test_older_folder_comes_back_if_the_newer_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    cannot_exchange(monkeypatch)
    path = tmp_path / "room"
    path.mkdir()
    (path / "older").touch()
    replace = Path.replace

    def fail(self: Path, target: Path) -> Path:
        if self.suffix == ".partial":
            raise error
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(type(error)):
        write_folder(path)
    assert [file.name for file in tmp_path.rglob("*")] == ["room", "older"]


def test_file_that_the_disk_does_not_take_is_not_put_into_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    path = tmp_path / "file.txt"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input/output error"), whole_file(path) as partial:
        partial.write_bytes(b"new")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_nothing_is_opened_where_open_files_cannot_be_renamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows, which also has no locks and opens no folders."""

    class Os:
        def __getattr__(self, name: str) -> object:
            if name in ("open", "fsync"):
                raise PermissionError(errno.EACCES, "Permission denied")
            return getattr(os, name)

    with monkeypatch.context() as windows:
        windows.setattr(sys, "platform", "win32")
        windows.setattr(partial_files, "os", Os())
        for content in ("1", "2"):
            with whole_file(tmp_path / "file") as partial:
                partial.write_text(content)
            with whole_folder(tmp_path / "folder") as folder:
                (folder / content).write_text(content)
    assert (tmp_path / "file").read_text() == "2"
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["2"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]
