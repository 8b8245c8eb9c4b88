"""The ROS 2 node, run by a stand-in for ROS that replays frames of a synthetic room. ROS itself never ran it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import ros_stage
from cli_helpers import write_workspace
from monoloc.bundle import Bundle, read_bundle
from monoloc.bundle_signature import make_keys
from monoloc.errors import BundleError
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.mcap_log import ros_frames_of
from monoloc.geometry import invert, rotation_to_quaternion
from monoloc.localizer import Localizer
from monoloc.ros.message_contents import camera_info
from monoloc.ros.ros_frames import pose_of
from monoloc.ros.step_messages import OBSTACLES, POSE, STATE
from repository import REPOSITORY
from ros_stage import BEGIN_NS, PERIOD_NS, Stage
from synthetic_room import FRAME_S, SMALL_CAMERA, Room, RoomRecording, make_path

FRAMES = 12


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    write_workspace(folder, recording)
    (folder / "flight.toml").write_text('room = "room.monoloc"\n[mount]\nforward_m = 0.1\n')
    return folder


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch, workspace: Path, recording: RoomRecording) -> Stage:
    return Stage(monkeypatch, recording, workspace / "flight.toml")


@pytest.fixture
def room(workspace: Path) -> str:
    return str(workspace / "room.monoloc")


@pytest.fixture
def bundle(room: str) -> Bundle:
    return read_bundle(Path(room))


@pytest.mark.parametrize("compressed", [False, True])
def test_images_in_poses_and_the_whole_tree_out(
    stage: Stage, recording: RoomRecording, bundle: Bundle, compressed: bool
) -> None:
    stage.begin()
    stage.give_image(0)
    assert stage.ros.said == ["no camera_info yet"]
    stage.give_camera()
    stage.give_image(0)  # by which the frames are known; the room is searched
    frames = ros_frames_of(bundle, FlightSettings.model_validate({"mount": {"forward_m": 0.1}}))
    T_map_base = frames.T_map_room @ recording.poses @ invert(frames.T_base_camera)
    stage.give_start(T_map_base[1])
    stage.ros.published.clear()
    for index in range(1, FRAMES):
        stage.give_image(index, compressed=compressed)
    poses = stage.ros.of(POSE)
    assert len(poses) >= FRAMES - 2
    stamps_ns = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in poses]
    indices = [(stamp_ns - BEGIN_NS) // PERIOD_NS for stamp_ns in stamps_ns]
    assert stamps_ns == [BEGIN_NS + index * PERIOD_NS for index in indices]  # to the nanosecond
    stated = np.array([pose_of(message) for message in poses])
    assert np.linalg.norm(stated[:, :3, 3] - T_map_base[indices, :3, 3], axis=1).max() < 0.15
    for message in poses:
        assert message.header.frame_id == "map" and np.diag(message.pose.covariance.reshape(6, 6)).min() > 0.0
    tree = stage.tree(-1)
    assert set(tree) == {("map", "odom"), ("odom", "base_link"), ("base_link", "cam_optical"), ("map", "room")}
    np.testing.assert_allclose(tree["map", "odom"] @ tree["odom", "base_link"], stated[-1], atol=1e-9)
    states = [message.status[0] for message in stage.ros.of(STATE)]
    assert len(states) == FRAMES - 1 and states[-1].level == b"\0" and states[-1].message == "tracking"
    assert not stage.ros.of(OBSTACLES)  # the bundle's network was not tuned


@pytest.mark.parametrize("by_tree", [False, True])
def test_images_of_a_camera_upside_down_are_turned(
    monkeypatch: pytest.MonkeyPatch,
    recording: RoomRecording,
    bundle: Bundle,
    tmp_path: Path,
    room: str,
    by_tree: bool,
) -> None:
    """The vehicle's poses are as with the camera upright; the turned images have a frame of their own."""
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    assert recording.poses is not None
    upside_down = RoomRecording(Room(), recording.poses @ turn, SMALL_CAMERA.turned(2))
    settings = tmp_path / "flight.toml"
    settings.write_text(f'room = "{room}"\n[mount]\nforward_m = 0.1\nroll_deg = 180.0\n')
    stage = Stage(monkeypatch, upside_down, settings)
    frames = ros_frames_of(bundle, FlightSettings.model_validate({"mount": {"forward_m": 0.1}}))
    if by_tree:
        stage.begin(settings="", bundle=room)
        stage.set_transform("base_link", "cam_optical", frames.T_base_camera @ turn)
    else:
        stage.begin()
    stage.give_camera()
    T_map_base = frames.T_map_room @ recording.poses @ invert(frames.T_base_camera)
    stage.give_image(0)
    stage.give_start(T_map_base[1])
    for index in range(1, FRAMES):
        stage.give_image(index)
    stated = np.array([pose_of(message) for message in stage.ros.of(POSE)])
    assert len(stated) >= FRAMES - 2
    assert np.linalg.norm(stated[-1, :3, 3] - T_map_base[-1, :3, 3]) < 0.1
    turned = "images are turned by 180°, to stand upright"
    assert turned in stage.ros.said and turned not in stage.ros.throttled
    np.testing.assert_allclose(stage.tree(-1)["base_link", "cam_optical_upright"], frames.T_base_camera, atol=1e-9)


