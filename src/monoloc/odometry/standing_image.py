"""Images that stand still although another sensor measures a turn, as of a stream that froze under a running clock.

A frozen image that comes again bit for bit is seen in the image alone. One that is encoded anew, or lies under a
clock, looks like that of a camera at rest; only a sensor of its motion tells otherwise.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from monoloc.geometry import rotation_angle
from monoloc.odometry.motion import Motion

_MOST_S = 2.0  # over which motions are compared
_DELAY_S = 0.25  # by which either sensor may be later than the other
_LEAST_TURN_RAD = np.deg2rad(3.0)  # beyond what a gyroscope's bias turns in that time
_SHOWN = 0.25  # share of the turn that the image shows at most, as a turn, or as a step over the distance


class StandingImage:
    """Compares the motion that images show with the turn that another sensor measures."""

    def __init__(self) -> None:
        self._frames = deque[tuple[float, Motion, Motion]]()  # the last one first
        self._stood_s = 0.0

    def reset(self) -> None:
        """Forget all images."""
        self._frames.clear()
        self._stood_s = 0.0

    def update(self, shown: Motion | None, measured: Motion | None, elapsed_s: float) -> float:
        """Take in a frame, and return for how many seconds the image has stood although the camera turned; 0 if not.

        Args:
            shown: motion since the previous frame by the images; None where they do not show it.
            measured: the same by the other sensor; None where there is none.
            elapsed_s: since the previous frame.
        """
        if shown is None or measured is None or len(shown.points) == 0:
            self.reset()
            return 0.0
        self._frames.appendleft((elapsed_s, shown, measured))
        while sum(frame[0] for frame in self._frames) - self._frames[-1][0] >= _MOST_S:
            self._frames.pop()
        standing_s = self._standing_s(float(np.median(shown.points[:, 2])))
        self._stood_s = max(self._stood_s + elapsed_s, standing_s) if standing_s > 0.0 else 0.0
        return self._stood_s

    def _standing_s(self, distance: float) -> float:
        """Shortest time up to now in which the image stood; 0 if it did not.

        Args:
            distance: of the scene, in the unit of the motion that images show.
        """
        T_shown = T_turned = np.eye(4)
        turns: list[tuple[float, float]] = []  # seconds ago, and the turn from then to a delay ago
        passed_s = 0.0
        for elapsed_s, shown, measured in self._frames:
            if passed_s >= _DELAY_S:
                T_turned = measured.T_previous_current @ T_turned
                turns.append((passed_s + elapsed_s, float(rotation_angle(T_turned[:3, :3]))))
            T_shown = shown.T_previous_current @ T_shown
            passed_s += elapsed_s
            turn_rad = next((turn for ago_s, turn in reversed(turns) if ago_s <= passed_s - _DELAY_S), 0.0)
            shown_rad = float(rotation_angle(T_shown[:3, :3]) + np.linalg.norm(T_shown[:3, 3]) / distance)
            if turn_rad > _LEAST_TURN_RAD and shown_rad < _SHOWN * turn_rad:
                return passed_s
        return 0.0
