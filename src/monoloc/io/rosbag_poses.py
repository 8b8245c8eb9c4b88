"""Poses of the camera from a bag: topics of poses, and the tree of transforms of /tf and /tf_static (REP 105)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, se3_log
from monoloc.io.pose_files import interpolate_poses, poses_from_quaternions

_UNCHANGED = 1e-9  # of a transform that is repeated
# Largest jump of the camera from one correction of its drift to the next, whose moment is unknown: about the noise of
# poses that a build bears.
_MOST_JUMP_M, _MOST_JUMP_RAD = 0.05, math.radians(1.0)
# What a pose needs: whether it is met at each time (Q,), and the reason that FrameFilter.require takes.
Requirement = tuple[NDArray[np.bool_], str]
# Poses at times (Q,) seconds: what they need, and T_a_b (Q, 4, 4), arbitrary where that is not met.
Sampler = Callable[[FloatArray], tuple[list[Requirement], FloatArray]]


def is_optical(frame: str) -> bool:
    """Whether a frame's name says that its axes are x right, y down, z forward (REP 103)."""
    return frame.removesuffix("_frame").endswith("optical")


@dataclass
class Samples:
    """Poses ``T_parent_child`` of one pair of frames over time.

    Attributes:
        stamps_ns: time of each, nanoseconds.
        rows: ``x, y, z, qx, qy, qz, qw`` of each, metres.
        is_static: whether they hold at all times.
    """

    stamps_ns: list[int] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    is_static: bool = False

    def __len__(self) -> int:
        return len(self.rows)

    def is_constant(self) -> bool:
        """Whether the pose is the same at all times, as that of a mount that is repeated on /tf."""
        return self.is_static or (len(self) > 1 and bool(np.ptp(np.array(self.rows), axis=0).max() < _UNCHANGED))

    def last(self, path: Path) -> FloatArray:
        """The last pose, (4, 4)."""
        row = np.array(self.rows[-1:])
        (pose,) = poses_from_quaternions(row[:, 3:], row[:, :3], path)
        return np.asarray(pose)

    def usable(self, path: Path) -> tuple[FloatArray, FloatArray]:
        """Increasing times (N,) seconds, and the poses (N, 4, 4) at these.

        Poses that are not finite or have no rotation, as before a tracker has started, are left out.

        Raises:
            DataError: a quaternion does not have unit length, or no pose remains.
        """
        stamps_ns, first = np.unique(np.array(self.stamps_ns, dtype=np.int64), return_index=True)
        rows = np.array(self.rows)[first]
        usable = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 3:]).max(axis=1) > 0.0)
        if not usable.any():
            raise DataError(path, "holds no finite pose", "record after the tracker has started")
        poses = poses_from_quaternions(rows[usable, 3:], rows[usable, :3], path)
        return stamps_ns[usable] / 1e9, poses

    def reason(self, name: str) -> str:
        """Why there is no pose at a time; ``name`` says what of."""
        count, span_s = len(set(self.stamps_ns)), (max(self.stamps_ns) - min(self.stamps_ns)) / 1e9
        rate = f"{(count - 1) / span_s:.2g} Hz" if count > 1 else "one pose"
        return f"without a pose near in time ({name} has {rate})"


