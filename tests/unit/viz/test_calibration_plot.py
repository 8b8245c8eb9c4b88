"""The plot of a network's stated errors against its actual ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.evaluation.uncertainty import ErrorCalibration, error_calibration
from monoloc.viz.calibration_plot import plot_calibration


@pytest.fixture(scope="module")
def calibrations() -> dict[str, ErrorCalibration]:
    rng = np.random.default_rng(0)
    log_scale = rng.normal(np.log(0.1), 0.8, 2000)
    error = rng.laplace(scale=np.exp(log_scale))
    return {
        "calibrated": error_calibration(error, log_scale),
        "overconfident": error_calibration(error, log_scale - 0.7),
    }


def test_plot_is_written(tmp_path: Path, calibrations: dict[str, ErrorCalibration]) -> None:
    plot_calibration(tmp_path / "calibration.png", calibrations)
    image = cv2.imread(str(tmp_path / "calibration.png"))
    assert image is not None and image.shape[0] >= 400 and image.shape[1] >= 900
    assert len(np.unique(image.reshape(-1, 3)[::7] @ (1, 256, 65536))) > 20
    assert [path.name for path in tmp_path.iterdir()] == ["calibration.png"]


def test_plot_that_cannot_be_written_is_an_error(tmp_path: Path, calibrations: dict[str, ErrorCalibration]) -> None:
    with pytest.raises(DataError, match=r"calibration\.png: cannot be written"):
        plot_calibration(tmp_path / "absent" / "calibration.png", calibrations)
