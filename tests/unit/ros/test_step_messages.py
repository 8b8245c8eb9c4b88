"""What a result says in ROS: one whole tree of frames, and nothing of a pose that is not known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavlink_helpers import BLACK, CAMERA, step_at
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, so3_exp
from monoloc.odometry.motion import Motion
from monoloc.ros.message_contents import TopicMessage
from monoloc.ros.ros_frames import RosFrames, pose_of
from monoloc.ros.step_messages import IMAGE, INFO, OBSTACLES, POSE, STATE, TF, ImageMessages, StepMessages
from monoloc.supervision.state import Reason, State

FRAMES = RosFrames(Mount(forward_m=0.2, yaw_deg=20.0).T_body_camera, (0.0, 1.0, 0.0))
PERIOD_NS = 50_000_000


def motion(twist: FloatArray) -> Motion:
    return Motion(se3_exp(twist))


def as_object(content: dict[str, Any]) -> SimpleNamespace:
    """A message whose fields are attributes."""
    return SimpleNamespace(**{k: as_object(v) if isinstance(v, dict) else v for k, v in content.items()})


def tree_of(messages: list[TopicMessage]) -> dict[tuple[str, str], FloatArray]:
    (message,) = (each for each in messages if each.topic == TF)
    return {
        (each["header"]["frame_id"], each["child_frame_id"]): pose_of(as_object({"transform": each["transform"]}))
        for each in message.content["transforms"]
    }


def topics_of(messages: list[TopicMessage]) -> set[str]:
    return {message.topic for message in messages}


def test_the_tree_leads_from_the_map_to_the_camera_and_odom_does_not_jump() -> None:
    """Odometry moves odom -> base_link, and a belief that jumps moves map -> odom alone."""
    messages = StepMessages(FRAMES, with_obstacles=True)
    rng = np.random.default_rng(0)
    pose, T_odom_base = se3_exp(rng.standard_normal(6)), np.eye(4)
    for index in range(5):
        twist = 0.05 * rng.standard_normal(6)
        pose = pose @ se3_exp(twist) if index != 3 else se3_exp(rng.standard_normal(6))
        step = replace(step_at(pose), motion=motion(twist) if index not in (0, 2) else None)
        tree = tree_of(messages.of(index * PERIOD_NS, step))
        assert set(tree) == {
            ("map", "odom"),
            ("odom", "base_link"),
            ("base_link", "camera_optical_frame"),
            ("map", "room"),
        }
        whole = tree["map", "odom"] @ tree["odom", "base_link"] @ tree["base_link", "camera_optical_frame"]
        np.testing.assert_allclose(whole, tree["map", "room"] @ pose, atol=1e-9)
        moved = invert(T_odom_base) @ tree["odom", "base_link"]
        expected = FRAMES.T_base_camera @ se3_exp(twist) @ invert(FRAMES.T_base_camera)
        np.testing.assert_allclose(moved, np.eye(4) if index in (0, 2) else expected, atol=1e-9)
        T_odom_base = tree["odom", "base_link"]


def test_odom_turns_with_a_gyroscope_and_is_in_metres() -> None:
    """A turn alone, a motion in metres, and one in units of a depth that is too small by a tenth."""
    messages = StepMessages(FRAMES, with_obstacles=True)
    T = se3_exp([0.1, 0.0, 0.05, 0.0, 0.2, 0.0])
    motions = Motion.rotation(T[:3, :3], 0.01), Motion.metric(T, 0.01, 0.01), Motion(T)
    for index, measured in enumerate(motions):
        step = step_at(np.eye(4))
        step = replace(step, motion=measured, estimate=replace(step.estimate, log_scale=np.log(1.1)))
        tree = tree_of(messages.of(index * PERIOD_NS, step))
    shifts = make_pose(T[:3, :3], np.zeros(3)), T, make_pose(T[:3, :3], 1.1 * T[:3, 3])
    expected = FRAMES.T_base_camera @ shifts[0] @ shifts[1] @ shifts[2] @ invert(FRAMES.T_base_camera)
    np.testing.assert_allclose(tree["odom", "base_link"], expected, atol=1e-9)


def test_odometry_of_another_node_is_corrected_and_not_published() -> None:
    T_odom_base = make_pose(so3_exp([0.0, 0.0, 1.0]), [3.0, 2.0, 1.0])
    step = step_at(se3_exp([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]))
    messages = StepMessages(FRAMES, with_obstacles=True, with_mount=False).of(0, step, T_odom_base)
    tree = tree_of(messages)
    assert set(tree) == {("map", "room"), ("map", "odom")}
    T_map_base, _ = FRAMES.base_pose(step.estimate)
    np.testing.assert_allclose(tree["map", "odom"] @ T_odom_base, T_map_base, atol=1e-9)
    (pose,) = (each for each in messages if each.topic == POSE)
    np.testing.assert_allclose(pose_of(as_object(pose.content)), T_map_base, atol=1e-9)


@pytest.mark.parametrize(
    ("state", "reasons", "covariance", "level"),
    [
        ("lost", {Reason.SEARCHING}, None, 2),
        ("uncertain", {Reason.IMAGE_REPEATED}, None, 1),
        ("uncertain", {Reason.IMAGE_EMPTY, Reason.NO_ODOMETRY}, None, 1),
        ("tracking", set(), np.full((6, 6), np.inf), 0),
    ],
)
def test_without_a_pose_of_this_frame_there_is_odometry_and_the_state(
    state: State, reasons: set[Reason], covariance: FloatArray | None, level: int
) -> None:
    step = step_at(np.eye(4), state, frozenset(reasons), 0.7, covariance=covariance)
    step = (
        step if covariance is None else replace(step, estimate=replace(step.estimate, pose=np.full((4, 4), np.nan)))
    )
    messages = StepMessages(FRAMES, with_obstacles=True).of(5, step)
    assert topics_of(messages) == {TF, STATE}
    assert ("map", "odom") not in tree_of(messages) and ("odom", "base_link") in tree_of(messages)
    (status,) = next(each for each in messages if each.topic == STATE).content["status"]
    assert status["level"] == level
    values = {each["key"]: each["value"] for each in status["values"]}
    assert values["state"] == state and values["probability_far"] == "0.7"
    assert values["reasons"] == ", ".join(sorted(reason.value for reason in reasons))


def test_an_uncertain_pose_is_sent_with_its_state() -> None:
    messages = StepMessages(FRAMES, with_obstacles=False).of(0, step_at(np.eye(4), "uncertain"))
    assert topics_of(messages) == {TF, STATE, POSE}


def test_obstacles_are_the_corrected_depth_in_the_cameras_frame_up_to_five_metres() -> None:
    step = step_at(np.eye(4), depth_m=1.6)
    step = replace(step, estimate=replace(step.estimate, log_scale=float(np.log(1.25))))
    step.depth.depth_m[:15] = 4.2
    step.depth.depth_m[15:20] = 0.0
    made = StepMessages(FRAMES, with_obstacles=True)
    clouds = [each for index in range(5) for each in made.of(index * PERIOD_NS, step) if each.topic == OBSTACLES]
    assert [cloud.stamp_ns for cloud in clouds] == [0, 2 * PERIOD_NS, 4 * PERIOD_NS]  # ten a second
    content = clouds[0].content
    points = np.frombuffer(content["data"], "<f4").reshape(-1, 3)
    assert content["header"]["frame_id"] == "camera_optical_frame"
    assert (content["width"], content["point_step"], content["row_step"]) == (400, 12, 4800) and len(points) == 400
    pixels = CAMERA.project(points)
    np.testing.assert_allclose(points[:, 2], 2.0, rtol=1e-6)
    np.testing.assert_allclose([pixels.min(axis=0), pixels.max(axis=0)], [[0.0, 20.0], [39.0, 29.0]], atol=1e-4)


def test_images_come_five_times_a_second_with_their_camera() -> None:
    made = ImageMessages(CAMERA, "camera_optical_frame")
    messages = [each for index in range(9) for each in made.of(index * PERIOD_NS, BLACK)]
    assert [each.stamp_ns for each in messages if each.topic == IMAGE] == [0, 4 * PERIOD_NS, 8 * PERIOD_NS]
    assert [each.stamp_ns for each in messages if each.topic == INFO] == [0, 4 * PERIOD_NS, 8 * PERIOD_NS]


def test_images_go_on_after_a_clock_that_was_set_back() -> None:
    made = ImageMessages(CAMERA, "camera_optical_frame")
    stamps_ns = [9 * 10**12, 9 * 10**12 - 3600 * 10**9, 9 * 10**12 - 3600 * 10**9 + PERIOD_NS]
    assert [len(made.of(stamp_ns, BLACK)) for stamp_ns in stamps_ns] == [2, 2, 0]
