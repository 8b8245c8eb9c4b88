"""A film of a localised flight for the documentation; also an example of one's own viewer.

LIVING=lab/monoloc_lab/rooms/living
python -m monoloc_lab.make.flight_film $LIVING/living.monoloc folder:$LIVING/test/L3 --out docs/pictures/flight.webp
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from monoloc.bundle import Bundle, read_bundle
from monoloc.cli.common import open_source, stderr
from monoloc.files import write_whole
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording
from monoloc.progress import ConsoleProgress
from monoloc.run import localize
from monoloc.start import Start
from monoloc.step import LocalizedFrame, Step
from monoloc.viz.picture import BLUE, GREEN, INK, ORANGE, VERMILION
from monoloc.viz.run_drawing import draw_mixture, norm_bound_95, page_axes

_SIZE_IN, _DPI = (8.8, 4.4), 100
_DEPTH_M = (0.5, 5.0)
_EVERY = 2  # frames
_SIGMAS_95 = 2.448  # 95 % ellipse in two dimensions: the root of the chi-squared quantile


class Film:
    """Draws every second frame of a recording with true poses; a :class:`monoloc.viz.viewer.Viewer`.

    Args:
        start: (4, 4) ``T_world_camera`` from which the flight, and odometry, begin.
    """

    def __init__(self, start: FloatArray) -> None:
        self._start = start
        self._pictures: list[Image.Image] = []
        self._trajectory: list[FloatArray] = []
        self._odometry: list[FloatArray] = []

    def begin(self, room: Bundle, recording: Recording) -> None:
        assert recording.poses is not None
        self._map, self._truth = room.adapted, recording.poses
        self._period_ms = round(1e3 * _EVERY * float(np.median(np.diff(recording.timestamps_s))))
        right, forward, _, _ = page_axes(np.asarray(room.provenance.down_world))
        self._plane = [right, forward]

    def show(self, frame: LocalizedFrame) -> None:
        step = frame.step
        if frame.index == 0:
            self._to_start = self._start @ invert(frame.odometry)
        self._trajectory.append(step.estimate.pose)
        self._odometry.append(self._to_start @ frame.odometry)
        if frame.index % _EVERY:
            return
        figure = Figure(figsize=_SIZE_IN, dpi=_DPI, facecolor="white")
        image, depth, plan = (
            figure.add_axes(box, frame_on=False, xticks=[], yticks=[], anchor="NW")
            for box in ((0.01, 0.5, 0.33, 0.44), (0.01, 0.01, 0.33, 0.44), (0.345, 0.01, 0.645, 0.93))
        )
        image.imshow(frame.color)
        image.set_title("camera image", loc="left", fontsize=10)
        near_m, far_m = _DEPTH_M
        assert step.depth is not None  # there is no budget
        depth.imshow(step.depth.depth_m, vmin=near_m, vmax=far_m, extent=image.get_images()[0].get_extent())
        depth.set_title("depth predicted by a small network", loc="left", fontsize=10)
        self._draw_plan(plan, frame.index, step)
        content = io.BytesIO()
        figure.savefig(content, format="png")
        self._pictures.append(Image.open(content).convert("RGB"))

    def _draw_plan(self, axis: Axes, index: int, step: Step) -> None:
        pose, covariance, plane = step.estimate.pose, step.estimate.covariance[:3, :3], self._plane
        low_m, high_m = np.percentile(self._map.means[:, plane], [0.5, 99.5], axis=0)
        axis.set(xlim=(low_m[0] - 0.3, high_m[0] + 0.3), ylim=(low_m[1] - 0.3, high_m[1] + 0.3), aspect="equal")
        draw_mixture(axis, plane, self._map.means, self._map.covariances)

        scan = transform(pose, np.exp(step.estimate.log_scale) * step.scan.points)
        axis.plot(*scan[:, plane].T, ".", color=GREEN, markersize=3, label="depth scan")
        seen = np.zeros((0, 3)) if step.landmark_pose is None else step.landmark_pose.points
        axis.plot(*seen[:, plane].T, "x", color=VERMILION, markersize=3, label="landmarks")
        trajectories: list[tuple[str, FloatArray, dict[str, Any]]] = [
            ("truth", self._truth, {"color": INK, "linewidth": 4.0, "alpha": 0.35}),
            ("odometry", np.array(self._odometry), {"color": ORANGE, "linewidth": 1.4, "linestyle": "--"}),
            ("monoloc", np.array(self._trajectory), {"color": BLUE, "linewidth": 1.8}),
        ]
        for name, poses, style in trajectories:
            axis.plot(*poses[: index + 1, plane, 3].T, **style, label=name)

        angles = np.linspace(0.0, 2.0 * np.pi, 60)
        in_world = (pose[:3, :3] @ covariance @ pose[:3, :3].T)[np.ix_(plane, plane)]
        ring = _SIGMAS_95 * np.linalg.cholesky(in_world) @ [np.cos(angles), np.sin(angles)]
        axis.fill(*(pose[plane, 3, None] + ring), color=BLUE, alpha=0.15)
        axis.quiver(*pose[plane, 3], *pose[plane, 2], color=BLUE, angles="xy", scale=12.0, width=0.008, zorder=5)

        error_cm, odometry_cm = (
            100.0 * np.linalg.norm(estimate[:3, 3] - self._truth[index, :3, 3])
            for estimate in (pose, self._odometry[index])
        )
        bound_cm = 100.0 * norm_bound_95(covariance[None])[0]
        stated = f"{step.state}, error {error_cm:.0f} cm (stated 95 % bound {bound_cm:.0f})"
        axis.set_title(f"{stated}, odometry {odometry_cm:.0f}", loc="left", fontsize=10)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=9, frameon=False)

    def webp(self) -> bytes:
        """The film as an animated WebP."""
        content, (first, *others) = io.BytesIO(), self._pictures
        first.save(
            content,
            "webp",
            save_all=True,
            append_images=others,
            duration=self._period_ms,
            loop=0,
            quality=70,
            method=6,
        )
        return content.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("source", help="recording with true poses")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    recording, room = open_source(arguments.source, "::"), read_bundle(arguments.bundle)
    assert recording.poses is not None
    start = Start.disturbed(recording.poses[0], np.random.default_rng(0))
    film = Film(start.pose)
    rng = np.random.default_rng(0)
    localize(room, recording, start, rng, ConsoleProgress(stderr), viewer=film)
    write_whole(arguments.out, film.webp())


if __name__ == "__main__":
    main()
