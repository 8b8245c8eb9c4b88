"""Everything that is checked of a recording, as findings: good, a warning, or bad."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, Remark, scale_sd_of, selected_from
from monoloc.io.upright import ON_THEIR_SIDE, STAND_UPRIGHT, walk_lies_on_side
from monoloc.progress import NoProgress, Progress
from monoloc.recording_check.depth_between_frames import CHECK_DEPTH, find_disagreement
from monoloc.recording_check.depth_check import DepthCheck, check_depth
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.explanations import small_delay
from monoloc.recording_check.image_quality import BLURRED, TOO_DARK, ImageQuality, measure_images
from monoloc.recording_check.lens_check import FOCAL_SDS, camera_doubts, check_factors
from monoloc.recording_check.map_agreement import LEAST_FOUND, LensRatio, MapAgreement, compare_with_map
from monoloc.recording_check.motion_coverage import MotionCoverage, cover
from monoloc.recording_check.pose_check import PoseCheck, compare_poses
from monoloc.recording_check.repeated_images import LEAVE_OUT, find_repeats
from monoloc.recording_check.time_stamps import TimeCheck, check_times
from monoloc.recording_check.world_agreement import AGREEING_SHARE

Level = Literal["good", "warning", "bad"]

LEAST_FRAMES_OF_A_BUILD = 5

_BLURRED_SHARE = 0.2  # of the images
# Brightness to the build's, beyond its own spread. RedKitchen and the desk, untuned, darkened and brightened with a
# sensor's noise: tracking as before down to 0.1, with some frames lost at 0.08; at 1.8, up to 27 % map-changed.
_MUCH_DARKER, _MUCH_BRIGHTER, _USUAL_SDS = 0.15, 1.6, 2.0
_CLIPPED_SHARE = 0.25  # of the pixels that are black, or saturated
_LEAST_COVERAGE = 0.3  # of the pixels with depth
_LEAST_FOUND_SHARE = 0.3  # of the frames, in which landmarks of the map are found
_SAME_WORLD_M, _SAME_WORLD_RAD = 0.1, np.deg2rad(3.0)
_FOCAL_ERROR = 0.04  # relative, of a focal length against a map's or the build's, that moves a pose
_BY_IMAGES = "monoloc build finds them from the images (extra sfm): give it --scale; localising needs none"


@dataclass(frozen=True)
class Finding:
    """One line of a check.

    Attributes:
        name: what was looked at.
        level: how good it is.
        value: what was found.
        remark: what follows, and what to do; empty if nothing does.
    """

    name: str
    level: Level
    value: str
    remark: str = ""


def worst(findings: Iterable[Finding]) -> Level:
    """The worst level of findings; good where there are none."""
    levels = {finding.level for finding in findings}
    return "bad" if "bad" in levels else "warning" if "warning" in levels else "good"


@dataclass(frozen=True)
class Inspection:
    """A recording, looked at from all sides.

    Attributes:
        recording: the frames that were looked at.
        findings: in order of the processing.
        times, images: of all recordings.
        motion: of one with poses.
        depth: of one with depth.
        poses, evidence: poses against images and depth, and the corners behind it; of one with both.
        agreement: with a bundle's map.
    """

    recording: Recording
    findings: list[Finding]
    times: TimeCheck
    images: ImageQuality
    motion: MotionCoverage | None = None
    depth: DepthCheck | None = None
    poses: PoseCheck | None = None
    evidence: Evidence | None = None
    agreement: MapAgreement | None = None

    @property
    def level(self) -> Level:
        """The worst of the findings."""
        return worst(self.findings)


def inspect_recording(
    recording: Recording,
    cloud: FloatArray | None = None,
    bundle: Bundle | None = None,
    progress: Progress = NoProgress(),
) -> Inspection:
    """Check a recording against itself, and against a bundle if there is one.

    Args:
        cloud: (N, 3) of the room, world frame, metres; replaces depth that the recording lacks.
        bundle: that the recording is to fly with.

    Raises:
        DataError: a frame cannot be read.
    """
    with progress.task("check", 5) as step:
        times, images = check_times(recording), measure_images(recording)
        step(1)
        motion = None if recording.poses is None else cover(recording.poses)
        depth = check_depth(recording) if recording.has_depth else None
        step(2)
        compared, evidence = compare_poses(recording, cloud)
        poses = None if evidence is None else compared
        step(3)
        agreeing = evidence if compared.verdict == "agree" else None
        factors = [] if agreeing is None else check_factors(agreeing)
        delay = None if agreeing is None else small_delay(agreeing)
        step(4)
        agreement = None if bundle is None else compare_with_map(bundle, recording)
        step(5)
    # A wrong focal length or convention also shifts edges and displaces landmarks: poses have the first word.
    is_explained = poses is not None and poses.verdict == "explained"
    findings = [
        *_of_frames(recording, times, is_for_a_build=bundle is None),
        *image_findings(images, "move more slowly, or expose for a shorter time", "record in more light"),
        *(_of_motion(motion) if motion is not None else ()),
        *_warned("upright", ON_THEIR_SIDE if walk_lies_on_side(recording) else None, STAND_UPRIGHT),
        *_warned("images", find_repeats(recording), LEAVE_OUT),
        *(_of_depth(depth, is_explained, scale_sd_of(recording) is not None) if depth is not None else ()),
        *_warned("depth between frames", None if is_explained else find_disagreement(recording), CHECK_DEPTH),
        *(_of_poses(poses) if poses is not None else _without_poses(recording, agreement)),
        *(() if delay is None else (Finding("pose times", "warning", delay[0], f"give {delay[1]}"),)),
        *(
            Finding(of.name, "warning" if of.remark else "good", of.value, of.remark)
            for of in (*factors, *camera_doubts(recording.camera))
        ),
    ]
    if agreement is not None and bundle is not None:
        findings += light_findings(images, bundle.provenance.brightness)
        findings += [_of_camera(agreement, recording.camera, bundle.camera), _of_landmarks(agreement)]
        if agreement.agreeing is not None and not is_explained:
            findings.append(_of_world(agreement, agreement.agreeing))
    return Inspection(recording, findings, times, images, motion, depth, poses, evidence, agreement)


def _of_frames(recording: Recording, times: TimeCheck, is_for_a_build: bool) -> Iterator[Finding]:
    doubts = [note for note in getattr(selected_from(recording), "notes", []) if not isinstance(note, Remark)]
    level: Level = "warning" if doubts else "good"
    if is_for_a_build and times.frames < LEAST_FRAMES_OF_A_BUILD:
        level = "bad"
        doubts.append(f"too few; a build needs at least {LEAST_FRAMES_OF_A_BUILD}")
    yield Finding("frames", level, f"{times.frames}", "; ".join(doubts))
    if times.rate_hz is None:
        return
    value = f"{times.duration_s:.1f} s, {times.rate_words}"
    if times.problem is not None:
        yield Finding("times", "bad" if times.is_certain else "warning", value, f"{times.problem}; {times.remedy}")
        return
    remark = ""
    if times.gaps_s:
        remark = f"{len(times.gaps_s)} gap{'s' * (len(times.gaps_s) > 1)}, the longest {max(times.gaps_s):.1f} s"
    yield Finding("times", "warning" if times.gaps_s else "good", value, remark)


def image_findings(images: ImageQuality, if_blurred: str, if_dark: str) -> Iterator[Finding]:
    """Findings on blur and exposure, with what to do about blurred and about dark images."""
    blurred = images.blurred_share
    remark = if_blurred if blurred > _BLURRED_SHARE else ""
    value = f"{float(np.median(images.blur)):.2f} median, {blurred:.0%} of images over {BLURRED}"
    yield Finding("blur", "warning" if remark else "good", value, remark)
    brightness, dark, bright = (float(np.mean(a)) for a in (images.brightness, images.dark, images.saturated))
    remark = ""
    if brightness < TOO_DARK or dark > _CLIPPED_SHARE:
        remark = if_dark
    elif bright > _CLIPPED_SHARE:
        remark = "expose for a shorter time"
    value = f"{brightness:.0f} of 255, {dark:.0%} of pixels black, {bright:.0%} saturated"
    yield Finding("exposure", "warning" if remark else "good", value, remark)


def light_findings(images: ImageQuality, built: tuple[float, float] | None) -> Iterator[Finding]:
    """Finding on the images' light against that of a build, whose ``Provenance.brightness`` it is; none if None."""
    if built is None:
        return
    (mean, sd), (brightness, _) = built, images.grey_level
    remark = ""
    if brightness < min(_MUCH_DARKER * mean, mean - _USUAL_SDS * sd):
        remark = "much darker than the build; add light or expose for longer, or build in this light"
    elif brightness > max(_MUCH_BRIGHTER * mean, mean + _USUAL_SDS * sd):
        remark = "much brighter than the build; expose for a shorter time, or build in this light"
    value = f"{brightness:.0f} of 255, the build's is {mean:.0f} ± {sd:.0f}"
    yield Finding("light", "warning" if remark else "good", value, remark)


