"""Arguments of plots, and a check of the picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from monoloc.geometry import make_pose, se3_exp, so3_exp

FRAMES = 30


def check_picture(path: Path, least_width: int, least_height: int) -> None:
    image = cv2.imread(str(path))
    assert image is not None
    height, width = image.shape[:2]
    assert width >= least_width and height >= least_height
    assert len(np.unique(image.reshape(-1, 3)[::7] @ (1, 256, 65536))) > 20  # colours
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # no temporary file is left


def make_run() -> dict[str, Any]:
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
