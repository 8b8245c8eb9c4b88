"""The ladder from the paper's method to the default: each rung adds one thing. And pairs that separate two causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from monoloc.builder.build_config import METHODS, BuildConfig
from monoloc.config import override
from monoloc.localizer_config import ADDITIONS, Part

_LIKE_DEFAULT = {"steps": 600, "network_rate": 0.0015}  # of tuning with ``all``, so that only the layers differ
_BY_MAP: dict[str, Any] = {"learns_from": "map", "synthesised_views": 0, "relit_share": 0.0, "pose_weight": 0.0}


@dataclass(frozen=True)
class Rung:
    """A method: how a room is built, and what is left out in flight.

    Attributes:
        name: in tables.
        build: settings of the build.
        without: parts that are left out of the flight.
    """

    name: str
    build: BuildConfig = field(default_factory=BuildConfig)
    without: tuple[Part, ...] = ()


def _but(*present: Part) -> tuple[Part, ...]:
    """All additions but those."""
    return tuple(part for part in ADDITIONS if part not in present)


def _built(**adapt: Any) -> BuildConfig:
    """The paper's build with other settings of adaptation; the volume likelihood is its own."""
    return override(METHODS["paper"], adapt=adapt)


_RAY = {"fits_scale": True, "likelihood": "ray"}
_BY_DEPTH = _RAY | {"learns_from": "depth"}
_WITH_VIEWS = _BY_DEPTH | {"synthesised_views": 1200, "relit_share": 0.25}
_WITH_STEPS = _WITH_VIEWS | {"pose_weight": 1.0}

RUNGS: tuple[Rung, ...] = (
    Rung("the paper's method", METHODS["paper"], ADDITIONS),
    Rung("+ scale fitted first", _built(fits_scale=True), ADDITIONS),
    Rung("+ log-depth, given the ray", _built(**_RAY), ADDITIONS),
    Rung("+ depth supervision", _built(**_BY_DEPTH), ADDITIONS),
    Rung("+ views and light", _built(**_WITH_VIEWS), ADDITIONS),
    Rung("+ pose-step loss", _built(**_WITH_STEPS), ADDITIONS),
    Rung("+ decoder", _built(**_WITH_STEPS, tune="decoder", **_LIKE_DEFAULT), ADDITIONS),
    Rung("+ all layers", without=ADDITIONS),
    Rung("+ depth scale", without=_but("depth-scale")),
    Rung("+ odometry", without=_but("depth-scale", "odometry")),
    Rung("+ scale and tilt", without=_but("depth-scale", "odometry", "scale-tilt")),
    Rung("+ bias filter", without=("known-bias", "landmarks", "gravity", "relocalization")),
    Rung("+ known bias", without=("landmarks", "gravity", "relocalization")),
    Rung("+ landmarks", without=("gravity", "relocalization")),
    Rung("+ relocalisation (the default)"),
)
"""Each is the one before and one addition. Flights are given no gravity and a start."""

_UNTUNED = BuildConfig.model_validate({"adapt": {"tune": "none", "map_transform": False}})
_NETWORK = BuildConfig.model_validate({"adapt": {"map_transform": False}})
_LAST = BuildConfig.model_validate({"adapt": _WITH_STEPS | {"tune": "last"}})
_LIKELIHOOD = BuildConfig.model_validate({"adapt": _BY_MAP})

_FLIGHTS: dict[str, tuple[Part, ...]] = {", depth alone": ("landmarks",), "": ()}

_PAPER_UNTUNED = Rung("untuned, in the paper's filter", _built(tune="none", map_transform=False), ADDITIONS)

PAIRS: tuple[tuple[Rung, Rung], ...] = (
    (_PAPER_UNTUNED, RUNGS[0]),
    *(
        (Rung(f"{name}{suffix}", build, without), Rung(f"the default{suffix}", without=without))
        for name, build in (
            ("untuned", _UNTUNED),
            ("network tuned, map as it is", _NETWORK),
            ("last layer tuned, losses of the default", _LAST),
            ("all layers tuned, by likelihood alone", _LIKELIHOOD),
        )
        for suffix, without in _FLIGHTS.items()
    ),
)
"""A method and another that differs in one thing of the build, flown alike.

The paper's method beside no tuning; others beside the default, by depth alone and in full.
"""


@dataclass(frozen=True)
class Claimed:
    """A method that the paper's claims are decided for, and the untuned bundle in the same filter."""

    name: str
    tuned: Rung
    untuned: Rung


_ALONE: tuple[Part, ...] = ("landmarks",)

CLAIMED: tuple[Claimed, ...] = (
    Claimed("the paper's method", RUNGS[0], _PAPER_UNTUNED),
    Claimed(
        "the default, depth alone",
        Rung("the default, depth alone", without=_ALONE),
        Rung("untuned, depth alone", _UNTUNED, _ALONE),
    ),
    Claimed("the default", RUNGS[-1], Rung("untuned", _UNTUNED)),
)

LAMBDAS: tuple[Rung, ...] = tuple(
    Rung(f"the paper's method, lambda {value:g}", _built(lambda_kl=value), ADDITIONS) for value in (1.0, 10.0)
)
"""The paper's method with other weights of the divergence than that of :data:`RUNGS`, 0.1."""


def all_rungs() -> Sequence[Rung]:
    """Every method once, in order."""
    return [*dict.fromkeys([*RUNGS, *(rung for pair in PAIRS for rung in pair), *LAMBDAS])]
