"""The thread of a link: what it does not send."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import closing

from monoloc.mavlink.byte_link import ByteLink


def test_what_went_stale_while_the_thread_stood_still_is_not_sent() -> None:
    """As on a busy computer, or while the process is stopped: the thread comes back with an old pose to send."""
    stands_still, goes_on = threading.Event(), threading.Event()

    def tick() -> None:
        stands_still.set()
        goes_on.wait(5.0)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        link = ByteLink(f"udpout:127.0.0.1:{peer.getsockname()[1]}", lambda data: None, tick)
        with closing(link):
            link.start()
            assert stands_still.wait(5.0)
            link.send(b"pose", goes_stale=True)
            time.sleep(0.25)
            link.send(b"text", goes_stale=False)
            goes_on.set()
            assert peer.recv(100) == b"text"
        assert link.counts == {"dropped": 1, "sent": 1}
