"""Reader of ply files: points of a cloud, triangles of a mesh."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice, repeat

import numpy as np

from monoloc.geometry import FloatArray

Column = FloatArray | list[FloatArray]
# (NumPy type of each column, R) -> the next R rows, or fewer at the end of the file.
_Take = Callable[[Sequence[str], int], FloatArray]

_MOST_LIST_ROWS = 2_000_000  # rows of lists are read one by one, in 5 s a million
_MOST_LIST = 1 << 20
_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2"},
    **{"uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    length: str | None  # type of a list's length; None for a scalar


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(each.length is not None for each in self.properties)


_Read = Callable[[_Element], dict[str, Column]]  # reads the elements of a file, in file order


def read_ply(content: bytes, *wanted: str) -> dict[str, dict[str, Column]]:
    """Read the elements of an ascii or binary ply file.

    Args:
        content: content of the file.
        wanted: names of elements. Elements after the last of these are not read.

    Returns:
        For each element name, for each property name: values (N,), or N arrays if the property is a list. The result
        includes all elements before the last wanted one, and omits wanted elements that the file does not have.

    Raises:
        ValueError: the content is not ply, has another encoding, or ends before the rows that its header announces.
    """
    if not re.match(rb"ply\s", content):
        raise ValueError("the first line is not 'ply'")
    match = re.match(rb"ply\s(.*?)^end_header\r?\n", content, re.DOTALL | re.MULTILINE)
    if match is None:
        raise ValueError("the header has no end_header")
    encoding, elements = _header(match[1].decode("ascii", errors="replace"))
    if encoding not in _ENCODINGS:
        raise ValueError(f"format {encoding!r} is none of {', '.join(_ENCODINGS)}")
    last = max((index for index, element in enumerate(elements) if element.name in wanted), default=-1)
    columns = _ENCODINGS[encoding](content[match.end() :])
    return {element.name: columns(element) for element in elements[: last + 1]}


def _header(text: str) -> tuple[str, list[_Element]]:
    encoding = ""
    elements: list[_Element] = []
    for words in (line.split() for line in text.splitlines()):
        try:
            if words[:1] == ["format"]:
                encoding = words[1]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], _count(words[2]), []))
            elif words[:1] == ["property"]:
                length = _TYPES[words[2]] if words[1] == "list" else None
                elements[-1].properties.append(_Property(words[-1], _TYPES[words[-2]], length))
        except (LookupError, ValueError):
            raise ValueError(f"the header's line {' '.join(words)!r} cannot be understood") from None
    return encoding, elements


def _count(word: str) -> int:
    """A number of rows; ValueError if no file has as many."""
    count = int(word)
    if not 0 <= count <= sys.maxsize:
        raise ValueError
    return count


def _ascii(body: bytes) -> _Read:
    lines = (line for line in body.splitlines() if line.strip())

    def read(element: _Element) -> dict[str, Column]:
        rows, width = list(islice(lines, element.count)), len(element.properties)
        if len(rows) < element.count:
            raise _cut_short(element, len(rows))
        if element.has_lists:
            return _read_list_rows(element, [_row_reader(_numbers(row)) for row in rows])
        numbers = _numbers(b"\n".join(rows))
        if len(numbers) != width * len(rows):
            raise ValueError(f"rows of {element.name!r} do not have {width} numbers each, as in the header")
        return _columns_by_name(element, numbers.reshape(len(rows), width))

    return read


def _binary(body: bytes, order: str) -> _Read:
    at = 0

    def take(kinds: Sequence[str], rows: int) -> FloatArray:
        nonlocal at
        row = np.dtype(",".join(f"{order}{kind}" for kind in kinds))
        got = min(max(rows, 0), (len(body) - at) // row.itemsize)
        table = np.frombuffer(body, row, got, at)
        at += got * row.itemsize
        with np.errstate(invalid="ignore"):  # a signalling NaN
            if row.names is None:  # one column
                return table.astype(np.float64)[:, None]
            numbers = np.empty((len(table), len(row.names)))
            for column, name in enumerate(row.names):
                numbers[:, column] = table[name]
            return numbers

    def read(element: _Element) -> dict[str, Column]:
        if element.has_lists:
            return _read_list_rows(element, repeat(take, element.count))
        table = take([each.kind for each in element.properties], element.count)
        if len(table) < element.count:
            raise _cut_short(element, len(table))
        return _columns_by_name(element, table)

    return read


_ENCODINGS: dict[str, Callable[[bytes], _Read]] = {
    "ascii": _ascii,
    "binary_little_endian": partial(_binary, order="<"),
    "binary_big_endian": partial(_binary, order=">"),
}


def _numbers(text: bytes) -> FloatArray:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # from older NumPy versions, for text that is not a number
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            raise ValueError("it contains text that is not a number") from None


def _row_reader(numbers: FloatArray) -> _Take:
    left = iter(numbers)
    return lambda kinds, rows: np.array(list(islice(left, max(rows, 0)))).reshape(-1, 1)


def _columns_by_name(element: _Element, table: FloatArray) -> dict[str, Column]:
    return {each.name: column for each, column in zip(element.properties, table.T, strict=True)}


def _read_list_rows(element: _Element, rows: Iterable[_Take]) -> dict[str, Column]:
    """Read an element with list properties, whose rows differ in length; ``rows`` yields the reader of each row."""
    if element.count > _MOST_LIST_ROWS:
        raise ValueError(f"it has {element.count} rows of {element.name!r}, more than {_MOST_LIST_ROWS}")
    values: list[list[FloatArray]] = [[] for _ in element.properties]
    for row, take in enumerate(rows):
        for column, each in zip(values, element.properties, strict=True):
            length = np.ones((1, 1)) if each.length is None else take([each.length], 1)
            if not np.isfinite(length).all():
                raise ValueError(f"a list of {element.name!r} has the length {length[0, 0]}")
            items = take([each.kind], int(min(length[0, 0], _MOST_LIST))) if len(length) else length
            if len(length) == 0 or len(items) != length[0, 0]:
                raise _cut_short(element, row)
            column.append(items[:, 0])
    pairs = zip(values, element.properties, strict=True)
    return {each.name: column if each.length else np.ravel(column) for column, each in pairs}


def _cut_short(element: _Element, got: int) -> ValueError:
    return ValueError(f"it ends after {got} of {element.count} rows of {element.name!r}")
