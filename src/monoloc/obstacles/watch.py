"""Obstacles of a flight: each result of the localizer becomes what is around the vehicle."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray, invert
from monoloc.obstacles.depth_error import DepthError
from monoloc.obstacles.local_occupancy import LocalOccupancy, Surroundings
from monoloc.obstacles.map_knowledge import MapKnowledge
from monoloc.step import Step

_MAP_AFTER_S = 2.0  # in a room that was entered in flight; a slow core takes half a second to prepare a map


class ObstacleWatch:
    """Joins the depth of the last second and the map.

    Args:
        error: of the depth.
        knowledge: of the map; None for live depth alone.
    """

    def __init__(self, error: DepthError, knowledge: MapKnowledge | None) -> None:
        self._occupancy, self._knowledge = LocalOccupancy(error), knowledge
        self._becoming: Future[MapKnowledge] | None = None
        self._first_s: float | None = None

    @classmethod
    def of(cls, bundle: Bundle) -> ObstacleWatch:
        """For flights in a room."""
        return cls(DepthError.of(bundle), MapKnowledge(bundle))

    @classmethod
    def entered(cls, bundle: Bundle) -> ObstacleWatch:
        """For a room that was entered in flight, without a wait: a thread prepares the map.

        Live depth stands alone for the first two seconds of images, however long the thread takes, so that the same
        images give the same obstacles.
        """
        watch, worker = cls(DepthError.of(bundle), None), ThreadPoolExecutor(1, "obstacles")
        watch._becoming = worker.submit(MapKnowledge, bundle)
        worker.shutdown(wait=False)
        return watch

    def clear(self) -> None:
        """Forget all frames: the pose has jumped, or is lost."""
        self._occupancy.clear()

    def update(self, captured_s: float, step: Step, T_level_camera: FloatArray) -> Surroundings | None:
        """What is around the vehicle after a frame; a :class:`~monoloc.obstacles.map_knowledge.Knowledge` with a map.

        None where the step has no depth, which it may leave out to keep its budget.

        While the state is *lost*, nothing is remembered and the map is not used, since the vehicle's place in it is
        not known.

        Args:
            captured_s: time of the image.
            step: the localizer's result.
            T_level_camera: pose of the camera in the vehicle's level frame, (4, 4), as
                :meth:`monoloc.mavlink.autopilot_frames.AutopilotFrames.T_level_camera` gives it.
        """
        self._first_s = captured_s if self._first_s is None else self._first_s
        if self._becoming is not None and captured_s - self._first_s >= _MAP_AFTER_S:
            self._knowledge, self._becoming = self._becoming.result(), None
        if step.restarted or step.state == "lost":
            self.clear()
        if step.depth is None:
            return None
        live = self._occupancy.update(captured_s, step.depth, step.estimate, T_level_camera)
        if self._knowledge is None or step.state == "lost":
            return live
        return self._knowledge.joined(live, step.estimate.pose @ invert(T_level_camera))
