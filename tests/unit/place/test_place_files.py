"""A place is written whole, read back equal, and refused where its bundles or its index are not what they were."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import refused, succeeds
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.bundle_manifest import PLACE_INDEX, PLACE_MANIFEST, manifest_content
from monoloc.bundle_signature import SIGNATURE, make_keys, signature_of
from monoloc.errors import BundleError, SettingError
from monoloc.geometry import se3_exp
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.place import place_files
from monoloc.place.place_files import Place, check_place_target, make_place, read_place, write_place
from monoloc.place.place_manifest import Door, place_content
from refusals import refuses, refuses_data, refuses_setting
from synthetic_room import Room, RoomRecording, make_bundle, make_path, room_mixture

NAMES = ("hall", "kitchen", "study", "attic")


def landmarks(seed: int, count: int = 60) -> Landmarks:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)).astype(np.float32)
    return Landmarks(points, rng.integers(0, 256, (count, 32), dtype=np.uint8))


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles")
    bare = make_bundle(room_mixture(Room(), 40), RoomRecording(Room(), make_path(2)), range(2))
    for seed, name in enumerate(NAMES):
        write_bundle(folder / f"{name}.monoloc", replace(bare, landmarks=landmarks(seed)))
    write_bundle(folder / "bare.monoloc", bare)
    return folder


@pytest.fixture
def here(bundles: Path, tmp_path: Path) -> Path:
    shutil.copytree(bundles, tmp_path, dirs_exist_ok=True)
    return tmp_path


def a_door(a: str, b: str, twist: list[float], centre: float = 0.0) -> Door:
    return Door.between(a, b, se3_exp(np.array(twist)), (0.02, 0.01), np.array([centre, 0.0, 0.0]), 1.0)


def a_place(here: Path) -> Place:
    """The hall leads to the kitchen, the kitchen to the study; nothing leads to the attic."""
    made = make_place(here / "house.place", [here / f"{name}.monoloc" for name in NAMES])
    made = made.with_door(a_door("hall", "kitchen", [1.0, 0.0, 0.0, 0.0, 0.3, 0.0]))
    return made.with_door(a_door("study", "kitchen", [0.0, 2.0, 0.0, 0.5, 0.0, 0.0]))


@pytest.mark.parametrize(("name", "length"), [("", 0), ("r" * 101, 101)])
def test_a_bundle_whose_name_is_none_of_a_room_is_refused(here: Path, name: str, length: int) -> None:
    bundle = (here / "hall.monoloc").rename(here / f"{name}.monoloc")
    given = [here / "kitchen.monoloc", bundle]
    problem = f"has a name of {length} characters before .monoloc"
    refuses_setting(lambda: make_place(here / "house.place", given), "ROOM", problem, "rename it, to 1 to 100")
    bundle.rename(here / f"{'r' * 100}.monoloc")
    assert len(make_place(here / "house.place", [given[0], here / f"{'r' * 100}.monoloc"]).names) == 2


def test_copies_of_one_bundle_are_no_two_rooms(here: Path) -> None:
    shutil.copytree(here / "hall.monoloc", here / "copy.monoloc")
    given = [here / f"{name}.monoloc" for name in ("hall", "kitchen", "copy")]
    problem = "hall and copy are copies of one bundle"
    refuses_setting(
        lambda: make_place(here / "house.place", given), "ROOM", problem, "name the bundle of each room once"
    )


def test_a_place_is_read_as_it_was_written(here: Path) -> None:
    made = a_place(here)
    assert len(made.read_room("study").landmarks) == 60  # before it is written
    size = write_place(made)
    read = read_place(made.path)
    assert read.manifest == made.manifest and size == sum(file.stat().st_size for file in made.path.iterdir())
    for one, other in zip(read.descriptors, made.descriptors, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(read.read_room("kitchen").landmarks) == 60
    assert [door.beyond("kitchen") for door in read.doors_of("kitchen")] == ["hall", "study"]


def test_a_door_joins_a_place_whose_index_was_compressed_elsewhere(here: Path) -> None:
    """Libraries for compression differ between computers, and give other bytes for the same arrays."""
    made = a_place(here)
    write_place(made)
    np.savez(made.path / PLACE_INDEX, **{str(number): each for number, each in enumerate(made.descriptors)})
    digest = hashlib.sha256((made.path / PLACE_INDEX).read_bytes()).hexdigest()
    manifest = made.manifest.model_copy(update={"index_sha256": digest})
    (made.path / PLACE_MANIFEST).write_text(manifest.model_dump_json())
    write_place(read_place(made.path).with_door(a_door("study", "attic", [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    assert len(read_place(made.path).manifest.doors) == 3


def test_a_place_moves_with_its_bundles(here: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    write_place(a_place(here))
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "copy"
    shutil.copytree(here, elsewhere)
    assert read_place(elsewhere / "house.place").names == list(NAMES)


def test_worlds_are_joined_by_chains_of_doors(here: Path) -> None:
    place = a_place(here)
    hall_kitchen, study_kitchen = (door.T_a_b for door in place.manifest.doors)
    chained = place.T_other_room("study", "hall")
    assert chained is not None
    np.testing.assert_allclose(chained, study_kitchen @ np.linalg.inv(hall_kitchen), atol=1e-12)
    assert place.T_other_room("attic", "hall") is None
    here_itself = place.T_other_room("hall", "hall")
    assert here_itself is not None
    np.testing.assert_allclose(here_itself, np.eye(4))


def test_a_door_that_is_measured_again_takes_the_old_ones_place(here: Path) -> None:
    place = a_place(here).with_door(a_door("kitchen", "hall", [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], centre=-0.8))
    assert sum({door.a, door.b} == {"hall", "kitchen"} for door in place.manifest.doors) == 1
    second = place.with_door(a_door("kitchen", "hall", [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], centre=4.0))
    assert sum({door.a, door.b} == {"hall", "kitchen"} for door in second.manifest.doors) == 2


def test_bundles_that_are_gone_or_changed_are_refused(here: Path) -> None:
    place = a_place(here)
    write_place(place)
    bundle = here / "kitchen.monoloc"
    write_bundle(bundle, replace(read_bundle(bundle), landmarks=landmarks(99)))
    refuses_data(
        lambda: read_place(place.path), bundle, "is not the bundle that room kitchen was made of", "place new"
    )
    refuses_data(lambda: place.read_room("kitchen"), bundle, "is not the bundle", "put the old one back")
    shutil.rmtree(bundle)
    refuses_data(lambda: read_place(place.path), bundle, "the bundle of room kitchen is missing", "put it back")


def test_a_bundle_that_is_replaced_while_its_room_is_read_is_refused(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would be flown with the doors of another world."""
    place = a_place(here)
    bundle, read = here / "kitchen.monoloc", place_files.read_described

    def replaced(path: Path, content: bytes) -> Bundle:
        write_bundle(path, replace(read_bundle(path), landmarks=landmarks(99)))
        return read(path, content)

    monkeypatch.setattr(place_files, "read_described", replaced)
    with pytest.raises(BundleError, match="is not what was written"):
        place.read_room("kitchen")
    assert bundle.is_dir()


