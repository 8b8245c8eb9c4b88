"""Files and folders that appear whole or not at all, whatever ends the writer: an error, a kill or a loss of power.

Each is written beside its place, under a random name for which nobody can have prepared a link, and takes the place
when it is complete. A kill leaves it there; the next writer of the same name removes it. Living writers hold locks.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

if sys.platform != "win32":  # where files of killed writers stay
    import fcntl

_SUFFIX = ".partial"
_AT_WORKING_FOLDER = -100  # AT_FDCWD of Linux
_EXCHANGE = 2  # RENAME_EXCHANGE
_NOT_SUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)


class PartialFile:
    """An empty file that takes the place of ``target`` by :meth:`finish`.

    Args:
        target: with its links resolved, as by :func:`monoloc.files.target_of`.
        is_synced: whether to wait until the disk has it; if not, files of killed writers stay as well.

    Attributes:
        path: where to write.

    Raises:
        OSError: the file cannot be written, at once or later.
    """

    def __init__(self, target: Path, *, is_synced: bool = True) -> None:
        self._target, self._is_synced = target, is_synced
        self.path, self._lock = _made(target, is_folder=False)
        self._is_open = True

    def finish(self) -> None:
        """Put what was written into its place."""
        if self._is_synced and self._lock is not None:
            os.fsync(self._lock)
        self.path.replace(self._target)
        if self._is_synced:
            _sync_folder(self._target.parent)
            _remove_litter(self._target)

    def close(self) -> None:
        """Remove the file, if it is not in its place."""
        if self._is_open:
            self._is_open = False
            with contextlib.suppress(OSError):
                self.path.unlink()
            _close(self._lock)


@contextmanager
def whole_file(target: Path, *, is_synced: bool = True) -> Iterator[Path]:
    """Context of a :class:`PartialFile`'s path, which is finished if the block ends without an error."""
    partial = PartialFile(target, is_synced=is_synced)
    try:
        yield partial.path
        partial.finish()
    finally:
        partial.close()


@contextmanager
def whole_folder(target: Path, *, is_synced: bool = True) -> Iterator[Path]:
    """Context of an empty folder that takes the place of ``target`` if the block ends without an error.

    On Linux there is a folder at ``target`` at every moment, if there was one. Elsewhere, and on file systems that
    cannot exchange two names, a kill in one moment leaves none: the old one is then beside it, with the suffix .old.

    Args:
        target: with its links resolved, as by :func:`monoloc.files.target_of`.
        is_synced: whether it survives a loss of power too; False for one of many files, where the wait is too long.

    Raises:
        OSError: the folder cannot be written.
    """
    partial, lock = _made(target, is_folder=True)
    try:
        yield partial
        if is_synced:
            for file in partial.rglob("*"):
                _sync(file)
            _sync(partial)
        _put(partial, target)
        _sync_folder(target.parent)
        _remove_litter(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        _close(lock)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock a folder, for which everyone else who locks it waits; without effect where folders cannot be locked."""
    descriptor = None
    with contextlib.suppress(OSError):  # a folder that may be written to but not read, or on NFS
        if sys.platform != "win32":
            descriptor = os.open(folder, os.O_RDONLY)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield
    finally:
        _close(descriptor)


def _made(target: Path, *, is_folder: bool) -> tuple[Path, int | None]:
    """A new file or folder beside ``target``, and the descriptor that holds its lock; Windows needs none."""
    while True:
        partial = target.with_name(f".{target.name}.{secrets.token_hex(8)}{_SUFFIX}")
        if is_folder:
            partial.mkdir()
        if sys.platform == "win32":  # folders cannot be opened there, and open files cannot be renamed
            if not is_folder:
                partial.touch()
            return partial, None
        flags = os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT | os.O_EXCL
        lock = os.open(partial, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)
        if _has_locked(lock) and partial.exists():  # else another writer has just taken it for left behind
            return partial, lock
        os.close(lock)


def _close(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def _has_locked(descriptor: int) -> bool:
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (*_NOT_SUPPORTED, errno.ENOLCK):
            raise
    return True


def _remove_litter(target: Path) -> None:
    """Remove what killed writers of ``target`` have left."""
    if sys.platform == "win32":
        return
    name = re.compile(rf"\.{re.escape(target.name)}\.[0-9a-f]{{16}}\{_SUFFIX}")
    with contextlib.suppress(OSError):  # a folder that may be written to but not listed
        for path in target.parent.iterdir():
            if name.fullmatch(path.name):
                with contextlib.suppress(OSError):
                    _remove_if_left(path)


def _remove_if_left(path: Path) -> None:
    lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
    finally:
        os.close(lock)


def _put(partial: Path, target: Path) -> None:
    """Move a folder to ``target``; what was there is then at ``partial``."""
    if not target.exists():
        partial.replace(target)
    elif not _exchanged(partial, target):
        old = partial.with_suffix(".old")
        target.replace(old)
        try:
            partial.replace(target)
        except BaseException:
            old.replace(target)
            raise
        shutil.rmtree(old)


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two names in one step; False if the system cannot."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    if rename is None:
        return False
    if rename(_AT_WORKING_FOLDER, os.fsencode(one), _AT_WORKING_FOLDER, os.fsencode(other), _EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NOT_SUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(other))


def _sync(path: Path) -> None:
    """Wait until the disk has a file's content, or a folder's names.

    Raises:
        OSError: the disk has not taken it.
    """
    if sys.platform == "win32":  # syncs only files that are open for writing
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NOT_SUPPORTED:  # some file systems do not sync folders
            raise
    finally:
        os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # a folder that may be written to but not read; the file itself is there
        _sync(folder)
