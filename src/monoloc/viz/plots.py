"""Figures of a localisation run, of predicted depth and of training.

Each function writes one PNG atomically.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.evaluation.depth_metrics import depth_metrics, truth_where_predicted
from monoloc.viz.picture import BLUE, ORANGE, picture
from monoloc.viz.run_drawing import DrawnRun, draw_errors, draw_views


def plot_localization(path: str | Path, run: DrawnRun, title: str = "") -> None:
    """Plot the trajectory over the map, from above and from the side, and its errors over time.

    Up is the signed world axis that is closest to the negative mean y axis of the cameras. Hence worlds with y down
    and worlds with z up are both shown from above. Without true poses, the right half shows only the bounds of the
    covariance.

    Args:
        path: PNG to write.
        run: what is drawn.
        title: title of the figure.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
        ValueError: an array does not match the estimate, or a pose is not finite.
    """
    with picture(path, 13.0, 7.8) as figure:
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        maps, errors = figure.subfigures(1, 2, squeeze=False, width_ratios=[1.0, 1.1], wspace=0.03)[0]
        shown = draw_views(maps, run) | draw_errors(errors, run)
        figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=8)


def plot_depth(
    path: str | Path,
    colors: Sequence[NDArray[np.uint8]],
    predicted_m: Sequence[ArrayLike],
    truth_m: Sequence[ArrayLike],
) -> None:
    """Plot one row per image: colour, predicted depth, true depth, and signed relative error.

    Args:
        path: PNG to write.
        colors: images (H, W, 3) uint8, RGB, of any size.
        predicted_m: depth images (h, w), metres; 0 where unknown, which is grey and excluded from the metrics.
        truth_m: depth images (h, w), metres; 0 or NaN where unknown, which is grey.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
        ValueError: there is no image, the lists differ in length, or an image has no pixel with both depths.
    """
    if not len(colors) == len(predicted_m) == len(truth_m) >= 1:
        raise ValueError(
            "colors, predicted_m and truth_m must be equally many and not none, "
            f"got {len(colors)}, {len(predicted_m)} and {len(truth_m)}"
        )
    metrics = [depth_metrics(p, truth_where_predicted(p, t)) for p, t in zip(predicted_m, truth_m, strict=True)]
    predictions, truths = ([np.where(np.asarray(d) > 0.0, d, np.nan) for d in ds] for ds in (predicted_m, truth_m))
    near_m, far_m = np.nanpercentile(np.concatenate([t.ravel() for t in truths]), [1.0, 99.0])

    aspect = colors[0].shape[0] / colors[0].shape[1]
    with picture(path, 13.0, 3.3 * aspect * len(colors) + 1.0) as figure:
        grid = figure.subplots(len(colors), 4, squeeze=False)
        for row, color, predicted, truth, metric in zip(grid, colors, predictions, truths, metrics, strict=True):
            row[0].imshow(color)
            for axis, image in ((row[1], predicted), (row[2], truth)):
                depth = axis.imshow(image, cmap="viridis", vmin=near_m, vmax=far_m)
            error = row[3].imshow(100.0 * (predicted - truth) / truth, cmap="PuOr", vmin=-50.0, vmax=50.0)
            row[3].set_title(f"AbsRel {metric.absrel:.3f}, δ1 {metric.delta1:.3f}", loc="right", fontsize=9)
            for axis in row:
                axis.set(xticks=[], yticks=[], facecolor="#D0D0D0")
                axis.grid(False)
        for axis, name in zip(grid[0], ("Colour", "Predicted depth", "True depth", "Error"), strict=True):
            axis.set_title(name)
        # The colour bar also takes space below the colour column, so that all columns stay aligned.
        figure.colorbar(
            depth, ax=grid[:, :3], location="bottom", label="depth (m)", extend="both",
            shrink=0.66, anchor=(1.0, 1.0), aspect=40,
        )  # fmt: skip
        figure.colorbar(error, ax=grid[:, 3], location="bottom", label="(predicted - true) / true (%)", extend="both")


def plot_training(path: str | Path, history: Sequence[Mapping[str, float]]) -> None:
    """Plot each quantity over epochs or steps in its own panel; ``train_x`` and ``validation_x`` share panel ``x``.

    Args:
        path: PNG to write.
        history: one record per epoch or step, all with the same keys. The first key is the horizontal axis. NaN
            leaves a gap.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
        ValueError: the history is empty, or its records have only one key.
    """
    if not history or len(history[0]) < 2:
        raise ValueError("history must hold records of a step and at least one quantity")
    step, *names = history[0]
    quantities = {name: name.removeprefix("train_").removeprefix("validation_") for name in names}
    panels = list(dict.fromkeys(quantities.values()))
    with picture(path, 3.8 * len(panels) + 0.4, 3.6) as figure:
        axes = dict(zip(panels, figure.subplots(1, len(panels), squeeze=False)[0], strict=True))
        steps = [record[step] for record in history]
        for name, quantity in quantities.items():
            colour = ORANGE if name.startswith("train_") else BLUE
            values = [record[name] for record in history]
            axes[quantity].plot(steps, values, ".-", color=colour, linewidth=1.5, label=name.replace("_", " "))
        for panel, axis in axes.items():
            axis.set(title=panel.replace("_", " "), xlabel=step)
            if len(axis.lines) > 1:
                axis.legend()
