"""Frames and maps that cannot give a pose, or only a poor one, are recognised."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from altered_recordings import Altered, range_of
from monoloc.builder import checks
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_frames, check_recording
from monoloc.builder.room_map import fit_map
from monoloc.errors import DataError
from monoloc.geometry import invert, make_pose, so3_exp
from monoloc.io.recording import Recording
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.recording_check.depth_check import DepthCheck
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, depth_from_blue, make_path

FloatArray = NDArray[np.float64]

FRAMES = 8
AT_WALL = (
    np.array([-1.2, -0.3, -1.0]),
    np.array([0.0, -np.pi / 2.0, 0.0]),
)  # position and turn: one wall fills the view


class Noisy(RoomRecording):
    """The room, seen by a sensor whose errors grow with the square of depth: 1 % at a metre."""

    def depth(self, index: int) -> NDArray[np.float32]:
        exact = super().depth(index)
        noise = np.random.default_rng(index).standard_normal(exact.shape)
        return np.asarray(exact * (1.0 + 0.01 * exact * noise), dtype=np.float32)


def hovering(position: FloatArray, turn: FloatArray, count: int = FRAMES) -> FloatArray:
    """Poses about a place, a decimetre and two degrees off, (count, 4, 4)."""
    rng = np.random.default_rng(1)
    turns = so3_exp(turn + rng.normal(0.0, 0.03, (count, 3)))
    return make_pose(turns, position + rng.normal(0.0, 0.1, (count, 3)))


def flying() -> FloatArray:
    return make_path(FRAMES, rate_hz=2.0)


@pytest.fixture(scope="module")
def room_map() -> tuple[FloatArray, GaussianMixture]:
    cloud = Room().cloud(0.04)
    return cloud, fit_mixture(cloud, 150, np.random.default_rng(0)).mixture


def check(recording: Recording, cloud: FloatArray, mixture: GaussianMixture, given: bool = True) -> list[str]:
    return check_frames(recording, cloud, mixture, given, depth_from_blue(), np.random.default_rng(0))


# --- Surfaces ---


def check_own_map(poses: FloatArray) -> list[str]:
    recording = Noisy(Room(), poses, SMALL_CAMERA)
    config = BuildConfig(components=100)
    cloud, mixture = fit_map(recording, None, config, np.random.default_rng(0), NoProgress())
    return check(recording, cloud, mixture, given=False)


def test_frames_of_a_room_give_no_warning() -> None:
    assert check_own_map(flying()) == []


def test_frames_of_one_wall_are_refused() -> None:
    with pytest.raises(
        DataError, match=r"^room: all frames see one flat surface \(9\d% faces one way\); record a trajectory"
    ):
        check_own_map(hovering(*AT_WALL))


def test_frames_of_two_surfaces_give_a_warning() -> None:
    """A wall and the floor: along their edge nothing fixes the camera."""
    down = make_pose(so3_exp([-0.6, 0.0, 0.0]), np.zeros(3))
    (warning,) = check_own_map(hovering(np.array([-1.3, 0.2, -0.2]), np.array([0.0, -np.pi / 2.0, 0.0])) @ down)
    assert "poses will slide that way" in warning
    x, y, z = (float(value) for value in warning[warning.index("(") + 1 : warning.index(")")].split(","))
    assert abs(z) > 0.95 and max(abs(x), abs(y)) < 0.3


def test_frames_of_one_wall_each_give_a_warning() -> None:
    """Wall after wall, never two at once: the map is good, but no frame gives a pose by itself."""
    facing = hovering(*AT_WALL)
    floor = hovering(np.array([0.0, -0.8, -0.8]), np.array([-np.pi / 2.0, 0.0, 0.0]))
    other = hovering(np.array([0.0, -0.3, -1.0]), np.array([0.0, np.pi, 0.0]))
    (warning,) = check_own_map(np.concatenate([facing, other, floor]))
    assert "see one flat surface only" in warning


# --- Poses and cloud ---

TURNED = make_pose(so3_exp([0.3, 1.2, -2.0]), np.array([0.5, 1.0, -0.3]))
OTHER_FRAMES = {
    "another world": lambda poses: TURNED @ poses,
    "inverted": lambda poses: invert(TURNED @ poses),
    "axes as in OpenGL": lambda poses: poses @ np.diag([1.0, -1.0, -1.0, 1.0]),
    "millimetres": lambda poses: make_pose(poses[:, :3, :3], 1000.0 * poses[:, :3, 3]),
    "far away": lambda poses: make_pose(np.eye(3), np.array([50.0, 0.0, 0.0])) @ poses,
}


@pytest.mark.parametrize("has_depth", [True, False])
def test_poses_in_the_clouds_frame_give_no_warning(
    room_map: tuple[FloatArray, GaussianMixture], has_depth: bool
) -> None:
    assert check(RoomRecording(Room(), flying(), SMALL_CAMERA, has_depth), *room_map) == []


@pytest.mark.parametrize("has_depth", [True, False])
def test_network_whose_scale_is_fitted_later_judges_nothing(
    room_map: tuple[FloatArray, GaussianMixture], has_depth: bool
) -> None:
    model = depth_from_blue()
    far = model.spec.model_copy(update={"scale": None, "mean": (0.5, 0.5, -0.7)})  # dozens of times as far
    recording = RoomRecording(Room(), flying(), SMALL_CAMERA, has_depth)
    assert check_frames(recording, *room_map, True, replace(model, spec=far), np.random.default_rng(0)) == []


def in_another_frame(name: str, has_depth: bool) -> RoomRecording:
    recording = RoomRecording(Room(), flying(), SMALL_CAMERA, has_depth)
    recording.poses = OTHER_FRAMES[name](flying())
    return recording


@pytest.mark.parametrize("name", OTHER_FRAMES)
def test_poses_in_another_frame_are_refused(room_map: tuple[FloatArray, GaussianMixture], name: str) -> None:
    with pytest.raises(
        DataError, match=r"^room: poses and cloud are not in one frame \(depth fits .*\); give T_world"
    ):
        check(in_another_frame(name, has_depth=True), *room_map)


def test_other_frame_is_recognised_despite_holes_in_depth(room_map: tuple[FloatArray, GaussianMixture]) -> None:
    """Holes are filled with the cloud as seen from the poses, which fits any poses."""

    class Holes(RoomRecording):
        def depth(self, index: int) -> NDArray[np.float32]:
            depth = super().depth(index).copy()
            depth[:, ::3] = depth[:, 1::3] = 0.0
            return depth

    recording = Holes(Room(), flying(), SMALL_CAMERA)
    assert check(recording, *room_map) == []
    recording.poses = TURNED @ flying()
    with pytest.raises(DataError, match="not in one frame"):
        check(recording, *room_map)


@pytest.mark.parametrize("name", ["another world", "millimetres", "far away"])
def test_poses_in_another_frame_without_sensor_depth_are_refused_or_warned_of(
    room_map: tuple[FloatArray, GaussianMixture], name: str
) -> None:
    """With a network's depth a warning is all that is certain, unless nothing is seen or nothing fits."""
    try:
        (message,) = check(in_another_frame(name, has_depth=False), *room_map)
    except DataError as error:
        message = str(error)
    assert re.search(
        "may not be in one frame|are not in one frame .*; give|next to nothing of the cloud; give", message
    )


