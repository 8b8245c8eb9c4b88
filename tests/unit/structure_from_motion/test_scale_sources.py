"""The scale of a model: by depth, a network, a marker and a marked distance, with its standard deviation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPredictor
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp, transform
from monoloc.structure_from_motion import depth_scale
from monoloc.structure_from_motion.dense_depth import small_camera
from monoloc.structure_from_motion.depth_scale import DepthScale, NetworkScale
from monoloc.structure_from_motion.distance_scale import DistanceScale
from monoloc.structure_from_motion.marker_scale import MarkerScale
from monoloc.structure_from_motion.scale_option import parse_scale
from monoloc.structure_from_motion.sparse_model import SparseModel
from refusals import refuses, refuses_data, refuses_setting
from synthetic_room import RoomRecording, depth_from_blue

UNIT_M = 0.25
SIZE_M = 0.7
T_WORLD_MARKER = make_pose(so3_exp([np.pi, 0.0, 0.0]), [0.1, 0.0, 2.0])


def own_depths(walk: RoomRecording) -> list[NDArray[np.float32]]:
    """The exact depth in the model's unit, without a part that was not found."""
    assert (small_camera(walk.camera).width, small_camera(walk.camera).height) == (160, 128)
    depths = [walk.depth(index) / np.float32(UNIT_M) for index in range(len(walk))]
    for depth in depths:
        depth[:, :40] = 0.0
    return depths


def test_depth_of_the_recording_gives_the_scale(walk: RoomRecording, model: SparseModel) -> None:
    found = DepthScale().measure(walk, model, own_depths(walk))
    assert found.metres == pytest.approx(UNIT_M, rel=0.002)
    assert 0.015 <= found.sd < 0.016  # a sensor's own error, as all frames agree
    assert found.is_bent is not None and not found.is_bent.any()


def test_depth_tells_where_the_model_is_bent(walk: RoomRecording, model: SparseModel) -> None:
    """As where a flat view and a screen that changed gave a part of the walk another scale."""
    bent = [3, 4, 5]
    scales = {
        3: 1.15,
        4: 1.7,
        5: 1.7,
        8: 1.15,
    }  # at its border, a bent part is less so; alone, that is no more than noise
    depths = [depth * np.float32(scales.get(index, 1.0)) for index, depth in enumerate(own_depths(walk))]
    found = DepthScale().measure(walk, model, depths)
    assert found.metres == pytest.approx(UNIT_M, rel=0.002)
    assert found.is_bent is not None and np.flatnonzero(found.is_bent).tolist() == bent


def test_model_without_frames_keeps_the_points_that_others_see(model: SparseModel) -> None:
    frame, point = np.repeat(np.arange(4), 3), np.array([0, 1, 2, 0, 1, 3, 0, 2, 3, 0, 2, 1])
    pixels = np.arange(24.0).reshape(12, 2)
    seen = replace(model, frames=np.arange(4) * 10, poses=model.poses[:4], frame=frame, point=point, pixels=pixels)
    left = seen.without(np.array([False, True, False, False]), least=3)
    assert left.frames.tolist() == [0, 20, 30]
    np.testing.assert_array_equal(left.points, model.points[[0, 2]])
    np.testing.assert_array_equal(left.poses, model.poses[[0, 2, 3]])
    assert [left.seen(each)[0].tolist() for each in range(3)] == [[0, 1], [0, 1], [0, 1]]
    np.testing.assert_array_equal(left.seen(1)[1], pixels[[6, 7]])


