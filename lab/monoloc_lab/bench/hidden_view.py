"""A picture of what is found to stand still in images with propeller guards, or with drops on the lens.

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
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from monoloc.bundle import read_bundle
from monoloc.files import write_whole
from monoloc.io.registry import open_recording
from monoloc.localizer import Localizer
from monoloc.start import Start
from monoloc.step import Step
from monoloc.viz.picture import VERMILION
from monoloc_lab.bench.fault_flights import with_fault
from monoloc_lab.bench.faults import FAULTS
from monoloc_lab.bench.judged_flight import FlightFrame, Image
from monoloc_lab.rooms import BUILD, BUNDLE, TESTS

_SIZE_IN, _DPI = (8.0, 3.7), 100
_FAULTS = ("propeller-guards", "drops")
_FRAMES = (0, 45, 60)  # that are shown
_MARK = ListedColormap([VERMILION])


def flown(fault: str, frames: int) -> Iterator[tuple[Image, Step]]:
    """Images and steps of a flight in the rendered room of the package, with one of the faults."""
    recording, build = open_recording(f"folder:{TESTS['L1']}"), open_recording(f"folder:{BUILD}")
    assert recording.poses is not None
    times_s = recording.timestamps_s.tolist()
    clean = [
        FlightFrame(partial(recording.color, index), times_s[index], recording.poses[index])
        for index in range(frames)
    ]
    changed, _ = with_fault(FAULTS[fault], clean, build.color, np.random.default_rng(0))
    localizer = Localizer(read_bundle(BUNDLE), recording.camera, Start(recording.poses[0], 0.05, 0.02))
    before_s = times_s[0]
    for frame in changed:
        image = frame.image()
        yield image, localizer.step(image, frame.time_s - before_s)
        before_s = frame.time_s


def draw(figure: Figure) -> None:
    for axes, fault in zip(figure.subplots(len(_FAULTS), len(_FRAMES)), _FAULTS, strict=True):
        steps = list(flown(fault, _FRAMES[-1] + 1))
        for axis, index in zip(axes, _FRAMES, strict=True):
            image, step = steps[index]
            _show(axis, f"frame {index}: {step.standing_share:.0%} stands still")
            axis.imshow(image)
            if step.standing is not None:
                height, width = image.shape[:2]
                marked = np.ma.masked_equal(step.standing, False)
                axis.imshow(marked, extent=(-0.5, width - 0.5, height - 0.5, -0.5), cmap=_MARK, alpha=0.7)


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
