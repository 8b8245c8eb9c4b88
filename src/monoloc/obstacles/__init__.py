"""Obstacles from depth: nearest in each direction, free space ahead, local occupancy, and the map's surfaces.

Depth that was predicted for localisation is used once more, at the scale of the belief. Distances are as good as the
build measured (:class:`~monoloc.obstacles.depth_error.DepthError`), and only in a room that the network was tuned to.

    frames = AutopilotFrames(mount.T_body_camera, bundle.down, 0.0)
    watch = ObstacleWatch.of(bundle)
    free_m, known_s = 0.0, 0.0  # nothing is known yet
    ...
    step = localizer.step(color, elapsed_s)
    around = watch.update(captured_s, step, frames.T_level_camera(step.estimate))
    if around is not None:  # None where the step left out depth, to keep its budget
        free_m, known_s = around.free_ahead(0.3).least_m, captured_s
    is_old = captured_s - known_s > 0.3
    if step.state not in ("tracking", "map-changed") or is_old or free_m < stopping_distance_m:
        brake()
"""

from monoloc.obstacles.depth_error import DepthError, tells_obstacles
from monoloc.obstacles.local_occupancy import LocalOccupancy, Surroundings
from monoloc.obstacles.map_knowledge import Knowledge, MapKnowledge
from monoloc.obstacles.sectors import HALF_HEIGHT_M, LEAST_M, MOST_M, SECTORS, depth_points, sector_distances_m
from monoloc.obstacles.watch import ObstacleWatch

__all__ = [
    "HALF_HEIGHT_M",
    "LEAST_M",
    "MOST_M",
    "SECTORS",
    "DepthError",
    "Knowledge",
    "LocalOccupancy",
    "MapKnowledge",
    "ObstacleWatch",
    "Surroundings",
    "depth_points",
    "sector_distances_m",
    "tells_obstacles",
]
