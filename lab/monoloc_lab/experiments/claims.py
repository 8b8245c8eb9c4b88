"""The source paper's three claims, decided by what was measured; where one fails, what the measurements say of why.

Every sentence of an analysis is there only where the numbers that it states make it true.
"""

from __future__ import annotations

from dataclasses import dataclass

from monoloc_lab.experiments.figure import Claim
from monoloc_lab.experiments.gather import Spread

SMALLER_BOUND = 1.15  # of the smaller network's error over the full one's
DARK_BOUND = 0.5  # of our error over each other method's
MOVED_BOUND_M = 0.10
ROUGHLY_RIGHT = 0.25  # AbsRel up to which depth is roughly right: the error at which delta1 no longer counts a pixel
_UNDECIDED = "No run has a figure to decide it by."
_BY = "RMSE of positions on frames that built nothing, medians over seeds"


@dataclass(frozen=True)
class Smaller:
    """What the first claim is decided by; pairs are of the largest and of the smaller network.

    Attributes:
        joint, unadapted: position RMSE, metres.
        ssim: of depth as it comes.
        absrel: of adapted depth.
        drift: position RMSE of dead reckoning by the largest network's odometry, metres.
    """

    split: str
    light: str
    sizes: tuple[str, str]
    joint: tuple[Spread, Spread]
    unadapted: tuple[Spread, Spread]
    ssim: tuple[float, float]
    absrel: tuple[float, float]
    drift: Spread


def smaller_is_as_good(measured: Smaller) -> Claim:
    """With a third of the parameters, adapted, the pose is as good; unadapted it is not, and depth is worse."""
    joint, unadapted, ssim = measured.joint, measured.unadapted, measured.ssim
    large, small = measured.sizes
    ratio = joint[1].median / joint[0].median
    holds = ratio <= SMALLER_BOUND and unadapted[1].median > unadapted[0].median and ssim[1] < ssim[0]
    figure = (
        f"Adapted, {small} has {_cm(joint[1])} where {large} has {_cm(joint[0])} ({_percent(ratio)}); unadapted, "
        f"{_cm(unadapted[1])} where {large} has {_cm(unadapted[0])}; SSIM of depth as it comes {ssim[1]:.3f} against "
        f"{ssim[0]:.3f}."
    )
    return Claim(
        name=f"A third of the parameters, adapted, locates as well as all of them ({measured.split})",
        holds=holds,
        figure=figure,
        spread=(joint[1] / joint[0]).range,
        settings={
            "split": measured.split,
            "light": measured.light,
            "sizes": list(measured.sizes),
            "seeds": len(joint[0].values),
            "judged_by": _BY,
            "bound": f"ratio at most {SMALLER_BOUND}; unadapted error larger; SSIM smaller",
            "spread_of": f"error of {small} over that of {large}, seed by seed",
        },
        analysis=None if holds else _why_not_smaller(measured, ratio),
    )


def _why_not_smaller(measured: Smaller, ratio: float) -> str:
    (full, third), (plain_full, plain_third) = measured.joint, measured.unadapted
    large, small = measured.sizes
    why = []
    if ratio > SMALLER_BOUND:
        why.append(f"Adapted, {small} is {_percent(ratio)} against {large}, more than {_percent(SMALLER_BOUND)}.")
        ranges = f"{full.centimetres()} and {third.centimetres()}"
        if third.range[0] <= full.range[1]:
            why.append(f"Over seeds the two overlap ({ranges}).")
        else:
            why.append(f"Over seeds the two do not overlap ({ranges}): seeds do not explain the difference.")
        deep, shallow = measured.absrel
        if shallow > deep:
            why.append(
                f"Adapted, the smaller network's depth is still the worse: {100.0 * shallow:.1f} % off, and "
                f"{100.0 * deep:.1f} % with {large}."
            )
    if plain_third.median <= plain_full.median:
        why.append(f"Unadapted, the smaller network is not the worse ({_cm(plain_third)} against {_cm(plain_full)}).")
        if plain_third.median > measured.drift.median:
            why.append(
                f"Both are worse than dead reckoning from the true start ({_cm(measured.drift)}), so which is "
                "farther off says little."
            )
    if measured.ssim[1] >= measured.ssim[0]:
        why.append(f"SSIM does not fall with the size ({measured.ssim[0]:.3f} and {measured.ssim[1]:.3f}).")
    return " ".join(why) or _UNDECIDED


