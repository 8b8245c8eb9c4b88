"""What is studied: recordings, how they are split, in which lights, with which networks and how many seeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from monoloc.depth.models import shipped_models
from monoloc_lab.rooms import BUILD, TESTS

WIDTH = 0.35
SIZES = tuple(model.name.rpartition("-")[0] for model in shipped_models() if model.width == WIDTH)
"""Of depth networks, largest first."""
FRAMES_PER_BUILT = 4
"""Of how many frames of a recording one builds a room, in every split."""
_SEEDS = 5
_QUICK_ADAPT: dict[str, Any] = {"steps": 200, "synthesised_views": 300}


@dataclass(frozen=True)
class Walk:
    """Frames to be localised.

    Attributes:
        source, frames: as on the command line.
        light: one of :data:`monoloc_lab.synth.light.LIGHTS`, which the images are changed to; None leaves them.
    """

    source: str
    frames: str
    light: str | None


@dataclass(frozen=True)
class Split:
    """Frames to build from, and frames to be judged on in every light; those that built are never judged.

    Attributes:
        name: in tables, as ``away``.
        walks: by the light's name: ``L1`` to ``L3``, and ``as taken`` for a recording that was not rendered.
    """

    name: str
    source: str
    frames: str
    walks: dict[str, Walk]


@dataclass(frozen=True)
class Study:
    """All that a reproduction depends on.

    Attributes:
        title: of the report.
        splits: the first is the one that single pictures are drawn of.
        sizes: of networks, largest first.
        adapt: settings of adaptation that differ from the default's; a quick study tunes for fewer steps.
        seeds: of the starts of runs, and of trainings of PoseNets.
        builds: how often a room is built anew; a run with seed s is in build s modulo that.
        quick: whether what costs most is left out; the report says so.
        encoder_weights: file that PoseNets' encoders start from; None for the largest depth network's, which started
            from ImageNet and then learned NYU Depth v2.
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
    """The room that comes with monoloc: one flight to build from, another in three rendered lights."""
    walks = {light: Walk(f"folder:{path}", "::", None) for light, path in TESTS.items()}
    split = Split("living room", f"folder:{BUILD}", "::2" if quick else "::", walks)
    return Study(
        title="rendered living room",
        splits=(split,),
        sizes=("full", "one-third") if quick else SIZES,
        adapt=_QUICK_ADAPT if quick else {},
        seeds=_SEEDS,
        builds=1 if quick else _SEEDS,
        quick=quick,
    )


def recorded(source: str, name: str, frames: int, quick: bool) -> Study:
    """A recording with poses and depth, of one room: split between build frames, and away from them.

    *away* builds from every third frame of the first three quarters and is judged on the last quarter; *between*
    builds from every fourth frame and is judged on all others. The lights are put on the images, see
    :func:`monoloc_lab.synth.light.relit`.

    Args:
        frames: how many it has.
    """
    last = 3 * frames // 4
    splits = tuple(
        Split(split, source, build, {light: Walk(source, judged, _changed(light)) for light in _LIGHTS})
        for split, build, judged in (
            ("away", f"0:{last}:3", f"{last}:{frames}"),
            ("between", f"0:{frames}:4", f"0:{frames}"),
        )
    )
    return Study(
        title=name,
        splits=splits[:1] if quick else splits,
        sizes=("full", "one-third") if quick else SIZES,
        adapt=_QUICK_ADAPT if quick else {},
        seeds=_SEEDS,
        builds=1 if quick else _SEEDS,
        quick=quick,
    )


_LIGHTS = ("as taken", "L1", "L2", "L3")


def _changed(light: str) -> str | None:
    return None if light == "as taken" else light