def test_networks_depth_gives_the_scale(
    walk: RoomRecording, model: SparseModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(depth_scale, "read_network", lambda name: depth_from_blue())
    found = NetworkScale().measure(walk, model, own_depths(walk))
    ratio = np.median(
        [np.median(DepthPredictor(depth_from_blue(), walk.camera)(walk.color(i)).depth_m) for i in range(len(walk))]
    ) / np.median([np.median(walk.depth(i)) for i in range(len(walk))])
    assert found.metres == pytest.approx(UNIT_M * ratio, rel=0.05)
    assert 0.3 <= found.sd < 0.35


def test_files_at_home_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No shell replaces the sign after a colon."""
    monkeypatch.setenv("HOME", str(tmp_path))
    assert parse_scale("distance:~/door.toml", False) == DistanceScale(tmp_path / "door.toml")
    assert parse_scale("network:~/net.onnx", False) == NetworkScale(str(tmp_path / "net.onnx"))


def test_nothing_in_common_gives_no_scale(walk: RoomRecording, model: SparseModel) -> None:
    nothing = [np.zeros((128, 160), dtype=np.float32)] * len(walk)
    refuses(lambda: DepthScale().measure(walk, model, nothing), DataError, "room: gives no scale: .*marker:ID:SIZE_M")


def test_recording_without_depth_cannot_give_the_scale(walk: RoomRecording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "has_depth", False)
    refuses_setting(lambda: DepthScale().frames(walk), "scale", "is depth, but room has none", "another --scale")


def with_marker(walk: RoomRecording, poses: FloatArray, squeeze: float = 1.0) -> list[NDArray[np.uint8]]:
    """The walk's images with marker 7 in the room, whose printed width is squeezed."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    printed = cv2.copyMakeBorder(
        cv2.aruco.generateImageMarker(dictionary, 7, 400), *[60] * 4, cv2.BORDER_CONSTANT, value=255
    )
    images = []
    for index, pose in enumerate(poses):
        T_marker_camera = invert(T_WORLD_MARKER) @ pose
        rays = walk.camera.pixel_rays() @ T_marker_camera[:3, :3].T
        origin = T_marker_camera[:3, 3]
        hit = origin + rays * (-origin[2] / rays[..., 2])[..., None]
        column = ((hit[..., 0] / squeeze / SIZE_M + 0.5) * 400.0 + 59.5).astype(np.float32)
        row = ((0.5 - hit[..., 1] / SIZE_M) * 400.0 + 59.5).astype(np.float32)
        gray = cv2.remap(printed, column, row, cv2.INTER_AREA, borderValue=0)
        inside = (column > 0) & (column < 519) & (row > 0) & (row < 519)
        image = walk.color(index).copy()
        image[inside] = gray[inside][:, None]
        images.append(image)
    return images


