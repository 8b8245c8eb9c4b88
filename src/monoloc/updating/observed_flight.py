"""A flight as a map may learn from it: the frames whose pose is beyond doubt, and what they saw."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle, fingerprint
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.editing.depth_comparison import depth_ratios, scale_problem
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, pose_distance_m
from monoloc.io.recording import Recording
from monoloc.landmarks.features import Keypoints
from monoloc.landmarks.landmark_map import FAMILIAR_TIMES, Landmarks, LandmarkViews
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.obstacles.depth_error import DepthError
from monoloc.odometry.standing_pixels import StandingMask
from monoloc.progress import Progress
from monoloc.run import localize
from monoloc.sensor_depth import sparse_depth
from monoloc.start import Start
from monoloc.step import LocalizedFrame, Step
from monoloc.supervision.map_change import ChangedRegion
from monoloc.supervision.state import VOUCHED_FOR, Reason, State

# Of a depth sensor: share of the distance, and what pose and map add.
_SENSOR_SD, _POSE_SD_M = 0.02, 0.03
_MOST_MISMATCHES = 0.1  # share of frames whose landmarks fit another lens
_LEAST_TRACKING_SHARE = 0.5  # of a flight's frames that are *tracking* or *map-changed*
_LEAST_VIEWS, _APART_M = 5, 0.05  # usable frames of a flight, and pose distance between them: nearer ones err alike
_PATCH_PX = 15  # to each side of a corner, which its descriptor reads
_LEAST_WITNESSES = 20  # landmarks outside of the changed region that agree with a frame's pose
# Of the share of familiar landmarks that the build found, at least found in a frame outside of the changed region.
_LEAST_FAMILIAR_SHARE = 0.5


@dataclass(frozen=True)
class UsableFrame:
    """A frame that a map may learn from.

    Attributes:
        pose: ``T_world_camera``, (4, 4), as estimated.
        pose_sd_m, pose_sd_rad: stated standard deviations of position and rotation, per axis, the largest.
        keypoints: of its image.
        is_landmark: (N,) keypoints that are landmarks of the map.
        visible, is_found: (E,) landmarks in view, and whether they were found.
        familiar: (L,) landmarks that the build found from here, and are expected.
        depth: metres at the belief's scale; None where there is none.
        checksum: of its image.
    """

    pose: FloatArray
    pose_sd_m: float
    pose_sd_rad: float
    keypoints: Keypoints
    is_landmark: NDArray[np.bool_]
    visible: NDArray[np.int64]
    is_found: NDArray[np.bool_]
    familiar: NDArray[np.bool_]
    depth: DepthPrediction | None
    checksum: int


@dataclass(frozen=True)
class ObservedFlight:
    """What a flight saw.

    Attributes:
        name: of the recording.
        frames: the usable ones.
        detected: camera of the keypoints.
        states: number of frames in each state.
        depth_error: standard deviation of depth.
        refusal: why nothing may be learned from it; None where it may.
        fix: what to do about that; empty where nothing is refused.
    """

    name: str
    frames: list[UsableFrame]
    detected: Camera
    states: dict[State, int]
    depth_error: DepthError
    refusal: str | None
    fix: str = ""

    def error_m(self, depth_m: FloatArray) -> FloatArray:
        """Standard deviation of depths (...) as surface in the map."""
        return np.asarray(np.hypot(self.depth_error.sd_m(depth_m), _POSE_SD_M))


def observe(
    bundle: Bundle,
    recording: Recording,
    start: Start | None,
    is_sensor_depth: bool,
    known: frozenset[int],
    rng: np.random.Generator,
    progress: Progress,
) -> ObservedFlight:
    """Localise a flight, and keep what its frames saw whose pose is beyond doubt.

    Args:
        start: as for :class:`monoloc.localizer.Localizer`.
        is_sensor_depth: whether surfaces are seen by the recording's depth; else by the network's.
        known: checksums of frames that have been counted.

    Raises:
        DataError: as :func:`views_of` and :func:`monoloc.run.localize`.
    """
    views_of(bundle)
    watcher = _Watcher(bundle, recording, is_sensor_depth, known)
    localize(bundle, recording, start, rng, progress, viewer=watcher)
    depth_error = DepthError(_SENSOR_SD, 0.0, True) if is_sensor_depth else DepthError.of(bundle)
    states: dict[State, int] = dict(watcher.states)
    refusal, fix = _refusal(watcher) or (None, "")
    return ObservedFlight(recording.name, watcher.of_room(), watcher.detected, states, depth_error, refusal, fix)


def views_of(bundle: Bundle) -> LandmarkViews:
    """The views of a bundle's landmarks, which say what a camera should see.

    Raises:
        DataError: it has none, or its build could not tell how often landmarks are found again.
    """
    views, model = bundle.landmarks.views, bundle.integrity
    if views is None or model.familiar_found <= model.strange_found:
        problem = "cannot be updated: its bundle does not know which landmarks are found from where"
        raise DataError(bundle.provenance.recording, problem, "build it from more frames, with landmarks")
    return views


def _refusal(watcher: _Watcher) -> tuple[str, str] | None:
    """The problem with a flight, and what to do; None if there is none."""
    count = sum(watcher.states.values())
    share = sum(watcher.states[state] for state in VOUCHED_FOR) / count
    if watcher.mismatches > _MOST_MISMATCHES * count:
        problem = f"landmarks fit another lens in {watcher.mismatches} of {count} frames"
        return problem, "give the intrinsics of its camera (--camera)"
    if share < _LEAST_TRACKING_SHARE:
        problem = f"{share:.0%} of its frames are tracking, fewer than {_LEAST_TRACKING_SHARE:.0%}"
        return problem, "give a flight in this room, slow and where its build looked"
    if watcher.known > 0.5 * count:
        problem = f"{watcher.known} of its {count} frames built the map or were counted before"
        return problem, "give another flight"
    if len(watcher.frames) < _LEAST_VIEWS:
        others = ", ".join(f"{why}: {number}" for why, number in watcher.left_out.most_common())
        problem = f"{len(watcher.frames)} of its frames are usable, fewer than {_LEAST_VIEWS} ({others})"
        return problem, "give a longer flight where the build looked"
    if (found := scale_problem(watcher.recording, watcher.depth_ratios)) is None:
        return None
    problem, fix = found
    return problem, f"{fix}, or leave it out: --depth predicted"


class _Watcher:
    """Keeps the usable frames of a run; a :class:`monoloc.viz.viewer.Viewer`."""

    def __init__(self, bundle: Bundle, recording: Recording, is_sensor_depth: bool, known: frozenset[int]) -> None:
        self.recording, self._is_sensor_depth = recording, is_sensor_depth
        self._known = known | set(bundle.provenance.frames.values())
        self._landmarks, self._familiar_found = bundle.landmarks, bundle.integrity.familiar_found
        self._localizer = OrbLandmarkLocalizer(bundle.landmarks, recording.camera)
        self.detected = self._localizer.detector.camera
        self.frames: list[UsableFrame] = []
        self.depth_ratios: list[FloatArray] = []  # of the sensor's depth to that of landmarks
        self.states: Counter[State] = Counter()
        self.left_out: Counter[str] = Counter()  # frames that are not usable, by why
        self.mismatches = self.known = 0
        self._standing: NDArray[np.bool_] | None = None  # what stands still in the images, as far as it is known

    def begin(self, room: Bundle, recording: Recording) -> None:
        pass

    def show(self, frame: LocalizedFrame) -> None:
        """Take in a frame, and keep it if it is usable."""
        step = frame.step
        self.states[step.state] += 1
        if step.standing is not None:  # later, as in a landing, too much of the image may stand to tell
            self._standing = step.standing
        self.mismatches += Reason.CAMERA_MISMATCH in step.reasons
        checksum = fingerprint(frame.color)
        if checksum in self._known:
            self.known += 1
            return
        if step.state not in VOUCHED_FOR or step.landmark_pose is None:
            self.left_out["in doubt or without landmarks"] += 1
            return
        pose, views = step.estimate.pose, self._landmarks.views
        times = None if views is None else views.times_found(pose)
        if times is None:
            self.left_out["far from the views that built the map"] += 1
            return
        if not self._is_apart(pose):
            self.left_out["as the view before"] += 1
            return
        keypoints = self._localizer.detect(frame.color)
        measured, which, where = self._localizer.matched_keypoints(keypoints, pose)
        familiar = times >= FAMILIAR_TIMES
        if not self._is_witnessed(step.changed_region, familiar, measured.visible, measured.is_found):
            self.left_out["too few of the expected landmarks found"] += 1
            return
        is_landmark = np.zeros(len(keypoints.pixels), dtype=np.bool_)
        is_landmark[where] = True
        depth = self._depth(frame.index, step)
        if self._is_sensor_depth and depth is not None:
            pixels, points = keypoints.pixels[where], self._landmarks.points[which]
            self.depth_ratios.append(depth_ratios(depth, self.detected, pixels, pose, points))
        sds = np.sqrt(np.diag(step.estimate.covariance))
        self.frames.append(
            UsableFrame(
                pose=pose,
                pose_sd_m=float(sds[:3].max()),
                pose_sd_rad=float(sds[3:].max()),
                keypoints=keypoints,
                is_landmark=is_landmark,
                visible=measured.visible[measured.is_shown],
                is_found=measured.is_found[measured.is_shown],
                familiar=familiar,
                depth=depth,
                checksum=checksum,
            )
        )

    def of_room(self) -> list[UsableFrame]:
        """The usable frames, without what stood still in the images: parts of the drone, or drops on the lens.

        What stands still is known some seconds after the first frame, and stood there before. A corner beside it is
        described by pixels of both.
        """
        if self._standing is None:
            return self.frames
        around = 2 * math.ceil(_PATCH_PX * self._standing.shape[1] / self.detected.width) + 1
        widened = cv2.dilate(self._standing.astype(np.uint8), np.ones((around, around), np.uint8)) > 0
        standing = StandingMask(self.recording.camera, widened)
        return [self._of_room(frame, standing) for frame in self.frames]

    def _of_room(self, frame: UsableFrame, standing: StandingMask) -> UsableFrame:
        points = self._landmarks.points[frame.visible].astype(np.float64)
        is_shown = frame.is_found | ~standing.hides(points, frame.pose)
        stands = replace(standing, camera=self.detected).stands(frame.keypoints.pixels)
        kept = np.flatnonzero(frame.is_landmark | ~stands)
        return replace(
            frame,
            keypoints=frame.keypoints.select(kept),
            is_landmark=frame.is_landmark[kept],
            visible=frame.visible[is_shown],
            is_found=frame.is_found[is_shown],
            depth=None if frame.depth is None else standing.without(frame.depth),
        )

    def _is_apart(self, pose: FloatArray) -> bool:
        if not self.frames:
            return True
        last = self.frames[-1].pose
        return float(pose_distance_m(last, pose[None])[0]) >= _APART_M

    def _is_witnessed(
        self,
        region: ChangedRegion | None,
        familiar: NDArray[np.bool_],
        visible: NDArray[np.int64],
        is_found: NDArray[np.bool_],
    ) -> bool:
        """Whether what is outside of the changed region confirms the pose: what has moved must not place the camera.

        Args:
            familiar: (L,).
            visible, is_found: (E,).
        """
        is_witness = np.ones(len(visible), dtype=np.bool_)
        if region is not None:
            is_witness = ~_within(region, self._landmarks, visible)
        expected = is_witness & familiar[visible]
        found = np.count_nonzero(is_found & is_witness)
        least_share = _LEAST_FAMILIAR_SHARE * self._familiar_found
        return bool(
            found >= _LEAST_WITNESSES
            and np.count_nonzero(is_found & expected) >= least_share * np.count_nonzero(expected)
        )

    def _depth(self, index: int, step: Step) -> DepthPrediction | None:
        if self._is_sensor_depth:
            return sparse_depth(self.recording.depth(index), self.recording.camera)
        if step.depth is None:
            return None
        scale = np.float32(np.exp(step.estimate.log_scale))
        return DepthPrediction(scale * step.depth.depth_m, step.depth.camera)


def _within(region: ChangedRegion, landmarks: Landmarks, chosen: NDArray[np.int64]) -> NDArray[np.bool_]:
    points = landmarks.points[chosen]
    return np.asarray(np.all((points >= region.lower) & (points <= region.upper), axis=1))
