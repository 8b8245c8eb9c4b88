"""Plots are written, of a sensible size and not blank."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from monoloc.errors import DataError, MissingExtraError
from monoloc.viz.plots import plot_depth, plot_localization, plot_training
from monoloc.viz.run_drawing import DrawnRun
from plot_helpers import check_picture, make_run


@pytest.mark.parametrize(
    "left_out",
    [
        (),
        ("truth", "covariances", "odometry", "unseen", "states", "mixture"),
    ],
)
def test_localization_is_drawn_with_any_arguments(tmp_path: Path, left_out: tuple[str, ...]) -> None:
    run = {name: value for name, value in make_run().items() if name not in left_out}
    plot_localization(tmp_path / "run.png", DrawnRun(**run), "k$\\frac{$")  # not a formula
    check_picture(tmp_path / "run.png", 1500, 900)


@pytest.mark.filterwarnings("error")
def test_localization_of_a_single_frame_is_drawn(tmp_path: Path) -> None:
    pose = np.eye(4)[None]
    run = DrawnRun(estimated=pose, timestamps_s=np.zeros(1), truth=pose, states=["lost"])
    plot_localization(tmp_path / "run.png", run)
    check_picture(tmp_path / "run.png", 1500, 900)


def test_truth_of_another_length_is_refused(tmp_path: Path) -> None:
    run = make_run()
    with pytest.raises(ValueError, match="estimated must have shape"):
        plot_localization(tmp_path / "run.png", DrawnRun(run["estimated"], run["timestamps_s"], run["truth"][1:]))
    assert list(tmp_path.iterdir()) == []


def test_depth_is_drawn(tmp_path: Path) -> None:
    images = 2
    rng = np.random.default_rng(0)
    colors = [rng.integers(0, 255, size=(48, 64, 3), dtype=np.uint8) for _ in range(images)]
    truths = [rng.uniform(1.0, 4.0, size=(24, 32)) for _ in range(images)]
    for truth in truths:
        truth[:5] = 0.0
    plot_depth(tmp_path / "depth.png", colors, [np.full((24, 32), 2.0)] * images, truths)
    check_picture(tmp_path / "depth.png", 1500, 300 * images)


def test_holes_in_predicted_depth_are_grey(tmp_path: Path) -> None:
    """As those of the sensor are; they are not evaluated."""
    rng = np.random.default_rng(0)
    color, truth = rng.integers(0, 255, size=(48, 64, 3), dtype=np.uint8), rng.uniform(1.0, 4.0, size=(24, 32))
    predicted = truth.copy()
    plot_depth(tmp_path / "depth.png", [color], [predicted], [truth])
    whole = cv2.imread(str(tmp_path / "depth.png"))
    predicted[:, :10] = 0.0
    plot_depth(tmp_path / "depth.png", [color], [predicted], [truth])
    check_picture(tmp_path / "depth.png", 1500, 300)
    with_holes = cv2.imread(str(tmp_path / "depth.png"))
    changed = np.any(with_holes != whole, axis=2)
    grey = np.all(with_holes == 0xD0, axis=2)
    assert changed.mean() > 0.05 and grey[changed].mean() > 0.9
    with pytest.raises(ValueError, match="truth must have a pixel that is finite and positive, got none"):
        plot_depth(tmp_path / "depth.png", [color], [np.zeros((24, 32))], [truth])


def test_unequal_numbers_of_images_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="equally many and not none, got 0, 1 and 1"):
        plot_depth(tmp_path / "depth.png", [], [np.ones((2, 2))], [np.ones((2, 2))])


def test_training_is_drawn(tmp_path: Path) -> None:
    history = [
        {"epoch": n, "train_$x^$": 1.0 / (n + 1), "validation_loss": 1.2 / (n + 1), "delta1": n / 9} for n in range(9)
    ]
    plot_training(tmp_path / "training.png", history)
    check_picture(tmp_path / "training.png", 900, 400)


@pytest.mark.parametrize("history", [[], [{"epoch": 1.0}]])
def test_empty_training_history_is_refused(tmp_path: Path, history: list[dict[str, float]]) -> None:
    with pytest.raises(ValueError, match="history must hold records"):
        plot_training(tmp_path / "training.png", history)


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"training\.png: cannot be written \(No such file or directory\); "):
        plot_training(tmp_path / "none" / "training.png", [{"epoch": 1, "loss": 1.0}])


def test_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r'plots needs the extra "report"'):
        plot_training(tmp_path / "training.png", [{"epoch": 1, "loss": 1.0}])


def test_matplotlib_is_imported_when_a_plot_is_drawn() -> None:
    code = "import sys, monoloc.viz.plots; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
