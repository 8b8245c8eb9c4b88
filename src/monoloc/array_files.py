"""NumPy arrays (.npy) and archives of them (.npz) from files that may come from anywhere.

What a header promises is checked before memory is taken for it, and nothing is unpickled.
"""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.files import read_regular

MOST_ARRAYS = 1000
"""Of an archive; one with more is not read."""

_MOST_BYTES = 1 << 28  # of all arrays of an archive: it is held three times while it is unpacked
_ENCRYPTED = 0x1  # flag of a member of an archive


def decode_array(data: bytes, path: Path) -> NDArray[Any]:
    """Decode the content of a .npy file; its header is checked before the array is allocated.

    Raises:
        DataError: the content is not such an array, is shorter than its header says, or holds objects.
    """
    try:
        return _array(data)
    except (ValueError, EOFError, OSError) as error:
        raise DataError(path, f"cannot be read as a NumPy array ({error})", "copy the file again") from error


def decode_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """Decode the content of a .npz file: its arrays by name.

    Raises:
        ValueError: the content is no such archive, or promises more than 256 MB.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            _check(members)
            return {member.filename.removesuffix(".npy"): _array(archive.read(member)) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, OSError) as error:
        raise ValueError(f"it is no whole archive of arrays: {error}") from error


def encode_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The content of a compressed .npz file for :func:`decode_arrays`; the same for the same arrays."""
    buffer = io.BytesIO()
    # The order of a transposed array would be stored too, and is lost where the array is read and written again.
    in_order = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    np.savez_compressed(buffer, **cast(dict[str, Any], in_order))
    return buffer.getvalue()


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file by name.

    Raises:
        OSError: the file cannot be read.
        ValueError: as :func:`decode_arrays` and :func:`monoloc.files.read_regular`.
    """
    return decode_arrays(read_regular(path, _MOST_BYTES))


def _check(members: list[zipfile.ZipInfo]) -> None:
    if len(members) > MOST_ARRAYS:
        raise ValueError(f"it has {len(members)} arrays")
    if any(member.flag_bits & _ENCRYPTED for member in members):
        raise ValueError("it is encrypted")
    if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
        raise ValueError("it is compressed by a method that NumPy does not use")
    size = sum(member.file_size for member in members)
    if size > _MOST_BYTES:
        raise ValueError(f"its arrays would take {size >> 20} MB")


def _array(data: bytes) -> NDArray[Any]:
    file = io.BytesIO(data)
    is_first_version = np.lib.format.read_magic(file) == (1, 0)
    header = np.lib.format.read_array_header_1_0 if is_first_version else np.lib.format.read_array_header_2_0
    try:
        shape, _, dtype = header(file)
        if math.prod(shape) * dtype.itemsize > len(data) - file.tell():
            raise ValueError("it is cut short")
        file.seek(0)
        return np.asarray(np.load(file, allow_pickle=False))
    # It is parsed as Python.
    except (SyntaxError, TypeError, TokenError, RecursionError, MemoryError) as error:
        raise ValueError("its header is damaged") from error
