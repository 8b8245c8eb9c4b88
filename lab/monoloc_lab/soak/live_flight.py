"""A live flight over real sockets, in which camera, link and process are lost and come back.

The camera (:mod:`monoloc_lab.soak.stream_camera`), ``monoloc fly`` and the autopilot's side are three processes. What
is measured is measured from outside of ``monoloc fly``: by the clock that all three share.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import MonolocError
from monoloc.io.camera_file import write_camera
from monoloc.machine import machine_facts
from monoloc.mavlink.firmware import Firmware
from monoloc_lab.soak.autopilot_peer import AutopilotPeer, Heard, MavsdkPeer

_FLY = (sys.executable, "-c", "from monoloc.cli.main import run; run()")
_GAP_S = 5.0  # for which camera and link are gone
_AFTER_S = 10.0  # for which the flight goes on after each return
_SOON_S = 60.0  # in which a first pose must come
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class LiveFlightFigures:
    """JSON keys of ``monoloc bench fly``.

    Attributes:
        machine: processor, cores, system, Python.
        load_average: over a minute, before and after: below the number of cores, nobody waits.
        firmware: whose decoder took the poses.
        seconds: of undisturbed flight.
        poses, poses_refused: that the decoder took, and did not take.
        poses_by_mavsdk: that MAVSDK read; None without it.
        rate_hz: poses by seconds of undisturbed flight.
        latency_ms_median, latency_ms_p95: from capture, by the camera's own log, to the message's arrival.
        stamp_error_ms_median, stamp_error_ms_p95: of the stamp in the message, against the camera's log.
        timesync_answered, timesync_ms_p95: questions for the time, and their round trip.
        resident_mb_start, resident_mb_end: memory of ``monoloc fly``, ten seconds after its first pose and at the
            end.
        camera_back_s, link_back_s: from the return of camera or link to the next pose.
        process_back_s: from the start of a new process, after a kill, to its first pose.
        longest_gap_s: between poses of undisturbed flight.
        resets: changes of the reset counter in undisturbed flight.
        summary: what the first process said at its end, with drops by cause.
        recordings: frames that ``monoloc replay`` computed again of the killed flight and of the one after, and how
            many poses differ.
        texts: what the pilot read.
    """

    machine: dict[str, str]
    load_average: tuple[float, float]
    firmware: str
    seconds: float
    poses: int
    poses_refused: int
    poses_by_mavsdk: int | None
    rate_hz: float
    latency_ms_median: float
    latency_ms_p95: float
    stamp_error_ms_median: float
    stamp_error_ms_p95: float
    timesync_answered: int
    timesync_ms_p95: float
    resident_mb_start: float
    resident_mb_end: float
    camera_back_s: float
    link_back_s: float
    process_back_s: float
    longest_gap_s: float
    resets: int
    summary: dict[str, object]
    recordings: list[dict[str, object]]
    texts: list[str]


@dataclass
class _Flight:
    """Everything of one run, started and stopped by parts."""

    bundle: Path
    source: str
    frames: str
    camera: Camera
    rate_hz: float
    firmware: Firmware
    folder: Path
    camera_port: int = field(default_factory=lambda: _free_port(socket.SOCK_STREAM))
    link_port: int = field(default_factory=lambda: _free_port(socket.SOCK_DGRAM))
    stream: subprocess.Popen[bytes] | None = None
    process: subprocess.Popen[bytes] | None = None

    @property
    def log(self) -> Path:
        return self.folder / "captured.txt"

    def plug_in(self) -> None:
        arguments = (self.source, self.frames, str(self.camera_port), str(self.rate_hz), str(self.log))
        command = [sys.executable, "-m", "monoloc_lab.soak.stream_camera", *arguments]
        # In a session of its own, Ctrl-C does not reach it, of which it would print a traceback; close() ends it.
        self.stream = subprocess.Popen(command, start_new_session=True)
        end_s = time.monotonic() + _SOON_S
        while not _listens(self.camera_port):
            if self.stream.poll() is not None or time.monotonic() > end_s:
                raise MonolocError("the camera does not start; see the lines above")
            time.sleep(0.05)

    def unplug(self) -> None:
        _end(self.stream, signal.SIGKILL)

    def start(self, record: Path | None = None) -> None:
        camera = self.folder / "camera.toml"  # numbers on the command line describe no fisheye or rational lens
        write_camera(camera, self.camera, {})
        command = [*_FLY, "fly", str(self.bundle), f"tcp://127.0.0.1:{self.camera_port}", "--json"]
        command += ["--camera", str(camera), "--firmware", self.firmware.value]
        command += ["--mavlink", f"udpout:127.0.0.1:{self.link_port}"]
        command += [] if record is None else ["--record", str(record)]
        errors = (self.folder / "fly.txt").open("ab")
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, env=os.environ | _ONE_THREAD)

    def has_ended(self) -> bool:
        return self.process is not None and self.process.poll() is not None

    def stop(self) -> dict[str, object]:
        """End the process as systemd does; returns what it says of itself."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        out, _ = self.process.communicate(timeout=_SOON_S)
        if self.process.returncode != 0:
            raise MonolocError(f"monoloc fly ended with {self.process.returncode}; see {self.folder / 'fly.txt'}")
        content = json.loads(out)
        assert isinstance(content, dict)
        return content

    def close(self) -> None:
        _end(self.process, signal.SIGKILL)
        self.unplug()


