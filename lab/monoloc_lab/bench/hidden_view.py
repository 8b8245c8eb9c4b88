"""A picture of the depth that is left of images with propeller guards, or drops on the lens, in them.

python -m monoloc_lab.bench.hidden_view --out docs/pictures/hidden-view.webp
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from monoloc.bundle import read_bundle
from monoloc.files import write_whole
from monoloc.io.registry import open_recording
from monoloc.localizer import Localizer
from monoloc.start import Start
from monoloc.step import Step
from monoloc_lab.bench.faults import FAULTS, Surroundings
from monoloc_lab.bench.judged_flight import FlightFrame, Image
from monoloc_lab.rooms import BUILD, BUNDLE, TESTS

_SIZE_IN, _DPI = (8.0, 3.7), 100
_ROWS = {"propeller-guards": "guards", "drops": "drops"}
_FRAMES = (0, 45, 60)  # that are shown
_DEPTH_M = (0.5, 5.0)


def flown(fault: str) -> Iterator[tuple[Image, Step]]:
    """Images and steps of a flight in the rendered room of the package."""
    recording, build = open_recording(f"folder:{TESTS['L1']}"), open_recording(f"folder:{BUILD}")
    assert recording.poses is not None
    times_s = recording.timestamps_s.tolist()
    frames = [
        FlightFrame(partial(recording.color, index), times_s[index], recording.poses[index])
        for index in range(_FRAMES[-1] + 1)
    ]
    around = Surroundings(frames[0], build.color, np.random.default_rng(0))
    localizer = Localizer(read_bundle(BUNDLE), recording.camera, Start(recording.poses[0], 0.05, 0.02))
    before_s = times_s[0]
    for frame in FAULTS[fault].change(frames, around):
        image = frame.image()
        yield image, localizer.step(image, frame.time_s - before_s)
        before_s = frame.time_s


def draw(figure: Figure) -> None:
    grid = figure.subplots(len(_ROWS), len(_FRAMES) + 1)
    for axes, (fault, name) in zip(grid, _ROWS.items(), strict=True):
        steps = list(flown(fault))
        _show(axes[0], name)
        axes[0].imshow(steps[_FRAMES[-1]][0])
        for axis, index in zip(axes[1:], _FRAMES, strict=True):
            step = steps[index][1]
            assert step.depth is not None
            _show(axis, f"frame {index}: {step.standing_share:.0%} left out")
            known = np.ma.masked_equal(step.depth.depth_m, 0.0)
            axis.imshow(known, vmin=_DEPTH_M[0], vmax=_DEPTH_M[1], cmap="viridis")


def _show(axis: Axes, title: str) -> None:
    axis.set_title(title, loc="left", fontsize=9)
    axis.set_xticks([])
    axis.set_yticks([])
    axis.set_frame_on(False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    figure, content = Figure(_SIZE_IN, dpi=_DPI, layout="constrained"), io.BytesIO()
    draw(figure)
    figure.savefig(content, format="webp")
    write_whole(parser.parse_args().out, content.getvalue())


if __name__ == "__main__":
    main()
