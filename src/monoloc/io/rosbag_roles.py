"""Which topics of a bag are colour, depth and poses: chosen by the user, or those with the most messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray
from monoloc.io.pose_files import interpolate_poses
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registration import DepthRegistration
from monoloc.io.rosbag_contents import Contents, ImageTopic
from monoloc.io.rosbag_file import BagFile
from monoloc.io.rosbag_messages import camera_of
from monoloc.io.rosbag_poses import PoseTopic, Requirement, Sampler, TransformTree, is_optical, mount_of

_NONE, _TF = "none", "/tf"
_SAME_INTRINSICS = 0.01  # largest relative difference of focal lengths and centres of one camera's images
_ALIGN = (
    "record aligned depth (realsense2_camera: align_depth.enable:=true; else depth_image_proc's register node), or "
    "/tf_static and the depth camera's CameraInfo, or add #depth=none"
)
_MOUNT = "record /tf_static from it to the camera, choose another topic with #poses=TOPIC, or add #poses=none"


def _pick(role: str, name: str, known: Iterable[str]) -> str:
    """Check a chosen topic."""
    known = sorted(known)
    if name not in known:
        fix = f"choose from {', '.join(known)}" if known else f"the bag has no topic for {role}; leave it out"
        raise SettingError("SOURCE", f"{role}={name} is not in the bag", fix)
    return name


def choose_color(bag: BagFile, contents: Contents, chosen: Mapping[str, str]) -> ImageTopic:
    """The colour topic: of colour before grey, that with the most messages.

    Raises:
        DataError: there is none.
        SettingError: the chosen topic is not in the bag.
    """
    if "color" in chosen:
        return contents.colors[_pick("color", chosen["color"], contents.colors)]
    if not contents.colors:
        topics = ", ".join(f"{name} ({kind})" for name, kind in sorted(bag.types.items())[:8]) or "none"
        fix = "record sensor_msgs/Image or CompressedImage of the colour camera"
        raise DataError(bag.path, f"holds no colour images; its topics are {topics}", fix)
    return max(
        contents.colors.values(),
        key=lambda each: (each.color_rank, len(each), contents.info_of(each) is not None, each.is_raw),
    )


def choose_camera(bag: BagFile, contents: Contents, color: ImageTopic, options: ReaderOptions) -> tuple[Camera, str]:
    """The colour camera, and where it is from.

    Raises:
        DataError: there is no CameraInfo, or it is not usable, and no camera is given.
    """
    info = contents.info_of(color)
    if info is None or (options.camera is not None and not options.keeps_distortion):
        if options.camera is None:
            fix = "record its camera_info topic, or give --camera"
            raise DataError(bag.path, f"holds no CameraInfo of {color.name}", fix)
        return options.camera, "intrinsics are those given"
    own = camera_of(info.message, color.is_rectified, color.size, bag.path / info.name.lstrip("/"))
    first = ", of which the first is used, as they change" if info.changes else ""
    return options.camera_or(own), f"intrinsics are those of {info.name}{first}"


@dataclass(frozen=True)
class DepthSource:
    """A depth topic; ``registration`` brings it to the colour camera, None if it is there already."""

    topic: ImageTopic
    how: str
    registration: DepthRegistration | None = None


def choose_depth(
    bag: BagFile,
    contents: Contents,
    tree: TransformTree,
    color: ImageTopic,
    camera: Camera,
    chosen: Mapping[str, str],
) -> DepthSource | None:
    """The depth topic that is aligned, else that can be registered, with the most messages; None without any.

    Those that are named depth come before all others: confidence, too, is an image of floating-point numbers.

    Raises:
        DataError: there is depth that is neither.
        SettingError: the chosen topic is not in the bag.
    """
    names = list(contents.depths)
    if chosen.get("depth") == _NONE or (not names and "depth" not in chosen):
        return None
    if "depth" in chosen:
        names = [_pick("depth", chosen["depth"], names)]
    topics = sorted(
        (contents.depths[name] for name in names),
        key=lambda each: (each.is_named_depth, len(each), each.is_raw),
        reverse=True,
    )
    for is_named in (True, False):
        alike = [each for each in topics if each.is_named_depth is is_named]
        found = _aligned_or_registered(bag, contents, alike, color, camera, tree)
        if found is not None:
            return found
    problem = f"is not aligned to {color.name} (frame {topics[0].frame!r}, colour {color.frame!r})"
    raise DataError(bag.path / topics[0].name.lstrip("/"), problem, _ALIGN)


def _aligned_or_registered(
    bag: BagFile,
    contents: Contents,
    topics: Sequence[ImageTopic],
    color: ImageTopic,
    camera: Camera,
    tree: TransformTree,
) -> DepthSource | None:
    """The first topic that is aligned, else the first that can be registered."""
    for topic in topics:
        if _is_aligned(bag, contents, topic, color, camera):
            return DepthSource(topic, "aligned to colour")
    for topic in topics:
        depth_info = contents.info_of(topic)
        T_color_depth = tree.rigid(color.frame, topic.frame) if topic.frame and color.frame else None
        if depth_info is not None and T_color_depth is not None:
            path = bag.path / depth_info.name.lstrip("/")
            depth_camera = camera_of(depth_info.message, topic.is_rectified, topic.size, path)
            how = f"registered to colour by {depth_info.name} and /tf_static"
            return DepthSource(topic, how, DepthRegistration(depth_camera, camera, T_color_depth))
    return None


def _is_aligned(bag: BagFile, contents: Contents, topic: ImageTopic, color: ImageTopic, camera: Camera) -> bool:
    """Whether depth has the frame, the size and the intrinsics of colour."""
    # A size that the header does not tell is checked when the image is decoded.
    if topic.frame != color.frame or topic.size not in (None, (camera.width, camera.height)):
        return False
    if not topic.frame and not ("aligned" in topic.name or "registered" in topic.name):
        return False
    info = contents.info_of(topic)
    if info is None or info is contents.info_of(color):
        return True
    own = camera_of(info.message, topic.is_rectified, topic.size, bag.path / info.name.lstrip("/"))
    numbers = np.array([[each.fx, each.fy, each.cx, each.cy] for each in (own, camera)])
    return bool(np.abs(numbers[0] / numbers[1] - 1.0).max() < _SAME_INTRINSICS)


@dataclass(frozen=True)
class PoseSource:
    """Where poses are from.

    Attributes:
        name: the topic.
        how: they become the camera's.
        count: of messages.
        sampler: gives ``T_world_camera`` at times.
        world_moves: whether their world itself moves in another, as odometry's does where its drift is corrected, and
            the camera's frame, in which the poses of markers are.
    """

    name: str
    how: str
    count: int
    sampler: Sampler
    world_moves: bool = False


def choose_poses(
    bag: BagFile, contents: Contents, tree: TransformTree, camera: str, chosen: Mapping[str, str]
) -> PoseSource | None:
    """The source of poses with the most messages of those that can be brought to the camera; None without any.

    Those whose world moves are taken only where there are no others.

    Raises:
        DataError: there are poses, but how the camera is mounted is unknown.
        SettingError: the chosen topic is not in the bag.
    """
    wanted = chosen.get("poses")
    if wanted == _NONE:
        return None
    topics = list(contents.poses.values())
    if wanted not in (None, _TF):
        topics = [contents.poses[_pick("poses", str(wanted), [*contents.poses, _TF])]]
    bodies = {each.name: _body_of(each, chosen) for each in topics}
    usable = [] if wanted == _TF else [_of_topic(bag, each, tree, camera, bodies[each.name]) for each in topics]
    if wanted in (None, _TF):
        usable.append(_of_transforms(tree, camera))
    found = [each for each in usable if each is not None]
    if found:
        return max(found, key=lambda each: (not each.world_moves, each.count))
    if wanted == _TF:
        raise DataError(bag.path, f"has no moving frame above {camera!r} in /tf", _MOUNT)
    if not topics:
        return None
    best = max(topics, key=lambda each: len(each.samples))
    body = bodies[best.name]
    problem = f"holds poses of {body}, and /tf_static does not say where the camera {camera!r} is on it"
    fix = _MOUNT
    if best.is_mixed:
        problem, fix = (
            "holds poses of several frames",
            "record the poses of one frame in one topic, or add #poses=none",
        )
    elif not body:
        problem = "does not say which frame its poses are of"
        fix = f"add #poses={best.name},body=FRAME, which may be the camera's, {camera!r}; or #poses=none"
    raise DataError(bag.path / best.name.lstrip("/"), problem, fix)


def _body_of(topic: PoseTopic, chosen: Mapping[str, str]) -> str:
    """The frame whose poses a topic holds; empty if nothing tells.

    ``body`` is of the topic that is chosen, and without one of those that do not state their frame: poses that are
    stated to be of another frame are not those that it is about.
    """
    return topic.body_frame(chosen.get("body") if "poses" in chosen or not topic.body else None)


def _of_topic(bag: BagFile, topic: PoseTopic, tree: TransformTree, camera: str, body: str) -> PoseSource | None:
    mount = None if topic.is_mixed else mount_of(body, camera, tree)
    if mount is None:
        return None
    T_body_camera, how = mount
    path = bag.path / topic.name.lstrip("/")

    def sample(query_s: FloatArray) -> tuple[list[Requirement], FloatArray]:
        known, T_world_body = interpolate_poses(query_s, *topic.samples.usable(path))
        return [(known, topic.samples.reason(topic.name))], T_world_body @ T_body_camera

    world_moves = is_optical(topic.world) or tree.world_of(topic.world) is not None
    return PoseSource(topic.name, how, len(topic.samples), sample, world_moves)


def _of_transforms(tree: TransformTree, camera: str) -> PoseSource | None:
    world = tree.world_of(camera) if camera else None
    if world is None:
        return None
    name, count = world
    return PoseSource(_TF, f"from {name} to {camera}", count, lambda query_s: tree.sampler(camera)(query_s))
