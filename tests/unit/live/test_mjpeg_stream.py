"""Motion JPEG however it is cut into pieces, and what is in it beside whole images of the right size."""

from __future__ import annotations

import io
import os
import threading
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.live.frame_source import EndOfStreamError
from monoloc.live.mjpeg_stream import MjpegStream
from refusals import refuses_data
from synthetic_recordings import make_color

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
COLORS = [make_color(64, 48, number) for number in range(3)]


def jpeg_of(rgb: NDArray[np.uint8], *parameters: int) -> bytes:
    is_coded, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95, *parameters])
    assert is_coded
    return data.tobytes()


JPEGS = [
    jpeg_of(COLORS[0]),
    jpeg_of(COLORS[1], cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
    jpeg_of(COLORS[2], cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
]
EXIF_WITH_THUMBNAIL = b"Exif\0\0" + jpeg_of(make_color(16, 12))
WITH_THUMBNAIL = (
    JPEGS[0][:2]
    + b"\xff\xe1"
    + (len(EXIF_WITH_THUMBNAIL) + 2).to_bytes(2, "big")
    + EXIF_WITH_THUMBNAIL
    + JPEGS[0][2:]
)


def stating(size: int) -> bytes:
    """An image whose header states another size, in both directions."""
    jpeg = bytearray(JPEGS[0])
    at = jpeg.index(b"\xff\xc0") + 5
    jpeg[at : at + 4] = size.to_bytes(2, "big") * 2
    return bytes(jpeg)


class Pieces(io.RawIOBase):
    """A pipe that gives what was written, in the pieces in which it was written."""

    def __init__(self, *pieces: bytes) -> None:
        self.pieces = list(pieces)

    def read(self, size: int = -1) -> bytes:
        piece = self.pieces.pop(0) if self.pieces else b""
        if len(piece) > size:
            self.pieces.insert(0, piece[size:])
        return piece[:size]


def stream_of(*pieces: bytes) -> MjpegStream:
    return MjpegStream(Pieces(*(piece for piece in pieces if piece)), CAMERA)


def images_of(stream: MjpegStream) -> list[NDArray[np.uint8]]:
    """All of them, to the end."""
    images = []
    while True:
        try:
            images.append(stream.grab()[0])
        except EndOfStreamError:
            return images


def shows(images: list[NDArray[np.uint8]], *numbers: int) -> None:
    """The images are these of the colours, but for what JPEG loses."""
    assert len(images) == len(numbers)
    for image, number in zip(images, numbers, strict=True):
        assert np.abs(image.astype(int) - COLORS[number]).mean() < 4.0


@settings(max_examples=60)
@given(cuts=st.lists(st.integers(0, sum(map(len, [*JPEGS, WITH_THUMBNAIL]))), max_size=12))
def test_images_are_found_wherever_the_stream_is_cut_into_pieces(cuts: list[int]) -> None:
    """Baseline, with restarts and progressive, and one with a thumbnail that is itself a JPEG."""
    data = b"".join([*JPEGS, WITH_THUMBNAIL])
    edges = [0, *sorted(cuts), len(data)]
    shows(images_of(stream_of(*(data[a:b] for a, b in pairwise(edges)))), 0, 1, 2, 0)


def test_one_byte_at_a_time() -> None:
    shows(images_of(stream_of(*(bytes([byte]) for byte in JPEGS[0] + JPEGS[1]))), 0, 1)


@pytest.mark.parametrize("before", [b"\xff\xdb", b"\xff\xc0", b"\xff\xda", b"\xff\xd9"])
def test_bytes_that_fill_up_before_a_marker_are_skipped(before: bytes) -> None:
    at = JPEGS[0].index(before, 2)
    shows(images_of(stream_of(JPEGS[0][:at] + b"\xff\xff" + JPEGS[0][at:], JPEGS[1])), 0, 1)


def test_boundaries_of_multipart_streams_and_other_bytes_between_images_are_skipped() -> None:
    boundary = b"\r\n--frame\r\nContent-Type: image/jpeg\r\nContent-Length: 1234\r\n\r\n"
    shows(images_of(stream_of(b"".join(boundary + jpeg for jpeg in JPEGS), boundary)), 0, 1, 2)


def test_an_image_is_given_when_its_last_byte_came_and_captured_then() -> None:
    stream = stream_of(JPEGS[0])
    before_s = time.monotonic()
    _, captured_s = stream.grab()
    assert before_s <= captured_s <= time.monotonic()


def test_a_pipe_that_does_not_wait_has_not_ended() -> None:
    """As the program that started this one may have made it."""
    reading, writing = os.pipe()
    os.set_blocking(reading, False)

    def write() -> None:
        os.write(writing, JPEGS[0])
        os.close(writing)

    writes = threading.Timer(0.1, write)
    writes.start()
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        shows(images_of(MjpegStream(pipe, CAMERA)), 0)
    writes.join()


@pytest.mark.parametrize(
    "damaged",
    [
        JPEGS[0][: len(JPEGS[0]) // 2],  # cut among its pixels
        JPEGS[0][:-2],
        JPEGS[0][:100],  # cut in its header
        JPEGS[0][:20] + JPEGS[0][23:],
        JPEGS[0][:2] + JPEGS[0][-2:],  # no pixels at all
    ],
)
def test_a_damaged_image_is_left_out_and_takes_no_other_with_it(damaged: bytes) -> None:
    shows(images_of(stream_of(JPEGS[1], damaged, JPEGS[2], JPEGS[0])), 1, 2, 0)


def test_an_image_that_the_end_cut_is_left_out() -> None:
    shows(images_of(stream_of(JPEGS[0], JPEGS[1][:-1])), 0)


def test_an_orientation_does_not_turn_the_pixels_that_the_intrinsics_are_of() -> None:
    exif = b"Exif\0\0MM\0*\0\0\0\x08" + b"\0\x01" + b"\x01\x12\0\x03\0\0\0\x01\0\x03\0\0" + b"\0\0\0\0"
    turned = JPEGS[0][:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + JPEGS[0][2:]
    shown = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None and np.abs(shown[..., ::-1].astype(int) - COLORS[0]).mean() > 20.0
    shows(images_of(stream_of(turned)), 0)


def test_another_size_is_refused_by_the_header_before_the_pixels_came() -> None:
    """The header of an image of 60000x60000 pixels; nothing of it is decoded, or even waited for."""
    large = stating(60000)
    header = large[: large.index(b"\xff\xc0") + 9]
    problem = "gives images of 60000x60000, but the camera is 64x48"
    refuses_data(stream_of(header).grab, Path("standard input"), problem, "intrinsics")
    stream = stream_of(JPEGS[0], large, header)
    shows([stream.grab()[0]], 0)
    refuses_data(stream.grab, Path("standard input"), problem, "intrinsics")


def test_damage_to_the_sizes_of_images_ends_no_flight() -> None:
    shows(images_of(stream_of(JPEGS[0], stating(7), stating(60000), JPEGS[1], stating(7), JPEGS[2])), 0, 1, 2)


def test_what_holds_no_images_is_refused_and_not_kept() -> None:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, 1 << 20, dtype=np.uint8).tobytes()
    assert noise.count(b"\xff\xd8\xff") == 0
    for data in (noise, b"\0" * (1 << 20), b"\xff\xd8\xff\x00\x00" * (1 << 18)):
        pipe = Pieces(data)
        stream = MjpegStream(pipe, CAMERA)
        refuses_data(stream.grab, Path("standard input"), "holds no JPEG images", "without a container")
        assert len(pipe.pieces[0]) > len(data) // 2


@pytest.mark.parametrize("data", [b"", b"garbage", JPEGS[0][:-2]])
def test_a_stream_that_ends_without_an_image_is_refused(data: bytes) -> None:
    refuses_data(stream_of(data).grab, Path("standard input"), "ended without a JPEG image", "motion JPEG")
