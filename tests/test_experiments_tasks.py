"""The tasks of ``monoloc reproduce``: names that change with all that matters, and what each of them gives."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from monoloc.adapt.settings import AdaptConfig
from monoloc.bundle import fingerprint, read_bundle
from monoloc.depth.models import shipped_file, shipped_models
from monoloc.errors import DataError
from monoloc.localizer import LocalizerConfig
from monoloc.map.mixture import BYTES_PER_COMPONENT
from monoloc_lab.baselines.posenet import PoseNet, posenet_config
from monoloc_lab.baselines.posenet_training import PoseNetTraining
from monoloc_lab.experiments import source_version as source
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.study import Split, Study, Walk, recorded
from monoloc_lab.experiments.task import Result, Task
from monoloc_lab.experiments.work import KINDS
from monoloc_lab.experiments.work_rooms import octree_bytes
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording

NETWORK = "tiny-0.35"
FRAMES = 48  # so that every third of the first three quarters is enough for a network to be tuned on


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "room"
    write_recording(path, RoomRecording(Room(), make_path(FRAMES, rate_hz=6.0), SMALL_CAMERA))
    return path


@pytest.fixture(autouse=True)
def fresh() -> None:
    """Recordings are looked at once in a process; a test may change them."""
    tasks._recording.cache_clear()


@pytest.fixture
def study(folder: Path) -> Study:
    whole = recorded(f"folder:{folder}", "room", FRAMES, quick=True)
    return replace(whole, adapt={"steps": 4, "synthesised_views": 4})


@pytest.fixture
def away(study: Study) -> Split:
    return study.splits[0]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Result]]:
    """What the tests of this file have done, by key; a bundle is built once."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield {"folder": Result(tmp_path_factory.mktemp("results"), {})}
    torch.set_num_threads(before)


def do(task: Task, done: dict[str, Result]) -> Result:
    """A task and what it needs, in this process; its figures are as they come back from JSON."""
    if task.key not in done:
        needs = [do(need, done) for need in task.needs]
        folder = done["folder"].folder / task.key
        folder.mkdir()
        figures = KINDS[task.kind](task.settings, needs, folder)
        done[task.key] = Result(folder, json.loads(json.dumps(figures)))
    return done[task.key]


def way(result: Result) -> dict[str, Any]:
    with np.load(result.folder / "way.npz") as arrays:
        return dict(arrays)


# --- Names ---