def test_camera_info_is_understood_by_the_first_image(stage: Stage) -> None:
    """That of a sensor of which images bin 2x2 pixels; one without a focal length is replaced by the next."""
    stage.begin()
    stage.give_camera(k=[0.0] * 9)
    stage.give_image(0)
    assert "has no focal length in K" in stage.ros.said[0] and not stage.ros.published
    stage.give_camera(SMALL_CAMERA.resized(2 * SMALL_CAMERA.width, 2 * SMALL_CAMERA.height), binning_x=2, binning_y=2)
    stage.give_image(1)
    assert len(stage.ros.said) == 1 and stage.ros.of(STATE)


def test_without_settings_the_mount_is_that_of_the_tree_and_odometry_may_be_anothers(
    stage: Stage, recording: RoomRecording, room: str, bundle: Bundle
) -> None:
    stage.begin(settings="", bundle=room, publish_odom=False, map_frame="world", base_frame="drone")
    stage.give_camera()
    stage.give_image(0)
    assert stage.ros.said == ["cam_optical is not connected to drone"] and not stage.ros.published
    T_base_camera = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0.1], [0, -1, 0, -0.2], [0, 0, 0, 1]])
    stage.set_transform("drone", "cam_optical", T_base_camera)
    stage.give_image(0)
    assert stage.ros.said[1].startswith("no odometry") and not stage.ros.published
    T_map_room = ros_frames_of(bundle, FlightSettings()).T_map_room
    T_odom_base = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    stage.set_transform("odom", "drone", T_odom_base)
    T_map_base = T_map_room @ recording.poses @ invert(T_base_camera)
    stage.give_start(T_map_base[1], frame="world")
    for index in range(1, 4):
        stage.give_image(index)
    tree = stage.tree(-1)
    assert set(tree) == {("world", "room"), ("world", "odom")}
    stated = tree["world", "odom"] @ T_odom_base
    assert np.linalg.norm(stated[:3, 3] - T_map_base[3, :3, 3]) < 0.15


def test_what_cannot_be_used_is_said_and_changes_nothing(stage: Stage, recording: RoomRecording) -> None:
    stage.begin()
    stage.give_start(np.eye(4))
    stage.give_camera()
    stage.give_image(0, age_s=0.5)
    stage.give_image(1)
    stage.give_image(0)  # out of order
    assert len(stage.ros.of(STATE)) == 1
    stage.give_start(np.eye(4), frame="odom")
    stage.give_start(np.eye(4), np.full((6, 6), np.nan))
    wrong = stage.message(
        "sensor_msgs/Image", {"width": 10, "height": 8, "step": 30, "encoding": "rgb8", "data": b""}
    )
    wrong.header.stamp.sec = BEGIN_NS // 10**9 + 60
    stage.ros.give("image", wrong)
    assert len(stage.ros.of(STATE)) == 1
    patterns = ["before the first image", "0.50 s old", "has frame 'odom'", "must be finite", "is 10x8, but"]
    for text, pattern in zip(stage.ros.said, patterns, strict=True):
        assert pattern in text
    assert stage.ros.throttled == [stage.ros.said[1], stage.ros.said[4]], "an answer to /initialpose may be lost"
    stage.give_image(2)
    assert len(stage.ros.of(STATE)) == 2


