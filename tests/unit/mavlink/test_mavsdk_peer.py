"""What MAVSDK, a library of others, reads from the messages that arrive over UDP; it plays the autopilot."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from monoloc.geometry import make_pose, so3_exp
from monoloc.mavlink.autopilot_frames import BodyPose
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.messages import obstacle_distance, odometry, status_text, vision_position_estimate

mavsdk = pytest.importorskip("mavsdk")
pytest.importorskip("pymavlink")
SOON_S = 10.0
COVARIANCE = np.diag([0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
POSE = BodyPose(make_pose(so3_exp([0.0, 0.0, 0.6]), [1.0, -2.0, -1.5]), COVARIANCE)


class Peer:
    """MAVSDK as component 1 of system 1."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        mavsdk.log_subscribe(lambda *_: True)  # its log is not the test's
        self._mavsdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.AUTOPILOT))
        self._mavsdk.add_any_connection(f"udpin://127.0.0.1:{self.port}")
        self.received: dict[str, dict[str, Any]] = {}

    def listen(self) -> None:
        """Once the link has been heard."""
        from mavsdk.plugins.mavlink_direct import MavlinkDirect

        end_s = time.monotonic() + SOON_S
        while not self._mavsdk.get_systems():
            assert time.monotonic() < end_s
            time.sleep(0.01)
        self._direct = MavlinkDirect(self._mavsdk.get_systems()[0])
        self._direct.subscribe_message("", self._take)

    def _take(self, message: Any, _: Any) -> None:
        content = {"component": message.component_id, **json.loads(message.fields_json)}
        self.received.setdefault(message.message_name, content)

    def close(self) -> None:
        self._mavsdk.destroy()


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


def test_mavsdk_reads_what_was_meant(peer: Peer) -> None:
    distances = np.full(72, 65535, dtype=np.uint16)
    distances[:3] = 120, 501, 80
    messages = [
        odometry(12.5, POSE, 93, 7, Firmware.PX4),
        vision_position_estimate(12.5, POSE, 7),
        obstacle_distance(12.5, distances, 0.3, 5.0),
        status_text("monoloc: lost: searching", True),
    ]
    kinds = {message.get_type() for message in messages}
    link = AutopilotLink(f"udpout:127.0.0.1:{peer.port}")
    try:
        peer.listen()
        end_s = time.monotonic() + SOON_S
        while not (kinds <= peer.received.keys() and link.is_alive):
            assert time.monotonic() < end_s, peer.received.keys()
            for message in messages:
                link.send(message)
            time.sleep(0.05)
    finally:
        link.close()

    odometry_read = peer.received["ODOMETRY"]
    assert (odometry_read["component"], odometry_read["frame_id"], odometry_read["child_frame_id"]) == (197, 1, 12)
    assert [odometry_read[axis] for axis in "xyz"] == [1.0, -2.0, -1.5]
    np.testing.assert_allclose(odometry_read["q"], [np.cos(0.3), 0.0, 0.0, np.sin(0.3)], atol=1e-6)
    diagonal = [odometry_read["pose_covariance"][index] for index in (0, 6, 11, 15, 18, 20)]
    np.testing.assert_allclose(diagonal, np.diag(COVARIANCE), rtol=1e-6)
    assert (odometry_read["time_usec"], odometry_read["reset_counter"]) == (12_500_000, 7)
    assert (odometry_read["estimator_type"], odometry_read["quality"]) == (2, 93)
    assert odometry_read["vx"] is None or np.isnan(odometry_read["vx"])

    vision = peer.received["VISION_POSITION_ESTIMATE"]
    np.testing.assert_allclose([vision[angle] for angle in ("roll", "pitch", "yaw")], [0.0, 0.0, 0.6], atol=1e-6)
    obstacles = peer.received["OBSTACLE_DISTANCE"]
    assert obstacles["distances"] == distances.tolist()
    assert (obstacles["increment_f"], obstacles["min_distance"], obstacles["max_distance"]) == (5.0, 30, 500)
    assert peer.received["STATUSTEXT"]["text"].rstrip("\0") == "monoloc: lost: searching"
