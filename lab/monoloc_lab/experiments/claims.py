"""The three claims of the paper, compared with measurements.

A claim says whether a median satisfies a bound, and by the interval over builds whether it *holds*, *fails* or is
*undecided*. monoloc differs from the paper in network, likelihood, filter,
odometry and rooms, so no claim is a verdict on the paper's method. Every sentence of an analysis states a
measurement, and appears only if the numbers make it true.
"""

from __future__ import annotations

from dataclasses import dataclass

from monoloc_lab.experiments.figure import Claim
from monoloc_lab.experiments.gather import Spread
from monoloc_lab.experiments.interval import Verdict, all_of, interval_of, is_below, of_builds

SMALLER_BOUND = 1.15  # error of the smaller network over that of the full one
DARK_BOUND = 0.5  # our error over that of each other method
MOVED_BOUND_M = 0.10
ACCURATE_DEPTH = 0.25  # largest AbsRel of a depth that counts as roughly right; beyond it delta1 counts no pixel
UNDECIDED = (
    "Undecided: whether this is due to the method of the paper, to its implementation here, to filter and odometry, "
    "or to the room."
)
_NO_RESULT = "No run has a pose to compare."
_ERROR = "RMSE of positions on unseen frames, median over seeds"
_METHOD = "network and map tuned; the paper tunes the last layer and the map"


@dataclass(frozen=True)
class Smaller:
    """Measurements for the first claim; pairs are of the largest and of the smaller network.

    Attributes:
        joint, unadapted: position RMSE, metres.
        ssim: of the unadapted depth.
        absrel: of the adapted depth.
        builds: number of builds that the seeds share.
        drift: position RMSE of dead reckoning with the odometry of the largest network, metres.
    """

    split: str
    light: str
    sizes: tuple[str, str]
    joint: tuple[Spread, Spread]
    unadapted: tuple[Spread, Spread]
    ssim: tuple[float, float]
    absrel: tuple[float, float]
    drift: Spread
    builds: int


def smaller_is_as_accurate(measured: Smaller) -> Claim:
    """With a third of the parameters the adapted error is as small; unadapted error and depth are worse."""
    joint, unadapted, ssim = measured.joint, measured.unadapted, measured.ssim
    large, small = measured.sizes
    ratio = joint[1].median / joint[0].median
    holds = ratio <= SMALLER_BOUND and unadapted[1].median > unadapted[0].median and ssim[1] < ssim[0]
    figure = (
        f"Adapted, {small} has an error of {_cm(joint[1])} and {large} of {_cm(joint[0])} ({_percent(ratio)}). "
        f"Unadapted, {small} has {_cm(unadapted[1])} and {large} {_cm(unadapted[0])}. The SSIM of the unadapted "
        f"depth is {ssim[1]:.3f} with {small} and {ssim[0]:.3f} with {large}."
    )
    return Claim(
        name=f"A third of the parameters, adapted, is as accurate as all of them ({_named(measured.split)})",
        holds=holds,
        figure=figure,
        spread=(joint[1] / joint[0]).range,
        settings={
            "split": measured.split,
            "light": measured.light,
            "sizes": list(measured.sizes),
            "method": _METHOD,
            "seeds": len(joint[0].values),
            "error": _ERROR,
            "bound": f"ratio at most {SMALLER_BOUND}; unadapted error larger; SSIM smaller",
            "spread_of": f"error of {small} over that of {large}, seed by seed",
        },
        analysis=None if holds else _analyse_smaller(measured, ratio),
        verdict=all_of(
            _below(joint[1] / joint[0], SMALLER_BOUND, measured.builds),
            _below(unadapted[0] / unadapted[1], 1.0, measured.builds),
        ),
    )


def _below(ratio: Spread, bound: float, builds: int) -> Verdict:
    """Whether a number of seeds lies below a bound, by the interval over builds."""
    values = of_builds(ratio.values, builds)
    return is_below(interval_of(values), bound) if values else "undecided"