def test_a_clock_that_is_set_back_silences_nothing(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither does a single stamp that is far ahead. Time begins anew at the next image."""
    elapsed: list[float] = []
    step = Localizer.step

    def spy(self: Any, color: Any, elapsed_s: float, down: Any = None) -> Any:
        elapsed.append(elapsed_s)
        return step(self, color, elapsed_s)

    monkeypatch.setattr(Localizer, "step", spy)
    stage.begin()
    stage.give_camera()
    for begin_ns in (BEGIN_NS, BEGIN_NS - 3600 * 10**9):
        monkeypatch.setattr(ros_stage, "BEGIN_NS", begin_ns)
        for index in (1, 2, 0):  # the last one is out of order
            stage.give_image(index)
    np.testing.assert_allclose(elapsed, [0.0, FRAME_S, 0.0, FRAME_S], atol=1e-8)


def test_gravity_of_the_imu_reaches_the_localizer(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera that looks forward on a level vehicle: down is its y axis. An IMU without orientation says nothing."""
    given: list[Any] = []
    step = Localizer.step

    def spy(self: Any, color: Any, elapsed_s: float, down: Any = None) -> Any:
        given.append((elapsed_s, down))
        return step(self, color, elapsed_s)

    monkeypatch.setattr(Localizer, "step", spy)
    monkeypatch.setattr(Bundle, "down", np.array([0.0, 1.0, 0.0]))
    stage.begin()
    stage.give_camera()
    stage.set_transform(
        "imu_link", "cam_optical", np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    )
    turn = dict(zip("xyzw", rotation_to_quaternion(np.eye(3)).tolist(), strict=True))
    for index, (age_ns, known) in enumerate(((10**7, 0.0), (10**7, -1.0), (10**9, 0.0))):
        header = camera_info(BEGIN_NS + index * PERIOD_NS - age_ns, "imu_link", SMALL_CAMERA)["header"]
        content = {"header": header, "orientation": turn, "orientation_covariance": [known] + [0.0] * 8}
        stage.ros.give("imu", stage.message("sensor_msgs/Imu", content))
        stage.give_image(index)
    elapsed, downs = zip(*given, strict=True)
    np.testing.assert_allclose(elapsed, [0.0, FRAME_S, FRAME_S], atol=1e-8)
    np.testing.assert_allclose(downs[0], [0.0, 1.0, 0.0], atol=1e-12)
    assert downs[1:] == (None, None)


def test_a_room_that_cannot_be_searched_waits_for_a_start(
    stage: Stage, recording: RoomRecording, bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bundle, "supports_relocalization", False)
    stage.begin()
    stage.give_camera()
    stage.give_image(0)
    assert stage.ros.said == ["this room cannot be searched for the camera; publish /initialpose"]
    frames = ros_frames_of(bundle, FlightSettings.model_validate({"mount": {"forward_m": 0.1}}))
    stage.give_start(frames.T_map_room @ recording.poses[1] @ invert(frames.T_base_camera))
    stage.give_image(1)
    assert len(stage.ros.of(POSE)) == 1


def test_main_ends_with_one_line_without_a_bundle_and_whole_when_it_is_stopped(stage: Stage, room: str) -> None:
    main = sys.modules["monoloc_ros.node"].main
    stage.ros.parameters["settings"] = ""
    with pytest.raises(SystemExit) as exit_:
        main()
    assert exit_.value.code == 2
    assert stage.ros.said == ["bundle: is missing; name the bundle that monoloc build wrote", "shut down"]
    stage.ros.parameters["bundle"] = str(REPOSITORY / "absent.monoloc")
    with pytest.raises(SystemExit):
        main()
    assert "monoloc build" in stage.ros.said[2]
    stage.ros.parameters["bundle"] = room

    def interrupt(node: Any) -> None:
        raise KeyboardInterrupt

    stage.ros.spin = interrupt
    main()
    assert stage.ros.said[-2:] == ["destroyed", "shut down"]


def test_a_signature_that_the_settings_require_is_asked_for(stage: Stage, room: str, tmp_path: Path) -> None:
    make_keys(tmp_path / "team.key", tmp_path / "team.pub")
    settings = tmp_path / "flight.toml"
    settings.write_text(f'room = "{room}"\nrequire_signature = "team.pub"\n')
    with pytest.raises(BundleError, match="is not signed"):
        stage.begin(settings=str(settings))
    with pytest.raises(BundleError, match="is not signed"):
        stage.begin(settings=str(settings), bundle=room)


def test_the_package_names_what_the_node_has() -> None:
    """Parameters and topics of the launch file are the node's, and so is the program that is installed."""
    folder = REPOSITORY / "ros" / "monoloc_ros"
    source = (folder / "monoloc_ros" / "node.py").read_text()
    (node,) = ElementTree.parse(folder / "launch" / "monoloc.launch.xml").getroot().iter("node")
    for name in [each.attrib["name"] for each in node.iter("param")] + [
        each.attrib["from"] for each in node.iter("remap")
    ]:
        assert f'"{name}"' in source, name
    assert "node = monoloc_ros.node:main" in (folder / "setup.py").read_text() and node.attrib["exec"] == "node"
    lines = sum(len(path.read_text().splitlines()) for path in (folder / "monoloc_ros").glob("*.py"))
    assert lines <= 300
    needed = {each.text for each in ElementTree.parse(folder / "package.xml").getroot().iter("exec_depend")}
    assert needed == {"rclpy", "tf2_ros", "tf2_msgs", "sensor_msgs", "geometry_msgs", "diagnostic_msgs"}
