"""Headers of image files, against what OpenCV writes."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from monoloc.io.image_header import ImageHeader, image_header


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".bmp", ".webp", ".ppm", ".pgm", ".pfm"])
def test_size_is_that_of_the_image(suffix: str) -> None:
    image = np.zeros((13, 300) if suffix == ".pgm" else (13, 300, 3), np.float32 if suffix == ".pfm" else np.uint8)
    data = cv2.imencode(suffix, image)[1].tobytes()
    assert image_header(data) == ImageHeader(300, 13)


def test_lossless_and_extended_webp() -> None:
    data = cv2.imencode(".webp", np.zeros((13, 300, 3), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    assert data[12:16] == b"VP8L" and image_header(data) == ImageHeader(300, 13)
    extended = b"RIFF\0\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0" + struct.pack("<HBHB", 299, 0, 12, 1)
    assert image_header(extended) == ImageHeader(300, 65549)


def test_any_map_may_hold_comments() -> None:
    assert image_header(b"P5 # a comment 7\n# another\n40\t30\n255\n") == ImageHeader(40, 30)


@pytest.mark.parametrize("data", [b"", b"BM", b"P6 100", b"RIFF\0\0\0\0WEBP", b"GIF89a\x10\0\x10\0", b"#?RADIANCE\n"])
def test_other_formats_and_headers_cut_short_have_no_size(data: bytes) -> None:
    assert image_header(data) is None