def _analyse_smaller(measured: Smaller, ratio: float) -> str:
    joint, unadapted, (large, small) = measured.joint, measured.unadapted, measured.sizes
    sentences = []
    if ratio > SMALLER_BOUND:
        sentences.append(
            f"The adapted error of {small} differs by {_percent(ratio)} from that of {large}; the bound is "
            f"{_percent(SMALLER_BOUND)}."
        )
        overlap = "overlap" if joint[1].range[0] <= joint[0].range[1] else "do not overlap"
        ranges = f"{joint[0].centimetres()} and {joint[1].centimetres()}"
        sentences.append(f"The ranges over seeds {overlap} ({ranges}).")
        deep, shallow = (100.0 * absrel for absrel in measured.absrel)
        if shallow > deep:
            sentences.append(
                f"The adapted depth of {small} has a relative error of {shallow:.1f} %, that of {large} of "
                f"{deep:.1f} %."
            )
    if unadapted[1].median <= unadapted[0].median:
        sentences.append(f"The unadapted error of {small} is not larger ({_cm(unadapted[1])}, {_cm(unadapted[0])}).")
        if unadapted[1].median > measured.drift.median:
            sentences.append(
                f"Both unadapted errors exceed that of dead reckoning from the true start ({_cm(measured.drift)})."
            )
    if measured.ssim[1] >= measured.ssim[0]:
        sentences.append(f"The SSIM does not fall with the size ({measured.ssim[0]:.3f}, {measured.ssim[1]:.3f}).")
    return _analysis(sentences)


@dataclass(frozen=True)
class Dark:
    """Measurements for the second claim, of one network size in one light.

    Attributes:
        joint, posenet, unadapted: position RMSE, metres.
        bright: that of PoseNet and of the unadapted filter in bright light, in which an error must be smaller for the
            light to be its cause.
        builds: number of builds that the seeds share.
        unadapted_drift: that of dead reckoning from the true start with the odometry of the unadapted network.
        nearest_m: median distance of an unseen frame to the nearest build frame.
        absrel: of unadapted and adapted depth.
    """

    split: str
    light: str
    size: str
    joint: Spread
    posenet: Spread
    unadapted: Spread
    unadapted_drift: Spread
    nearest_m: float
    absrel: tuple[float, float]
    bright: tuple[Spread, Spread]
    builds: int


def half_in_the_dark(measured: Dark) -> Claim:
    """In near darkness the error is at most half of PoseNet's and of the unadapted filter's."""
    ours = measured.joint
    ratios = {"PoseNet": ours.median / measured.posenet.median, "unadapted": ours.median / measured.unadapted.median}
    holds = all(ratio <= DARK_BOUND for ratio in ratios.values())
    better = min((measured.posenet, measured.unadapted), key=lambda spread: spread.median)
    figure = (
        f"In {measured.light}, {measured.size} has an error of {_cm(ours)}. PoseNet of equal size has "
        f"{_cm(measured.posenet)} (ratio {ratios['PoseNet']:.2f}), the unadapted filter {_cm(measured.unadapted)} "
        f"(ratio {ratios['unadapted']:.2f}). In bright light these have {_cm(measured.bright[0])} and "
        f"{_cm(measured.bright[1])}."
    )
    others = (measured.posenet, measured.unadapted)
    return Claim(
        name=f"Near darkness: at most half of PoseNet's and of the unadapted error ({_named(measured.split)})",
        holds=holds,
        figure=figure,
        spread=(ours / better).range,
        settings={
            "split": measured.split,
            "light": measured.light,
            "size": measured.size,
            "method": _METHOD,
            "seeds": len(ours.values),
            "error": _ERROR,
            "bound": f"ratio to each at most {DARK_BOUND}; an effect of light only if their errors are smaller in "
            "bright light",
            "spread_of": "error over that of the better of the two, seed by seed",
        },
        analysis=None if holds else _analyse_dark(measured, ratios),
        verdict=all_of(
            *(_below(ours / other, DARK_BOUND, measured.builds) for other in others),
            *(
                _below(bright / other, 1.0, measured.builds)
                for bright, other in zip(measured.bright, others, strict=True)
            ),
        ),
    )


