"""Calibration plot of a depth network: stated errors against actual errors."""

from __future__ import annotations

from pathlib import Path

from monoloc.evaluation.uncertainty import ErrorCalibration
from monoloc.viz.picture import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, picture

_COLOURS = (BLUE, ORANGE, GREEN, VERMILION, PURPLE)


def plot_calibration(path: str | Path, calibrations: dict[str, ErrorCalibration]) -> None:
    """Plot actual over stated error (left) and coverage over confidence (right); the diagonal is perfect calibration.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
    """
    with picture(path, 10.0, 4.6) as figure:
        errors, coverage = figure.subplots(1, 2)
        most = max(float(max(c.stated.max(), c.actual.max())) for c in calibrations.values())
        errors.plot([0.0, most], [0.0, most], color=GREY, linewidth=1.0)
        coverage.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linewidth=1.0)
        for index, (name, calibration) in enumerate(calibrations.items()):
            style = {"marker": ".", "color": _COLOURS[index % len(_COLOURS)], "label": name}
            errors.plot(calibration.stated, calibration.actual, **style)
            coverage.plot(calibration.confidence, calibration.coverage, **style)
        errors.set(xlabel="stated error of log-depth", ylabel="actual error", title="Ten bins, most certain first")
        coverage.set(xlabel="confidence", ylabel="share within", title="Coverage", xlim=(0, 1), ylim=(0, 1))
        errors.legend()
