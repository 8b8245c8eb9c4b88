"""Whether a recording's intrinsics are those of its images: by the corners, and by what cameras have."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from monoloc.camera import Camera
from monoloc.io.recording import scale_sd_of
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.factors import Factor, fit_depth_scale, fit_focal
from monoloc.recording_check.wide_pairs import match_wide

FOCAL_SDS = 3.0
"""How many standard deviations a focal length must be off to count as wrong."""

# Logarithm of a focal length or of depth's scale. In 26 parts of RedKitchen, the desk and a rendered room, right ones
# came out up to 0.045 off. So a focal length that is 4 % off, which moves a pose already, looks like a right one.
_FACTOR_ERROR = 0.05
# Poses that agree are not in a scale so far from that of depth, unless the camera only turned, which fits any scale.
_MOST_LOG_SCALE = 0.5
# Error by the right one of two factors over that by the other. In 16 parts of these rooms, the right one of scale and
# focal length, 10 % off, gave 0.5 to 1.05.
_AS_GOOD = 1.1
_OFF_CENTRE = 0.1  # of the image's side; the benchmarks' cameras are within 4 %
_SQUARE = 0.05  # relative difference of fx and fy; the benchmarks' cameras have 0.8 % at most

_CHECK_FOCAL = "calibrate the camera, or check that the intrinsics are of this image size"
# Poses that scatter by a third of the camera's step come out as a scale 20 % off, and a principal point 7 % of the
# image's width off as one of 10 %.
_CHECK_SCALE = "check the scale of the depth, unit and scatter of the poses, and the principal point"


@dataclass(frozen=True)
class LensFinding:
    """What was found of the intrinsics or of a scale, and what to do about it; that is empty if it is right."""

    name: str
    value: str
    remark: str = ""


def check_factors(evidence: Evidence) -> list[LensFinding]:
    """What corners say of the focal length and of depth's scale, where poses agree: one doubt, or what is right.

    A wrong scale of depth or poses moves corners much as a wrong focal length does. A factor is named only if it is
    off itself and fits about as well as the other one.

    Raises:
        DataError: a frame cannot be read.
    """
    evidence = match_wide(evidence) or evidence
    focal, scale, camera = fit_focal(evidence), _scale(evidence), evidence.recording.camera
    of_focal = f"{focal.value:.3f} ± {focal.log_sd:.3f} of the stated {camera.focal_px:.0f} px"
    measured = [(focal, "focal length", of_focal, _CHECK_FOCAL)]
    if scale is not None:
        far = f"depth is {scale.value:.2f} ± {scale.log_sd:.2f} times as far as the poses say"
        measured.append((scale, "scale", far, _CHECK_SCALE))
    least = min(factor.error for factor, *_ in measured)
    doubted = [each for each in measured if _is_off(each[0]) and each[0].error <= _AS_GOOD * least]
    if not any(_is_certain(factor) for factor, *_ in doubted):
        return [LensFinding(name, value) for _, name, value, _ in measured]
    _, name, value, remark = doubted[0]
    others = "".join(f"; or {other}: {check}" for _, _, other, check in doubted[1:])
    return [LensFinding(name, value, remark + others)]


def camera_doubts(camera: Camera) -> Iterator[LensFinding]:
    """Doubts about intrinsics that hardly any camera has; corners tell them less clearly."""
    off_x = abs(camera.cx - 0.5 * (camera.width - 1)) / camera.width
    off_y = abs(camera.cy - 0.5 * (camera.height - 1)) / camera.height
    if not camera.is_window and max(off_x, off_y) > _OFF_CENTRE:
        value = f"({camera.cx:.0f}, {camera.cy:.0f}) in images of {camera.width}x{camera.height}"
        order = "check that cx and cy are of this image size and in this order, or calibrate the camera"
        yield LensFinding("principal point", value, f"far from the centre; {order}")
    if abs(camera.fx / camera.fy - 1.0) > _SQUARE:
        value = f"fx = {camera.fx:.0f}, fy = {camera.fy:.0f}"
        yield LensFinding("pixels", value, "pixels are not square; check both, unless the images were stretched")


def intrinsics_warnings(evidence: Evidence | None, camera: Camera) -> Iterator[str]:
    """Warnings of a build, one line each.

    Args:
        evidence: of a recording whose poses agree; None of others, which do not tell the focal length.
    """
    if evidence is not None:
        for found in check_factors(evidence):
            if found.remark:
                yield f"{found.name} by the corners: {found.value}; {found.remark}"
    for doubt in camera_doubts(camera):
        yield f"{doubt.name}: {doubt.value}; {doubt.remark}"


def _scale(evidence: Evidence) -> Factor | None:
    """Scale of depth over that of the poses; None where nothing tells it."""
    # Of a map from images, depth and poses have one scale, whose uncertainty is known.
    if not evidence.recording.has_depth or scale_sd_of(evidence.recording) is not None:
        return None
    scale = fit_depth_scale(evidence)
    return scale if abs(scale.log_value) < _MOST_LOG_SCALE else None


def _is_off(factor: Factor) -> bool:
    return abs(factor.log_value) > _FACTOR_ERROR


def _is_certain(factor: Factor) -> bool:
    return abs(factor.log_value) > FOCAL_SDS * factor.sampling_log_sd
