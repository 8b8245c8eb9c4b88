"""Pictures are made, of a sensible size and not blank; how they look is for eyes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from monoloc.errors import DataError, MissingExtraError
from monoloc.evaluation.cloud_metrics import cloud_distances
from monoloc.geometry import make_pose, se3_exp, so3_exp
from monoloc.supervision.state import State
from monoloc.viz.map_drawing import plot_map_change
from monoloc.viz.plots import plot_depth, plot_localization, plot_training
from monoloc.viz.run_drawing import _STATE_COLOURS, Run, _beside, draw_errors, view_axes

FRAMES = 30


def check_picture(path: Path, least_width: int, least_height: int) -> None:
    image = cv2.imread(str(path))
    assert image is not None
    height, width = image.shape[:2]
    assert width >= least_width and height >= least_height
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # no temporary file is left


def run_of_a_camera() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    angle = np.linspace(0.0, 3.0, FRAMES)
    turns = so3_exp(np.stack([0.0 * angle, angle, 0.0 * angle], axis=-1))
    truth = make_pose(turns, np.stack([np.cos(angle), 0.1 * angle, np.sin(angle)], axis=-1))
    roots = rng.normal(size=(12, 3, 3)) * 0.2
    return {
        "estimated": truth @ se3_exp(0.02 * rng.normal(size=(FRAMES, 6))),
        "timestamps_s": 100.0 + np.arange(FRAMES) / 15.0,
        "truth": truth,
        "covariances": np.tile(4e-4 * np.eye(6), (FRAMES, 1, 1)),
        "odometry": truth @ se3_exp(0.002 * rng.normal(size=(FRAMES, 6)).cumsum(axis=0)),
        "unseen": np.arange(FRAMES) % 4 != 0,
        "states": ["tracking"] * 20 + ["uncertain"] * 5 + ["lost"] * 5,
        "mixture": (rng.uniform(-2.0, 2.0, size=(12, 3)), roots @ roots.swapaxes(-1, -2)),
    }


def test_what_is_coloured_is_a_state_of_the_filter() -> None:
    assert set(_STATE_COLOURS) == set(get_args(State)) - {"tracking"}


@pytest.mark.parametrize(
    "left_out",
    [
        (),
        ("truth", "odometry"),
        ("truth", "covariances", "odometry", "unseen", "states", "mixture"),
    ],
)
def test_localization(tmp_path: Path, left_out: tuple[str, ...]) -> None:
    run = {name: value for name, value in run_of_a_camera().items() if name not in left_out}
    plot_localization(tmp_path / "run.png", **run, title="A turn")
    check_picture(tmp_path / "run.png", 1500, 900)


@pytest.mark.filterwarnings("error")
def test_localization_of_a_single_frame(tmp_path: Path) -> None:
    pose = np.eye(4)[None]
    plot_localization(tmp_path / "run.png", estimated=pose, truth=pose, timestamps_s=np.zeros(1), states=["lost"])
    check_picture(tmp_path / "run.png", 1500, 900)


def test_how_far_off_a_lost_camera_is_sets_no_axis() -> None:
    run = run_of_a_camera() | {"states": ["lost"] * 5 + ["tracking"] * (FRAMES - 5)}
    run["estimated"][:5, :3, 3] += 100.0
    run["covariances"][:5] = 100.0 * np.eye(6)
    for states, least_cm, most_cm in ((run["states"], 3.0, 50.0), (["lost"] * FRAMES, 1e4, 1e5)):
        figure = Figure()
        draw_errors(figure.subfigures(), Run(**run | {"states": states}))
        assert least_cm < figure.axes[0].get_ylim()[1] < most_cm


@pytest.mark.parametrize(
    ("down", "axes"),
    [
        ([0, 1, 0], (0, 2, 1, True)),  # 7-Scenes: y down, so x right and z forward
        ([0, -1, 0], (2, 0, 1, False)),
        ([0, 0, -1], (0, 1, 2, False)),  # most robots: z up
        ([1, 0, 0], (2, 1, 0, True)),
    ],
)
def test_the_top_view_looks_down_and_is_not_mirrored(down: list[float], axes: tuple[int, int, int, bool]) -> None:
    rotation = np.zeros((3, 3))
    rotation[:, 1] = down  # the camera's y axis in the world; the other two do not matter
    assert view_axes(make_pose(rotation, np.zeros(3))[None]) == axes
    right, forward, up, up_is_negative = axes
    sign = -1.0 if up_is_negative else 1.0
    np.testing.assert_array_equal(np.cross(np.eye(3)[right], np.eye(3)[forward]), sign * np.eye(3)[up])


@pytest.mark.parametrize("turned", range(0, 360, 30))
@pytest.mark.parametrize("flipped", [False, True])
def test_the_name_of_an_end_hides_no_way_and_stays_inside(turned: float, flipped: bool) -> None:
    """A straight way with arrows on one side of it leaves room on the other."""
    angle = np.deg2rad(turned)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    way = np.stack([np.linspace(0.0, 2.0, 60), np.zeros(60)], axis=-1) @ turn.T
    crowd = np.concatenate([way, way + turn @ [0.0, 0.2]])
    axis = Figure().subplots()
    axis.set_xlim(-2.5, 2.5)
    axis.set_ylim(*([2.5, -2.5] if flipped else [-2.5, 2.5]))
    (right_pt, up_pt), box = _beside(axis, way[0], crowd)
    assert np.abs(box).max() < 2.5
    low, high = box.min(axis=0), box.max(axis=0)
    assert not np.any(np.all((crowd > low) & (crowd < high), axis=1))
    np.testing.assert_array_equal(np.sign(box[0] - way[0]), np.sign([right_pt, -up_pt if flipped else up_pt]))


def test_localization_refuses_truth_of_another_length(tmp_path: Path) -> None:
    run = run_of_a_camera()
    with pytest.raises(ValueError, match="estimated must have shape"):
        plot_localization(
            tmp_path / "run.png",
            estimated=run["estimated"],
            truth=run["truth"][1:],
            timestamps_s=run["timestamps_s"],
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("down", [[0.0, 1.0, 0.0], [0.1, 0.0, -1.0]])
@pytest.mark.parametrize("shift_m", [0.0, 0.1])
@pytest.mark.filterwarnings("error")
def test_change_of_a_map(tmp_path: Path, down: list[float], shift_m: float) -> None:
    cloud = np.random.default_rng(0).uniform(0.0, [4.0, 3.0, 2.0], (3000, 3))
    distances_m = cloud_distances(cloud, cloud + shift_m)
    plot_map_change(tmp_path / "map.png", cloud, cloud + shift_m, distances_m, np.array(down), "A room")
    check_picture(tmp_path / "map.png", 1500, 1200)


@pytest.mark.parametrize("images", [1, 2])
def test_depth(tmp_path: Path, images: int) -> None:
    rng = np.random.default_rng(0)
    colors = [rng.integers(0, 255, size=(48, 64, 3), dtype=np.uint8) for _ in range(images)]
    truths = [rng.uniform(1.0, 4.0, size=(24, 32)) for _ in range(images)]
    for truth in truths:
        truth[:5] = 0.0
    plot_depth(tmp_path / "depth.png", colors, [np.full((24, 32), 2.0)] * images, truths)
    check_picture(tmp_path / "depth.png", 1500, 300 * images)


def test_depth_with_holes_in_what_is_predicted(tmp_path: Path) -> None:
    """They are drawn as what the sensor does not see is, and not judged."""
    rng = np.random.default_rng(0)
    color, truth = rng.integers(0, 255, size=(48, 64, 3), dtype=np.uint8), rng.uniform(1.0, 4.0, size=(24, 32))
    predicted = truth.copy()
    plot_depth(tmp_path / "depth.png", [color], [predicted], [truth])
    whole = cv2.imread(str(tmp_path / "depth.png"))
    predicted[:, :10] = 0.0
    plot_depth(tmp_path / "depth.png", [color], [predicted], [truth])
    check_picture(tmp_path / "depth.png", 1500, 300)
    holed = cv2.imread(str(tmp_path / "depth.png"))
    changed = np.any(holed != whole, axis=2)
    grey = np.all(holed == 0xD0, axis=2)
    assert changed.mean() > 0.05 and grey[changed].mean() > 0.9
    with pytest.raises(ValueError, match="truth must have a pixel that is finite and positive, got none"):
        plot_depth(tmp_path / "depth.png", [color], [np.zeros((24, 32))], [truth])


def test_depth_refuses_unequal_numbers_of_images(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="equally many and not none, got 0, 1 and 1"):
        plot_depth(tmp_path / "depth.png", [], [np.ones((2, 2))], [np.ones((2, 2))])


def test_a_dollar_in_a_name_is_no_formula(tmp_path: Path) -> None:
    names = "k$\\frac{$", "train_$x^$"
    plot_localization(tmp_path / "run.png", **run_of_a_camera(), title=names[0])
    check_picture(tmp_path / "run.png", 1500, 900)
    (tmp_path / "run.png").unlink()
    plot_training(tmp_path / "training.png", [{"epoch": n, names[1]: 1.0 / (n + 1)} for n in range(9)])
    check_picture(tmp_path / "training.png", 500, 400)


def test_training(tmp_path: Path) -> None:
    history = [
        {"epoch": n, "train_loss": 1.0 / (n + 1), "validation_loss": 1.2 / (n + 1), "delta1": n / 9} for n in range(9)
    ]
    plot_training(tmp_path / "training.png", history)
    check_picture(tmp_path / "training.png", 900, 400)


@pytest.mark.parametrize("history", [[], [{"epoch": 1.0}]])
def test_training_refuses_an_empty_history(tmp_path: Path, history: list[dict[str, float]]) -> None:
    with pytest.raises(ValueError, match="history must hold records"):
        plot_training(tmp_path / "training.png", history)


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"training\.png: cannot be written \(No such file or directory\); "):
        plot_training(tmp_path / "none" / "training.png", [{"epoch": 1, "loss": 1.0}])


def test_the_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r'plots needs the extra "report"'):
        plot_training(tmp_path / "training.png", [{"epoch": 1, "loss": 1.0}])


def test_matplotlib_is_not_imported_before_a_picture_is_made() -> None:
    code = "import sys, monoloc.viz.plots; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
