"""A place takes in edits of its bundles, keeps its doors, and refuses bundles that may have another world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import json_of, listing, refused
from edit_helpers import CUBE, cube_cloud, mapped_room
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.editing.edits import add, remove
from monoloc.editing.undo import undone
from monoloc.errors import BundleError
from monoloc.geometry import se3_exp
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.place.place_files import make_place, read_place, write_place
from monoloc.place.place_manifest import Door
from monoloc.place.place_update import updated_place
from refusals import refuses_data


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def room_of(seed: int) -> Bundle:
    """A room with 60 landmarks, half of them in the cube that tests remove."""
    points = np.random.default_rng(seed).uniform(-0.2, 0.2, (60, 3)) + CUBE.centre
    points[::2] += 2.0
    descriptors = np.random.default_rng(seed).integers(0, 256, (60, 32), dtype=np.uint8)
    return replace(mapped_room(), landmarks=Landmarks(points.astype(np.float32), descriptors))


@pytest.fixture
def house(tmp_path: Path) -> Path:
    bundles = [tmp_path / "hall.monoloc", tmp_path / "kitchen.monoloc"]
    for seed, bundle in enumerate(bundles):
        write_bundle(bundle, room_of(seed))
    door = Door.between("hall", "kitchen", se3_exp(np.full(6, 0.1)), (0.02, 0.01), np.zeros(3), 1.0)
    write_place(make_place(tmp_path / "house.place", bundles).with_door(door))
    return tmp_path / "house.place"


def test_edits_are_taken_in_and_the_doors_stay(house: Path, capfd: pytest.CaptureFixture[str]) -> None:
    hall, before = house.parent / "hall.monoloc", read_place(house)
    write_bundle(hall, remove(read_bundle(hall), CUBE, {}, rng()))
    write_bundle(hall, add(read_bundle(hall), cube_cloud(), {}, rng()))
    with pytest.raises(BundleError, match=r"hall\.monoloc: is not the bundle .*edited: monoloc place update"):
        read_place(house)
    assert json_of(capfd, "place", "update", str(house))["edits"] == {"hall": 2}
    after = read_place(house)
    assert after.manifest.doors == before.manifest.doors and after.names == before.names
    known = {row.tobytes() for row in read_bundle(hall).landmarks.descriptors}
    assert {row.tobytes() for row in after.descriptors[0]} <= known
    assert not {row.tobytes() for row in before.descriptors[0]} <= known
    np.testing.assert_array_equal(after.descriptors[1], before.descriptors[1])


def test_a_place_of_unchanged_bundles_stays_as_it_is(house: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = listing(house)
    assert json_of(capfd, "place", "update", str(house)) == {"place": str(house), "edits": {}, "bytes": None}
    assert listing(house) == before


def test_a_bundle_that_may_have_another_world_is_refused(house: Path, capfd: pytest.CaptureFixture[str]) -> None:
    hall = house.parent / "hall.monoloc"
    write_bundle(hall, remove(room_of(2), CUBE, {}, rng()))  # another build, edited
    problem, fix = "is not the bundle that the place knows, with edits made since", "make the place again"
    refused(capfd, house.parent, ("place", "update", str(house)), str(hall), problem, fix)
    edited = remove(room_of(0), CUBE, {}, rng())
    write_bundle(hall, edited)
    write_place(updated_place(house)[0])
    write_bundle(hall, undone(edited))
    refuses_data(lambda: updated_place(house), hall, problem, fix)
