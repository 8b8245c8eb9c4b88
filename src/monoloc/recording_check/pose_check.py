"""Whether a recording's poses agree with its images and depth, and if not, what they would agree as."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from monoloc.errors import DataError
from monoloc.geometry import FloatArray, so3_log
from monoloc.io.recording import Recording
from monoloc.recording_check.correspondences import PAIRS
from monoloc.recording_check.evidence import Evidence, gather_evidence, other_readings
from monoloc.recording_check.explanations import (
    LEAST_PAIRS,
    MANY_TIMES,
    Explanation,
    explain,
    explain_unseen_cloud,
    in_percent,
)
from monoloc.recording_check.pose_hypotheses import as_stated
from monoloc.recording_check.pose_jumps import PoseJump, find_jumps

# Median error, share of the corners' motion. On RedKitchen (0:200), whose poses have 2 cm of noise, it is 0.07, on
# the desk (0:350) 0.08; later parts of both have up to 0.14. There, wrong conventions gave 0.48 and more, poses one
# frame late 0.17 and 0.22, a focal length or depth 20 % off 0.12 to 0.22, and independent noise of 2 cm and 1 degree
# over the whole recordings 0.45 and 0.90. Positions with other axes than the rotations gave 0.15 and more.
_RIGHT = 0.12  # with at most this, no other reading is tried
_POOR = 0.25  # without an explanation, a larger error gives a warning
_HOPELESS = 0.5  # as large as that of wrong conventions
# Correlation of the motions by the poses with those by the corners. Right poses gave 0.87 and more, noise of 2 cm and
# 1 degree 0.49 and more; of 46 wrong camera axes and directions, at most one in a room came to 0.4 in both.
_RELATED = 0.4

REFINE = "--refine-poses may help"
"""What a build can do about noisy poses."""


@dataclass(frozen=True)
class PoseCheck:
    """Agreement of poses with images and depth.

    Attributes:
        verdict: ``unknown`` where too few frames have corners, depth and motion.
        pairs, corners: number of pairs and matches that were compared.
        share: median error of the corners under the poses, share of their motion; None if unknown.
        free_share: the same under the motion that the corners themselves give.
        correlation: of the motions by the poses with those that the corners give, the lower one of rotation and
            translation; None if unknown.
        explanation: what the poses would agree as; None if nothing is found, or nothing is wrong.
        jumps: steps of poses that agree otherwise, which the images contradict.
        cloud_is_unseen: whether corners move, and nearly none lies on the cloud that was given.
    """

    verdict: Literal["unknown", "agree", "doubtful", "explained", "disagree"]
    pairs: int
    corners: int
    share: float | None = None
    free_share: float | None = None
    correlation: float | None = None
    explanation: Explanation | None = None
    jumps: tuple[PoseJump, ...] = ()
    cloud_is_unseen: bool = False

    @property
    def jump_sentence(self) -> str | None:
        """The largest jump, and what to do about it, for a message; None if there is none."""
        if not self.jumps:
            return None
        largest = max(self.jumps, key=lambda jump: jump.distance_m + jump.angle_rad)
        by = f"{100.0 * largest.distance_m:.0f} cm and {np.rad2deg(largest.angle_rad):.0f} degrees"
        most = "" if len(self.jumps) == 1 else f", the largest of {len(self.jumps)} jumps,"
        found = f"poses jump by {by}{most} from frame {largest.before} to {largest.after}, and the images do not"
        at = largest.position
        return f"{found}; if they go on in another world, give --frames :{at} or {at}:, else leave these frames out"

    @property
    def sentence(self) -> str:
        """The finding, for a message."""
        if self.share is None:
            if self.explanation is not None:
                found = f"by the poses, {self.pairs} pairs of frames see the cloud"
                away = f"{in_percent(self.explanation.share)} of their motion away from where they are seen"
                return f"{found}; corners land {away} as {self.explanation.what}"
            if self.cloud_is_unseen:
                seen = f"by them, {self.pairs} pairs of frames see the cloud"
                return f"poses are not compared with the images: {seen}; give poses and cloud in one frame, in metres"
            seen = f"{self.pairs} pairs of frames show corners that move and whose depth is known"
            return f"poses are not compared with the images: {seen}"
        of = "" if self.share >= MANY_TIMES else " of"  # "66 times their motion"
        away = f"{in_percent(self.share)}{of} their motion away from where they are seen"
        found = f"by poses and depth, corners land {away}"
        if self.explanation is not None:
            return f"{found}, and {in_percent(self.explanation.share)} as {self.explanation.what}"
        related = "" if self.correlation is None else f", and motions correlate by {self.correlation:.2f}"
        return f"{found} ({in_percent(self.free_share)} by their own motion{related})"

    @property
    def fix(self) -> str:
        if self.explanation is not None:
            return self.explanation.fix
        return "check the poses' convention, their times, the depth's scale and the intrinsics"


def check_poses(recording: Recording, pairs: int = PAIRS) -> PoseCheck:
    """Compare a recording's poses with its images and depth.

    Args:
        recording: with poses.
        pairs: most pairs of frames that are compared.

    Raises:
        DataError: a frame cannot be read.
    """
    return compare_poses(recording, None, pairs)[0]


def compare_poses(
    recording: Recording, cloud: FloatArray | None, pairs: int = PAIRS
) -> tuple[PoseCheck, Evidence | None]:
    """As :func:`check_poses`, with the corners that were compared; None where there is no depth to do so.

    Args:
        cloud: (N, 3) of the room, world frame, metres, which gives depth where the recording has none.
    """
    if recording.poses is None or not (recording.has_depth or cloud is not None):
        return PoseCheck("unknown", 0, 0), None
    evidence = gather_evidence(recording, cloud, pairs)
    return check_matches(evidence), evidence


def check_matches(evidence: Evidence) -> PoseCheck:
    """As :func:`check_poses`, of corners that are matched already."""
    stated = as_stated(evidence)
    corners = len(evidence.matches.pair)
    if stated.pairs < LEAST_PAIRS and not _enough_otherwise(evidence):
        explanation = explain_unseen_cloud(evidence)
        if explanation is not None:
            return PoseCheck("explained", stated.pairs, corners, explanation=explanation)
        cloud_is_unseen = not evidence.recording.has_depth and len(evidence.matches) >= LEAST_PAIRS
        return PoseCheck("unknown", stated.pairs, corners, cloud_is_unseen=cloud_is_unseen)
    share = stated.median
    depth_m = evidence.depth_m(evidence.poses)
    free_motion = evidence.reproject.free_motion(depth_m)
    free = evidence.reproject(free_motion, depth_m)
    correlation = _correlation(evidence.relative(evidence.poses), free_motion)
    check = PoseCheck("agree", stated.pairs, corners, share, free.median if free.pairs else None, correlation)
    check = _with_verdict(check, evidence)
    return replace(check, jumps=tuple(find_jumps(evidence))) if check.verdict == "agree" else check


def _with_verdict(check: PoseCheck, evidence: Evidence) -> PoseCheck:
    share, correlation = check.share, check.correlation
    assert share is not None
    if share <= _RIGHT:
        return check
    explanation = explain(evidence, share)
    if explanation is not None:
        return replace(check, verdict="explained", explanation=explanation)
    if share > _HOPELESS and (correlation is None or correlation < _RELATED):
        return replace(check, verdict="disagree")
    return replace(check, verdict="doubtful") if share > _POOR else check


def _correlation(stated: FloatArray, free: FloatArray) -> float | None:
    """Lower correlation of turns and of translations of relative poses (N, 4, 4); None if few are known."""
    known = np.isfinite(free).all(axis=(1, 2))
    if known.sum() < LEAST_PAIRS:
        return None
    stated, free = stated[known], free[known]
    vectors = [(T[:, :3, 3], so3_log(T[:, :3, :3])) for T in (stated, free)]
    return min(_alike(a, b) for a, b in zip(*vectors, strict=True))


def _alike(a: FloatArray, b: FloatArray) -> float:
    """Correlation of vectors (N, 3); 0 if one side is all zero, as placeholders for poses are."""
    length = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / length if length > 0.0 else 0.0


def require_agreement(name: str, check: PoseCheck, poses_are_refined: bool, if_poor: str = REFINE) -> list[str]:
    """Warnings of a check before a recording becomes a part of a map.

    Args:
        name: of the recording.
        check: of it.
        poses_are_refined: whether the build aligns noisy poses with the map.
        if_poor: what to do about noisy poses.

    Raises:
        DataError: another reading of the recording agrees, or the poses have nothing to do with the images.
    """
    if check.verdict == "explained" or (check.verdict == "disagree" and not poses_are_refined):
        raise DataError(name, f"poses and images disagree: {check.sentence}", check.fix)
    if check.verdict in ("doubtful", "disagree") and not poses_are_refined:
        return [f"poses fit the images poorly: {check.sentence}; {if_poor}"]
    if check.cloud_is_unseen:
        return [check.sentence]
    if check.verdict == "unknown":
        return [f"{check.sentence}; a wrong convention would not be noticed, so give more frames, closer together"]
    return [] if check.jump_sentence is None else [check.jump_sentence]


def _enough_otherwise(evidence: Evidence) -> bool:
    """Whether corners have depth if it is read otherwise, although few have as it is stated."""
    return any(as_stated(reading).pairs >= LEAST_PAIRS for reading in other_readings(evidence))
