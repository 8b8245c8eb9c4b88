"""Reader of ROS 1 and ROS 2 bags: colour, depth, intrinsics and poses from topics that are guessed or chosen.

``rosbag:PATH`` takes the topics with the most messages, and
``rosbag:PATH#color=TOPIC,depth=TOPIC,poses=TOPIC,body=FRAME`` those given. Each part is optional. ``depth=none`` and
``poses=none`` leave these out, ``poses=/tf`` takes the transforms, and ``body`` states the frame whose poses a topic
holds, where its messages do not (geometry_msgs/PoseStamped).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Remark
from monoloc.io.rosbag_contents import Contents, ImageTopic, read_contents
from monoloc.io.rosbag_file import BagFile, is_bag
from monoloc.io.rosbag_messages import color_of, depth_of
from monoloc.io.rosbag_roles import PoseSource, choose_camera, choose_color, choose_depth, choose_poses
from monoloc.io.tum_recording import MAX_TIME_DIFFERENCE_S, mutual_nearest

_CHOICES = ("color", "depth", "poses", "body")
recognises = is_bag


def read(path: Path, options: ReaderOptions) -> RosbagRecording:
    """Open a bag: a ``.bag``, ``.mcap`` or ``.db3`` file, or a folder with ``metadata.yaml``.

    Depth within 20 ms belongs to a colour image. It is taken as it is if its frame, size and intrinsics are those of
    colour, and is registered to colour if its CameraInfo and /tf_static say how. Poses are interpolated at the time
    stamps of colour, and brought from the frame that they are of to the colour camera by /tf_static.

    Args:
        path: the bag, with an optional choice of topics after a ``#``.
        options: overriding intrinsics of colour and depth scale.

    Raises:
        DataError: the bag cannot be read, or has no usable colour, depth or poses; the error says which.
        MissingExtraError: rosbags is not installed.
        SettingError: a chosen topic is not in the bag.
    """
    options.allow_only("rosbag", "camera", "depth_scale")
    path, chosen = _split(path)
    return RosbagRecording(BagFile(path), chosen, options)


def _split(path: Path) -> tuple[Path, dict[str, str]]:
    """The bag, and the value of each choice after ``#``."""
    before, mark, after = str(path).rpartition("#")
    if not mark or path.exists():
        return path, {}
    chosen = dict(part.partition("=")[::2] for part in after.split(","))
    if not all(name in _CHOICES and value for name, value in chosen.items()):
        names = ",".join(f"{name}={'FRAME' if name == 'body' else 'TOPIC'}" for name in _CHOICES)
        raise SettingError(
            "SOURCE", f"{'#' + after!r} is no choice of topics", f"write PATH#{names}, or some of these"
        )
    return Path(before), chosen


class RosbagRecording:
    """A :class:`~monoloc.io.recording.StoredRecording` of a bag. Messages are read and decoded on demand."""

    def __init__(self, bag: BagFile, chosen: Mapping[str, str], options: ReaderOptions) -> None:
        _refuse_librealsense(bag)
        contents, tree = read_contents(bag)
        self._bag, self._depth_scale = bag, options.depth_scale
        self._color = choose_color(bag, contents, chosen)
        self.name = bag.path.resolve().name.removesuffix(bag.path.suffix)
        self.camera, camera_note = choose_camera(bag, contents, self._color, options)
        depth = choose_depth(bag, contents, tree, self._color, self.camera, chosen)
        poses = choose_poses(bag, contents, tree, self._color.frame, chosen)
        times_s = self._color.times_s
        frames = FrameFilter(len(times_s))
        frames.require(np.diff(times_s, prepend=-np.inf) > 0.0, "with the time stamp of another")
        self._depth, self.has_depth = depth, depth is not None
        self._partners = np.zeros(len(times_s), dtype=np.int64)
        if depth is not None:
            self._partners = mutual_nearest(times_s, depth.topic.times_s)
            frames.require(self._partners >= 0, f"without depth within {1e3 * MAX_TIME_DIFFERENCE_S:g} ms")
        all_poses = None
        if poses is not None:
            needs, all_poses = poses.sampler(times_s)
            for known, reason in needs:
                frames.require(known, reason)
        fix = (
            "check that images, depth and poses use one clock and poses come at 4 Hz or more, or choose other topics"
        )
        used = frames.positions(bag.path, fix)
        self._positions, self._partners = used, self._partners[used]
        self.timestamps_s = times_s[used]
        self.frame_names = [f"{position:06d}" for position in used]
        self.poses: FloatArray | None = None if all_poses is None else all_poses[used]
        roles = [f"colour is {self._color.name}", camera_note]
        roles += [f"depth is {depth.topic.name}, {depth.how}" if depth else "there is no depth"]
        roles += [f"poses are those of {poses.name}, {poses.how}" if poses else "there are no poses"]
        self.notes = [Remark("; ".join(roles)), *self._other_notes(contents, poses), *frames.notes()]
        self.color(0)
        if self.has_depth:
            self.depth(0)

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        message, path = self._message(self._color, int(self._positions[index]))
        return color_of(message, path, self.camera)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        if self._depth is None:
            raise DataError(self._bag.path, "has no depth images", "use a recording with depth, or predicted depth")
        message, path = self._message(self._depth.topic, int(self._partners[index]))
        registration = self._depth.registration
        if registration is None:
            return depth_of(message, path, self.camera, self._depth_scale)
        return registration(depth_of(message, path, registration.depth_camera, self._depth_scale))

    def _message(self, topic: ImageTopic, position: int) -> tuple[object, Path]:
        """A message, and where it is for error messages."""
        data = self._bag.message(topic.name, int(topic.times_ns[position]), int(topic.stamps_ns[position]))
        return self._bag.decode(topic.name, data), self._bag.path / topic.name.lstrip("/")

    def _other_notes(self, contents: Contents, poses: PoseSource | None) -> list[str]:
        """Topics that are not used, and images without time stamps."""
        used = {self._color.name, self._depth.topic.name if self._depth else "", poses.name if poses else ""}
        roles: dict[str, Collection[str]] = {
            "color": contents.colors,
            "depth": contents.depths,
            "poses": contents.poses,
        }
        others = [
            f"{role}={name} ({self._bag.counts[name]})"
            for role, topics in roles.items()
            for name in topics
            if name not in used
        ]
        notes: list[str] = []
        if others:
            names = ", ".join(sorted(others))
            notes.append(
                Remark(f"also in the bag, with numbers of messages: {names}; choose by rosbag:PATH#ROLE=TOPIC")
            )
        if not self._color.is_timed:
            notes.append(f"{self._color.name} has no time stamps, so the times of recording are used")
        return notes


def _refuse_librealsense(bag: BagFile) -> None:
    """Refuse files of librealsense's recorder: their images are no valid messages, and depth is not aligned."""
    if any(kind.startswith("realsense_msgs/") for kind in bag.types.values()):
        fix = (
            "play it through the ROS driver (ros2 launch realsense2_camera rs_launch.py rosbag_filename:=BAG "
            "align_depth.enable:=true), and record its topics with: ros2 bag record"
        )
        raise DataError(bag.path, "is a recording of the RealSense SDK, not of ROS topics", fix)
