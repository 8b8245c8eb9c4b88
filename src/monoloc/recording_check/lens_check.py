"""Whether a recording's intrinsics are those of its images: by the corners, and by what cameras have."""

from __future__ import annotations

from collections.abc import Iterator

from monoloc.camera import Camera
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.factors import Factor, fit_depth_scale, fit_focal

FOCAL_ERROR, FOCAL_SDS = 0.04, 3.0
"""Relative error of a focal length that moves a pose, and how certain it must be."""

_SCALE_ERROR = 0.08  # of depth; right parts of RedKitchen gave up to 0.05, with a standard deviation of 0.02 to 0.05
# Error by the right one of two factors over that by the other. In RedKitchen and at the desk, the right one of scale
# and focal length, which was 10 % off, gave 0.8 to 1.1.
_AS_GOOD = 1.15
_OFF_CENTRE = 0.1  # of the image's side; the benchmarks' cameras are within 4 %
_SQUARE = 0.05  # relative difference of fx and fy; the benchmarks' cameras have 0.8 % at most


def check_focal(evidence: Evidence) -> tuple[str, str]:
    """The focal length by the corners of poses that agree, and what follows; nothing if it may be right.

    A wrong scale of depth or poses moves corners much as a wrong focal length does: what fits is named, or both.
    """
    focal, camera = fit_focal(evidence), evidence.recording.camera
    value = f"{focal.value:.3f} ± {focal.log_sd:.3f} of the stated {camera.focal_px:.0f} px"
    scale = fit_depth_scale(evidence) if evidence.recording.has_depth else None
    is_focal, is_scale = _is_wrong(focal, FOCAL_ERROR), scale is not None and _is_wrong(scale, _SCALE_ERROR)
    if not (is_focal or is_scale):
        return value, ""
    remarks = []
    if scale is None or focal.fit.median <= _AS_GOOD * scale.fit.median:
        remarks.append("calibrate the camera, or check that the intrinsics are of this image size")
    if scale is not None and scale.fit.median <= _AS_GOOD * focal.fit.median:
        far = f"depth is {scale.value:.2f} ± {scale.log_sd:.2f} times as far as the poses say"
        remarks.append(f"{far}: check the scale of the depth and the unit of the poses")
    return value, "; or ".join(remarks)


def camera_doubts(camera: Camera) -> Iterator[tuple[str, str, str]]:
    """Name, value and remark of intrinsics that hardly any camera has; corners tell them less clearly."""
    off_x = abs(camera.cx - 0.5 * (camera.width - 1)) / camera.width
    off_y = abs(camera.cy - 0.5 * (camera.height - 1)) / camera.height
    if not camera.is_window and max(off_x, off_y) > _OFF_CENTRE:
        value = f"({camera.cx:.0f}, {camera.cy:.0f}) in images of {camera.width}x{camera.height}"
        order = "check that cx and cy are of this image size and in this order, or calibrate the camera"
        yield "principal point", value, f"far from the centre; {order}"
    if abs(camera.fx / camera.fy - 1.0) > _SQUARE:
        value = f"fx = {camera.fx:.0f}, fy = {camera.fy:.0f}"
        yield "pixels", value, "pixels are not square; check both, unless the images were stretched"


def intrinsics_warnings(evidence: Evidence | None, camera: Camera) -> Iterator[str]:
    """Warnings of a build, one line each.

    Args:
        evidence: of a recording whose poses agree; None of others, which do not tell the focal length.
    """
    if evidence is not None:
        value, remark = check_focal(evidence)
        if remark:
            yield f"by the corners, the focal length is {value}; {remark}"
    for name, value, remark in camera_doubts(camera):
        yield f"{name}: {value}; {remark}"


def _is_wrong(factor: Factor, least: float) -> bool:
    return abs(factor.log_value) > max(least, FOCAL_SDS * factor.log_sd)
