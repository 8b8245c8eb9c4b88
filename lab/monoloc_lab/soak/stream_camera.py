"""A camera in a process of its own: a recording, live-paced, as motion JPEG in NUT to one client over TCP.

    python -m monoloc_lab.soak.stream_camera SOURCE FRAMES PORT RATE_HZ LOG

The recording runs to its end and back, again and again. A line of the log is the time at which a frame was captured,
by the monotonic clock. To unplug the camera, kill the process.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from monoloc.cli.common import open_source
from monoloc.errors import MonolocError

_CLOCK_HZ = 90_000  # of the stream's stamps


class _Sink:
    """A file that PyAV writes to."""

    def __init__(self, client: socket.socket) -> None:
        self._client = client

    def write(self, data: bytes) -> int:
        self._client.sendall(data)
        return len(data)


def serve(images: list[NDArray[np.uint8]], port: int, rate_hz: float, log: Path) -> None:
    """Serve one client after the other, for ever."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with socket.create_server(("127.0.0.1", port)) as server, log.open("a", encoding="ascii") as lines:
        while True:
            client, _ = server.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            try:
                for captured_s in _send(images, client, rate_hz):
                    lines.write(f"{captured_s!r}\n")
                    lines.flush()
            except OSError:
                client.close()


def _send(images: list[NDArray[np.uint8]], client: socket.socket, rate_hz: float) -> Iterator[float]:
    import av

    height, width = images[0].shape[:2]
    order = [*range(len(images)), *range(len(images) - 2, 0, -1)]  # there and back
    # NUT holds whole images: a reader of MPEG-TS must wait for the beginning of the next one.
    container = av.open(cast(BinaryIO, _Sink(client)), "w", format="nut", options={"flush_packets": "1"})
    video = container.add_stream("mjpeg", rate=round(rate_hz))
    # Colour at full resolution: the network of the synthetic rooms reads depth from it.
    video.width, video.height, video.pix_fmt = width, height, "yuvj444p"
    video.time_base = video.codec_context.time_base = Fraction(1, _CLOCK_HZ)
    video.options = {"qmin": "1", "qmax": "2", "threads": "1"}
    began_s = time.monotonic()
    count = 0
    while True:
        due_s = began_s + count / rate_hz
        time.sleep(max(0.0, due_s - time.monotonic()))
        captured_s = time.monotonic()
        frame = av.VideoFrame.from_ndarray(images[order[count % len(order)]], format="rgb24")
        frame.pts, frame.time_base = round((captured_s - began_s) * _CLOCK_HZ), video.time_base
        container.mux(video.encode(frame))
        yield captured_s
        count += 1


def main(arguments: list[str]) -> int:
    source, frames, port, rate_hz, log = arguments
    try:
        recording = open_source(source, frames)
        images = [recording.color(index) for index in range(len(recording))]
    except MonolocError as error:
        print(error, file=sys.stderr)
        return 2
    serve(images, int(port), float(rate_hz), Path(log))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
