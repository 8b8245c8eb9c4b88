"""Two real rooms as one place: a camera of unknown start is found in its own room and never believed in the other."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from monoloc.io.registry import open_recording
from monoloc.place.place_files import Place, read_place
from monoloc.place.place_localizer import PlaceLocalizer
from monoloc.supervision.state import VOUCHED_FOR
from recording_helpers import monoloc, source

pytestmark = [pytest.mark.data, pytest.mark.slow]

QUICK = ("--tune", "none", "--no-map-transform", "-k", "100", "--network", "one-third-0.35-int8")


@pytest.fixture(scope="module")
def sources(data_root: Path) -> dict[str, str]:
    return {
        "desk": source(data_root, "folder", "office-desk"),
        "kitchen": source(data_root, "7scenes", "7scenes/redkitchen/seq-01"),
    }


@pytest.fixture(scope="module")
def place(sources: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Place:
    here = tmp_path_factory.mktemp("place")
    bundles = [here / f"{name}.monoloc" for name in sources]
    for bundle, given, frames in zip(bundles, sources.values(), ("0:350:10", "0:300:8"), strict=True):
        monoloc("build", given, "--frames", frames, "--out", bundle, *QUICK)
    monoloc("place", "new", here / "two.place", *bundles)
    monoloc("place", "door", here / "two.place", "desk", "kitchen", "--same-world")
    return read_place(here / "two.place")


@pytest.mark.parametrize(
    ("room", "starts", "least_found"), [("desk", range(350, 480, 20), 2), ("kitchen", range(300, 360, 10), 2)]
)
def test_a_camera_is_found_in_its_own_room(
    place: Place, sources: dict[str, str], room: str, starts: range, least_found: int
) -> None:
    """Starts on frames that built nothing, some of which look at what no build frame saw: 1.5 s each."""
    cv2.setNumThreads(1)
    recording, found = open_recording(sources[room]), 0
    for start in starts:
        localizer, rooms = PlaceLocalizer(place, recording.camera, seed=start), set()
        times_s = recording.timestamps_s - recording.timestamps_s[start]
        last = start
        for index in range(start, len(recording), 2):
            if times_s[index] > 1.5:
                break
            step = localizer.step(recording.color(index), float(times_s[index] - times_s[last]))
            last = index
            rooms |= {step.room} if step.state in VOUCHED_FOR else set()
        assert rooms <= {room}
        found += bool(rooms)
    assert found >= least_found