def leaves(settings: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths to all that is neither a mapping nor a list."""
    inner = settings.items() if isinstance(settings, Mapping) else enumerate(settings)
    for name, value in inner:
        if isinstance(value, (Mapping, list)):
            yield from leaves(value, (*path, name))
        else:
            yield (*path, name)


def all_kinds(study: Study, split: Split) -> list[Task]:
    walk = split.walks["L3"]
    bundle, posenet = tasks.bundle(study, split, NETWORK, "network"), tasks.posenet(study, split, "tiny", 1)
    return [
        bundle,
        tasks.remapped(bundle, "voxels", 0.2),
        tasks.run(bundle, walk, 0),
        posenet,
        *posenet.needs,
        tasks.posenet_run(posenet, walk),
        tasks.filtered_run(posenet, bundle, walk, 0),
        tasks.keypoints_run(study, split, walk, "orb"),
        tasks.depth(bundle, walk),
        tasks.clouds(bundle),
    ]


def test_every_kind_has_a_factory_and_a_worker(study: Study, away: Split) -> None:
    assert {task.kind for task in all_kinds(study, away)} == set(KINDS)


def test_key_changes_with_every_setting(study: Study, away: Split) -> None:
    for task in all_kinds(study, away):
        keys = {task.key}
        paths = list(leaves(task.settings))
        for path in paths:
            changed = task.settings
            place = changed
            for name in path[:-1]:
                place = place[name]
            place[path[-1]] = "another"
            keys.add(Task.of(task.kind, changed, task.needs).key)
        assert len(keys) == 1 + len(paths), task.kind


def test_what_a_bundle_depends_on_is_in_its_settings(study: Study, away: Split) -> None:
    """Every choice of the factory's is another task, and all settings of a build are there, resolved."""
    plain = tasks.bundle(study, away, NETWORK)
    others = [
        tasks.bundle(study, study.splits[0].__class__(away.name, away.source, "0:30", away.walks), NETWORK),
        tasks.bundle(study, away, "one-third-0.35"),
        *(tasks.bundle(study, away, NETWORK, variant) for variant in tasks.VARIANTS if variant != "joint"),
        tasks.bundle(study, away, NETWORK, seed=1),
        tasks.bundle(study, away, NETWORK, components=100),
        tasks.bundle(study, away, NETWORK, frames=5),
        tasks.bundle(study, away, NETWORK, lambda_kl=1.0),
        tasks.bundle(replace(study, adapt={}), away, NETWORK),
    ]
    assert len({plain.key, *(other.key for other in others)}) == 1 + len(others)
    config = plain.settings["config"]
    assert set(config["adapt"]) == set(AdaptConfig.model_fields)
    assert config["adapt"]["steps"] == 4 and config["adapt"]["tune"] == "all" and config["components"] == 200
    assert tasks.bundle(study, away, NETWORK, lambda_kl=1.0).settings["config"]["adapt"]["lambda_kl"] == 1.0
    # The default's value, said or not, is the same task.
    assert tasks.bundle(study, away, NETWORK, lambda_kl=AdaptConfig().lambda_kl).key == plain.key


def test_an_unadapted_bundle_does_not_depend_on_how_others_are_tuned(study: Study, away: Split) -> None:
    quick, full = (tasks.bundle(s, away, NETWORK, "unadapted") for s in (study, replace(study, adapt={})))
    assert quick == full


def test_key_changes_with_the_network_s_content(study: Study, away: Split, tmp_path: Path) -> None:
    network = tmp_path / "mine.onnx"
    network.write_bytes(shipped_file(NETWORK).read_bytes())
    first, depth = (
        lambda: tasks.bundle(study, away, str(network)),
        lambda: tasks.depth(str(network), away.walks["L1"]),
    )
    before = first().key, depth().key
    assert (first().key, depth().key) == before
    network.write_bytes(shipped_file("one-third-0.35").read_bytes())
    assert first().key != before[0] and depth().key != before[1]


def test_key_changes_with_the_encoder_s_content(study: Study, away: Split, tmp_path: Path) -> None:
    weights = tmp_path / "weights.npz"
    keys = set()
    for content in (b"one", b"other"):
        weights.write_bytes(content)
        keys.add(tasks.posenet(replace(study, encoder_weights=str(weights)), away, "tiny", 0).key)
    assert len(keys | {tasks.posenet(study, away, "tiny", 0).key}) == 3


@pytest.mark.parametrize("changed", ["poses", "times", "camera", "image", "depth", "depth scale", "length"])
def test_key_changes_with_what_lies_at_the_recording_s_place(
    study: Study, away: Split, tmp_path: Path, changed: str
) -> None:
    place = tmp_path / "room"
    recording = RoomRecording(Room(), make_path(6), SMALL_CAMERA)
    write_recording(place, recording)
    split = Split("away", f"folder:{place}", "::2", {"as taken": Walk(f"folder:{place}", "::", None)})

    def keys() -> list[str]:
        tasks._recording.cache_clear()
        bundle = tasks.bundle(study, split, NETWORK)
        return [bundle.key, tasks.depth(NETWORK, split.walks["as taken"]).key]

    before = keys()
    assert keys() == before
    if changed == "poses":
        lines = (place / "poses.txt").read_text().splitlines()
        times, *numbers = lines[1].split()
        (place / "poses.txt").write_text("\n".join([lines[0], " ".join([times, "0.123", *numbers[1:]]), *lines[2:]]))
    elif changed == "times":
        head, first, *rest = (place / "poses.txt").read_text().splitlines()
        time_s, *numbers = first.split()
        earlier = " ".join([f"{float(time_s) - 0.01}", *numbers])
        (place / "poses.txt").write_text("\n".join([head, earlier, *rest]))
    elif changed == "image":
        cv2.imwrite(str(place / "color" / "000000.png"), 255 - recording.color(0))
    elif changed == "depth":
        cv2.imwrite(str(place / "depth" / "000000.png"), np.full((128, 160), 1234, dtype=np.uint16))
    elif changed in ("camera", "depth scale"):
        name = {"camera": "fx", "depth scale": "depth_scale"}[changed]
        lines = (place / "dataset.toml").read_text().splitlines()
        (at,) = (number for number, line in enumerate(lines) if line.startswith(f"{name} "))
        lines[at] = f"{name} = {1.01 * float(lines[at].partition('=')[2])}"
        (place / "dataset.toml").write_text("\n".join(lines))
    else:
        description = place / "dataset.toml"
        description.write_text(description.read_text().replace("count = 6", "count = 5"))
        poses = (place / "poses.txt").read_text().splitlines()
        (place / "poses.txt").write_text("\n".join(poses[:-1]) + "\n")
        split = replace(split, frames="0:4:2")
    assert not set(keys()) & set(before)


def test_frames_that_changed_since_are_refused(study: Study, tmp_path: Path, done: dict[str, Result]) -> None:
    """While a run is at work, or on another machine."""
    place = tmp_path / "room"
    recording = RoomRecording(Room(), make_path(6), SMALL_CAMERA)
    write_recording(place, recording)
    task = tasks.depth(NETWORK, Walk(f"folder:{place}", "::", None))
    cv2.imwrite(str(place / "color" / "000003.png"), 255 - recording.color(3))
    with pytest.raises(DataError, match="is not what it was when this run began; run it again, with the same data"):
        do(task, done)


def test_posenets_share_one_search_and_quick_ones_train_less(study: Study, away: Split) -> None:
    first, second = (tasks.posenet(study, away, "tiny", seed) for seed in (0, 1))
    assert first.key != second.key and first.needs == second.needs
    assert first.needs[0].settings["seed"] == 0
    whole = tasks.posenet(replace(study, quick=False), away, "tiny", 0)
    quick, full = first.settings["training"], whole.settings["training"]
    assert set(quick) == set(full) == set(PoseNetTraining.model_fields)  # resolved: a default that changes is another
    assert quick["epochs"] < full["epochs"] == PoseNetTraining().epochs
    seen = tasks.posenet(study, away, "tiny", 0, views=True)
    assert seen.settings["training"]["synthesised_views"] == 4 and seen.needs != first.needs


def test_in_changed_light_each_posenet_sees_noise_of_its_own(study: Study, away: Split) -> None:
    runs = [tasks.posenet_run(tasks.posenet(study, away, "tiny", seed), away.walks["L3"]) for seed in (0, 1)]
    assert [run.settings["seed"] for run in runs] == [0, 1]


def test_key_changes_with_our_own_source(
    study: Study, away: Split, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of what makes the result, however it is imported; not of what uses or shows it."""
    package = tmp_path / "monoloc"
    shutil.copytree(
        Path(source.monoloc.__file__).parent,
        package,
        ignore=shutil.ignore_patterns("rooms", "*.onnx", "*.safetensors"),
    )
    (package / "_core.so").touch()
    monkeypatch.setattr(source.monoloc, "__file__", str(package / "__init__.py"))
    monkeypatch.setattr(source._core, "__file__", str(package / "_core.so"))
    monkeypatch.setattr(tasks, "source_sha256", source.source_sha256.__wrapped__)  # as another process finds it

    def keys() -> tuple[str, str, str]:
        built = tasks.bundle(study, away, NETWORK)
        return built.key, tasks.run(built, away.walks["as taken"], 0).key, tasks.posenet(study, away, "tiny", 0).key

    for name, expected in {
        "__init__.py": (True, True, True),
        "_core.so": (True, True, True),
        "datasets/tum.py": (True, True, True),
        "adapt/__init__.py": (True, True, True),
        "adapt/train.py": (True, True, False),  # imported only where it is needed
        "filter/weigh.py": (True, True, False),
        "experiments/work_runs.py": (False, True, False),
        "baselines/posenet_training.py": (False, False, True),
        "experiments/tasks.py": (False, False, False),
        "experiments/fig1.py": (False, False, False),
        "cli/main.py": (False, False, False),
        "viewer.py": (False, False, False),
        "rerun_viewer.py": (False, False, False),
    }.items():
        before = keys()
        with (package / name).open("a") as file:
            file.write("\n")
        changed = tuple(one != other for one, other in zip(keys(), before, strict=True))
        assert changed == expected, name


# --- What they give ---


@pytest.mark.slow
def test_bundle_run_depth_and_clouds(study: Study, away: Split, done: dict[str, Result]) -> None:
    bundle = tasks.bundle(study, away, NETWORK, "unadapted")
    built = do(bundle, done)
    room = read_bundle(built.folder / "room.monoloc")
    assert built.figures["map_bytes"] == 200 * BYTES_PER_COMPONENT and built.figures["frames"] == 12
    assert built.figures["network_bytes"] == len(room.depth_model.content)
    run = do(tasks.run(bundle, away.walks["as taken"], 3, sensor=True), done)
    arrays = way(run)
    assert set(arrays) == set(tasks.WAY)
    assert arrays["covariances"].shape == (12, 6, 6) and arrays["unseen"].all()
    errors = np.linalg.norm(arrays["poses"][:, :3, 3] - arrays["truth"][:, :3, 3], axis=1)
    assert run.figures["unseen_ate_rmse_m"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    seen_before = do(tasks.run(bundle, replace(away.walks["as taken"], frames="0:24"), 3, sensor=True), done)
    assert seen_before.figures["unseen_ate_median_m"] < 0.06 and seen_before.figures["unseen_frames"] == 16
    walk = do(tasks.run(bundle, away.walks["as taken"], 3, motion="random-walk"), done)
    assert "odometry" not in way(walk) and walk.figures["motion"] == "random-walk"
    depth = do(tasks.depth(bundle, away.walks["as taken"], stride=4, shown=(1, 4)), done)
    assert depth.figures["per_frame"]["index"] == [0, 4, 8] and depth.figures["frames"] == 3
    for name in ("absrel", "delta1", "ssim"):
        assert depth.figures[name] == pytest.approx(np.mean(depth.figures["per_frame"][name]))
    with np.load(depth.folder / "depth.npz") as pictures:
        assert pictures["index"].tolist() == [1, 4] and pictures["color"].shape == (2, 128, 160, 3)
        predicted, truth = pictures["predicted"][1], pictures["truth"][1]
        seen = truth > 0.0
        absrel = np.mean(np.abs(predicted[seen] - truth[seen]) / truth[seen])
        assert depth.figures["per_frame"]["absrel"][1] == pytest.approx(absrel, rel=1e-5)
    assert (
        do(tasks.depth(NETWORK, away.walks["as taken"], stride=4), done).figures["absrel"] == depth.figures["absrel"]
    )
    clouds = do(tasks.clouds(bundle), done)
    assert clouds.figures["c2c_max_m"] < 1e-9  # nothing was bent
    with np.load(clouds.folder / "clouds.npz") as arrays:
        assert arrays["original"].shape == arrays["adapted"].shape == (50_000, 3)
        np.testing.assert_allclose(arrays["distances_m"], 0.0, atol=1e-9)
        assert np.linalg.norm(arrays["down_world"]) == pytest.approx(1.0)


@pytest.mark.slow
def test_light_is_put_on_after_frames_are_known_again(study: Study, folder: Path, done: dict[str, Result]) -> None:
    """In the dark too, the frames that built the map are those that did."""
    split = Split("between", f"folder:{folder}", "0:48:4", {"L3": Walk(f"folder:{folder}", "0:24", "L3")})
    bundle = tasks.bundle(study, split, NETWORK, "unadapted")
    arrays = way(do(tasks.run(bundle, split.walks["L3"], 0), done))
    np.testing.assert_array_equal(arrays["unseen"], np.arange(24) % 4 != 0)
    dark = do(tasks.depth(NETWORK, split.walks["L3"], shown=(0,)), done)
    light = do(tasks.depth(NETWORK, replace(split.walks["L3"], light=None), shown=(0,)), done)
    colours = []
    for result in (dark, light):
        with np.load(result.folder / "depth.npz") as pictures:
            colours.append(pictures["color"][0])
    assert colours[0].mean() < 0.5 * colours[1].mean()
    keypoints = do(tasks.keypoints_run(study, split, split.walks["L3"], "orb"), done)
    np.testing.assert_array_equal(way(keypoints)["unseen"], np.arange(24) % 4 != 0)


def test_some_of_the_build_frames(study: Study, away: Split, done: dict[str, Result]) -> None:
    few = do(tasks.bundle(study, away, NETWORK, "unadapted", frames=5), done)
    names = list(read_bundle(few.folder / "room.monoloc").provenance.frames)
    assert names == [f"{3 * index:06d}" for index in (0, 3, 6, 8, 11)]  # 11 / 4 apart, rounded
    with pytest.raises(DataError, match="has 12 build frames, not 13; ask for fewer"):
        do(tasks.bundle(study, away, NETWORK, "unadapted", frames=13), done)


@pytest.mark.slow
def test_other_maps_of_the_same_room(study: Study, away: Split, done: dict[str, Result]) -> None:
    bundle = tasks.bundle(study, away, NETWORK, "network")
    built = do(bundle, done)
    given = read_bundle(built.folder / "room.monoloc")
    same = read_bundle(do(tasks.remapped(bundle, "mixture", 200), done).folder / "room.monoloc")
    # An adapted map has its components' moments taken once more, see AdaptedMap.
    np.testing.assert_allclose(same.adapted.means, given.adapted.means, atol=0.01)
    assert same.depth_model == given.depth_model

    def but_near(settings: LocalizerConfig) -> LocalizerConfig:
        any_near = settings.lasting.model_copy(update={"sd_at_reference_m": 0.0, "sd_at_reference_rad": 0.0})
        return settings.model_copy(update={"lasting": any_near})

    # What is of network and map together is measured anew.
    assert but_near(same.settings) == but_near(given.settings)
    assert same.settings.lasting.sd_at_reference_m == pytest.approx(given.settings.lasting.sd_at_reference_m, rel=0.3)
    fewer = do(tasks.remapped(bundle, "mixture", 25), done)
    assert fewer.figures == {"components": 25, "map_bytes": 1000}
    voxels = do(tasks.remapped(bundle, "voxels", 0.25), done)
    room = read_bundle(voxels.folder / "room.monoloc").adapted
    np.testing.assert_allclose(room.covariances, np.tile(0.25**2 / 12.0 * np.eye(3), (len(room), 1, 1)), rtol=1e-5)
    np.testing.assert_allclose((room.means / 0.25) % 1.0, 0.5, atol=1e-4)
    assert voxels.figures["components"] == len(room) > 50
    points = do(tasks.remapped(bundle, "points", 0.25), done)
    assert points.figures["map_bytes"] == 12 * points.figures["components"]
    coarse = read_bundle(points.folder / "room.monoloc").adapted
    np.testing.assert_allclose(coarse.covariances[0], 0.125**2 * np.eye(3), rtol=1e-5)
    sd_at_reference_m = read_bundle(points.folder / "room.monoloc").settings.lasting.sd_at_reference_m
    assert sd_at_reference_m != given.settings.lasting.sd_at_reference_m


def test_bytes_of_an_octree() -> None:
    header = 16
    assert octree_bytes(np.array([[5, -3, 2]])) == header
    # Two neighbours within one parent, and two at opposite ends of a cube of four.
    assert octree_bytes(np.array([[0, 0, 0], [1, 1, 1]])) == header + 1
    assert octree_bytes(np.array([[0, 0, 0], [3, 3, 3]])) == header + 2 + 1
    full = np.stack(np.meshgrid(*[np.arange(8)] * 3), axis=-1).reshape(-1, 3)
    assert octree_bytes(full - 100) == header + 64 + 8 + 1


@pytest.mark.slow
def test_posenet_filtered_posenet_and_keypoints(
    folder: Path, done: dict[str, Result], study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {"epochs": 2, "learning_rates": (3e-3, 1e-3), "search_epochs": 1, "batch_size": 8}
    monkeypatch.setattr(tasks, "_QUICK_POSENET", short)
    split = Split("between", f"folder:{folder}", "0:48:2", {"as taken": Walk(f"folder:{folder}", "0:12", None)})
    walk = split.walks["as taken"]
    network = tasks.posenet(study, split, "tiny", 1, views=True)
    trained = do(network, done)
    trials = trained.figures["trials"]
    best = min(trials, key=lambda trial: trial["position_m"] + trial["rotation_rad"])
    assert len(trials) == 2 and trained.figures["learning_rate"] == best["learning_rate"]
    assert trained.figures["bytes"] == (trained.folder / "posenet.safetensors").stat().st_size
    catalogue = next(model for model in shipped_models() if model.name == NETWORK)
    at_its_size = PoseNet(posenet_config("tiny", 0.35)).multiply_adds(catalogue.input_width, catalogue.input_height)
    assert trained.figures["multiply_adds"] == at_its_size
    located = do(tasks.posenet_run(network, walk), done)
    bundle = tasks.bundle(study, split, NETWORK, "unadapted")
    followed = do(tasks.filtered_run(network, bundle, walk, 0), done)
    found = do(tasks.keypoints_run(study, split, walk, "orb"), done)
    for result in (located, followed, found):
        arrays = way(result)
        np.testing.assert_array_equal(arrays["unseen"], np.arange(12) % 2 == 1)
        assert result.figures["frames"] == 12 and result.figures["unseen_frames"] == 6
        assert {"unseen_ate_rmse_m", "unseen_rot_median_deg", "unseen_failed_frames"} <= set(result.figures)
    assert found.figures["map_bytes"] > 0
    assert way(located)["poses"].shape == (12, 4, 4) and located.figures["failed_frames"] == 0


def test_walk_without_depth_cannot_be_judged_by_it(folder: Path, tmp_path: Path, done: dict[str, Result]) -> None:
    bare = tmp_path / "bare"
    recording = RoomRecording(Room(), make_path(6), SMALL_CAMERA)
    write_recording(bare, recording)
    description = bare / "dataset.toml"
    lines = [line for line in description.read_text().splitlines() if not line.startswith("depth")]
    description.write_text("\n".join(lines))
    walk = Walk(f"folder:{bare}", "::", None)
    assert fingerprint(recording.color(0)) in tasks.depth(NETWORK, walk).settings["walk"]["images"]
    with pytest.raises(DataError, match="has no depth; give a recording whose depth can be compared"):
        do(tasks.depth(NETWORK, walk), done)
