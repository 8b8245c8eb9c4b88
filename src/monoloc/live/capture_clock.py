"""Times of capture from a stream's own time stamps, whose zero is unknown."""

from __future__ import annotations

from collections import deque

_MEMORY_S = 20.0  # of arrivals, over which the shortest delay is taken; clocks drift less than a millisecond in it
_BACK_S = 0.1  # by which a stamp goes back where the stream has begun anew; less is a frame out of order


class CaptureClock:
    """Brings stamps to the clock of arrivals: the frame with the shortest delay arrived when it was captured.

    What remains is that shortest delay itself, the latency of the camera, which no stamp tells. A delay that grows is
    one of the network: the frames that a stall held back keep their times, and are recognised as old.
    """

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()  # arrival and delay, the latter ascending
        self._stamp_s = float("-inf")  # the previous one

    def captured_s(self, stamp_s: float, arrived_s: float) -> float:
        """Time of capture of a frame by the clock of arrivals, never after its arrival.

        Args:
            stamp_s: the stream's stamp.
            arrived_s: when the frame came, not before that of the previous call.
        """
        if stamp_s < self._stamp_s - _BACK_S:
            self._delays.clear()
        self._stamp_s, delay_s = stamp_s, arrived_s - stamp_s
        while self._delays and self._delays[0][0] < arrived_s - _MEMORY_S:
            self._delays.popleft()
        while self._delays and self._delays[-1][1] >= delay_s:
            self._delays.pop()
        self._delays.append((arrived_s, delay_s))
        return min(arrived_s, stamp_s + self._delays[0][1])  # rounding