def bench_live_flight(
    bundle: Path,
    source: str,
    frames: str,
    camera: Camera,
    seconds: float,
    rate_hz: float,
    firmware: Firmware,
    folder: Path,
    say: Callable[[str], None],
) -> LiveFlightFigures:
    """Fly undisturbed, then without camera, without link, and after a kill.

    Args:
        bundle: of the recording's room.
        source, frames, camera: recording that the camera plays, and its intrinsics.
        seconds: of undisturbed flight.
        rate_hz: of the camera.
        firmware: of the autopilot.
        folder: empty, for logs and recordings.
        say: takes a line on what happens.

    Raises:
        MonolocError: a process does not do what it must; the message says which.
    """
    flight = _Flight(bundle, source, frames, camera, rate_hz, firmware, folder)
    mavsdk, mavsdk_port = _mavsdk()
    peer = AutopilotPeer(flight.link_port, firmware, mavsdk_port)
    load_before = os.getloadavg()[0]
    try:
        flight.plug_in()
        peer.open()
        flight.start()
        if mavsdk is not None:
            _heard_by(mavsdk, flight)
        say("undisturbed")
        begin_s = _next_pose(flight, peer.heard, 0.0)
        time.sleep(10.0)
        resident_start = _resident_mb(flight)
        time.sleep(max(0.0, seconds - 10.0))
        undisturbed = [pose for pose in peer.heard.poses if pose[0] >= begin_s]
        asked = len(peer.heard.answered_s), peer.heard.answered_s[:]
        say("camera unplugged")
        flight.unplug()
        time.sleep(_GAP_S)
        flight.plug_in()
        camera_s = _back(flight, peer.heard)
        say("link gone")
        peer.close()
        time.sleep(_GAP_S)
        peer.open()
        link_s = _back(flight, peer.heard)
        resident_end = _resident_mb(flight)
        summary = flight.stop()
        say("killed, and started again")
        flight.start(folder / "killed")
        _next_pose(flight, peer.heard, time.monotonic())
        time.sleep(_AFTER_S)
        _end(flight.process, signal.SIGKILL)
        flight.start(folder / "after")
        process_s = _back(flight, peer.heard)
        flight.stop()
    finally:
        flight.close()
        peer.close()
        if mavsdk is not None:
            mavsdk.close()
    say("replay")
    recordings = [_replayed(folder / name) for name in ("killed", "after")]
    figures = _figures(undisturbed, np.loadtxt(flight.log), seconds)
    return LiveFlightFigures(
        machine=machine_facts(),
        load_average=(load_before, os.getloadavg()[0]),
        firmware=firmware.value,
        seconds=seconds,
        poses=len(peer.heard.poses),
        poses_refused=peer.heard.counts["refused"],
        poses_by_mavsdk=None if mavsdk is None else mavsdk.counts["ODOMETRY"],
        timesync_answered=asked[0],
        timesync_ms_p95=1e3 * float(np.percentile(asked[1], 95)) if asked[1] else float("nan"),
        resident_mb_start=resident_start,
        resident_mb_end=resident_end,
        camera_back_s=camera_s,
        link_back_s=link_s,
        process_back_s=process_s,
        summary=summary,
        recordings=recordings,
        texts=[text for _, text in peer.heard.texts],
        **figures,
    )


