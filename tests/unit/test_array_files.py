"""Archives of arrays that promise more than they hold, or more than anybody needs."""

from __future__ import annotations

import io
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from monoloc import array_files
from monoloc.array_files import decode_arrays, encode_arrays, read_arrays


def archive(method: int = zipfile.ZIP_DEFLATED, **members: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return buffer.getvalue()


def npy(values: object) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(values))
    return buffer.getvalue()


def promising(shape: str) -> bytes:
    """A header of a shape, without the values."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def test_arrays_are_read_as_written(tmp_path: Path) -> None:
    first, second = np.arange(6.0).reshape(2, 3), np.array([1, 2], dtype=np.uint8)
    np.savez_compressed(tmp_path / "file.npz", first=first, second=second)
    arrays = read_arrays(tmp_path / "file.npz")
    assert list(arrays) == ["first", "second"] and arrays["second"].dtype == np.uint8
    np.testing.assert_array_equal(arrays["first"], first)


def test_arrays_of_the_same_values_are_the_same_bytes_whatever_their_order_in_memory() -> None:
    columns = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    content = encode_arrays({"columns": columns, "one": np.array(4)})
    assert content == encode_arrays({"columns": columns.copy(order="C"), "one": np.array(4)})
    assert content == encode_arrays(decode_arrays(content))


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "no whole archive"),
        (archive(a=npy([1.0]))[:-30], "no whole archive"),
        (npy([1.0]), "no whole archive"),
        (archive(a=b"text"), "magic string"),
        (archive(a=promising("(1000000000000,)")), "cut short"),
        (archive(a=promising("(1,(")), "its header is damaged"),
        (archive(a=promising("(1,), 1: 2")), "its header is damaged"),
        (archive(zipfile.ZIP_LZMA, a=npy([1.0])), "a method that NumPy does not use"),
        (archive(a=promising("(" * 200 + ")" * 200)), "[Hh]eader"),
        (archive(a=npy(np.array([object()], dtype=object))), "allow_pickle"),
    ],
)
def test_what_is_no_archive_of_arrays_is_refused(content: bytes, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        decode_arrays(content)


def test_archive_that_grows_beyond_the_bound_is_not_unpacked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bomb = archive(a=npy(np.zeros(500_000)), b=npy(np.zeros(500_000)))
    assert len(bomb) < 20_000
    monkeypatch.setattr(array_files, "_MOST_BYTES", 1 << 20)
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(ValueError, match="its arrays would take 7 MB"):
        decode_arrays(bomb)


def test_encrypted_archive_is_refused() -> None:
    content = bytearray(archive(a=npy([1.0])))
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(signature) + offset] |= 1
    with pytest.raises(ValueError, match="it is encrypted"):
        decode_arrays(bytes(content))


def test_pipes_and_large_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(ValueError, match="not a regular file"):
        read_arrays(tmp_path / "pipe.npz")
    (tmp_path / "large.npz").write_bytes(bytes(3 << 20))
    monkeypatch.setattr(array_files, "_MOST_BYTES", 2 << 20)
    with pytest.raises(ValueError, match="larger than 2 MB"):
        read_arrays(tmp_path / "large.npz")
