"""What a bag contains, by role: one pass over its messages, which keeps positions of images and decodes the rest."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.io.rosbag_file import BagFile
from monoloc.io.rosbag_messages import (
    COLOR,
    COMPRESSED,
    GREY,
    IMAGE,
    INFO,
    POSES,
    TF,
    is_depth,
    pixels_of,
    pose_row,
    region_size,
    same_intrinsics,
    size_of,
)
from monoloc.io.rosbag_poses import PoseTopic, TransformTree

_NAMED_DEPTH = re.compile(r"(^|[/_])depth([/_]|$)", re.IGNORECASE)


@dataclass
class ImageTopic:
    """A topic of images.

    Attributes:
        name: the topic.
        first: its first message.
        frame: the camera's optical frame.
        times_ns: (N,) when each message was recorded, nanoseconds, in order of the stamps.
        stamps_ns: (N,) time stamp of each.
        is_timed: whether stamps are set, of which one may be 0; otherwise the times of recording stand for them.
    """

    name: str
    first: Any
    frame: str
    times_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    is_timed: bool

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height; None if they are unknown."""
        return size_of(self.first)

    @property
    def base(self) -> str:
        """The topic without what image_transport appends for compression."""
        return re.sub("/(compressed|compressedDepth)$", "", self.name)

    @property
    def is_raw(self) -> bool:
        """Whether the images are not compressed."""
        return hasattr(self.first, "encoding")

    @property
    def is_rectified(self) -> bool:
        """Whether the topic is named as those of rectified images are (image_proc)."""
        return "rect" in self.base.rpartition("/")[2]

    @property
    def is_named_depth(self) -> bool:
        """Whether the name of the topic says that it is depth, or a picture of depth."""
        return _NAMED_DEPTH.search(self.name) is not None

    @property
    def color_rank(self) -> int:
        """2 for colour, 1 for grey, 0 for an encoding that is not read."""
        encoding = pixels_of(self.first)
        if not self.is_raw:
            return 1 if encoding in GREY else 2
        return (encoding in COLOR) + (encoding in COLOR and encoding not in GREY)

    @property
    def times_s(self) -> FloatArray:
        """(N,) seconds."""
        return np.asarray((self.stamps_ns if self.is_timed else self.times_ns) / 1e9)

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass
class InfoTopic:
    """A topic of CameraInfo.

    Attributes:
        name: the topic.
        message: its first message.
        frame: the camera's optical frame.
        changes: whether the intrinsics of a later message differ.
    """

    name: str
    message: Any
    frame: str
    changes: bool = False


@dataclass
class Contents:
    """Topics of a bag that matter, by name."""

    colors: dict[str, ImageTopic] = field(default_factory=dict)
    depths: dict[str, ImageTopic] = field(default_factory=dict)
    infos: dict[str, InfoTopic] = field(default_factory=dict)
    poses: dict[str, PoseTopic] = field(default_factory=dict)

    def info_of(self, image: ImageTopic) -> InfoTopic | None:
        """CameraInfo of images: that beside their topic, else the only one of their frame or size."""
        beside = f"{image.base.rpartition('/')[0]}/camera_info"
        if beside in self.infos:
            return self.infos[beside]
        alike = [
            each
            for each in self.infos.values()
            if image.size in ((each.message.width, each.message.height), region_size(each.message))
        ]
        of_frame = [each for each in alike if each.frame == image.frame]
        for group in (of_frame, alike):
            if len(group) == 1:
                return group[0]
        return None


def read_contents(bag: BagFile) -> tuple[Contents, TransformTree]:
    """Read all messages that matter once.

    Raises:
        DataError: the bag is damaged.
    """
    wanted = [topic for topic, kind in bag.types.items() if kind in (IMAGE, COMPRESSED, INFO, TF, *POSES)]
    contents, tree = Contents(), TransformTree(bag.path)
    images: dict[str, list[tuple[int, int]]] = {}
    firsts: dict[str, tuple[Any, str]] = {}
    for topic, time_ns, data in bag.messages(wanted):
        kind = bag.types[topic]
        if kind in (IMAGE, COMPRESSED):
            header = bag.header(topic, data)
            if topic not in firsts:
                firsts[topic] = (bag.decode(topic, data), header.frame_id)
            images.setdefault(topic, []).append((header.stamp_ns, time_ns))
        elif kind == INFO:
            _add_info(contents, bag, topic, data)
        elif kind == TF:
            _add_transforms(tree, bag, topic, data)
        else:
            _add_pose(contents, bag, topic, time_ns, data)
    for topic, (first, frame) in firsts.items():
        _add_images(contents, ImageTopic(topic, first, frame, *_ordered(images[topic])))
    return contents, tree


def _ordered(positions: Sequence[tuple[int, int]]) -> tuple[NDArray[np.int64], NDArray[np.int64], bool]:
    """Times of recording and stamps in order of time, and whether these are set."""
    stamps_ns, times_ns = np.array(positions, dtype=np.int64).T
    is_timed = int((stamps_ns <= 0).sum()) <= int(len(stamps_ns) > 1)  # a recording's own clock begins at 0
    order = np.argsort(stamps_ns if is_timed else times_ns, kind="stable")
    return times_ns[order], stamps_ns[order], is_timed


def _add_images(contents: Contents, topic: ImageTopic) -> None:
    is_infrared = pixels_of(topic.first) == "mono16" and not topic.is_named_depth
    if is_depth(topic.first) and not is_infrared:
        contents.depths[topic.name] = topic
    elif not (topic.is_named_depth or is_infrared):  # other images of a depth camera are pictures of depth
        contents.colors[topic.name] = topic


def _add_info(contents: Contents, bag: BagFile, topic: str, data: bytes) -> None:
    header, message = bag.header(topic, data), bag.decode(topic, data)
    known = contents.infos.setdefault(topic, InfoTopic(topic, message, header.frame_id))
    known.changes |= not same_intrinsics(message, known.message)


def _add_transforms(tree: TransformTree, bag: BagFile, topic: str, data: bytes) -> None:
    is_static = topic.endswith("tf_static")
    for each in bag.decode(topic, data).transforms:
        stamp_ns = each.header.stamp.sec * 10**9 + each.header.stamp.nanosec
        frames = (each.header.frame_id.strip("/"), each.child_frame_id.strip("/"))
        tree.add(*frames, stamp_ns, pose_row(each), is_static)


def _add_pose(contents: Contents, bag: BagFile, topic: str, time_ns: int, data: bytes) -> None:
    header, message = bag.header(topic, data), bag.decode(topic, data)
    body = getattr(message, "child_frame_id", "").strip("/")
    known = contents.poses.setdefault(topic, PoseTopic(topic, header.frame_id, body))
    if (known.world, known.body) != (header.frame_id, body):
        known.is_mixed = True
    known.samples.stamps_ns.append(header.stamp_ns or time_ns)
    known.samples.rows.append(pose_row(message))
