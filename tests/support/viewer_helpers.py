"""Files of Rerun, read back, and runs before a viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from monoloc.bundle import Bundle
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.viz.viewer import Viewer
from synthetic_room import RoomRecording

RUN_ENTITIES = {
    "/world",
    "/world/map",
    "/world/truth",
    "/world/estimate",
    "/world/odometry",
    "/world/camera",
    "/world/camera/image",
    "/world/camera/covariance",
    "/world/particles",
    "/world/scan",
    "/depth",
    "/error_cm/estimate",
    "/error_cm/odometry",
    "/error_cm/stated_sd",
    "/likelihood/scan",
    "/likelihood/low",
    "/likelihood/lost",
    "/state",
    "/step_ms",
}


class Recorded:
    """A file of Rerun: its entities, and the values of a component by frame."""

    def __init__(self, path: Path) -> None:
        self.reader = RrdReader(path)
        self.entities = {str(entity) for entity in self.reader.stream().collect().schema().entity_paths()}
        (self.store,) = self.reader.recordings()

    def frames(self, entity: str, component: str, timeline: str = "frame") -> dict[Any, Any]:
        """Values of a component that changes, by the number of the frame, or by another time."""
        values: dict[Any, Any] = {}
        for chunk in self.reader.stream().filter(content=entity, is_static=False).to_chunks():
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                values |= zip(batch[timeline].to_pylist(), batch[component].to_pylist(), strict=True)
        return values

    def static(self, entity: str, component: str) -> Any:
        """Value of a component that does not change: the last one that was logged."""
        chunks = self.reader.stream().filter(content=entity, is_static=True).to_chunks()
        values: dict[bytes, Any] = {}
        for batch in (chunk.to_record_batch() for chunk in chunks):
            if component in batch.schema.names:
                values |= zip(batch["rerun.controls.RowId"].to_pylist(), batch[component].to_pylist(), strict=True)
        return values[max(values)]


def show_run(bundle: Bundle, recording: RoomRecording, viewer: Viewer) -> Run:
    """A recording, localised with its true start before a viewer."""
    assert recording.poses is not None
    rng = np.random.default_rng(0)
    return localize(bundle, recording, Start(recording.poses[0]), rng, NoProgress(), viewer=viewer)


def file_names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
