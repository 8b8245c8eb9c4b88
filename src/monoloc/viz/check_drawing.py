"""Picture of a check: corners against poses, sharpness and exposure over time, the path from above, the findings."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.image_quality import BLURRED
from monoloc.recording_check.inspection import Inspection, Level
from monoloc.recording_check.pose_hypotheses import as_stated
from monoloc.viz.picture import BLUE, GREEN, GREY, INK, ORANGE, VERMILION, picture
from monoloc.viz.run_drawing import view_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS: dict[Level, str] = {"good": GREEN, "warning": ORANGE, "bad": VERMILION}
_MOST_ARROWS = 70
_REMARK_WIDTH = 92  # letters of a line


def plot_check(path: str | Path, inspection: Inspection, title: str = "") -> None:
    """Draw a check of a recording.

    Args:
        path: PNG to write.
        inspection: what was found.
        title: of the figure.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written, or an image cannot be read.
    """
    lines = sum(1 + len(_remark_lines(finding.remark)) for finding in inspection.findings)
    with picture(path, 12.5, 7.4 + 0.24 * lines) as figure:
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[7.0, 0.24 * lines + 0.4])[:, 0]
        axes = above.subplots(2, 2, width_ratios=[1.25, 1.0])
        _draw_corners(axes[0][0], inspection)
        _draw_errors(axes[0][1], inspection)
        _draw_images(axes[1][0], inspection)
        _draw_path(axes[1][1], inspection)
        _write_findings(below.subplots(), inspection)


def _draw_corners(axis: Axes, inspection: Inspection) -> None:
    """The image of a typical pair, with where poses and depth put its corners, and where they are."""
    axis.grid(False)
    axis.set(xticks=[], yticks=[])
    evidence = inspection.evidence
    errors = None if evidence is None else as_stated(evidence).shares
    if evidence is None or errors is None or not np.isfinite(errors).any():
        index = len(inspection.recording) // 2
        axis.imshow(inspection.recording.color(index))
        axis.set_title(f"Frame {inspection.recording.frame_names[index]}")
        return
    typical = int(np.nanargmin(np.abs(errors - np.nanmedian(errors))))
    predicted, seen = _pair(evidence, typical)
    camera = evidence.matches.camera
    frame = int(evidence.matches.frames[typical, 1])
    gray = cv2.cvtColor(inspection.recording.color(frame), cv2.COLOR_RGB2GRAY)
    axis.imshow(gray, cmap="gray", extent=(-0.5, camera.width - 0.5, camera.height - 0.5, -0.5), alpha=0.75)
    axis.plot(*np.stack([predicted, seen]).transpose(2, 0, 1), color=VERMILION, linewidth=1.2)
    axis.plot(*predicted.T, "o", color=VERMILION, markersize=3.0, label="where poses and depth put it")
    axis.plot(*seen.T, "o", color=BLUE, markersize=3.0, label="corner")
    axis.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))
    names = [name.rpartition("/")[2] for name in inspection.recording.frame_names]
    axis.set_title(f"Corners from frame {names[int(evidence.matches.frames[typical, 0])]} in {names[frame]}")
    axis.legend(loc="upper left", bbox_to_anchor=(0.0, -0.01), ncols=2, borderpad=0.1)


def _pair(evidence: Evidence, index: int) -> tuple[FloatArray, NDArray[np.float32]]:
    """Predicted and matched pixels of some corners of a pair, (M, 2) each, of the matches' camera."""
    depth_m = evidence.depth_m(evidence.poses)
    predicted = evidence.reproject.predicted_px(evidence.relative(evidence.poses), depth_m)
    of = evidence.matches.of_pair(index)
    known = np.flatnonzero((depth_m[of] > 0.0) & np.isfinite(predicted[of]).all(axis=1))
    known = known[:: max(1, len(known) // _MOST_ARROWS)]
    return predicted[of][known], evidence.matches.pixels[of][known, 1]


def _draw_errors(axis: Axes, inspection: Inspection) -> None:
    """Errors of all pairs, under the poses and under the corners' own motion."""
    axis.set_title("Corners' error, share of their motion")
    evidence, poses = inspection.evidence, inspection.poses
    if evidence is None or poses is None or poses.share is None:
        _say(axis, "poses are not compared with the images")
        return
    depth_m = evidence.depth_m(evidence.poses)
    free = evidence.reproject(evidence.reproject.free_motion(depth_m), depth_m).shares
    frames = evidence.matches.frames[:, 0]
    percent = 100.0 * as_stated(evidence).shares
    axis.plot(frames, percent, "o", color=VERMILION, markersize=4.0, label="by poses and depth")
    axis.plot(frames, 100.0 * free, "o", color=BLUE, markersize=4.0, label="by the corners' own motion")
    axis.axhline(100.0 * poses.share, color=VERMILION, linewidth=1.0)
    if poses.explanation is not None:
        share = 100.0 * poses.explanation.share
        axis.axhline(share, color=GREEN, linewidth=1.5, label=textwrap.shorten(poses.explanation.what, 48))
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:g} %")
    most = float(np.nanmax(np.append(percent[np.isfinite(percent)], 100.0)))
    axis.set(xlabel="frame", ylim=(0.7, 12.0 * most))  # with room for the legend
    axis.legend(loc="upper left")


def _draw_images(axis: Axes, inspection: Inspection) -> None:
    """Blur and brightness of the images that were looked at."""
    images = inspection.images
    axis.plot(images.frames, images.blur, ".-", color=BLUE, linewidth=1.2, label="blur")
    axis.axhline(BLURRED, color=BLUE, linewidth=1.0, linestyle="--", label="blurred above")
    axis.plot(images.frames, images.brightness / 255.0, ".-", color=ORANGE, linewidth=1.2, label="brightness")
    axis.plot(images.frames, images.dark + images.saturated, color=GREY, linewidth=1.2, label="black or saturated")
    axis.set(xlabel="frame", ylim=(0.0, 1.0), title="Images, from 0 to 1")
    axis.legend(loc="upper right", ncols=4, frameon=True, framealpha=0.9, edgecolor="none")


def _draw_path(axis: Axes, inspection: Inspection) -> None:
    """Positions and views from above: along the world axis that is nearest to the cameras' down."""
    axis.set_title("Path from above")
    poses = inspection.recording.poses
    if poses is None:
        _say(axis, "no poses")
        return
    first, second, _, _ = view_axes(poses)
    positions = poses[:, :3, 3]
    axis.plot(positions[:, first], positions[:, second], color=BLUE, linewidth=1.5)
    some = poses[:: max(1, len(poses) // 40)]
    axis.quiver(
        some[:, first, 3], some[:, second, 3], some[:, first, 2], some[:, second, 2],
        color=GREY, width=0.0035, scale=18.0, label="view",
    )  # fmt: skip
    axis.plot(positions[0, first], positions[0, second], "o", color=GREEN, label="start")
    axis.margins(0.12)  # arrows reach beyond the path
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel=f"{'xyz'[first]} (m)", ylabel=f"{'xyz'[second]} (m)")
    axis.legend(loc="best")


def _write_findings(axis: Axes, inspection: Inspection) -> None:
    """The findings as lines of text, each with a spot of its colour."""
    axis.set_axis_off()
    rows = [(finding, _remark_lines(finding.remark)) for finding in inspection.findings]
    count = sum(1 + len(remark) for _, remark in rows)
    axis.set(xlim=(0.0, 1.0), ylim=(count + 0.2, -0.6))
    at = 0
    for finding, remark in rows:
        axis.plot([0.008], [at], "o", color=_COLOURS[finding.level], markersize=8.0)
        axis.text(0.025, at, finding.name, va="center", fontsize=10, fontweight="bold", color=INK)
        axis.text(0.14, at, finding.value, va="center", fontsize=10, color=INK)
        for offset, line in enumerate(remark, start=1):
            axis.text(0.14, at + offset, line, va="center", fontsize=9.5, color=_COLOURS[finding.level])
        at += 1 + len(remark)


def _remark_lines(remark: str) -> list[str]:
    return textwrap.wrap(remark, _REMARK_WIDTH, break_long_words=False)


def _say(axis: Axes, text: str) -> None:
    axis.set_axis_off()
    axis.text(0.5, 0.5, text, ha="center", va="center", color=GREY, transform=axis.transAxes)