def _analyse_dark(measured: Dark, ratios: dict[str, float]) -> str:
    ours, sentences = measured.joint.median, []
    if ratios["PoseNet"] > DARK_BOUND:
        sentences.append(f"PoseNet has an error of {_cm(measured.posenet)}, {_compared(ratios['PoseNet'], ours)}.")
        near, theirs = measured.nearest_m, measured.posenet.median
        relation = "less than our error" if near < ours else "more than our error"
        if near >= ours:
            relation += f" and {'more' if theirs < near else 'less'} than PoseNet's"
        sentences.append(f"The median distance to the nearest build frame is {100.0 * near:.1f} cm, {relation}.")
    if ratios["unadapted"] > DARK_BOUND:
        compared = _compared(ratios["unadapted"], ours)
        sentences.append(f"The unadapted filter has an error of {_cm(measured.unadapted)}, {compared}.")
        if measured.unadapted_drift.median <= 1.25 * measured.unadapted.median:
            sentences.append(
                "Dead reckoning with its odometry from the true start has an error of "
                f"{_cm(measured.unadapted_drift)}."
            )
        before, after = (100.0 * absrel for absrel in measured.absrel)
        sentences.append(
            f"The relative error of the depth in this light is {before:.1f} % before and {after:.1f} % after "
            "adaptation."
        )
    return _analysis(sentences)


def map_moves_little(split: str, network: str, median: Spread, before: Spread, gain: Spread, builds: int) -> Claim:
    """Adaptation moves half of the map by less than 10 cm if the unadapted depth is roughly right, and helps.

    Args:
        median: median C2C distance between original and adapted cloud, metres, over builds.
        before: AbsRel of the unadapted depth on held-out build frames.
        gain: adapted error over unadapted error, seed by seed. A map that moves little without one shows nothing.
        builds: number of builds that the seeds share.
    """
    accurate = before.median <= ACCURATE_DEPTH
    holds = median.median < MOVED_BOUND_M and gain.median < 1.0
    error, bound = 100.0 * before.median, 100.0 * ACCURATE_DEPTH
    figure = (
        f"The median distance of the original to the adapted cloud is {median.centimetres()}. The unadapted depth "
        f"has a relative error of {error:.0f} %, {'at most' if accurate else 'more than'} the {bound:.0f} % that "
        "count as roughly right."
    )
    return Claim(
        name=f"Adaptation moves the map little ({_named(split)})",
        holds=holds,
        figure=figure,
        spread=median.range,
        settings={
            "split": split,
            "network": network,
            "method": _METHOD,
            "builds": len(median.values),
            "bound": f"median C2C distance under {MOVED_BOUND_M} m; adapted error smaller than unadapted",
            "adapted_over_unadapted": gain.median,
            "roughly_right": f"AbsRel at most {ACCURATE_DEPTH}",
            "depth_is_roughly_right": accurate,
            "spread_of": "median C2C distance, metres, over builds",
        },
        analysis=None if holds else _analysis([f"At 3 m, {error:.0f} % are {3.0 * error:.0f} cm."]),
        verdict=all_of(_below(median, MOVED_BOUND_M, len(median.values)), _below(gain, 1.0, builds)),
    )


def _analysis(sentences: list[str]) -> str:
    return " ".join([*sentences, UNDECIDED]) if sentences else _NO_RESULT


def _compared(ratio: float, ours: float) -> str:
    than = "less than" if ratio > 1.0 else "less than twice"
    return f"{than} our {100.0 * ours:.1f} cm"


def _named(split: str) -> str:
    return f"{split} split" if split in ("extrapolation", "interpolation") else split


def _cm(spread: Spread) -> str:
    return f"{100.0 * spread.median:.1f} cm"


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):+.0f} %"