@dataclass(frozen=True)
class Dark:
    """What the second claim is decided by, of one size of network.

    Attributes:
        joint, posenet, unadapted: position RMSE in that light, metres.
        unadapted_drift: that of dead reckoning from the true start by the unadapted network's odometry.
        nearest_m: median distance of a judged frame to the nearest build frame.
        absrel: of depth in that light, as it comes and adapted.
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


def half_in_the_dark(measured: Dark) -> Claim:
    """In near darkness the error is at most half of PoseNet's and of the unadapted filter's."""
    ours = measured.joint
    ratios = {"PoseNet": ours.median / measured.posenet.median, "unadapted": ours.median / measured.unadapted.median}
    holds = all(ratio <= DARK_BOUND for ratio in ratios.values())
    nearer = min((measured.posenet, measured.unadapted), key=lambda spread: spread.median)
    figure = (
        f"In {measured.light}, {_cm(ours)} with {measured.size}; PoseNet of equal size {_cm(measured.posenet)} "
        f"({ratios['PoseNet']:.2f} of it), unadapted {_cm(measured.unadapted)} ({ratios['unadapted']:.2f} of it)."
    )
    return Claim(
        name=f"Near darkness: at most half of PoseNet's and of the unadapted error ({measured.split})",
        holds=holds,
        figure=figure,
        spread=(ours / nearer).range,
        settings={
            "split": measured.split,
            "light": measured.light,
            "size": measured.size,
            "seeds": len(ours.values),
            "judged_by": _BY,
            "bound": f"ratio to each at most {DARK_BOUND}",
            "spread_of": "error over that of the better of the two, seed by seed",
        },
        analysis=None if holds else _why_not_half(measured, ratios),
    )


def _why_not_half(measured: Dark, ratios: dict[str, float]) -> str:
    ours, why = measured.joint.median, []
    if ratios["PoseNet"] > DARK_BOUND:
        why.append(_why_posenet(measured, ratios["PoseNet"]))
    if ratios["unadapted"] > DARK_BOUND:
        than = "less than" if ratios["unadapted"] > 1.0 else "not twice"
        why.append(f"The unadapted filter is off by {_cm(measured.unadapted)}, {than} our {100.0 * ours:.1f} cm.")
        if measured.unadapted_drift.median <= 1.25 * measured.unadapted.median:
            alone = _cm(measured.unadapted_drift)
            why.append(f"Odometry carries it: its dead reckoning from the true start alone is off by {alone}.")
        before, after = (100.0 * absrel for absrel in measured.absrel)
        became = "became better" if after < before else "did not become better"
        why.append(f"Depth {became} by adaptation in this light: {before:.1f} % off before, {after:.1f} % after.")
    return " ".join(why) or _UNDECIDED


def _why_posenet(measured: Dark, ratio: float) -> str:
    ours, theirs, near = measured.joint.median, measured.posenet.median, measured.nearest_m
    than = "less than" if ratio > 1.0 else "not twice"
    beginning = f"PoseNet is off by {_cm(measured.posenet)}, {than} our {100.0 * ours:.1f} cm."
    where = f"A judged frame's nearest build frame is {100.0 * near:.1f} cm away in the median"
    if near < ours:
        return f"{beginning} {where}, nearer than our error: here whoever remembers pictures needs no geometry."
    if theirs < near:
        return f"{beginning} {where}, farther than PoseNet's error: it interpolates between what it has seen."
    return f"{beginning} {where}, and PoseNet is no nearer to the truth than that; we are, but not by half."


def map_moves_little(split: str, network: str, median: Spread, before: Spread) -> Claim:
    """Adaptation moves half of the map by less than 10 cm, where depth was roughly right to begin with.

    Args:
        median: of C2C distances between original and adapted cloud, metres, over builds.
        before: AbsRel of depth on held-out build frames before adaptation.
    """
    right = before.median <= ROUGHLY_RIGHT
    holds = median.median < MOVED_BOUND_M
    figure = (
        f"The median point lies {median.centimetres()} from the adapted cloud; depth as it comes is "
        f"{100.0 * before.median:.0f} % off, {'' if right else 'not '}roughly right by our bound of "
        f"{100.0 * ROUGHLY_RIGHT:.0f} %."
    )
    why = f"Half of the map lies {100.0 * median.median:.1f} cm or more from the adapted cloud. " + (
        "Depth was roughly right, so that does not explain it."
        if right
        else f"Depth was not roughly right: at 3 m, {100.0 * before.median:.0f} % are {300.0 * before.median:.0f} cm."
    )
    return Claim(
        name=f"Adaptation moves the map little ({split})",
        holds=holds,
        figure=figure,
        spread=median.range,
        settings={
            "split": split,
            "network": network,
            "builds": len(median.values),
            "bound": f"median C2C distance under {MOVED_BOUND_M} m",
            "roughly_right": f"AbsRel at most {ROUGHLY_RIGHT}",
            "depth_is_roughly_right": right,
            "spread_of": "median C2C distance, metres, over builds",
        },
        analysis=None if holds else why,
    )


def _cm(spread: Spread) -> str:
    return f"{100.0 * spread.median:.1f} cm"


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):+.0f} %"