def test_marker_gives_the_scale_within_its_stated_error(
    walk: RoomRecording, model: SparseModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert walk.poses is not None
    images = with_marker(walk, walk.poses)
    monkeypatch.setattr(walk, "color", lambda index: images[index])
    assert len(MarkerScale(7, SIZE_M).frames(walk)) >= 3
    found = MarkerScale(7, SIZE_M).measure(walk, model, [])
    assert abs(np.log(found.metres / UNIT_M)) < 2.0 * found.sd < 0.1


@pytest.mark.slow
def test_marker_that_is_not_there_or_not_square_is_refused(
    walk: RoomRecording, model: SparseModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert walk.poses is not None
    refuses(
        lambda: MarkerScale(7, SIZE_M).frames(walk),
        DataError,
        "room: shows marker 7 of apriltag_36h11 in 0 of 12 frames",
    )
    refuses(
        lambda: MarkerScale(7, SIZE_M).measure(walk, model, []),
        DataError,
        "room: shows marker 7 from one side only, in 0",
    )
    images = with_marker(walk, walk.poses, squeeze=0.7)
    monkeypatch.setattr(walk, "color", lambda index: images[index])
    refuses(
        lambda: MarkerScale(7, SIZE_M).measure(walk, model, []),
        DataError,
        "room: shows marker 7 with sides that differ by .*; film it from nearer and from more sides, flat",
    )


def distance_file(folder: Path, model: SparseModel, frames: tuple[int, ...] = (0, 4, 8), metres: float = 0.8) -> Path:
    """Two points, 0.8 m apart, marked in some frames with an error of a pixel."""
    rng, lines = np.random.default_rng(1), [f"metres = {metres}"]
    for name, x in (("a", -0.4), ("b", 0.4)):
        pixels = model.camera.project(
            transform(invert(model.poses[list(frames)]), np.array([[x, 0.1, 2.0]]) / UNIT_M)[:, 0]
        )
        clicked = pixels + rng.normal(0.0, 1.0, pixels.shape)
        rows = [[f"{frame:06d}", *xy] for frame, xy in zip(frames, clicked.tolist(), strict=True)]
        lines.append(f"{name} = {rows}".replace("'", '"'))
    path = folder / "distance.toml"
    path.write_text("\n".join(lines))
    return path


def test_marked_distance_gives_the_scale_within_its_stated_error(
    walk: RoomRecording, model: SparseModel, tmp_path: Path
) -> None:
    scale = DistanceScale(distance_file(tmp_path, model))
    assert scale.frames(walk) == [0, 4, 8]
    found = scale.measure(walk, model, [])
    assert abs(np.log(found.metres / UNIT_M)) < 2.0 * found.sd < 0.2


def test_bad_distances_are_refused(walk: RoomRecording, model: SparseModel, tmp_path: Path) -> None:
    path = distance_file(tmp_path, model, frames=(0, 0))
    refuses_data(lambda: DistanceScale(path).measure(walk, model, []), path, "a is marked in 1 of the", "more frames")
    path.write_text(path.read_text().replace("000000", "IMG_1"))
    refuses_data(lambda: DistanceScale(path).frames(walk), path, "'IMG_1' is no frame of room", "000000 to 000011")
    path.write_text("metres = -1")
    refuses_data(lambda: DistanceScale(path).frames(walk), path, "metres", "write metres, a and b")
    path.write_text('metres = 1\na = [["000001", 2, 3]]\nb = [["000001", 2, 3], ["000002", 4, 5]]')
    problem = "a: must have at least 2 items, not 1"
    refuses_data(lambda: DistanceScale(path).frames(walk), path, problem, "write metres, a and b")
    path.write_text("metres =")
    refuses_data(lambda: DistanceScale(path).frames(walk), path, "is not valid TOML", "correct the line")


@pytest.mark.parametrize("metres", [80.0, 800.0])  # 0.8 m in centimetres and in millimetres
def test_distance_in_another_unit_is_refused(
    walk: RoomRecording, model: SparseModel, tmp_path: Path, metres: float
) -> None:
    path = distance_file(tmp_path, model, metres=metres)
    problem = rf"metres: is {metres:g}, which puts a \d+ m from the nearest camera"
    refuses_data(
        lambda: DistanceScale(path).measure(walk, model, []), path, problem, "give it in metres, not in cent"
    )


def test_point_from_one_side_is_not_one_of_too_few_frames(
    walk: RoomRecording, model: SparseModel, tmp_path: Path
) -> None:
    path, still = distance_file(tmp_path, model), np.repeat(model.poses[:1], len(walk), axis=0)
    refuses_data(
        lambda: DistanceScale(path).measure(walk, replace(model, poses=still), []),
        path,
        "a is seen from one side only, or one of its marks is wrong",
        "further apart",
    )


def test_marks_of_two_points_under_one_name_are_refused(
    walk: RoomRecording, model: SparseModel, tmp_path: Path
) -> None:
    path = distance_file(tmp_path, model)
    head, a, b = path.read_text().splitlines()
    marks = json.loads(b.removeprefix("b = "))
    marks[2][2] += 30.0
    path.write_text("\n".join([head, a, f"b = {json.dumps(marks)}"]))
    problem = r"the marks of b do not show one point: that in 00000\d is [12]\d px off"
    refuses_data(lambda: DistanceScale(path).measure(walk, model, []), path, problem, "correct it, or another mark")


def test_undetermined_length_is_refused(walk: RoomRecording, model: SparseModel, tmp_path: Path) -> None:
    path = distance_file(tmp_path, model, metres=0.001)
    refuses_data(lambda: DistanceScale(path).measure(walk, model, []), path, "does not determine a distance", "sides")


def test_option_is_parsed() -> None:
    assert parse_scale(None, has_depth=True) == parse_scale("depth", has_depth=False) == DepthScale()
    assert parse_scale(None, has_depth=False) == parse_scale("network", has_depth=True) == NetworkScale()
    assert parse_scale("network:midas.toml", has_depth=False) == NetworkScale("midas.toml")
    assert parse_scale("marker:7:0.16", has_depth=False) == MarkerScale(7, 0.16)
    assert parse_scale("marker:7:0.16:4x4_50", has_depth=False) == MarkerScale(7, 0.16, "4x4_50")
    assert parse_scale("distance:door.toml", has_depth=False) == DistanceScale(Path("door.toml"))


@pytest.mark.parametrize(
    ("text", "problem", "fix"),
    [
        ("metres", "is 'metres'", "write network"),
        ("marker:7", "is 'marker:7'", "write marker:ID:SIZE_M"),
        ("marker:7:16", "is 'marker:7:16'", "up to 5 metres"),
        ("marker:7:0.16:apriltag", "names the dictionary 'apriltag'", "apriltag_36h11"),
    ],
)
def test_other_options_are_refused(text: str, problem: str, fix: str) -> None:
    refuses_setting(lambda: parse_scale(text, has_depth=True), "scale", problem, fix)


@pytest.mark.parametrize("metric", [False, True])
def test_network_whose_scale_is_not_known_is_refused(
    walk: RoomRecording, monkeypatch: pytest.MonkeyPatch, metric: bool
) -> None:
    model = depth_from_blue()
    relative = model.spec.model_copy(update={"scale": None, "metric": metric})
    monkeypatch.setattr(depth_scale, "read_network", lambda name: type(model)(model.content, relative, model.name))
    with pytest.raises(SettingError, match=r"scale: is network, but full-0\.35 does not state its scale; name"):
        NetworkScale().frames(walk)
