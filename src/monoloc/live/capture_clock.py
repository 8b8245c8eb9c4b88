"""Times of capture from a stream's own time stamps, whose zero is unknown."""

from __future__ import annotations

from collections import deque

_MEMORY_S = 20.0  # of arrivals, over which the shortest delay is taken; clocks drift less than a millisecond in it
_JUMP_S = 1.0  # between a stamp and its arrival, by which the stream has begun anew


class CaptureClock:
    """Brings stamps to the clock of arrivals: the frame with the shortest delay arrived when it was captured.

    What remains is that shortest delay itself, the latency of the camera, which no stamp tells.
    """

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()  # arrival and delay, the latter ascending

    def captured_s(self, stamp_s: float, arrived_s: float) -> float:
        """Time of capture of a frame by the clock of arrivals, never after its arrival.

        Args:
            stamp_s: the stream's stamp.
            arrived_s: when the frame came, not before that of the previous call.
        """
        delay_s = arrived_s - stamp_s
        if self._delays and abs(delay_s - self._delays[0][1]) > _JUMP_S:
            self._delays.clear()
        while self._delays and self._delays[0][0] < arrived_s - _MEMORY_S:
            self._delays.popleft()
        while self._delays and self._delays[-1][1] >= delay_s:
            self._delays.pop()
        self._delays.append((arrived_s, delay_s))
        return stamp_s + self._delays[0][1]
