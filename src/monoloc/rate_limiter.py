"""Uses at most so many events a second."""

from __future__ import annotations


class RateLimiter:
    """Selects events, such as frames to send, so that their rate holds on average, however unevenly they come.

    Uses are scheduled one period apart, and each takes the event that comes nearest to its time. If only the time
    since the last use decided, an event that came a millisecond early would be left out, and of a camera of 30 Hz
    only 15 to 20 frames a second would be sent.

    Args:
        most_hz: of the events that are used.
    """

    def __init__(self, most_hz: float) -> None:
        self._period_s = 1.0 / most_hz
        self._scheduled_s: float | None = None  # when the next use is due
        self._event_s = 0.0  # of the last event

    def is_due(self, time_s: float) -> bool:
        """Whether to use the event at this time; called once for each event."""
        interval_s, self._event_s = time_s - self._event_s, time_s
        if self._scheduled_s is None:
            return True
        early_s = self._scheduled_s - time_s
        was_set_back = early_s > 2.0 * self._period_s  # the clock: no use is scheduled so far ahead
        return was_set_back or early_s <= 0.5 * min(max(interval_s, 0.0), self._period_s)

    def use(self, time_s: float) -> None:
        """Note that an event that was due is used."""
        scheduled_s = self._scheduled_s
        if scheduled_s is None or abs(time_s - scheduled_s) > 0.5 * self._period_s:
            scheduled_s = time_s  # after a gap, or a clock that was set back
        self._scheduled_s = scheduled_s + self._period_s