def _of_motion(motion: MotionCoverage) -> Iterator[Finding]:
    value = f"{motion.path_m:.1f} m, within {motion.extent_m:.1f} m, turned by {np.rad2deg(motion.turned_rad):.0f}°"
    problem = motion.problem
    yield Finding("motion", "good" if problem is None else "warning", value, problem or "")


def _warned(name: str, found: str | None, remark: str) -> Iterator[Finding]:
    """A warning of what was found, if anything was."""
    if found is not None:
        yield Finding(name, "warning", found, remark)


def _of_depth(depth: DepthCheck, is_explained: bool, is_from_images: bool) -> Iterator[Finding]:
    median = f", median {depth.median_m:.1f} m" if depth.coverage > 0.0 else ""
    value = f"{depth.coverage:.0%} of pixels{median}"
    if depth.problem is not None and not is_explained:
        otherwise = "" if depth.is_certain else "otherwise "
        level: Level = "bad" if depth.is_certain else "warning"
        yield Finding("depth", level, value, f"{depth.problem}; {otherwise}{depth.remedy}")
        return
    if depth.coverage >= _LEAST_COVERAGE:
        yield Finding("depth", "good", value)
        return
    of_sensor = "keep within the sensor's range, away from dark and shiny surfaces"
    of_images = "film surfaces with texture, each from several places"
    yield Finding("depth", "warning", value, of_images if is_from_images else of_sensor)


