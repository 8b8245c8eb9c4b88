"""Unpacking of archives from elsewhere: nothing is written outside of the folder, and no more than fits."""

from __future__ import annotations

import lzma
import shutil
import tarfile
import zipfile
import zlib
from pathlib import Path

from monoloc.errors import DataError

# RuntimeError: encrypted, compressed in an unknown way, or nested without end.
_BROKEN = (zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, EOFError, RuntimeError)


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a ``.zip`` or ``.tgz`` into a folder, and the zip files in it beside themselves.

    Raises:
        DataError: the archive is broken, leads out of the folder, or holds more than the disk has room for.
    """
    if not hasattr(tarfile, "data_filter"):
        raise DataError(archive, "cannot be unpacked safely by this Python", "use Python 3.11.4 or newer")
    try:
        if archive.suffix == ".zip":
            _unpack_zip(archive, folder)
        else:
            with tarfile.open(archive) as tar:
                _check_room(archive, sum(member.size for member in tar), folder)
                tar.extractall(folder, filter="data")
    except _BROKEN as error:
        raise DataError(archive, f"is no whole archive ({error})", "remove it, and fetch it again") from error


def _unpack_zip(archive: Path, folder: Path) -> None:
    with zipfile.ZipFile(archive) as file:
        _check_room(archive, sum(each.file_size for each in file.infolist()), folder)
        file.extractall(folder)  # which strips drives, leading slashes and '..'
        inner = [folder / each.filename for each in file.infolist() if each.filename.endswith(".zip")]
    for path in inner:  # a scene of 7-Scenes holds one for each sequence
        if path.is_file():
            _unpack_zip(path, path.parent)
            path.unlink()


def _check_room(archive: Path, size: int, folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if size > free:
        raise DataError(
            archive, f"holds {size / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free", "make room, or give --out"
        )
