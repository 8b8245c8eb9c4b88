"""Keys of tasks change with everything that their results depend on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from monoloc.adapt.settings import AdaptConfig
from monoloc.depth.models import shipped_file
from monoloc.errors import DataError
from monoloc_lab.baselines.posenet_training import PoseNetTraining
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.study import EvalRecording, Split, Study
from monoloc_lab.experiments.task import Task
from monoloc_lab.experiments.task_inputs import build_frames
from monoloc_lab.experiments.work import KINDS
from study_helpers import NETWORK, small_study, write_room


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "room"
    write_room(path)
    return path


@pytest.fixture(autouse=True)
def fresh() -> None:
    """Recordings are described once per process; tests change them."""
    tasks._recording.cache_clear()


@pytest.fixture
def study(folder: Path) -> Study:
    return small_study(folder)


@pytest.fixture
def split(study: Study) -> Split:
    return study.splits[0]


def leaves(settings: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths to all values that are neither mappings nor lists."""
    inner = settings.items() if isinstance(settings, Mapping) else enumerate(settings)
    for name, value in inner:
        if isinstance(value, (Mapping, list)):
            yield from leaves(value, (*path, name))
        else:
            yield (*path, name)


def all_kinds(study: Study, split: Split) -> list[Task]:
    recording = split.recordings["L3"]
    bundle, posenet = tasks.bundle(study, split, NETWORK, "network"), tasks.posenet(study, split, "tiny", 1)
    return [
        bundle,
        tasks.remapped(bundle, "voxels", 0.2),
        tasks.run(bundle, recording, 0),
        posenet,
        *posenet.needs,
        tasks.posenet_run(posenet, recording),
        tasks.filtered_run(posenet, bundle, recording, 0),
        tasks.keypoints_run(study, split, recording, "orb"),
        tasks.depth(bundle, recording),
        tasks.clouds(bundle),
    ]


def test_every_kind_has_a_factory_and_its_work(study: Study, split: Split) -> None:
    assert {task.kind for task in all_kinds(study, split)} == set(KINDS)


def test_key_changes_with_every_setting(study: Study, split: Split) -> None:
    for task in all_kinds(study, split):
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


def test_every_choice_of_a_bundle_is_in_its_settings(study: Study, split: Split) -> None:
    default = tasks.bundle(study, split, NETWORK)
    others = [
        tasks.bundle(study, replace(split, frames="0:30"), NETWORK),
        tasks.bundle(study, replace(split, alteration="pose noise"), NETWORK),
        tasks.bundle(study, split, "one-third-0.35"),
        *(tasks.bundle(study, split, NETWORK, variant) for variant in tasks.VARIANTS if variant != "joint"),
        tasks.bundle(study, split, NETWORK, seed=1),
        tasks.bundle(study, split, NETWORK, components=100),
        tasks.bundle(study, split, NETWORK, frames=5),
        tasks.bundle(study, split, NETWORK, landmarks=True),
        tasks.bundle(study, split, NETWORK, refine_poses=True),
        tasks.bundle(study, split, NETWORK, lambda_kl=1.0),
        tasks.bundle(replace(study, adapt={}), split, NETWORK),
    ]
    assert len({default.key, *(other.key for other in others)}) == 1 + len(others)
    config = default.settings["config"]
    assert set(config["adapt"]) == set(AdaptConfig.model_fields)
    assert config["adapt"]["steps"] == 4 and config["adapt"]["tune"] == "all" and config["components"] == 200
    assert tasks.bundle(study, split, NETWORK, lambda_kl=1.0).settings["config"]["adapt"]["lambda_kl"] == 1.0
    # An explicit default is the same task.
    assert tasks.bundle(study, split, NETWORK, lambda_kl=AdaptConfig().lambda_kl).key == default.key


def test_unadapted_bundle_does_not_depend_on_settings_of_tuning(study: Study, split: Split) -> None:
    quick, full = (tasks.bundle(s, split, NETWORK, "unadapted") for s in (study, replace(study, adapt={})))
    assert quick == full


def test_key_changes_with_the_content_of_network_and_encoder(study: Study, split: Split, tmp_path: Path) -> None:
    network, weights = tmp_path / "mine.onnx", tmp_path / "weights.npz"
    keys: set[str] = set()
    for name, content in ((NETWORK, b"one"), ("one-third-0.35", b"other")):
        network.write_bytes(shipped_file(name).read_bytes())
        weights.write_bytes(content)
        keys |= {
            tasks.bundle(study, split, str(network)).key,
            tasks.depth(str(network), split.recordings["L1"]).key,
            tasks.posenet(replace(study, encoder_weights=str(weights)), split, "tiny", 0).key,
        }
    assert len(keys | {tasks.posenet(study, split, "tiny", 0).key}) == 7


@pytest.mark.parametrize("changed", ["poses", "times", "camera", "image", "depth", "depth scale", "length"])
def test_key_changes_with_the_content_of_the_recording(study: Study, tmp_path: Path, changed: str) -> None:
    place = tmp_path / "room"
    recording = write_room(place, 6)
    split = Split("one", f"folder:{place}", "::2", {"as recorded": EvalRecording(f"folder:{place}", "::", None)})

    def keys() -> list[str]:
        tasks._recording.cache_clear()
        bundle = tasks.bundle(study, split, NETWORK)
        return [bundle.key, tasks.depth(NETWORK, split.recordings["as recorded"]).key]

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


def test_changed_frames_are_refused_by_an_existing_task(study: Study, tmp_path: Path) -> None:
    recording = write_room(tmp_path / "room", 6)
    task = tasks.bundle(study, Split("one", f"folder:{tmp_path / 'room'}", "::", {}), NETWORK)
    cv2.imwrite(str(tmp_path / "room" / "color" / "000003.png"), 255 - recording.color(3))
    with pytest.raises(DataError, match="has changed since this run began; run it again, with the same data"):
        build_frames(task.settings)


def test_some_of_the_build_frames_are_evenly_spaced(study: Study, split: Split) -> None:
    frames = build_frames(tasks.bundle(study, split, NETWORK, frames=5).settings)
    assert frames.frame_names == [f"{3 * index:06d}" for index in (0, 3, 6, 8, 11)]  # 11 / 4 apart, rounded
    with pytest.raises(DataError, match="has 12 build frames, not 13; ask for fewer"):
        build_frames(tasks.bundle(study, split, NETWORK, frames=13).settings)


def test_posenets_share_one_search_and_quick_ones_train_less(study: Study, split: Split) -> None:
    first, second = (tasks.posenet(study, split, "tiny", seed) for seed in (0, 1))
    assert first.key != second.key and first.needs == second.needs
    assert first.needs[0].settings["seed"] == 0
    whole = tasks.posenet(replace(study, quick=False), split, "tiny", 0)
    quick, full = first.settings["training"], whole.settings["training"]
    assert set(quick) == set(full) == set(PoseNetTraining.model_fields)  # every default is part of the key
    assert quick["epochs"] < full["epochs"] == PoseNetTraining().epochs
    with_views = tasks.posenet(study, split, "tiny", 0, views=True)
    assert with_views.settings["training"]["synthesised_views"] == 4 and with_views.needs != first.needs


def test_each_posenet_sees_its_own_noise_in_simulated_light(study: Study, split: Split) -> None:
    runs = [tasks.posenet_run(tasks.posenet(study, split, "tiny", seed), split.recordings["L3"]) for seed in (0, 1)]
    assert [run.settings["seed"] for run in runs] == [0, 1]
