"""MCAP files: decoded by two other programs, read back as a recording, and readable after a kill."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.typesys import Stores, get_typestore

from mavlink_helpers import CAMERA, step_at
from monoloc.camera import Camera
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, se3_exp
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.rosbag import read
from monoloc.ros.mcap_file import McapFile, StepRecorder
from monoloc.ros.message_contents import TopicMessage, camera_info
from monoloc.ros.ros_frames import RosFrames
from monoloc.ros.step_messages import IMAGE, INFO, OBSTACLES, POSE, STATE, TF
from refusals import refuses_data

FRAMES = RosFrames(Mount(forward_m=0.2, pitch_deg=-10.0).T_body_camera, None)
COUNT, PERIOD_S, BEGIN_S = 12, 0.2, 1_700_000_000.0


def pose_at(index: int) -> FloatArray:
    return np.asarray(se3_exp(index * np.array([0.1, -0.05, 0.02, 0.03, 0.1, -0.02])))


def image_at(index: int) -> np.ndarray:
    """A smooth picture, which JPEG keeps."""
    picture = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    picture[..., 0], picture[..., 1] = 20 * index, np.linspace(0, 200, CAMERA.width)
    return picture


def write(path: Path, lost: tuple[int, ...] = (), as_it_comes: bool = False) -> None:
    recorder = StepRecorder(McapFile(path, as_it_comes), FRAMES, CAMERA, with_obstacles=True)
    for index in range(COUNT):
        step = step_at(pose_at(index), "lost" if index in lost else "tracking")
        recorder.add(BEGIN_S + PERIOD_S * index, image_at(index), step)
    recorder.file.finish()
    recorder.file.close()


def decoded(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, time and message of everything in a file, by mcap-ros2-support."""
    with path.open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        return [(channel.topic, message.log_time, content) for _, channel, message, content in messages]


def plain(message: Any) -> Any:
    """A message of either decoder as lists, numbers and texts, without the constants that rosbags adds."""
    if isinstance(message, (bool, int, float, str)):
        return message
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, (list, tuple, bytes)):
        return [plain(each) for each in message]
    fields = getattr(message, "__slots__", None) or vars(message)
    names = [name for name in fields if not (name.startswith("_") or name.isupper())]
    return {name: plain(getattr(message, name)) for name in names}


def test_two_other_programs_decode_every_message_alike(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    write(path, lost=(0,))
    ours = [(topic, time_ns, plain(message)) for topic, time_ns, message in decoded(path)]
    types = get_typestore(Stores.ROS2_HUMBLE)
    theirs = []
    with RosbagsReader(path) as reader:
        for connection, time_ns, data in reader.messages():
            content = plain(types.deserialize_cdr(data, connection.msgtype))
            theirs.append((connection.topic, time_ns, content))
    counts = {topic: sum(each[0] == topic for each in ours) for topic in (POSE, TF, STATE, OBSTACLES, IMAGE, INFO)}
    assert counts == {POSE: 11, TF: 12, STATE: 12, OBSTACLES: 11, IMAGE: 12, INFO: 12}
    assert len(ours) == len(theirs) == sum(counts.values())
    assert sorted(ours, key=str) == sorted(theirs, key=str)
    for topic, time_ns, content in ours:
        header = content["transforms"][0]["header"] if topic == TF else content["header"]
        assert header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"] == time_ns  # of capture


def test_images_and_poses_are_read_back_as_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    write(path, lost=(4, 5))
    recording = read(path, ReaderOptions())
    known = [index for index in range(COUNT) if index not in (4, 5)]
    assert recording.camera == CAMERA
    np.testing.assert_allclose(recording.timestamps_s, BEGIN_S + PERIOD_S * np.array(known), atol=1e-6)
    assert recording.poses is not None
    np.testing.assert_allclose(recording.poses, [pose_at(index) for index in known], atol=1e-9)
    for position, index in enumerate(known):
        assert np.abs(recording.color(position).astype(int) - image_at(index)).max() < 12
    assert any("without a pose" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("brown", (-0.1, 0.02, 0.001, -0.002, 0.003)),
        ("rational", (-0.1, 0.02, 0.001, -0.002, 0.003, 0.01, 0.002, 0.001)),
        ("fisheye", (-0.02, 0.004, 0.001, -0.0005)),
    ],
)
def test_every_lens_is_read_back(tmp_path: Path, model: Any, coefficients: tuple[float, ...]) -> None:
    camera = Camera(320, 240, 210.0, 212.0, 161.0, 119.0, coefficients, model)
    path = tmp_path / "flight.mcap"
    recorder = StepRecorder(McapFile(path, False), FRAMES, camera, with_obstacles=False)
    for index in range(3):
        recorder.add(1.0 + index, np.full((240, 320, 3), 90, np.uint8), step_at(pose_at(index)))
    recorder.file.finish()
    assert read(path, ReaderOptions()).camera == camera


WRITER = """
import sys
sys.path[:0] = sys.argv[2:]
from test_mcap_file import FRAMES, CAMERA, McapFile, Path, StepRecorder, image_at, pose_at, step_at
recorder = StepRecorder(McapFile(Path(sys.argv[1]), True), FRAMES, CAMERA, with_obstacles=True)
index = 0
while True:
    recorder.add(100.0 + 0.1 * index, image_at(index % 12), step_at(pose_at(index)))
    index += 1
    print(index, flush=True)
"""


def test_what_was_written_is_readable_after_a_kill(tmp_path: Path) -> None:
    path, here = tmp_path / "flight.mcap", Path(__file__).parent
    support = here.parents[1] / "support"
    command = [sys.executable, "-c", WRITER, str(path), str(here), str(support)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= 300:
            break
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=60)
    with path.open("rb") as file:
        decoders, poses = DecoderFactory(), []
        schemas, channels = {}, {}
        try:
            for record in StreamReader(file).records:
                kind = type(record).__name__
                if kind == "Schema":
                    schemas[record.id] = record
                elif kind == "Channel":
                    channels[record.id] = record
                elif kind == "Message":
                    channel = channels[record.channel_id]
                    decode = decoders.decoder_for(channel.message_encoding, schemas[channel.schema_id])
                    assert decode is not None
                    message = decode(record.data)
                    if channel.topic == POSE:
                        poses.append(message.pose.pose.position.x)
        except EndOfFile:
            pass
    assert len(poses) >= 280  # all but what was in the last chunk
    T_map_base = [FRAMES.base_pose(step_at(pose_at(index)).estimate)[0] for index in range(len(poses))]
    np.testing.assert_allclose(poses, [pose[0, 3] for pose in T_map_base], atol=1e-12)


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    refuses_data(
        lambda: McapFile(tmp_path / "no" / "a.mcap", False), tmp_path / "no" / "a.mcap", "cannot be", "folder"
    )
    file = McapFile(tmp_path / "a.mcap", False)
    for stamp_ns, time in ((-1, "-0.000"), (2**31 * 10**9, "2147483648.000")):
        message = TopicMessage(INFO, "sensor_msgs/CameraInfo", stamp_ns, camera_info(1, "a", CAMERA))
        refuses_data(lambda: file.write([message]), tmp_path / "a.mcap", f"cannot hold the time {time}", "format")  # noqa: B023
    file.close()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    path, before = tmp_path / "a.mcap", resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = StepRecorder(McapFile(path, True), FRAMES, CAMERA, with_obstacles=True)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(Exception, match=r"a\.mcap: cannot be written \(File too large\); make room"):
            for index in range(1000):
                recorder.add(float(index), image_at(index % 12), step_at(pose_at(index)))
        recorder.file.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