def test_slightly_wrong_poses_give_a_warning(room_map: tuple[FloatArray, GaussianMixture]) -> None:
    recording = RoomRecording(Room(), flying(), SMALL_CAMERA)
    recording.poses = make_pose(so3_exp([0.0, 0.12, 0.0]), np.array([0.25, 0.0, 0.1])) @ flying()
    (warning,) = check(recording, *room_map)
    assert "may not be in one frame" in warning


# --- Clouds ---


def test_cloud_in_millimetres_is_refused() -> None:
    with pytest.raises(
        DataError, match=r"^cloud: none of \d+ points has neighbours .*; give a denser one, in metres"
    ):
        fit_map(None, 1000.0 * Room().cloud(0.2), BuildConfig(), np.random.default_rng(0), NoProgress())


# --- Scale ---


@pytest.mark.parametrize(("scale", "is_warned_of"), [(1.0, False), (0.75, False), (0.5, True), (1.8, True)])
@pytest.mark.parametrize("has_depth", [True, False])
def test_scale_that_is_not_the_networks_is_warned_of(
    room_map: tuple[FloatArray, GaussianMixture], scale: float, is_warned_of: bool, has_depth: bool
) -> None:
    """A cloud from structure from motion, or a whole recording, in a scale of its own."""
    cloud, original = scale * room_map[0], room_map[1]
    mixture = GaussianMixture(original.weights, scale * original.means, scale**2 * original.covariances)
    recording = RoomRecording(Room(), flying(), SMALL_CAMERA, has_depth)
    assert recording.poses is not None
    scaled = Altered(
        recording,
        poses=make_pose(recording.poses[:, :3, :3], scale * recording.poses[:, :3, 3]),
        depth=lambda depth: scale * depth,
        has_depth=has_depth,
    )
    warnings = [each for each in check(scaled, cloud, mixture, given=not has_depth) if "network's" in each]
    assert len(warnings) == is_warned_of
    if warnings:
        what = "depth" if has_depth else "the cloud"
        found = re.fullmatch(
            rf"{what} is ([\d.]+) times as far as the network's; it may be in a scale .*", warnings[0]
        )
        assert found and float(found[1]) == pytest.approx(scale, rel=0.06)


