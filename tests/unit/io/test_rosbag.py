"""ROS bags of both versions and all storages, written by rosbags' own writers, and logs of other projects."""

from __future__ import annotations

import gc
import sqlite3
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_writers import Capture, check_opened, halved
from monoloc.camera import Camera
from monoloc.errors import MissingExtraError
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from monoloc.io.rosbag_file import BagFile
from refusals import refuses, refuses_data, refuses_setting, refuses_to_open
from synthetic_recordings import check_recording

pytest.importorskip("rosbags")

from bag_writers import BODY, COLOR, DEPTH, ODOM, OPTICAL, T_BODY_CAMERA, WORLD, Bag, Ros, bag_of, odometry_of


@pytest.fixture
def capture(capture: Capture) -> Capture:
    return replace(capture, times_s=capture.times_s + 1_700_000_000.0)


@pytest.mark.parametrize(
    ("version", "storage", "compression"),
    [
        (1, "", ""),
        (1, "", "LZ4"),
        (1, "", "BZ2"),
        (2, "sqlite3", ""),
        (2, "sqlite3", "MESSAGE"),
        (2, "sqlite3", "FILE"),
        (2, "mcap", ""),
        (2, "mcap", "STORAGE"),
    ],
)
def test_bag_opens(tmp_path: Path, capture: Capture, version: int, storage: str, compression: str) -> None:
    path = bag_of(capture, version).write(tmp_path / "walk", storage, compression)
    recording = open_recording(str(path))
    check_recording(recording, len(capture))
    check_opened(recording, capture, capture.depths_mm, color_error=1e-9)
    np.testing.assert_allclose(recording.timestamps_s, capture.times_s, atol=1e-6)
    assert recording.camera == capture.camera and recording.name == "walk"
    assert recording.notes == [
        f"colour is {COLOR}; intrinsics are those of /cam/color/camera_info; depth is {DEPTH}, aligned to colour; "
        f"poses are those of {ODOM}, of {BODY}, brought to {OPTICAL} by /tf_static"
    ]
    np.testing.assert_array_equal(recording.color(7), capture.colors[7])  # at random


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc/self/fd, of Linux")
@pytest.mark.parametrize("version", [1, 2])
def test_bag_that_is_no_longer_used_is_closed(tmp_path: Path, capture: Capture, version: int) -> None:
    path = bag_of(capture, version).write(tmp_path / "walk", "sqlite3" if version == 2 else "", "")

    def is_open() -> bool:
        links = [link.readlink() for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
        return any(path in (link, *link.parents) for link in links)

    bag = BagFile(path)
    assert is_open()
    del bag
    gc.collect()
    assert not is_open()


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_single_file_of_ros2_opens(tmp_path: Path, capture: Capture, suffix: str) -> None:
    folder = bag_of(capture).write(tmp_path / "walk", suffix[1:])
    check_opened(open_recording(str(folder / f"walk{suffix}")), capture, capture.depths_mm, 1e-9)


def test_images_are_decoded_from_each_encoding(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, poses=False, depth=False)
    ros, color, time_s = bag.ros, capture.colors[0], float(capture.times_s[0])
    bgr = np.ascontiguousarray(color[..., ::-1])
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    alpha = np.full((*grey.shape, 1), 9, dtype=np.uint8)
    encodings = {
        "bgr8": bgr,
        "rgba8": np.concatenate([color, alpha], axis=2),
        "bgra8": np.concatenate([bgr, alpha], axis=2),
        "mono8": grey,
    }
    for encoding, pixels in encodings.items():
        bag.add(f"/cam/{encoding}", time_s, ros.image(time_s, OPTICAL, pixels, encoding))
    for fmt in ("png", "jpg"):
        data = cv2.imencode(f".{fmt}", bgr)[1].tobytes()
        bag.add(
            f"/cam/{fmt}/compressed", time_s, ros.compressed(time_s, OPTICAL, data, f"rgb8; {fmt} compressed bgr8")
        )
    path = bag.write(tmp_path / "walk")
    for topic, expected, error in [
        *((f"/cam/{name}", color, 0.0) for name in ("bgr8", "rgba8", "bgra8")),
        ("/cam/mono8", np.repeat(grey[..., None], 3, axis=2), 0.0),
        ("/cam/png/compressed", color, 0.0),
        ("/cam/jpg/compressed", color, 4.0),
    ]:
        recording = open_recording(f"rosbag:{path}#color={topic}")
        assert np.abs(recording.color(0).astype(float) - expected).mean() <= error
    assert "also in the bag, with numbers of messages: color=/cam/bgr8 (1), " in open_recording(str(path)).notes[1]


def test_compressed_infrared_is_not_taken_for_colour(tmp_path: Path, capture: Capture) -> None:
    """As image_transport writes a RealSense's images: the infrared ones come first, and are as many."""
    bag = bag_of(capture, poses=False, depth=False)
    del bag.topics[COLOR]
    for time_s, color in zip(capture.times_s, capture.colors, strict=True):
        grey = cv2.imencode(".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))[1].tobytes()
        bgr = cv2.imencode(".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR))[1].tobytes()
        for name, data, fmt in (("infra1/image_rect_raw", grey, "mono8"), ("color/image_raw", bgr, "rgb8")):
            message = bag.ros.compressed(time_s, OPTICAL, data, f"{fmt}; jpeg compressed ")
            bag.add(f"/cam/{name}/compressed", time_s, message)
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    assert recording.notes[0].startswith(f"colour is {COLOR}/compressed;")


def test_compressed_infrared_is_not_taken_for_depth(tmp_path: Path, capture: Capture) -> None:
    """An Azure Kinect's infrared images have 16 bits, as its depth, and come from the same camera."""
    bag = bag_of(capture)
    infrared = cv2.imencode(".png", np.full_like(capture.depths_mm[0], 900))[1].tobytes()
    bag.topics = {"/k4a/ir/image_raw/compressed": [], **bag.topics}
    for time_s in [*capture.times_s, capture.times_s[-1] + 0.001]:
        message = bag.ros.compressed(time_s, OPTICAL, infrared, "mono16; png compressed ")
        bag.add("/k4a/ir/image_raw/compressed", time_s, message)
    check_opened(open_recording(str(bag.write(tmp_path / "walk"))), capture, capture.depths_mm, 1e-9)


def test_confidence_is_not_taken_for_depth(tmp_path: Path, capture: Capture) -> None:
    """A ZED's confidence has the encoding, the frame and the size of its depth, and as many messages."""
    bag = bag_of(capture)
    confidence = np.full(capture.depths_mm[0].shape, 50.0, np.float32)
    bag.topics = {"/zed/confidence/confidence_map": [], **bag.topics}
    for time_s in capture.times_s:
        message = bag.ros.image(time_s, OPTICAL, confidence, "32FC1")
        bag.add("/zed/confidence/confidence_map", time_s, message)
    check_opened(open_recording(str(bag.write(tmp_path / "walk"))), capture, capture.depths_mm, 1e-9)


def inverse_depth(depth_m: NDArray[np.float32]) -> bytes:
    """compressedDepth of 32FC1, as compressed_depth_image_transport quantises it."""
    a, b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0
    stored = np.where(depth_m > 0.0, a / np.maximum(depth_m, 1e-3) + b, 0.0).round().astype(np.uint16)
    return struct.pack("<iff", 1, a, b) + cv2.imencode(".png", stored)[1].tobytes()


@pytest.mark.parametrize(
    ("make", "tolerance_m"),
    [
        (lambda ros, t, mm: ros.image(t, OPTICAL, (mm / 1000.0).astype(np.float32), "32FC1"), 1e-6),
        (lambda ros, t, mm: ros.image(t, OPTICAL, np.where(mm, mm / 1000.0, np.nan).astype("<f4"), "32FC1"), 1e-6),
        (lambda ros, t, mm: ros.image(t, OPTICAL, mm.astype(">u2"), "16UC1"), 1e-6),
        (
            lambda ros, t, mm: ros.compressed(
                t, OPTICAL, bytes(12) + cv2.imencode(".png", mm)[1].tobytes(), "16UC1; compressedDepth png"
            ),
            1e-6,
        ),
        (
            lambda ros, t, mm: ros.compressed(
                t, OPTICAL, inverse_depth((mm / 1000.0).astype(np.float32)), "32FC1; compressedDepth png"
            ),
            5e-3,
        ),
    ],
)
def test_depth_is_in_metres(
    tmp_path: Path, capture: Capture, make: Callable[[Ros, float, Any], Any], tolerance_m: float
) -> None:
    bag = bag_of(capture, depth=False)
    for time_s, mm in zip(capture.times_s, capture.depths_mm, strict=True):
        holed = mm.copy()
        holed[5:9] = 0
        bag.add(DEPTH, time_s, make(bag.ros, time_s, holed))
    depth_m = open_recording(str(bag.write(tmp_path / "walk"))).depth(3)
    assert depth_m.dtype == np.float32 and not depth_m[5:9].any()
    expected = capture.depths_mm[3] / 1000.0
    np.testing.assert_allclose(depth_m[9:], expected[9:], atol=tolerance_m)


def depth_camera_of(capture: Capture) -> Camera:
    return capture.camera.resized(capture.camera.width // 2, capture.camera.height // 2)


@pytest.mark.parametrize("distance_m", [0.0, 0.05])
def test_depth_of_another_camera_is_registered(tmp_path: Path, capture: Capture, distance_m: float) -> None:
    bag = bag_of(capture, depth=False)
    ros, frame = bag.ros, "cam_depth_optical_frame"
    bag.add("/cam/depth/camera_info", 0.0, ros.info(depth_camera_of(capture), frame))
    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = distance_m
    static = ros.transform(0.0, BODY, frame, T_BODY_CAMERA @ T_color_depth)
    bag.topics["/tf_static"][0][1].transforms.append(static)
    wall_m = 2.0
    for time_s in capture.times_s:
        wall = np.full((capture.camera.height // 2, capture.camera.width // 2), 1000 * wall_m, dtype=np.uint16)
        bag.add("/cam/depth/image_rect_raw", time_s, ros.image(time_s, frame, wall, "16UC1"))
        scores = np.ones((capture.camera.height, capture.camera.width), np.float32)  # no depth, and in colour's frame
        bag.add("/detector/scores", time_s, ros.image(time_s, OPTICAL, scores, "32FC1"))
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    depth_m = recording.depth(0)
    assert "registered to colour by /cam/depth/camera_info and /tf_static" in recording.notes[0]
    np.testing.assert_allclose(depth_m[depth_m > 0.0], wall_m, atol=1e-6)
    # Seen from a camera to the right of colour, the wall's left edge moves right by f * distance / depth.
    first = np.flatnonzero((depth_m > 0.0).any(axis=0))[0]
    assert abs(first - capture.camera.fx * distance_m / wall_m) <= 1.0


def test_depth_that_cannot_be_aligned_is_refused(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, depth=False)
    for time_s, mm in zip(capture.times_s, capture.depths_mm, strict=True):
        bag.add(
            "/cam/depth/image_rect_raw", time_s, bag.ros.image(time_s, "cam_depth_optical_frame", halved(mm), "16UC1")
        )
    path = bag.write(tmp_path / "walk")
    problem, fix = "is not aligned to /cam/color/image_raw .*cam_depth", "align_depth.enable:=true.*#depth=none"
    refuses_to_open(path, path / "cam/depth/image_rect_raw", problem, fix)
    assert not open_recording(f"rosbag:{path}#depth=none").has_depth


def without_poses(capture: Capture) -> Bag:
    bag = bag_of(capture)
    del bag.topics[ODOM]
    return bag


def test_poses_are_chained_from_transforms(tmp_path: Path, capture: Capture) -> None:
    """map to odom drifts slowly, odom to the body moves; the body's mount is static."""
    bag = without_poses(capture)
    ros = bag.ros
    for index, (time_s, T_map_body) in enumerate(odometry_of(capture)):
        T_map_odom = np.eye(4)
        T_map_odom[1, 3] = 0.01 * index
        parts = (("map", "odom", T_map_odom), ("odom", BODY, np.linalg.inv(T_map_odom) @ T_map_body))
        for parent, child, pose in parts:
            bag.add("/tf", time_s, ros.tf(ros.transform(time_s, parent, child, pose)))
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    check_opened(recording, capture, capture.depths_mm, 1e-9)
    assert recording.notes[0].endswith(f"poses are those of /tf, from map to {OPTICAL}")


def corrected_odometry(capture: Capture, stamps_s: NDArray[np.float64], jump_m: float = 0.0) -> Bag:
    """/tf of odom to the body at images' times, and of map to odom at few: 2 cm/s of drift, and a jump halfway."""
    bag = without_poses(capture)
    ros, halfway_s = bag.ros, capture.times_s.mean()

    def T_map_odom(time_s: float) -> NDArray[np.float64]:
        correction = np.eye(4)
        correction[1, 3] = 0.02 * (time_s - capture.times_s[0]) + jump_m * (time_s > halfway_s)
        return correction

    for time_s, T_map_body in odometry_of(capture):
        T_odom_body = np.linalg.inv(T_map_odom(time_s)) @ T_map_body
        bag.add("/tf", time_s, ros.tf(ros.transform(time_s, "odom", BODY, T_odom_body)))
    for time_s in (capture.times_s[0] + stamps_s).tolist():
        bag.add("/tf", time_s, ros.tf(ros.transform(time_s, "map", "odom", T_map_odom(time_s))))
    return bag


def test_poses_with_their_drift_corrected_are_preferred(tmp_path: Path, capture: Capture) -> None:
    """As SLAM beside wheel odometry records them: as many messages of /odom as transforms, but in the world odom."""
    bag = corrected_odometry(capture, capture.times_s - capture.times_s[0])
    for time_s, message in bag.topics["/tf"][: len(capture)]:
        (odom_to_body,) = message.transforms
        odometry = bag.ros.odometry(time_s, BODY, np.eye(4))
        odometry.header.frame_id = "odom"
        odometry.pose.pose.position = odom_to_body.transform.translation
        odometry.pose.pose.orientation = odom_to_body.transform.rotation
        bag.add(ODOM, time_s, odometry)
    path = bag.write(tmp_path / "walk")
    check_opened(open_recording(str(path)), capture, capture.depths_mm, 1e-9)
    drifting = open_recording(f"rosbag:{path}#poses={ODOM}")
    assert f"poses are those of {ODOM}" in drifting.notes[0]


def test_poses_of_a_marker_are_not_those_of_the_camera(tmp_path: Path, capture: Capture) -> None:
    """Detectors publish them in the camera's frame, without a name for the marker, often more than odometry comes."""
    bag = bag_of(capture)
    for time_s in [*capture.times_s, capture.times_s[-1] + 0.01]:
        bag.add("/aruco_single/pose", time_s, bag.ros.pose_stamped(time_s, OPTICAL, np.eye(4)))
    check_opened(open_recording(str(bag.write(tmp_path / "walk"))), capture, capture.depths_mm, 1e-9)


def test_slow_corrections_of_drift_are_interpolated(tmp_path: Path, capture: Capture) -> None:
    span_s = np.ptp(capture.times_s)
    bag = corrected_odometry(capture, np.linspace(-0.1, span_s + 0.1, 3))
    recording = open_recording(str(bag.write(tmp_path / "whole")))
    check_opened(recording, capture, capture.depths_mm, 1e-9)
    assert len(recording.notes) == 1
    bag = corrected_odometry(capture, np.array([0.3, 0.7]) * span_s)  # the first and the last are held
    recording = open_recording(str(bag.write(tmp_path / "held")))
    check_opened(recording, capture, capture.depths_mm, 1e-9, pose_error=0.02 * 0.3 * span_s + 1e-6)


def test_frames_beside_a_jump_of_corrections_are_left_out(tmp_path: Path, capture: Capture) -> None:
    span_s = np.ptp(capture.times_s)
    bag = corrected_odometry(capture, np.linspace(-0.1, 1.1, 4) * span_s, jump_m=0.4)
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    fractions = (capture.times_s - capture.times_s[0]) / span_s
    kept = (fractions < 0.3) | (fractions > 0.7)
    np.testing.assert_allclose(recording.poses, capture.poses[kept], atol=1e-6)
    rate = f"{3 / (1.2 * span_s):.2g} Hz"
    assert recording.notes[1].endswith(
        f": {int((~kept).sum())} without a pose near in time (map to odom of /tf jumps or ends, and has {rate})"
    )
    bag = corrected_odometry(capture, np.array([0.0, 0.1]) * span_s)  # then, none for long
    recording = open_recording(str(bag.write(tmp_path / "stopped")))
    assert len(recording) == int((fractions <= 0.2).sum())


def test_slow_transforms_of_the_camera_are_named(tmp_path: Path, capture: Capture) -> None:
    """Its movement between two poses is unknown."""
    bag = without_poses(capture)
    step_s = float(capture.times_s[1] - capture.times_s[0])
    for time_s in capture.times_s[0] + step_s * np.arange(0.5, 12.0, 4.0):
        pose = np.eye(4)
        pose[0, 3] = time_s - capture.times_s[0]
        bag.add("/tf", time_s, bag.ros.tf(bag.ros.transform(time_s, WORLD, BODY, pose)))
    path = bag.write(tmp_path / "walk")
    problem = rf"12 without a pose near in time \(map to {BODY} of /tf has 3.[78] Hz\)"
    refuses_to_open(path, path, problem, "poses come at 4 Hz or more")


def test_poses_are_interpolated_and_what_is_left_out_is_told(tmp_path: Path, capture: Capture) -> None:
    bag = without_poses(capture)
    for time_s, pose in odometry_of(capture)[:6]:
        for offset in (-0.03, 0.03):  # seconds, and metres: 1 m/s along x
            shifted = pose.copy()
            shifted[0, 3] += offset
            bag.add(ODOM, time_s, bag.ros.odometry(time_s + offset, BODY, shifted))
    lost = bag.ros.odometry(capture.times_s[-1], BODY, np.eye(4))  # what a tracker may say that has lost its way
    lost.pose.pose.position.x = np.nan
    bag.add(ODOM, capture.times_s[-1], lost)
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    assert recording.notes[1:] == ["6 of 12 frames are left out: 6 without a pose near in time (/odom has 16 Hz)"]
    assert recording.poses is not None
    np.testing.assert_allclose(recording.poses, capture.poses[:6], atol=1e-6)


def test_pose_without_a_body_needs_one(tmp_path: Path, capture: Capture) -> None:
    bag = without_poses(capture)
    for time_s, pose in odometry_of(capture):
        bag.add("/mocap", time_s, bag.ros.pose_stamped(time_s, WORLD, pose))
    path = bag.write(tmp_path / "walk")
    refuses_to_open(path, path / "mocap", "does not say which frame", f"#poses=/mocap,body=FRAME.*{OPTICAL}")
    check_opened(open_recording(f"rosbag:{path}#poses=/mocap,body={BODY}"), capture, capture.depths_mm, 1e-9)


def test_body_is_of_poses_that_do_not_state_theirs(tmp_path: Path, capture: Capture) -> None:
    """Odometry of the body is beside poses of the camera: to take it as the camera's would tilt every pose."""
    bag = bag_of(capture)
    for time_s, pose in zip(capture.times_s, capture.poses, strict=True):
        bag.add("/mocap", time_s, bag.ros.pose_stamped(time_s, WORLD, pose))
    time_s, pose = odometry_of(capture)[-1]
    bag.add(ODOM, time_s + 1.0, bag.ros.odometry(time_s + 1.0, BODY, pose))  # there is more of it
    path = bag.write(tmp_path / "walk")
    for choice in (f"body={OPTICAL}", f"poses=/mocap,body={OPTICAL}"):
        check_opened(open_recording(f"rosbag:{path}#{choice}"), capture, capture.depths_mm, 1e-9)
    chosen = open_recording(f"rosbag:{path}#poses={ODOM},body={OPTICAL}")  # of the topic that it is chosen with
    assert f"poses are those of {ODOM}, of {OPTICAL}" in chosen.notes[0]


def test_optical_poses_are_taken_as_they_are(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, poses=False)
    for time_s, pose in zip(capture.times_s, capture.poses, strict=True):
        bag.add("/vio", time_s, bag.ros.odometry(time_s, "left_optical", pose))
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    check_opened(recording, capture, capture.depths_mm, 1e-9)
    assert "of left_optical, taken as the colour camera's" in recording.notes[0]


def test_pose_of_a_body_with_unknown_mount_is_refused(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture)
    del bag.topics["/tf_static"]
    path = bag.write(tmp_path / "walk")
    refuses_to_open(path, path / "odom", f"poses of {BODY}, and /tf_static does not say where", "#poses=none")
    assert open_recording(f"rosbag:{path}#poses=none").poses is None
    refuses_data(
        lambda: open_recording(f"rosbag:{path}#poses=/tf"), path, "no moving frame above", "record /tf_static"
    )


@pytest.mark.parametrize(
    ("model", "coefficients", "expected"),
    [
        ("plumb_bob", (0.05, -0.02, 0.001, 0.002, 0.0), "brown"),
        ("rational_polynomial", (0.05, 0.01, 0.001, 0.002, 0.0, 0.04, 0.0, 0.0), "rational"),
        ("equidistant", (0.01, 0.002, 0.0, 0.0), "fisheye"),
        ("", (), "brown"),
    ],
)
def test_lens_of_each_model(
    tmp_path: Path, capture: Capture, model: str, coefficients: Sequence[float], expected: str
) -> None:
    bag = bag_of(capture, version=1, poses=False, depth=False)
    bag.topics["/cam/color/camera_info"] = [
        (0.0, bag.ros.info(capture.camera, OPTICAL, model, d=np.array(coefficients)))
    ]
    camera = open_recording(str(bag.write(tmp_path / "walk"))).camera
    assert camera == replace(capture.camera, distortion=tuple(coefficients), distortion_model=expected)


def sensor_of(capture: Capture) -> Camera:
    """The sensor of whose pixels (20, 8) to (340, 392) the capture's images show each 2x3 as one."""
    camera = capture.camera
    centre = (2 * (camera.cx + 0.5) - 0.5 + 20, 3 * (camera.cy + 0.5) - 0.5 + 8)
    return Camera(400, 420, 2 * camera.fx, 3 * camera.fy, *centre)


@pytest.mark.parametrize("version", [1, 2])
def test_region_and_binning_of_a_sensor_are_applied(tmp_path: Path, capture: Capture, version: int) -> None:
    bag = bag_of(capture, version)
    info = bag.ros.info(sensor_of(capture), OPTICAL, binning=(2, 3), roi=(20, 8, 321, 385))  # a rest of one pixel
    bag.topics = {"/info": [(0.0, info)]} | {
        topic: messages for topic, messages in bag.topics.items() if not topic.endswith("camera_info")
    }
    recording = open_recording(str(bag.write(tmp_path / "walk")))
    check_opened(recording, capture, capture.depths_mm, 1e-9)
    numbers = ("width", "height", "fx", "fy", "cx", "cy")
    np.testing.assert_allclose(
        *([getattr(each, name) for name in numbers] for each in (recording.camera, capture.camera))
    )


def test_binning_that_the_intrinsics_allow_for_is_not_applied(tmp_path: Path, capture: Capture) -> None:
    """As some drivers write it: width, height and K are those of the images."""
    bag = bag_of(capture, poses=False, depth=False)
    bag.topics["/cam/color/camera_info"] = [(0.0, bag.ros.info(capture.camera, OPTICAL, binning=(2, 2)))]
    assert open_recording(str(bag.write(tmp_path / "walk"))).camera == capture.camera


def test_region_outside_the_sensor_is_refused(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, poses=False, depth=False)
    info = bag.ros.info(sensor_of(capture), OPTICAL, roi=(240, 8, 161, 128))
    bag.topics["/cam/color/camera_info"] = [(0.0, info)]
    path = bag.write(tmp_path / "walk")
    problem = r"has the roi 161x128 at \(240, 8\), outside its 400x420"
    refuses_to_open(path, path / "cam/color/camera_info", problem, "give --camera W,H")
    whole = replace(capture.camera, distortion=(0.01, 0.0, 0.0, 0.0, 0.0))
    assert open_recording(str(path), ReaderOptions(whole)).camera == whole


def test_intrinsics_that_change_are_told(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, poses=False, depth=False)
    told = "of which the first is used, as they change"
    bag.add("/cam/color/camera_info", 0.5, bag.ros.info(capture.camera, OPTICAL))
    assert told not in open_recording(str(bag.write(tmp_path / "same"))).notes[0]
    first = bag.topics.pop("/cam/color/camera_info")
    for name, camera, binning in (("lens", replace(capture.camera, fx=140.0), 0), ("binning", capture.camera, 2)):
        changed = bag.ros.info(camera, OPTICAL, binning=(binning, binning))
        bag.topics["/cam/color/camera_info"] = [*first, (1.0, changed)]
        recording = open_recording(str(bag.write(tmp_path / name)))
        assert recording.camera == capture.camera and told in recording.notes[0]


def test_rectified_images_have_the_projection_matrix(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, poses=False, depth=False)
    lens = replace(capture.camera, fx=100.0, distortion=(0.05, 0.0, 0.0, 0.0, 0.0))
    P = np.hstack([capture.camera.matrix, np.zeros((3, 1))]).reshape(-1)
    bag.topics = {
        "/cam/color/camera_info": [(0.0, bag.ros.info(lens, OPTICAL, p=P))],
        "/cam/color/image_rect_color": bag.topics[COLOR],
    }
    assert open_recording(str(bag.write(tmp_path / "walk"))).camera == capture.camera


@pytest.mark.parametrize(
    ("changes", "model", "problem", "fix"),
    [
        ({"k": np.zeros(9)}, "plumb_bob", "has no focal length in K", "calibrate"),
        ({"d": np.full(5, 0.01)}, "ftheta", "model 'ftheta'", "one of plumb_bob"),
        ({"d": np.full(8, 0.001)}, "plumb_bob", "has 8 coefficients of plumb_bob", "k1, k2"),
        ({"d": np.full(14, 0.001)}, "rational_polynomial", "has 14 coefficients", "k1, k2"),
    ],
)
def test_unusable_camera_info_is_refused(
    tmp_path: Path, capture: Capture, changes: dict[str, Any], model: str, problem: str, fix: str
) -> None:
    bag = bag_of(capture, poses=False, depth=False)
    bag.topics["/cam/color/camera_info"] = [(0.0, bag.ros.info(capture.camera, OPTICAL, model, **changes))]
    path = bag.write(tmp_path / "walk")
    refuses_to_open(path, path / "cam/color/camera_info", problem, fix)


@pytest.mark.parametrize(
    ("pixels", "encoding", "problem", "fix"),
    [
        (np.zeros((128, 160), np.uint8), "bayer_rggb8", "encoding 'bayer_rggb8'", "debayer node"),
        (np.zeros((128, 160, 2), np.uint8), "yuv422", "encoding 'yuv422'", "record one of rgb8"),
        (np.zeros((64, 80, 3), np.uint8), "rgb8", "is 80x64, but the intrinsics are for 160x128", "CameraInfo"),
        (np.zeros((128, 160), np.uint8), "rgb8", "holds 20480 bytes, rows of 160", "record it again"),
    ],
)
def test_unusable_image_is_refused(
    tmp_path: Path, capture: Capture, pixels: NDArray[Any], encoding: str, problem: str, fix: str
) -> None:
    bag = bag_of(capture, poses=False, depth=False)
    bag.topics[COLOR] = [(1.0, bag.ros.image(1.0, OPTICAL, pixels, encoding))]
    path = bag.write(tmp_path / "walk")
    refuses_to_open(path, path / COLOR[1:], problem, fix)


def test_rvl_is_refused(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, depth=False)
    bag.add(
        DEPTH, 1.0, bag.ros.compressed(float(capture.times_s[0]), OPTICAL, bytes(64), "16UC1; compressedDepth rvl")
    )
    path = bag.write(tmp_path / "walk")
    refuses_to_open(path, path / DEPTH[1:], "RVL", "format of compressedDepth set to png")


@pytest.mark.parametrize(
    ("choice", "problem", "fix"),
    [
        ("color=/no", "color=/no is not in the bag", "choose from /cam/color/image_raw"),
        ("poses=/no", "poses=/no is not in the bag", "choose from /odom, /tf"),
        ("colour=/no", "is no choice of topics", "write PATH#color=TOPIC"),
        ("color", "is no choice of topics", "write PATH#color=TOPIC"),
    ],
)
def test_wrong_choice_is_refused(tmp_path: Path, capture: Capture, choice: str, problem: str, fix: str) -> None:
    path = bag_of(capture).write(tmp_path / "walk")
    refuses_setting(lambda: open_recording(f"rosbag:{path}#{choice}"), "SOURCE", problem, fix)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _replace(old: bytes, new: bytes) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        data = path.read_bytes()
        assert old in data and len(old) == len(new)
        path.write_bytes(data.replace(old, new))

    return change


def _forget_index(path: Path) -> None:
    """Set the footer's offset of the summary to 0."""
    data = bytearray(path.read_bytes())
    data[-28:-20] = bytes(8)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("version", "storage", "damage", "problem", "fix"),
    [
        (1, "", _cut, "cannot be read", "rosbag reindex"),
        (1, "", _replace(b"#ROSBAG V2.0", b"#ROSBAG V1.2"), "version 102", "rosbag fix"),
        (1, "", _replace(b"compression=none", b"compression=nine"), "Compression 'nine'", "rosbag decompress"),
        (2, "mcap", _cut, "end magic is invalid", "mcap recover"),
        (2, "mcap", _replace(b"\x04\x00\x00\x00ros2", b"\x04\x00\x00\x00ros1"), "Profile is not ros2", "ros2 bag"),
        (2, "mcap", _forget_index, "has no index of chunks", "mcap recover"),
        (2, "db3", _cut, "cannot be read as a ROS bag", "copy the bag again"),
    ],
)
def test_damaged_bag_is_refused(
    tmp_path: Path,
    capture: Capture,
    version: int,
    storage: str,
    damage: Callable[[Path], None],
    problem: str,
    fix: str,
) -> None:
    path = bag_of(capture, version).write(tmp_path / "walk", storage)
    if version == 2:
        path = path / f"walk.{storage}"
    damage(path)
    refuses_to_open(path, path, problem, fix)


def test_encrypted_bag_is_refused(tmp_path: Path, capture: Capture) -> None:
    path = bag_of(capture, 1).write(tmp_path / "walk")
    data = path.read_bytes()
    start = data.index(b"\n") + 1
    (length,) = struct.unpack_from("<I", data, start)
    entry = b"encryptor=rosbag/AesCbcEncryptor"
    header = data[start + 4 : start + 4 + length] + struct.pack("<I", len(entry)) + entry
    (padding,) = struct.unpack_from("<I", data, start + 4 + length)
    grown = len(entry) + 4
    rest = struct.pack("<I", padding - grown) + data[start + 8 + length : -grown or None]
    body = data[start + 8 + length + grown :]
    path.write_bytes(data[:start] + struct.pack("<I", len(header)) + header + rest[:4] + body)
    refuses_to_open(path, path, "encryption 'rosbag/AesCbcEncryptor' is not supported", "rosbag decrypt")


def test_compressed_messages_need_the_metadata(tmp_path: Path, capture: Capture) -> None:
    path = bag_of(capture).write(tmp_path / "walk", "sqlite3", "MESSAGE")
    (file,) = path.glob("*.db3*")
    refuses_to_open(file, file, "has compressed messages", "folder with its metadata.yaml")


def test_missing_file_of_a_bag_is_refused(tmp_path: Path, capture: Capture) -> None:
    path = bag_of(capture).write(tmp_path / "walk")
    next(path.glob("*.db3")).unlink()
    refuses_to_open(path, path, "database files are missing", "ros2 bag reindex")
    (path / "metadata.yaml").unlink()
    refuses_data(lambda: open_recording(f"rosbag:{path}"), path, "is not a ROS bag", "metadata.yaml")


def test_unusable_poses_are_refused(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture)
    bag.add(ODOM, 0.0, bag.ros.odometry(0.0, "arm", np.eye(4)))
    path = bag.write(tmp_path / "mixed")
    refuses_to_open(path, path / "odom", "holds poses of several frames", "#poses=none")
    for _, message in bag.topics[ODOM]:
        message.child_frame_id, message.pose.pose.orientation.w = BODY, np.nan
    path = bag.write(tmp_path / "lost")
    refuses_to_open(path, path / "odom", "holds no finite pose", "after the tracker has started")


def test_bag_that_changes_is_refused(tmp_path: Path, capture: Capture) -> None:
    path = bag_of(capture).write(tmp_path / "walk") / "walk.db3"
    recording = open_recording(str(path))
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM messages WHERE id > 3")
    database.close()
    refuses_data(lambda: recording.color(9), path, "no longer holds a message of /cam|cannot be read", "leave|copy")


def test_other_clock_is_refused(tmp_path: Path, capture: Capture) -> None:
    bag = bag_of(capture, depth=False)
    bag.topics[ODOM] = [(t, bag.ros.odometry(t - 1e6, BODY, np.eye(4))) for t in capture.times_s]
    path = bag.write(tmp_path / "walk")
    refuses_to_open(path, path, "none of its 12 frames can be used: 12 without a pose", "one clock")


def stamped(capture: Capture, stamps_s: NDArray[np.float64]) -> Bag:
    """The capture without depth and poses, recorded at its times, whose images have other stamps."""
    bag = bag_of(capture, poses=False, depth=False)
    del bag.topics[COLOR]
    for time_s, stamp_s, color in zip(capture.times_s, stamps_s, capture.colors, strict=True):
        bag.add(COLOR, time_s, bag.ros.image(stamp_s, OPTICAL, color, "rgb8"))
    return bag


def test_clock_that_begins_at_zero_is_taken(tmp_path: Path, capture: Capture) -> None:
    stamps_s = capture.times_s - capture.times_s[0]
    recording = open_recording(str(stamped(capture, stamps_s).write(tmp_path / "walk")))
    np.testing.assert_allclose(recording.timestamps_s, stamps_s, atol=1e-6)
    assert len(recording.notes) == 1
    np.testing.assert_array_equal(recording.color(0), capture.colors[0])


def test_images_without_stamps_have_the_times_of_recording(tmp_path: Path, capture: Capture) -> None:
    recording = open_recording(str(stamped(capture, np.zeros(len(capture))).write(tmp_path / "walk")))
    np.testing.assert_allclose(recording.timestamps_s, capture.times_s, atol=1e-6)
    assert recording.notes[1:] == [f"{COLOR} has no time stamps, so the times of recording are used"]


def test_missing_extra_is_named(tmp_path: Path, capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag_of(capture).write(tmp_path / "walk")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    refuses(lambda: open_recording(str(path)), MissingExtraError, r"\[ros\]")


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "problem", "fix"),
    [
        ("ros1-images.bag", "holds no CameraInfo of /image", "--camera"),
        ("realsense-d4xx.bag", "recording of the RealSense SDK", "ros2 bag record"),
        ("lz4.bag", r"holds no colour images; its topics are .*turtle1/pose", "record sensor_msgs/Image"),
        ("tf.bag", "holds no colour images; its topics are /tf", "record"),
        ("tf.db3", "holds no colour images; its topics are /tf", "record"),
        ("compressed-messages.db3", "holds no colour images", "record"),
        ("nav2-turtlebot.mcap", "holds no colour images; its topics are /amcl_pose", "record"),
    ],
)
def test_real_log_is_refused(data_root: Path, name: str, problem: str, fix: str) -> None:
    path = data_root / "logs" / name
    if not path.is_file():
        pytest.skip(f"no log at {path}")
    refuses_to_open(path, path, problem, fix)


@pytest.mark.data
def test_real_logs_with_images_open(data_root: Path) -> None:
    logs = data_root / "logs"
    if not logs.is_dir():
        pytest.skip(f"no logs at {logs}")
    camera = Camera(360, 240, 300.0, 300.0, 180.0, 120.0)
    first = open_recording(str(logs / "ros1-images.bag"), ReaderOptions(camera))
    assert first.color(0)[0, 0].tolist() == [166, 163, 175] and first.notes[-1].startswith(
        "/image has no time stamps"
    )
    second = open_recording(str(logs / "ros2-sensors.mcap"))
    assert second.camera == Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
    assert second.color(0)[0, 0].tolist() == [219, 0, 4]
    compressed = open_recording(f"rosbag:{logs}/ros2-sensors.mcap#color=/compressed_image")
    assert compressed.color(0).shape == (480, 640, 3)