def _figures(poses: list[tuple[float, float, int]], captured_s: np.ndarray, seconds: float) -> dict[str, Any]:
    """Rate, latency and stamps of undisturbed flight, by the camera's log of captures."""
    arrived, stamped, counters = (np.array(column) for column in zip(*poses, strict=True))
    # The stamp is some milliseconds late, by coding and network: its frame is the last one before it.
    frame = np.searchsorted(captured_s, stamped, side="right") - 1
    true_s = captured_s[np.maximum(frame, 0)]
    latency_ms, error_ms = 1e3 * (arrived - true_s), 1e3 * (stamped - true_s)
    return {
        "rate_hz": len(poses) / seconds,
        "latency_ms_median": float(np.median(latency_ms)),
        "latency_ms_p95": float(np.percentile(latency_ms, 95)),
        "stamp_error_ms_median": float(np.median(error_ms)),
        "stamp_error_ms_p95": float(np.percentile(error_ms, 95)),
        "longest_gap_s": float(np.diff(arrived).max()),
        "resets": int(np.count_nonzero(np.diff(counters))),
    }


def _mavsdk() -> tuple[MavsdkPeer | None, int | None]:
    if find_spec("mavsdk") is None:
        return None, None
    port = _free_port(socket.SOCK_DGRAM)
    return MavsdkPeer(port), port


def _next_pose(flight: _Flight, heard: Heard, after_s: float) -> float:
    """Time of arrival of the first pose after a time.

    Raises:
        MonolocError: none comes, or the process has ended.
    """
    end_s = time.monotonic() + _SOON_S
    while time.monotonic() < end_s:
        if heard.poses and heard.poses[-1][0] > after_s:
            return next(pose[0] for pose in heard.poses if pose[0] > after_s)
        if flight.has_ended():
            break
        time.sleep(0.02)
    raise _nothing_heard(flight)


def _heard_by(mavsdk: MavsdkPeer, flight: _Flight) -> None:
    try:
        mavsdk.listen(_SOON_S, flight.has_ended)
    except TimeoutError as error:
        raise _nothing_heard(flight) from error


def _nothing_heard(flight: _Flight) -> MonolocError:
    what = "monoloc fly ended" if flight.has_ended() else f"no pose came within {_SOON_S:.0f} s"
    said = (flight.folder / "fly.txt").read_text(encoding="utf-8").splitlines()[-1:]
    return MonolocError(f"{what}; monoloc fly said last: {' '.join(said) or 'nothing'}")


def _back(flight: _Flight, heard: Heard) -> float:
    """Seconds to the next pose; waits some more, so that the flight goes on."""
    now_s = time.monotonic()
    back_s = _next_pose(flight, heard, now_s) - now_s
    time.sleep(_AFTER_S)
    return back_s


def _replayed(folder: Path) -> dict[str, object]:
    done = subprocess.run([*_FLY, "replay", str(folder), "--json"], stdout=subprocess.PIPE, check=False)
    if done.returncode != 0:
        raise MonolocError(f"monoloc replay {folder} ended with {done.returncode}")
    content = json.loads(done.stdout)
    assert isinstance(content, dict)
    return content


def _resident_mb(flight: _Flight) -> float:
    assert flight.process is not None
    pages = int(Path(f"/proc/{flight.process.pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _end(process: subprocess.Popen[bytes] | None, number: int) -> None:
    if process is not None and process.poll() is None:
        process.send_signal(number)
    if process is not None:
        process.wait()


def _free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _listens(port: int) -> bool:
    """Whether something listens, without a connection, which the camera would take for its client."""
    own = f":{port:04X} 00000000:0000 0A"
    return own in Path("/proc/net/tcp").read_text(encoding="ascii")
