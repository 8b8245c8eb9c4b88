"""Where a camera sees the scene from a new view. Images of one view have the same errors, however long it hovers."""

from __future__ import annotations

from monoloc.geometry import FloatArray, pose_distance_m

_NEW_VIEW_M = 0.1  # pose distance after which errors are mostly new, as those of landmark poses


class DistinctViews:
    """Follows a camera from view to view."""

    def __init__(self) -> None:
        self._view: FloatArray | None = None

    def is_new(self, pose: FloatArray) -> bool:
        """Whether a camera at ``T_world_camera``, (4, 4), has left the last view that was new; the first one is."""
        if self._view is not None and pose_distance_m(self._view, pose[None])[0] <= _NEW_VIEW_M:
            return False
        self._view = pose.copy()
        return True