def test_scale_that_was_asked_for_is_to_be_checked_there(room_map: tuple[FloatArray, GaussianMixture]) -> None:
    """As by a marker that is printed half as large as it is said to be."""
    cloud, mixture = 2.0 * room_map[0], room_map[1]
    mixture = GaussianMixture(mixture.weights, 2.0 * mixture.means, 4.0 * mixture.covariances)
    recording = RoomRecording(Room(), flying(), SMALL_CAMERA)
    assert recording.poses is not None
    poses = make_pose(recording.poses[:, :3, :3], 2.0 * recording.poses[:, :3, 3])
    scaled = Altered(recording, poses=poses, depth=lambda depth: 2.0 * depth)
    scaled.scale_sd = 0.02
    (warning,) = [each for each in check(scaled, cloud, mixture, given=False) if "network's" in each]
    assert warning.endswith("which may be off as much; check the size, distance or depth that --scale named")


# --- Recording ---


@pytest.mark.slow
def test_recording_is_checked_before_its_map() -> None:
    """Poses have the first word, and a right recording is silent."""
    recording = RoomRecording(Room(), make_path(24), SMALL_CAMERA)
    assert check_recording(recording, None, BuildConfig()) == []
    assert recording.poses is not None
    inverted = Altered(recording, poses=invert(recording.poses), depth=range_of(recording))
    with pytest.raises(DataError, match=r"^room: poses and images disagree: .* as world-to-camera; give --fix-poses"):
        check_recording(inverted, None, BuildConfig())
    with pytest.raises(DataError, match=r"^room: depth is distance .*; give --fix-depth range$"):
        check_recording(Altered(recording, depth=range_of(recording)), None, BuildConfig())


def timed(times_s: FloatArray) -> RoomRecording:
    recording = RoomRecording(Room(), make_path(len(times_s)), SMALL_CAMERA.resized(32, 26))
    recording.timestamps_s = times_s
    return recording


def test_times_in_another_unit_are_refused() -> None:
    words = r"^room: time stamps are 66\.67 s apart: they look like milliseconds; divide them by 1000$"
    with pytest.raises(DataError, match=words):
        check_recording(timed(1e3 * np.arange(20) / 15.0), None, BuildConfig())


def test_times_that_look_like_frame_numbers_are_warned_of() -> None:
    first, *_ = check_recording(timed(np.arange(20.0)), None, BuildConfig())
    assert first == (
        "time stamps are whole numbers, one frame a second: they look like frame numbers; "
        "divide them by the frame rate, unless the camera took one image a second"
    )


def test_depth_that_one_view_shows_by_chance_is_warned_of_and_of_several_views_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = DepthCheck(1.0, 2.0, 0.5, 1.2, "mirrored", has_few_views=True)
    monkeypatch.setattr(checks, "check_depth", lambda _: seen)
    recording = timed(np.arange(20) / 15.0)
    remedy = "store depth and colour images the same way around"
    chance = "perhaps by chance, as the camera hovers in one view"
    warning = f"depth is not registered to the images: its edges fit mirrored, {chance}; otherwise {remedy}"
    assert warning in check_recording(recording, None, BuildConfig())
    seen = replace(seen, has_few_views=False)
    with pytest.raises(DataError, match=rf"^room: depth is not registered .* fit mirrored; {remedy}$"):
        check_recording(recording, None, BuildConfig())


def test_walk_with_images_on_their_side_is_warned_of() -> None:
    poses = make_pose(so3_exp(np.outer(np.linspace(0.0, 3.0, 12), [1.0, 0.0, 0.0])), np.zeros((12, 3)))
    warnings = check_recording(RoomRecording(Room(), poses, SMALL_CAMERA), None, BuildConfig())
    assert warnings[-1].startswith("images lie on their side") and "dataset.toml" in warnings[-1]
