"""The definition of a study: recordings, splits, lights, networks and seeds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc.depth.models import shipped_models
from monoloc_lab.rooms import LIVING, build_of, tests_of

WIDTH = 0.35
SIZES = tuple(model.name.rpartition("-")[0] for model in shipped_models() if model.width == WIDTH)
"""Sizes of the depth networks, largest first."""
FRAMES_PER_BUILD_FRAME = 4
"""In every split one of so many frames of the recording is a build frame."""
AS_RECORDED = "as recorded"
"""Name of the light that a real recording was taken in."""
_SEEDS = 5
_QUICK_ADAPT: dict[str, Any] = {"steps": 200, "synthesised_views": 300}


@dataclass(frozen=True)
class EvalRecording:
    """Frames that are localised and compared with the truth.

    Attributes:
        source, frames: as on the command line.
        light: one of :data:`monoloc_lab.synth.light.LIGHTS`, in which the images are simulated; None for the light
            they were recorded in.
        alteration: key of :data:`monoloc_lab.experiments.altered.ALTERATIONS`; None for the recording itself.
    """

    source: str
    frames: str
    light: str | None
    alteration: str | None = None


@dataclass(frozen=True)
class Split:
    """Build frames, and evaluation recordings in several lights. No error counts a build frame.

    Attributes:
        name: in tables, as ``extrapolation``.
        source, frames: of the build, as on the command line.
        recordings: by the light's name: ``L1`` to ``L3``, and :data:`AS_RECORDED` for a real recording. Those of a
            published split by the sequence.
        alteration: of the build frames, as in :class:`EvalRecording`.
    """

    name: str
    source: str
    frames: str
    recordings: dict[str, EvalRecording]
    alteration: str | None = None


@dataclass(frozen=True)
class Study:
    """Everything that a reproduction depends on.

    Attributes:
        title: of the report.
        splits: plots of a single split show the first.
        sizes: of the networks, largest first.
        adapt: settings of adaptation that differ from the defaults; a quick study takes fewer steps.
        seeds: number of starts of a run, and of trainings of a PoseNet.
        builds: number of builds of a room; a run with seed s uses build s modulo this number.
        quick: whether the most expensive parts are left out; the report says so.
        encoder_weights: file with the initial weights of the PoseNets' encoders; None for the encoder of the largest
            depth network, which started from ImageNet and was then trained on NYU Depth v2.
    """

    title: str
    splits: tuple[Split, ...]
    sizes: tuple[str, ...]
    adapt: dict[str, Any]
    seeds: int
    builds: int
    quick: bool
    encoder_weights: str | None = None


def builtin(quick: bool) -> Study:
    """The rendered room of the package."""
    return rendered(LIVING, "living room", quick)


def rendered(folder: Path, name: str, quick: bool) -> Study:
    """A room of :mod:`monoloc_lab.make.rendered_room`: built from one flight, evaluated on another in each light."""
    recordings = {light: EvalRecording(f"folder:{path}", "::", None) for light, path in tests_of(folder).items()}
    split = Split(name, f"folder:{build_of(folder)}", "::2" if quick else "::", recordings)
    return _study(f"rendered {name}", (split,), quick)


def recorded(source: str, name: str, frames: int, quick: bool, build: str | None = None) -> Study:
    """A recording of one room with poses and depth, in two splits.

    *extrapolation* builds from every third frame of the first three quarters and evaluates on the last quarter.
    *interpolation* builds from every fourth frame and evaluates on the others. Lights are simulated on the images,
    see :func:`monoloc_lab.synth.light.relit`.

    Args:
        frames: number of frames of the recording.
        build: other build frames of *extrapolation*, START:STOP:STEP; the frames from STOP are evaluated.
    """
    last = 3 * frames // 4 if build is None else int(build.split(":")[1])
    lights = {AS_RECORDED: None, "L1": "L1", "L2": "L2", "L3": "L3"}
    splits = tuple(
        Split(split, source, build, {name: EvalRecording(source, evaluated, light) for name, light in lights.items()})
        for split, build, evaluated in (
            ("extrapolation", build or f"0:{last}:3", f"{last}:{frames}"),
            ("interpolation", f"0:{frames}:4", f"0:{frames}"),
        )
    )
    return _study(name, splits[:1] if quick else splits, quick)


def _study(title: str, splits: tuple[Split, ...], quick: bool) -> Study:
    return Study(
        title=title,
        splits=splits,
        sizes=("full", "one-third") if quick else SIZES,
        adapt=_QUICK_ADAPT if quick else {},
        seeds=_SEEDS,
        builds=1 if quick else _SEEDS,
        quick=quick,
    )