class TransformTree:
    """Frames, each with its pose in a parent frame."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._samples: dict[str, dict[str, Samples]] = {}  # of a child, by parent

    def add(self, parent: str, child: str, stamp_ns: int, row: tuple[float, ...], is_static: bool) -> None:
        """Add ``T_parent_child``; see :class:`Samples`."""
        samples = self._samples.setdefault(child, {}).setdefault(parent, Samples())
        samples.stamps_ns.append(stamp_ns)
        samples.rows.append(row)
        samples.is_static |= is_static

    def rigid(self, a: str, b: str) -> FloatArray | None:
        """``T_a_b`` (4, 4) of two frames that do not move against each other; None if the tree does not state it."""
        if a == b:
            return np.eye(4)
        from_a, from_b = self._rigid_poses(a), self._rigid_poses(b)
        common = next((frame for frame in from_a if frame in from_b), None)
        return None if common is None else invert(from_a[common]) @ from_b[common]

    def _rigid_poses(self, frame: str) -> dict[str, FloatArray]:
        """``T_ancestor_frame`` of a frame's rigid ancestors, nearest first, with itself."""
        poses = {frame: np.eye(4)}
        T_ancestor_frame = np.eye(4)
        for parent, samples in self._ancestors(frame):
            if not samples.is_constant():
                break
            T_ancestor_frame = samples.last(self._path) @ T_ancestor_frame
            poses[parent] = T_ancestor_frame
        return poses

    def _ancestors(self, frame: str) -> list[tuple[str, Samples]]:
        """Parents from a frame to the root, each with the poses of the frame below it."""
        chain: list[tuple[str, Samples]] = []
        seen = {frame}
        while frame in self._samples:
            # Two nodes may publish a child with different parents; most messages decide.
            parent, samples = max(self._samples[frame].items(), key=lambda item: len(item[1]))
            if parent in seen:
                break
            chain.append((parent, samples))
            seen.add(parent)
            frame = parent
        return chain

    def world_of(self, frame: str) -> tuple[str, int] | None:
        """The root above a frame, and the most poses of a moving part between them; None if nothing moves."""
        chain = self._ancestors(frame)
        moving = [len(samples) for _, samples in chain if not samples.is_constant()]
        return (chain[-1][0], max(moving)) if moving else None

    def sampler(self, frame: str) -> Sampler:
        """``T_root_frame`` of a frame over time.

        The lowest transform that changes moves with the frame, so that it is needed near in time. Those above correct
        its drift, as that from map to odom (REP 105), and may come slowly as long as they jump little.
        """

        def sample(query_s: FloatArray) -> tuple[list[Requirement], FloatArray]:
            needs: list[Requirement] = []
            T_child_frame = np.tile(np.eye(4), (len(query_s), 1, 1))
            child = frame
            for parent, samples in self._ancestors(frame):
                name = f"{parent} to {child} of /tf"
                if samples.is_constant():
                    T_parent_child = samples.last(self._path)
                elif not needs:
                    known, T_parent_child = interpolate_poses(query_s, *samples.usable(self._path))
                    needs = [(known, samples.reason(name))]
                else:
                    times_s, poses = samples.usable(self._path)
                    known, _ = interpolate_poses(query_s, times_s, poses)
                    known |= _jumps_little(query_s, times_s, poses, T_child_frame)
                    _, T_parent_child = interpolate_poses(query_s, times_s, poses, np.inf)
                    needs.append((known, samples.reason(f"{name} jumps or ends, and")))
                T_child_frame = T_parent_child @ T_child_frame
                child = parent
            return needs, T_child_frame

        return sample


def _jumps_little(
    query_s: FloatArray, times_s: FloatArray, poses: FloatArray, T_child_frame: FloatArray
) -> NDArray[np.bool_]:
    """Whether a frame is nearly the same by the correction before and that after each time: (Q,).

    The first and the last are held for as long as they usually come apart.

    Args:
        query_s: (Q,) seconds.
        times_s: (N,) seconds, of the corrections.
        poses: the corrections ``T_parent_child``, (N, 4, 4).
        T_child_frame: at each time, (Q, 4, 4).
    """
    after = np.searchsorted(times_s, query_s)
    last = len(times_s) - 1
    earlier, later = (poses[at.clip(0, last)] @ T_child_frame for at in (after - 1, after))
    jump = se3_log(invert(earlier) @ later)
    usual_s = np.median(np.diff(times_s)) if last else 0.0
    is_near = (query_s >= times_s[0] - usual_s) & (query_s <= times_s[-1] + usual_s)
    jump_m, jump_rad = (np.linalg.norm(part, axis=1) for part in (jump[:, :3], jump[:, 3:]))
    return np.asarray(is_near & (jump_m <= _MOST_JUMP_M) & (jump_rad <= _MOST_JUMP_RAD))


@dataclass
class PoseTopic:
    """A topic of poses.

    Attributes:
        name: the topic.
        world: frame in which the poses are.
        body: frame whose poses they are, empty if the messages do not say.
        samples: the poses ``T_world_body``.
        is_mixed: whether these are poses of several frames, which cannot be used.
    """

    name: str
    world: str
    body: str
    samples: Samples = field(default_factory=Samples)
    is_mixed: bool = False

    def body_frame(self, chosen: str | None) -> str:
        """The frame whose poses these are: as chosen by the user, as stated, or ``world`` if that is optical."""
        return chosen or self.body or (self.world if is_optical(self.world) else "")


def mount_of(body: str, camera: str, tree: TransformTree) -> tuple[FloatArray, str] | None:
    """``T_body_camera`` (4, 4), and how it is known; None if it is not."""
    if body == camera and body:
        return np.eye(4), f"of {body}"
    mount = tree.rigid(body, camera) if body and camera else None
    if mount is not None:
        return mount, f"of {body}, brought to {camera} by /tf_static"
    return (np.eye(4), f"of {body}, taken as the colour camera's") if is_optical(body) else None