def _without_poses(recording: Recording, agreement: MapAgreement | None) -> Iterator[Finding]:
    """Of a recording without poses, or whose poses there is no depth to compare with."""
    if recording.poses is None and agreement is not None:
        yield Finding("poses", "good", "none", "localising needs none")
    elif recording.poses is None:
        yield Finding("poses", "warning", "none", _BY_IMAGES)
    elif agreement is not None:
        if agreement.agreeing is None:
            yield Finding("poses", "warning", "not compared", "there is no depth, and few frames show landmarks")
    else:
        both = "or leave the poses out, and a build finds poses and depth"
        yield Finding("depth", "bad", "none", f"give a cloud of the room (--cloud), {both}")


def _of_poses(poses: PoseCheck) -> Iterator[Finding]:
    if poses.verdict == "unknown":
        yield Finding("poses", "warning", "not compared", poses.sentence)
        return
    unseen = f"{poses.pairs} pairs of frames see the cloud"
    value = unseen if poses.share is None else f"{poses.share:.0%} of the corners' motion off"
    if poses.verdict == "agree":
        jumps = poses.jump_sentence
        yield Finding("poses", "good" if jumps is None else "warning", value, jumps or "")
        return
    level: Level = "warning" if poses.verdict == "doubtful" else "bad"
    why = poses.sentence
    if poses.explanation is not None:
        off = "" if poses.share is not None else " of the corners' motion off"
        why = f"{poses.explanation.share:.0%}{off} as {poses.explanation.what}"
    yield Finding("poses", level, value, f"{why}; {poses.fix}")


def _of_landmarks(agreement: MapAgreement) -> Finding:
    value = f"landmarks found in {agreement.found} of {agreement.frames} frames"
    least = min(LEAST_FOUND, agreement.frames)  # a recording may have fewer
    if agreement.found >= max(least, _LEAST_FOUND_SHARE * agreement.frames):
        return Finding("map", "good", value)
    level: Level = "bad" if agreement.found < least else "warning"
    return Finding("map", level, value, "another room, other light, or intrinsics that are far off")


def _of_camera(agreement: MapAgreement, camera: Camera, built: Camera) -> Finding:
    value = f"{camera.width}x{camera.height}, f {camera.focal_px:.0f} px"
    build = f"the build's is {built.width}x{built.height}, f {built.focal_px:.0f} px"
    if (aspect := agreement.aspect) is not None and _is_off(aspect):
        stretched = f"the images are stretched: landmarks fit {aspect.value:.2f} times the stated fy over fx"
        return Finding("camera", "bad", value, f"{stretched}; correct --camera, or do not stretch the images")
    if (focal := agreement.focal) is not None and _is_off(focal):
        remark = f"landmarks fit {focal.value:.2f} times the stated focal length; correct --camera"
        return Finding("camera", "bad", value, remark)
    if (camera.width, camera.height) != (built.width, built.height):
        return Finding("camera", "good", value, build)
    if abs(np.log(camera.focal_px / built.focal_px)) > _FOCAL_ERROR:
        return Finding("camera", "warning", value, f"{build}; for the same camera, give the same intrinsics")
    return Finding("camera", "good", value, "" if value in build else build)


def _is_off(ratio: LensRatio) -> bool:
    return abs(math.log(ratio.value)) > max(_FOCAL_ERROR, FOCAL_SDS * ratio.log_sd)


def _of_world(agreement: MapAgreement, agreeing: int) -> Finding:
    assert agreement.offset_m is not None and agreement.offset_rad is not None
    offset = f"{100.0 * agreement.offset_m:.0f} cm, {np.rad2deg(agreement.offset_rad):.0f} degrees"
    if agreeing < AGREEING_SHARE * agreement.found:
        value = f"{agreeing} of {agreement.found} frames agree"
        reading = agreement.reading
        if reading is not None:
            return Finding("world", "bad", value, f"they do as {reading.what}; give {reading.option}")
        return Finding("world", "bad", value, "poses of the recording do not fit the map by any rigid transform")
    if agreement.offset_m < _SAME_WORLD_M and agreement.offset_rad < _SAME_WORLD_RAD:
        return Finding("world", "good", f"that of the map, to {offset}")
    remark = "its poses are in another world; errors against them need that transform"
    return Finding("world", "warning", f"one rigid transform away: {offset}", remark)
