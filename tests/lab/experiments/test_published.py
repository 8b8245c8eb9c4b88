"""Published splits: their layouts, what is wrong with them, and a scene's row from start to end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.builder.build_config import BuildConfig
from monoloc.config import override
from monoloc.geometry import FloatArray, invert
from monoloc.io.registry import open_recording, select_frames
from monoloc.io.seven_scenes import T_COLOR_DEPTH
from monoloc_lab.experiments.gather import trajectory
from monoloc_lab.experiments.published import over_scenes, read_scene, scene_row, scene_runs
from monoloc_lab.experiments.task import Result, Task
from refusals import refuses_data
from study_helpers import NETWORK, execute
from twelve_scenes_room import KITCHEN, write_kitchen

_QUICKEST = override(BuildConfig(), components=40, adapt={"tune": "none", "map_transform": False})


@pytest.fixture
def chess(tmp_path: Path) -> Path:
    """A scene of 7-Scenes of three sequences of two frames, of which the second is the test sequence."""
    write_seven_scenes_split(tmp_path / "chess")
    return tmp_path / "chess"


def write_seven_scenes_split(scene: Path) -> FloatArray:
    poses = synthetic.write_seven_scenes(scene, sequences=3, frames=2)
    (scene / "TrainSplit.txt").write_text("sequence1\r\nsequence3\r\n")
    (scene / "TestSplit.txt").write_text("sequence2\n")
    return poses


def frames_of(source: str, frames: str) -> list[str]:
    return select_frames(open_recording(source), frames).frame_names


def test_seven_scenes_trains_and_tests_on_the_sequences_of_its_files(tmp_path: Path) -> None:
    poses = write_seven_scenes_split(tmp_path / "chess")
    scene = read_scene("7scenes", tmp_path, "chess")
    assert (scene.name, scene.training, scene.notes) == ("chess", ["seq-01", "seq-03"], [])
    assert scene.split.frames == "0:2,4:6" and list(scene.split.recordings) == ["seq-02"]
    joined = select_frames(open_recording(scene.split.source), scene.split.frames)
    assert joined.frame_names == [f"seq-0{sequence}/frame-00000{frame}" for sequence in (1, 3) for frame in (0, 2)]
    assert np.diff(joined.timestamps_s)[1] > 1.0
    test = scene.split.recordings["seq-02"]
    tested = select_frames(open_recording(test.source), test.frames)
    np.testing.assert_allclose(tested.poses, poses[2:4] @ invert(T_COLOR_DEPTH), atol=1e-7)


def test_twelve_scenes_tests_on_its_first_sequence(tmp_path: Path) -> None:
    folder = tmp_path / "apt1" / "kitchen"
    synthetic.write_twelve_scenes(folder, [2, 2, 1])
    (folder / "data/frame-000001.pose.txt").write_text("\n".join(["-INF -INF -INF -INF"] * 4))
    scene = read_scene("12scenes", tmp_path, "apt1/kitchen")
    assert scene.training == ["sequence1", "sequence2"]
    assert frames_of(scene.split.source, scene.split.frames) == [
        *("sequence1/frame-000002", "sequence1/frame-000003", "sequence2/frame-000004"),
    ]
    test = scene.split.recordings["sequence0"]
    assert frames_of(test.source, test.frames) == ["sequence0/frame-000000"]
    assert scene.notes == ["1 of 5 frames are left out: 1 without a pose"]


@pytest.mark.parametrize(
    ("file", "text", "problem", "fix"),
    [
        ("TrainSplit.txt", None, "is missing", "restore it"),
        ("TestSplit.txt", None, "is missing", "restore it"),
        ("TestSplit.txt", "\n", "names no sequence", "sequenceN"),
        ("TestSplit.txt", "sequence2\ntwo\n", "line 2 is not a sequence", "sequenceN"),
        ("TestSplit.txt", "sequence12\n", "names sequence12, and there is no folder seq-12", "unpack seq-12.zip"),
        ("TestSplit.txt", "sequence2\nsequence3\n", "names seq-03, which TrainSplit.txt names too", "restore"),
    ],
)
def test_wrong_split_of_seven_scenes_is_refused(
    chess: Path, file: str, text: str | None, problem: str, fix: str
) -> None:
    (chess / file).unlink()
    if text is not None:
        (chess / file).write_text(text)
    refuses_data(lambda: read_scene("7scenes", chess.parent, "chess"), chess / file, problem, fix)


def test_scene_that_is_missing_or_has_no_poses_is_refused(chess: Path) -> None:
    fire = chess.with_name("fire")
    refuses_data(lambda: read_scene("7scenes", chess.parent, "fire"), fire, "is missing", "--scene")
    for file in chess.rglob("*.pose.txt"):
        file.unlink()
    refuses_data(lambda: read_scene("7scenes", chess.parent, "chess"), chess, "has no poses", "pose.txt files too")


def test_test_sequence_that_has_no_frames_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "apt1" / "kitchen"
    synthetic.write_twelve_scenes(folder, [1, 2])
    (folder / "data/frame-000000.pose.txt").unlink()
    problem = "has no usable frame of sequence0"
    refuses_data(lambda: read_scene("12scenes", tmp_path, "apt1/kitchen"), folder, problem, "unpack")


def test_scene_of_one_sequence_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "apt1" / "kitchen"
    synthetic.write_twelve_scenes(folder, [2])
    split = folder / "split.txt"
    refuses_data(lambda: read_scene("12scenes", tmp_path, "apt1/kitchen"), split, "one sequence", "training")


@pytest.mark.slow
def test_scene_is_built_of_its_training_sequences_and_flown_without_a_start(tmp_path: Path) -> None:
    walks = write_kitchen(tmp_path / KITCHEN, [12, 30, 18])
    scene = read_scene("12scenes", tmp_path, KITCHEN)
    runs = scene_runs(scene, NETWORK, _QUICKEST)
    (tmp_path / "out").mkdir()
    done: dict[str, Result] = {}
    for run in runs.values():
        execute(run, tmp_path / "out", done)
    results: dict[Task, Result] = {task: done[task.key] for run in runs.values() for task in (run, *run.needs)}
    row = scene_row(scene, runs, results)
    assert (row["training_frames"], row["build_frames"], row["test_frames"]) == (48, 48, 12)
    arrays = trajectory(results[runs["sequence0"]])
    np.testing.assert_allclose(arrays["truth"], walks[0], atol=1e-9)
    assert arrays["unseen"].all()
    assert row["position_median_cm"] < 20.0  # landmarks find the camera: the room is 5 m long


def test_mean_and_median_are_over_scenes() -> None:
    rows = [
        {"position_median_cm": cm, "rotation_median_deg": 1.0, "within_5cm_5deg": share}
        for cm, share in ((2.0, 0.9), (3.0, 0.8), (10.0, 0.1))
    ]
    summary = over_scenes(rows)
    assert summary["mean"]["position_median_cm"] == pytest.approx(5.0)
    assert summary["median"] == {"position_median_cm": 3.0, "rotation_median_deg": 1.0, "within_5cm_5deg": 0.8}