def test_rooms_are_read_in_flight_although_the_file_of_the_key_has_gone(here: Path) -> None:
    make_keys(here / "team.key", here / "team.pub")
    made = a_place(here)
    for name in NAMES:
        bundle = here / f"{name}.monoloc"
        (bundle / SIGNATURE).write_bytes(signature_of(manifest_content(bundle), here / "team.key"))
    write_place(made)
    (made.path / SIGNATURE).write_bytes(signature_of(place_content(made.path), here / "team.key"))
    place = read_place(made.path, here / "team.pub")
    (here / "team.pub").unlink()
    assert len(place.read_room("kitchen").landmarks) == 60
    (here / "kitchen.monoloc" / SIGNATURE).unlink()
    with pytest.raises(BundleError, match="is not signed"):
        place.read_room("kitchen")


@pytest.mark.parametrize("file", ["map.npz", "landmarks.npz", "depth.onnx"])
def test_a_bundle_with_a_damaged_file_is_refused(here: Path, file: str) -> None:
    """Though its manifest, which the place knows it by, is the same."""
    place = a_place(here)
    write_place(place)
    damaged = here / "kitchen.monoloc" / file
    damaged.write_bytes(damaged.read_bytes() + b"x")
    refuses_data(lambda: read_place(place.path), damaged, "is not what was written", "copy the bundle again")


def test_an_index_that_is_not_what_was_written_is_refused(here: Path) -> None:
    place = a_place(here)
    write_place(place)
    file = place.path / "index.npz"
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    refuses_data(lambda: read_place(place.path), file, "it is not what was written", "place new")
    file.unlink()
    refuses_data(lambda: read_place(place.path), file, "cannot be read", "place new")


def test_a_new_place_is_refused_where_measured_doors_would_be_lost(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = str(here / "house.place")
    new = ("place", "new", path, str(here / "hall.monoloc"))
    write_place(a_place(here))
    refused(capfd, here, new, path, "exists, and its doors would be lost .2.", "remove this one first")
    write_place(make_place(here / "house.place", [here / "study.monoloc"]))
    succeeds(capfd, *new)
    assert read_place(path).names == ["hall"]


def test_bundles_that_make_no_place_are_refused(here: Path) -> None:
    path, bare = here / "x.place", here / "bare.monoloc"
    refuses_data(lambda: make_place(path, [bare]), bare, "has fewer than 20 landmarks", "build it with landmarks")
    twice = [here / "hall.monoloc", here / "hall.monoloc"]
    refuses(lambda: make_place(path, twice), SettingError, "two bundles are named hall; rename one")


def test_targets_that_would_lose_something_are_refused(here: Path) -> None:
    refuses_data(lambda: check_place_target(here / "house"), here / "house", "is not named", "NAME.place")
    nowhere = here / "no" / "x.place"
    refuses_data(lambda: check_place_target(nowhere), nowhere, "does not exist", "make .*no first")
    write_place(a_place(here))
    inner = here / "house.place" / "x.place"
    refuses_data(lambda: check_place_target(inner), inner, "lies in the place", "another folder")
    (here / "file.place").write_text("")
    refuses_data(lambda: check_place_target(here / "file.place"), here / "file.place", "is a file", "another name")
    (here / "full.place").mkdir()
    (here / "full.place" / "notes.txt").write_text("")
    refuses_data(lambda: check_place_target(here / "full.place"), here / "full.place", "holds more", "another name")
