"""Sizes and orientation tags of image files, from their headers: read before an image is decoded."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

_PNG, _JPEG, _NUMPY = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"\x93NUMPY"
_WEBP, _BMP = b"WEBP", b"BM"
# Portable any-map: kind, width and height, between white space and comments.
_GAP = rb"(?:\s|#[^\n]{0,1000}\n)+"
_PNM = re.compile(rb"P[1-6Ff]" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})\s")
_TIFF = {b"II*\x00": "<", b"MM\x00*": ">"}  # byte order
_WIDTH, _HEIGHT, _ORIENTATION = 256, 257, 274  # TIFF tags
_SHORT, _LONG = 3, 4  # TIFF types
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # JPEG markers that start a frame
_APP1, _SCAN, _JPEG_END = 0xE1, 0xDA, b"\xff\xd9"  # JPEG markers
_BARE = {0x01, *range(0xD0, 0xD9)}  # JPEG markers without a length
_ENTRIES = 512  # more than any TIFF directory has


@dataclass(frozen=True)
class ImageHeader:
    """What a header says of its image.

    Attributes:
        width, height: size of the stored pixels.
        orientation: EXIF's orientation, 1 to 8; 1 is as stored.
    """

    width: int
    height: int
    orientation: int = 1


def image_header(data: bytes) -> ImageHeader | None:
    """Header of a PNG, JPEG, TIFF, BMP, WebP or portable any-map image.

    None for other formats and for headers that are cut short.
    """
    try:
        if data.startswith(_PNG):
            return ImageHeader(*struct.unpack_from(">II", data, 16))
        if data.startswith(_JPEG):
            return _jpeg(data)
        if data.startswith(_BMP):
            width, height = struct.unpack_from("<ii", data, 18)
            return ImageHeader(abs(width), abs(height))  # a negative height is stored from the top
        if data[8:12] == _WEBP:
            return _webp(data)
        if (match := _PNM.match(data)) is not None:
            return ImageHeader(int(match[1]), int(match[2]))
        if is_tiff(data):
            tags = _tiff_tags(data)
            return ImageHeader(tags[_WIDTH], tags[_HEIGHT])
    except (struct.error, KeyError):
        pass
    return None


def is_whole_jpeg(data: bytes) -> bool:
    """Whether a JPEG image has its end, whatever follows: phones append a video or another image, cameras zeros."""
    scans = (at for marker, at in _jpeg_segments(data) if marker == _SCAN)
    start = next(scans, None)  # a thumbnail in a segment before it has an end of its own
    return start is not None and data.find(_JPEG_END, start) >= 0


def is_tiff(data: bytes) -> bool:
    """Whether the data is a TIFF image."""
    return data[:4] in _TIFF


def is_numpy(data: bytes) -> bool:
    """Whether the data is a NumPy array file."""
    return data.startswith(_NUMPY)


def _webp(data: bytes) -> ImageHeader | None:
    """Size in the first chunk (RFC 9649)."""
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return ImageHeader(width & 0x3FFF, height & 0x3FFF)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return ImageHeader((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    if kind == b"VP8X":
        low_width, high_width, low_height, high_height = struct.unpack_from("<HBHB", data, 24)
        return ImageHeader((high_width << 16 | low_width) + 1, (high_height << 16 | low_height) + 1)
    return None


def _jpeg(data: bytes) -> ImageHeader | None:
    """Size from the start of the frame, and orientation from the EXIF segment before it."""
    orientation = 1
    for marker, at in _jpeg_segments(data):
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return ImageHeader(width, height, orientation)
        if marker == _APP1 and data[at + 4 : at + 10] == b"Exif\0\0":
            (length,) = struct.unpack_from(">H", data, at + 2)
            orientation = _orientation(data[at + 10 : at + 2 + length])
    return None


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Marker and start of each segment of a JPEG image, up to the first that pixels follow."""
    at, marker = 2, 0
    while at + 4 <= len(data) and data[at] == 0xFF and marker != _SCAN:
        marker = data[at + 1]
        if marker == 0xFF or marker in _BARE:
            at += 1 if marker == 0xFF else 2  # 0xFF may be repeated before a marker
            continue
        yield marker, at
        at += 2 + int(struct.unpack_from(">H", data, at + 2)[0])


def _orientation(exif: bytes) -> int:
    try:
        value = _tiff_tags(exif).get(_ORIENTATION, 1)
    except (struct.error, KeyError):
        return 1
    return value if 1 <= value <= 8 else 1


def _tiff_tags(data: bytes) -> dict[int, int]:
    """Values of the first directory that are one short or long number, by tag (TIFF 6.0, section 2)."""
    order = _TIFF[data[:4]]
    (start,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, start)
    tags: dict[int, int] = {}
    for index in range(min(count, _ENTRIES)):
        at = start + 2 + 12 * index
        tag, kind, number = struct.unpack_from(f"{order}HHI", data, at)
        if number == 1 and kind in (_SHORT, _LONG):
            (tags[tag],) = struct.unpack_from(f"{order}{'H' if kind == _SHORT else 'I'}", data, at + 8)
    return tags
