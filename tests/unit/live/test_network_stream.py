"""Streams by PyAV: a file, and the same over a socket, as a camera sends it; damaged, ended, absent."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.live import network_stream
from monoloc.live.frame_source import CameraGoneError, EndOfStreamError
from monoloc.live.network_stream import NetworkStream
from monoloc.live.newest_frame import NewestFrame
from refusals import refuses, refuses_data
from synthetic_recordings import write_video

av = pytest.importorskip("av")

FRAMES = 60
# Images that come while FFmpeg finds out what a stream is are old once it is open.
MOST_PROBED = 30


@pytest.fixture(scope="module")
def transport_stream(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A video of grey 4, 8 and so on, each image whole."""
    return written_stream(tmp_path_factory.mktemp("video") / "stream.ts", key_frame_every=1)


def written_stream(path: Path, key_frame_every: int) -> bytes:
    """A video of grey 4, 8 and so on, as MPEG-TS: the container for streams that are cut anywhere."""
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg2video", rate=25)
        video.width, video.height, video.pix_fmt, video.gop_size = 64, 48, "yuv420p", key_frame_every
        for index in range(FRAMES):
            image = np.full((48, 64, 3), 4 * (index + 1), np.uint8)
            container.mux(video.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(video.encode())
    return path.read_bytes()


@contextmanager
def served(*contents: bytes, pause_s: float = 0.0) -> Iterator[str]:
    """The URL of a server that gives each client the next content, and then closes the connection."""

    def serve() -> None:
        for content in contents:
            client, _ = server.accept()
            with client:
                for at in range(0, len(content), 1880):
                    client.sendall(content[at : at + 1880])
                    time.sleep(pause_s)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        thread.join(10.0)


class _SlowCamera(BaseHTTPRequestHandler):
    """Motion JPEG, ten images a second, whose container has no time stamps, and a size that means nothing."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", "99999999")
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        for index in range(14):
            _, jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 10 * index, np.uint8))
            part = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            with suppress(ConnectionError):  # the client has seen enough
                self.wfile.write(part.encode() + jpeg.tobytes() + b"\r\n")
            time.sleep(0.1)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""


def test_motion_jpeg_is_timed_on_arrival() -> None:
    """FFmpeg counts its images at 25 a second: those of a slower camera would seem older and older."""
    with ThreadingHTTPServer(("127.0.0.1", 0), _SlowCamera) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        stream = NetworkStream(f"http://127.0.0.1:{server.server_address[1]}/stream")
        stream.open()
        ages_s = []
        for _ in range(10):
            _, captured_s = stream.grab()
            ages_s.append(time.monotonic() - captured_s)
        stream.close()
        server.shutdown()
    assert max(ages_s) < 0.3


def test_motion_jpeg_that_states_a_size_is_a_camera_that_may_come_back() -> None:
    """Taken for a file, its first interruption would end the flight."""
    with ThreadingHTTPServer(("127.0.0.1", 0), _SlowCamera) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        stream = NetworkStream(f"http://127.0.0.1:{server.server_address[1]}/stream")
        stream.open()
        with pytest.raises(CameraGoneError):
            for _ in range(20):
                stream.grab()
        stream.close()
        server.shutdown()


def frames_of(stream: NetworkStream, end: type[Exception] = CameraGoneError) -> tuple[list[int], list[float]]:
    """Greys and times of capture of all frames until the end, by default that the camera is gone."""
    greys, times_s = [], []
    while True:
        try:
            color, captured_s = stream.grab()
        except end:
            return greys, times_s
        assert color.shape == (48, 64, 3) and color.dtype == np.uint8
        assert captured_s <= time.monotonic()
        greys.append(round(float(color.mean())))
        times_s.append(captured_s)


class Quiet(SimpleHTTPRequestHandler):
    """Serves files, a part at a time, and no more than a share of each."""

    share = 1.0

    def log_message(self, *arguments: object) -> None:
        pass

    def copyfile(self, source: Any, outputfile: Any) -> None:
        content = source.read()
        outputfile.write(content[: int(self.share * len(content))])


@contextmanager
def http_server(folder: Path, share: float = 1.0) -> Iterator[str]:
    handler = type("Handler", (Quiet,), {"share": share})
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


@pytest.mark.parametrize("kind", ["mp4", "ts"])
def test_a_file_on_a_server_ends_and_does_not_play_again(tmp_path: Path, transport_stream: bytes, kind: str) -> None:
    write_video(tmp_path / "flight.mp4", codec="mp4v")
    (tmp_path / "flight.ts").write_bytes(transport_stream)
    with http_server(tmp_path) as address:
        source = NewestFrame(NetworkStream(f"{address}/flight.{kind}"))
        end_s = time.monotonic() + 20.0
        with pytest.raises(EndOfStreamError):
            while time.monotonic() < end_s:
                source.next(0.1)
        assert source.reconnections == 0
        source.close()


def test_a_file_on_a_server_is_played_at_its_own_pace(tmp_path: Path, transport_stream: bytes) -> None:
    """Read as fast as it comes, all but a few of its frames would be dropped, and the others seem to be a rush."""
    (tmp_path / "flight.ts").write_bytes(transport_stream)
    with http_server(tmp_path) as address:
        source = NewestFrame(NetworkStream(f"{address}/flight.ts"))
        taken = []
        with pytest.raises(EndOfStreamError):
            while True:
                taken += [frame] if (frame := source.next(1.0)) is not None else []
        source.close()
    assert len(taken) >= FRAMES - 5  # a busy machine drops some
    span_s, steps = (taken[-1].captured_s - taken[0].captured_s, taken[-1].sequence - taken[0].sequence)
    assert span_s == pytest.approx(steps / 25.0, abs=0.02)


def test_a_file_whose_stamps_jump_is_played_on_at_its_own_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where videos were joined: no frame waits for a jump, and none after it comes in a rush."""
    clock = [100.0]
    waits = SimpleNamespace(monotonic=lambda: clock[0], sleep=lambda wait_s: clock.append(clock.pop() + wait_s))
    monkeypatch.setattr(network_stream, "time", waits)
    stream = NetworkStream("http://server/joined.ts")
    played_s = [stream._awaited_s(stamp_s, clock[0]) for stamp_s in (2.0, 2.5, 60.0, 60.5, 61.0, 0.0, 0.5)]
    np.testing.assert_allclose(played_s, [100.0, 100.5, 100.5, 101.0, 101.5, 101.5, 102.0])


def test_a_file_on_a_server_that_breaks_off_is_named(tmp_path: Path, transport_stream: bytes) -> None:
    (tmp_path / "flight.ts").write_bytes(transport_stream)
    with http_server(tmp_path, share=0.6) as address:
        stream = NetworkStream(f"{address}/flight.ts")
        stream.open()
        refuses(lambda: frames_of(stream), DataError, "flight.ts: breaks off .*; copy it here")
        stream.close()


def test_a_file_gives_its_frames_and_can_be_opened_again(tmp_path: Path) -> None:
    write_video(tmp_path / "flight.mp4", codec="mp4v")
    stream = NetworkStream(str(tmp_path / "flight.mp4"))
    for _ in range(2):  # it can be opened again
        stream.open()
        greys, times_s = frames_of(stream, EndOfStreamError)
        # Also the first, by which FFmpeg found out what it is, and which others may need.
        assert greys == pytest.approx([20, 40, 60, 80, 100, 120], abs=6)
        assert (np.diff(times_s) > 0.0).all()
        stream.close()
    stream.close()


def test_a_stream_over_a_socket_ends_with_its_last_frame_and_can_be_opened_again(transport_stream: bytes) -> None:
    with served(transport_stream, transport_stream) as url:
        stream = NetworkStream(url)
        for _ in range(2):
            stream.open()
            greys, _ = frames_of(stream)
            stream.close()
            assert greys == pytest.approx(list(range(4 * (FRAMES - len(greys) + 1), 4 * FRAMES + 1, 4)), abs=3)
            assert len(greys) >= FRAMES - MOST_PROBED


def test_all_images_may_build_on_the_first_and_those_of_the_opening_are_not_given(tmp_path: Path) -> None:
    """A stream of 25 images a second that begins with its only key frame when the camera is connected to."""
    content = written_stream(tmp_path / "stream.ts", key_frame_every=FRAMES)
    with served(content, pause_s=FRAMES / 25.0 / (len(content) / 1880)) as url:
        stream, began_s = NetworkStream(url), time.monotonic()
        stream.open()
        color, _ = stream.grab()
        age_s = time.monotonic() - began_s - float(color.mean()) / 4.0 / 25.0
        greys, _ = frames_of(stream)
        stream.close()
    assert age_s < 0.5
    assert greys[-1] == pytest.approx(4 * FRAMES, abs=3)


def test_images_of_the_opening_are_old_also_where_other_threads_are_busy() -> None:
    """Each packet is then waited for, but their stamps pass faster than the time."""
    stream = NetworkStream("rtsp://camera")
    stream._has_stamps, stream._opened_s, stream._opening_s, stream._waited_s = True, 10.0, 1.0, 0.025
    probed = [stream._is_old(SimpleNamespace(time=index / 30.0), 10.0 + 0.025 * index) for index in range(20)]
    assert all(probed)
    assert not stream._is_old(SimpleNamespace(time=20 / 30.0), 10.0 + 0.025 * 19 + 1 / 30.0)


def test_a_damaged_part_costs_its_frames_and_no_others(transport_stream: bytes) -> None:
    damaged = bytearray(transport_stream)
    middle = len(damaged) // 2
    damaged[middle : middle + 400] = bytes(400)
    with served(bytes(damaged)) as url:
        stream = NetworkStream(url)
        stream.open()
        greys, _ = frames_of(stream)
        stream.close()
    lost = np.flatnonzero(np.diff(greys) > 6)
    assert len(lost) == 1 and len(greys) >= FRAMES - MOST_PROBED
    assert greys[-1] == pytest.approx(4 * FRAMES, abs=3)


def test_a_packet_that_cannot_be_decoded_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_video(tmp_path / "flight.mp4", codec="mp4v")
    stream = NetworkStream(str(tmp_path / "flight.mp4"))
    stream.open()
    whole = stream._container.demux

    class Damaged:
        def decode(self) -> object:
            raise av.error.InvalidDataError(1094995529, "Invalid data found")

    def demux(video: object) -> Iterator[object]:
        for packet in whole(video):
            yield Damaged()
            yield packet

    monkeypatch.setattr(stream, "_container", type("Container", (), {"demux": staticmethod(demux)}))
    stream._frames = stream._decoded(0)
    assert len(frames_of(stream, EndOfStreamError)[0]) == 6


def test_a_camera_that_stops_sending_is_gone(transport_stream: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network_stream, "_TIMEOUT_S", 0.3)
    release = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.sendall(transport_stream)
                release.wait(10.0)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        stream = NetworkStream(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        stream.open()
        began_s = time.monotonic()
        frames_of(stream)
        assert time.monotonic() - began_s < 5.0
        stream.close()
        release.set()
        thread.join(10.0)


def test_an_address_that_says_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network_stream, "_TIMEOUT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:
        silent = NetworkStream(f"http://127.0.0.1:{server.getsockname()[1]}/")
        refuses(silent.open, DataError, "gives no video .no answer in 0.3 s.; check the address")


def test_an_address_that_gives_no_video_is_refused_without_its_password(tmp_path: Path) -> None:
    fix = "another player"
    absent = NetworkStream("rtsp://pilot:se@cret@127.0.0.1:1/x")
    refuses(absent.open, DataError, "^rtsp://127.0.0.1:1/x: gives no video .Connection refused.; .*another player")
    (tmp_path / "noise.ts").write_bytes(bytes(5000))
    noise = NetworkStream(str(tmp_path / "noise.ts"))
    refuses_data(noise.open, tmp_path / "noise.ts", "gives no video .Invalid data", fix)
    sound = tmp_path / "sound.wav"
    with av.open(str(sound), "w") as container:
        audio = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(audio.encode(frame))
    refuses_data(NetworkStream(str(sound)).open, sound, "gives no video .it has none.", fix)
