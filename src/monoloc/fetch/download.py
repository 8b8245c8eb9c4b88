"""Downloads that go on where they broke off."""

from __future__ import annotations

import errno
import http.client
import re
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from monoloc.errors import DataError
from monoloc.progress import Progress, Step

_CHUNK = 1 << 20
_TIMEOUT_S = 60.0
_AGAIN = "check the connection, and run the command again: it continues where it stopped"
_MAKE_ROOM = "make room, and run the command again: it continues where it stopped"
_HTTP_PARTIAL, _HTTP_NO_SUCH_RANGE = 206, 416


def download(url: str, target: Path, progress: Progress) -> None:
    """Download to ``target``. What an earlier call left at ``target`` is kept, if the server can go on from there.

    Raises:
        DataError: the server cannot be reached, refuses, or breaks off, or the disk is full.
    """
    have = target.stat().st_size if target.exists() else 0
    headers = {"User-Agent": "monoloc"} | ({"Range": f"bytes={have}-"} if have else {})
    try:
        with urlopen(Request(url, headers=headers), timeout=_TIMEOUT_S) as response:
            goes_on = response.status == _HTTP_PARTIAL and _first_byte(response.headers["Content-Range"]) == have
            have = have if goes_on else 0
            length = response.headers["Content-Length"]
            total = None if length is None else have + int(length)
            with progress.task(f"download {target.name}", None if total is None else -(-total // _CHUNK)) as step:
                size = _write(response, target, have, step)
    except HTTPError as error:
        if error.code == _HTTP_NO_SUCH_RANGE and error.headers["Content-Range"] == f"bytes */{have}":
            return  # it was whole already
        raise DataError(
            url, f"is refused ({error.code} {error.reason})", "look whether its page has moved"
        ) from error
    except (URLError, OSError, http.client.HTTPException) as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DataError(target, f"cannot be written ({error.strerror})", _MAKE_ROOM) from error
        reason = error.reason if isinstance(error, URLError) else error
        raise DataError(url, f"cannot be downloaded ({reason or type(error).__name__})", _AGAIN) from error
    if total is not None and size != total:
        raise DataError(url, f"broke off after {size} of {total} bytes", _AGAIN)


def _write(response: http.client.HTTPResponse, target: Path, have: int, step: Step) -> int:
    """Write what comes behind the first ``have`` bytes; returns the size."""
    with target.open("r+b" if have else "wb") as file:
        file.seek(have)
        file.truncate()
        while chunk := response.read(_CHUNK):
            file.write(chunk)
            step(-(-file.tell() // _CHUNK))
        return file.tell()


def _first_byte(content_range: str | None) -> int | None:
    match = re.match(r"bytes (\d+)-", content_range or "")
    return None if match is None else int(match.group(1))
