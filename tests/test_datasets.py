"""Readers: small recordings of each format, and the real ones where they are."""

from __future__ import annotations

import itertools
import subprocess
import sys
from dataclasses import replace

import cv2
import h5py
import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc import geometry
from monoloc.camera import Camera
from monoloc.io import nyu, seven_scenes
from monoloc.io.images import read_depth
from monoloc.io.pose_files import nearest_times
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Recording
from monoloc.io.registration import DepthRegistration
from monoloc.io.registry import FORMATS, open_recording, select_frames
from monoloc.io.rgbd_scenes_v2 import read_pose_file


def check_protocol(recording, frames: int) -> None:
    """What every recording promises."""
    assert isinstance(recording, Recording)
    assert len(recording) == len(recording.frame_names) == frames
    assert len(set(recording.frame_names)) == frames
    assert recording.timestamps_s.shape == (frames,)
    assert (np.diff(recording.timestamps_s) > 0).all()
    size = (recording.camera.height, recording.camera.width)
    color = recording.color(frames - 1)
    assert color.shape == (*size, 3)
    assert color.dtype == np.uint8
    if recording.has_depth:
        depth_m = recording.depth(frames - 1)
        assert depth_m.shape == size
        assert depth_m.dtype == np.float32
    if recording.poses is not None:
        assert recording.poses.shape == (frames, 4, 4)
        assert geometry.is_rigid(recording.poses, tolerance=1e-9).all()


# --- 7-Scenes ---


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_seven_scenes_joins_its_sequences(tmp_path, suffix):
    T_world_depth = synthetic.write_seven_scenes(tmp_path, sequences=2, frames=2, suffix=suffix)
    recording = open_recording(f"7scenes:{tmp_path}")
    check_protocol(recording, 4)
    assert recording.frame_names[::3] == ["seq-01/frame-000000", "seq-02/frame-000002"]
    np.testing.assert_allclose(recording.timestamps_s[:2], [0.0, 2 / 30])
    expected = T_world_depth @ geometry.invert(seven_scenes.T_COLOR_DEPTH)
    np.testing.assert_allclose(recording.poses, expected, atol=1e-7)
    assert recording.camera.fx == 525.5


def test_seven_scenes_opens_one_sequence_and_keeps_the_frame_names(tmp_path):
    synthetic.write_seven_scenes(tmp_path, sequences=2, frames=2)
    recording = open_recording(str(tmp_path / "seq-02"))
    check_protocol(recording, 2)
    assert recording.frame_names == ["seq-02/frame-000000", "seq-02/frame-000002"]


def test_both_marks_of_no_depth_are_read(tmp_path):
    synthetic.write_seven_scenes(tmp_path, frames=1)
    depth_m = read_depth(tmp_path / "seq-01/frame-000000.depth.png", 1000.0, seven_scenes.DEPTH_CAMERA)
    assert not depth_m[:2].any()  # stored as 0 and as 65535
    assert (depth_m[2:] == 2.0).all()


def test_seven_scenes_takes_the_depth_camera_from_the_scene(tmp_path):
    synthetic.write_seven_scenes(tmp_path, frames=1)
    np.savetxt(tmp_path / "camera-intrinsics.txt", [[600.0, 0, 321], [0, 601, 239], [0, 0, 1]])
    for path in (tmp_path, tmp_path / "seq-01"):
        recording = open_recording(str(path))
        assert recording.camera == seven_scenes.COLOR_CAMERA
        assert recording.registration.depth_camera == Camera(640, 480, 600.0, 601.0, 321.0, 239.0)


def test_seven_scenes_without_depth_images(tmp_path):
    synthetic.write_seven_scenes(tmp_path, frames=1)
    (tmp_path / "seq-01" / "frame-000000.depth.png").unlink()
    assert not open_recording(str(tmp_path)).has_depth


def test_seven_scenes_without_poses(tmp_path):
    synthetic.write_seven_scenes(tmp_path, frames=2)
    for path in (tmp_path / "seq-01").glob("*.pose.txt"):
        path.unlink()
    recording = open_recording(str(tmp_path))
    check_protocol(recording, 2)
    assert recording.poses is None and recording.has_depth


@pytest.mark.data
def test_real_redkitchen(data_root):
    recording = open_recording(f"7scenes:{data_root}/7scenes/redkitchen")
    check_protocol(recording, 400)
    assert recording.timestamps_s[-1] == pytest.approx(798 / 30)
    # The walk is continuous: no step beyond 10 cm at 15 Hz.
    assert np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1).max() < 0.1
    depth_m = recording.depth(200)
    assert 0.6 < (depth_m > 0).mean() < 0.9
    assert 0.8 < np.median(depth_m[depth_m > 0]) < 4.0


# --- Registration of depth to colour ---


def render_scene(camera: Camera, T_depth_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth (h, w) of a slanted wall behind a steep board, and where the board is, (h, w) bool.

    Both are given in the depth camera's frame.
    """
    rays = camera.pixel_rays() @ T_depth_camera[:3, :3].T
    origin = T_depth_camera[:3, 3]

    def hit(normal: list[float], distance: float) -> np.ndarray:
        return (distance - origin @ np.array(normal)) / (rays @ np.array(normal))

    wall = hit([0.2, 0.1, 1.0], 2.5)
    board = hit([-1.2, 0.0, 1.0], 0.9)
    x, y, _ = np.moveaxis(origin + board[..., None] * rays, -1, 0)
    on_board = (np.abs(x) < 0.25) & (np.abs(y) < 0.2) & (board > 0)
    return np.where(on_board, board, wall), on_board


def near_discontinuity(depth_m: np.ndarray, pixels: int) -> np.ndarray:
    """Where depth jumps by more than 10 % within some pixels."""
    kernel = np.ones((2 * pixels + 1,) * 2)
    return cv2.dilate(depth_m, kernel) > 1.1 * cv2.erode(depth_m, kernel)


def test_registration_renders_what_the_colour_camera_sees():
    T_depth_color = geometry.invert(seven_scenes.T_COLOR_DEPTH)
    depth_camera, color_camera = seven_scenes.DEPTH_CAMERA, seven_scenes.COLOR_CAMERA
    seen_by_depth = render_scene(depth_camera, np.eye(4))[0].astype(np.float32)
    expected, board = render_scene(color_camera, T_depth_color)
    register = DepthRegistration(depth_camera, color_camera, seven_scenes.T_COLOR_DEPTH)
    result = register(seen_by_depth)

    # Which points of the colour image the depth camera sees too, by projecting them into it.
    points = geometry.transform(T_depth_color, color_camera.back_project(expected).reshape(-1, 3))
    u, v = np.round(depth_camera.project(points)).astype(int).T
    inside = (u >= 0) & (u < 640) & (v >= 0) & (v < 480)
    visible = np.zeros(640 * 480, dtype=bool)
    visible[inside] = np.abs(seen_by_depth[v[inside], u[inside]] - points[inside, 2]) < 0.02
    visible = visible.reshape(480, 640)

    clear = ~near_discontinuity(expected, 1)
    has_depth = result > 0
    # No hole in what both see, up to the pixel at its border.
    assert has_depth[cv2.erode((visible & clear).astype(np.uint8), np.ones((3, 3))) > 0].all()
    # Nothing invented in the shadow: the wall beside the board that only the colour camera sees.
    shadow = cv2.erode((~visible).astype(np.uint8), np.ones((3, 3))) > 0
    assert shadow.sum() > 1000
    assert not has_depth[shadow].any()
    # Right everywhere: the wall to millimetres, the board (12 mm a pixel) to its slope over a pixel.
    error = np.abs(result - expected)
    assert error[has_depth & clear & ~board].max() < 0.004
    assert error[has_depth & clear & board].max() < 0.02
    assert (board & clear).sum() > 10000


def test_registration_between_equal_cameras_changes_nothing():
    camera = Camera(40, 30, 35.0, 35.0, 19.5, 14.5)
    depth_m = np.random.default_rng(0).uniform(1.0, 1.02, size=(30, 40)).astype(np.float32)
    result = DepthRegistration(camera, camera, np.eye(4))(depth_m)
    np.testing.assert_allclose(result, depth_m, rtol=1e-6)


def test_registration_closes_cracks_of_one_surface_only():
    # Twice the focal length writes every second pixel: the gaps between them are cracks, each closed from
    # its two neighbours; the step between the two surfaces stays open.
    depth_camera = Camera(20, 3, 20.0, 10.0, 0.0, 1.0)
    color_camera = Camera(39, 3, 40.0, 10.0, 0.0, 1.0)
    depth_m = np.where(np.arange(20) < 10, 1.0, 2.0).astype(np.float32)[None].repeat(3, axis=0)
    result = DepthRegistration(depth_camera, color_camera, np.eye(4))(depth_m)
    np.testing.assert_allclose(result[:, :19], 1.0)
    assert not result[:, 19].any()
    np.testing.assert_allclose(result[:, 20:], 2.0)


def depth_edges(depth_m: np.ndarray) -> np.ndarray:
    """Pixels on the near side of depth steps beyond 10 %, away from the image border."""
    edges = np.zeros(depth_m.shape, dtype=bool)
    for axis in (0, 1):
        first = depth_m[:-1] if axis == 0 else depth_m[:, :-1]
        second = depth_m[1:] if axis == 0 else depth_m[:, 1:]
        step = (first > 0) & (second > 0) & (np.abs(first - second) > 0.1 * np.minimum(first, second))
        edges_first = edges[:-1] if axis == 0 else edges[:, :-1]
        edges_second = edges[1:] if axis == 0 else edges[:, 1:]
        edges_first |= step & (first < second)
        edges_second |= step & (second < first)
    edges[:12] = edges[-12:] = edges[:, :12] = edges[:, -12:] = False
    return edges


@pytest.mark.data
def test_registration_brings_real_depth_edges_to_colour_edges(data_root):
    source = f"7scenes:{data_root}/7scenes/redkitchen"
    recording = open_recording(source)
    distances_px: dict[str, list[np.ndarray]] = {"before": [], "after": []}
    for index in range(0, 400, 80):
        grey = cv2.GaussianBlur(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2GRAY), (0, 0), 1.5)
        to_color_edge = cv2.distanceTransform(255 - cv2.Canny(grey, 30, 90), cv2.DIST_L2, 3)
        stored = read_depth(recording.depth_paths[index], recording.depth_scale, seven_scenes.DEPTH_CAMERA)
        distances_px["before"].append(to_color_edge[depth_edges(stored)])
        distances_px["after"].append(to_color_edge[depth_edges(recording.depth(index))])
    for before, after in zip(distances_px["before"], distances_px["after"], strict=True):
        assert after.mean() < before.mean()
    before, after = (np.concatenate(distances_px[key]) for key in ("before", "after"))
    assert np.median(after) < 0.7 * np.median(before)  # 2.9 against 5.7 pixels
    assert (after <= 2.0).mean() > 1.3 * (before <= 2.0).mean()


# --- TUM ---


def test_tum_associates_by_time_and_interpolates_the_truth(tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg3_test"
    expected = synthetic.write_tum(folder)
    recording = open_recording(str(folder))
    check_protocol(recording, 4)
    np.testing.assert_allclose(recording.poses, expected, atol=1e-6)
    assert recording.camera.fx == 535.4
    assert set(np.unique(recording.depth(0))) == {0.0, 2.0}
    assert open_recording(str(folder), ReaderOptions(depth_scale=1000.0)).depth(0).max() == 10.0


def test_tum_drops_frames_without_partner_or_pose(tmp_path):
    synthetic.write_tum(tmp_path, frames=5)
    lists = {name: (tmp_path / f"{name}.txt").read_text().splitlines() for name in ("depth", "groundtruth")}
    del lists["depth"][2]  # the partner of frame 1
    lists["groundtruth"] = [
        line for line in lists["groundtruth"] if line.startswith("#") or float(line.split()[0]) < 100.1
    ]  # frame 4, at 100.133, is 43 ms after the last sample
    for name, lines in lists.items():
        (tmp_path / f"{name}.txt").write_text("\n".join(lines) + "\n")
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.timestamps_s, [100.0, 100.066667, 100.1], atol=1e-5)


def test_tum_takes_the_nearest_truth_where_samples_are_far_apart(tmp_path):
    expected = synthetic.write_tum(tmp_path)
    times_s = 100.0 + np.arange(4) / 30.0 + 0.003
    (tmp_path / "groundtruth.txt").write_text(synthetic.tum_lines(times_s[::2], expected[::2]))
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.timestamps_s, [100.0, 100.066667], atol=1e-5)
    np.testing.assert_allclose(recording.poses, expected[::2], atol=1e-6)


def test_tum_association_is_one_to_one(tmp_path):
    synthetic.write_tum(tmp_path, frames=2)
    # Two colour images 10 ms apart, and one depth image between them, nearer to the second.
    (tmp_path / "rgb.txt").write_text("100.000 rgb/100.000000.png\n100.010 rgb/100.033333.png\n")
    (tmp_path / "depth.txt").write_text("100.008 depth/100.005000.png\n")
    np.testing.assert_allclose(open_recording(str(tmp_path)).timestamps_s, [100.010])


@pytest.mark.parametrize(("name", "fx"), [("freiburg1_xyz", 517.3), ("freiburg2_desk", 520.9), ("mine", 525)])
def test_tum_knows_its_cameras_by_name(tmp_path, name, fx):
    synthetic.write_tum(tmp_path / name, frames=1)
    (tmp_path / name / "depth.txt").unlink()
    recording = open_recording(f"tum:{tmp_path / name}")
    assert recording.camera.fx == fx
    assert not recording.has_depth


def test_tum_without_poses(tmp_path):
    synthetic.write_tum(tmp_path)
    (tmp_path / "groundtruth.txt").unlink()
    recording = open_recording(str(tmp_path))
    check_protocol(recording, 4)
    assert recording.poses is None and recording.has_depth


def test_nearest_times_agree_with_brute_force():
    rng = np.random.default_rng(0)
    for query_count, time_count in itertools.product((1, 5, 40), (1, 2, 30)):
        query, times = np.sort(rng.uniform(size=query_count)), np.sort(rng.uniform(size=time_count))
        brute = np.abs(query[:, None] - times).argmin(axis=1)
        np.testing.assert_array_equal(nearest_times(query, times), brute)


# --- RGB-D Scenes v2 ---


def test_rgbd_scenes_v2(tmp_path):
    expected = synthetic.write_rgbd_scenes_v2(tmp_path)
    for source in (f"rgbd-scenes-v2:{tmp_path}/imgs/scene_01", str(tmp_path)):
        recording = open_recording(source)
        check_protocol(recording, 3)
        np.testing.assert_allclose(recording.poses, expected, atol=1e-9)
        assert recording.frame_names[1] == "00001"
        assert recording.depth(0).max() == 2.0  # 20000 / 10000
        assert recording.camera.fx == 570.3
    options = ReaderOptions(depth_scale=1000.0, camera=Camera(640, 480, 525.0, 525.0, 320.0, 240.0))
    overridden = open_recording(str(tmp_path), options)
    assert overridden.depth(0).max() == 20.0
    assert overridden.camera.fx == 525.0


def test_rgbd_scenes_v2_pairs_poses_with_frame_numbers(tmp_path):
    expected = synthetic.write_rgbd_scenes_v2(tmp_path)
    for kind in ("color", "depth"):
        (tmp_path / "imgs" / "scene_01" / f"00001-{kind}.png").unlink()
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.poses, expected[[0, 2]], atol=1e-9)
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 2 / 30])


@pytest.mark.data
def test_real_pose_files(data_root):
    counts = []
    for scene in range(1, 15):
        poses = read_pose_file(data_root / "rgbd-scenes-v2" / "pc" / f"{scene:02d}.pose")
        assert geometry.is_rigid(poses).all()
        np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-12)
        # Recorded at 30 Hz by a walking person: no step beyond 2 cm or 2 degrees.
        steps = geometry.se3_log(geometry.invert(poses[:-1]) @ poses[1:])
        assert np.linalg.norm(steps[:, :3], axis=1).max() < 0.02
        assert np.degrees(np.linalg.norm(steps[:, 3:], axis=1)).max() < 2.0
        counts.append(len(poses))
    assert sum(counts) == 11427


@pytest.mark.data
def test_real_poses_stand_in_the_real_cloud(data_root):
    folder = data_root / "rgbd-scenes-v2" / "pc"
    lines = (folder / "03_ascii.ply").read_text().split("end_header\n")[1].splitlines()
    cloud = np.array([line.split()[:3] for line in lines[:20510]], dtype=float)
    poses = read_pose_file(folder / "03.pose")
    # The cameras stand within the cloud's extent, and each sees a good part of it, none of it closer than
    # the sensor can measure.
    assert (poses[:, :3, 3] > cloud.min(axis=0)).all()
    assert (poses[:, :3, 3] < cloud.max(axis=0)).all()
    camera = Camera(640, 480, 570.3, 570.3, 320.0, 240.0)
    for pose in poses[::100]:
        points = geometry.transform(geometry.invert(pose), cloud)
        u, v = camera.project(points).T
        seen = (u > 0) & (u < 640) & (v > 0) & (v < 480)
        assert seen.mean() > 0.15
        assert points[seen, 2].min() > 0.4
        assert 1.5 < np.median(points[seen, 2]) < 3.0


# --- NYU ---


def write_nyu_mat(path) -> None:
    with h5py.File(path, "w") as file:
        images = np.stack([synthetic.make_color(640, 480, n).transpose(2, 1, 0) for n in range(2)])
        file["images"] = images
        depths = np.full((2, 640, 480), 3.0, dtype=np.float32)
        depths[0, :, :200] = 1.5  # MATLAB's order: the upper rows of the image
        file["depths"] = depths


def test_nyu_labelled_mat(tmp_path):
    write_nyu_mat(tmp_path / "tiny.mat")
    recording = open_recording(str(tmp_path / "tiny.mat"))
    check_protocol(recording, 2)
    assert recording.poses is None
    left, top, width, height = nyu.VALID_WINDOW
    expected = synthetic.make_color(640, 480, 1)[top : top + height, left : left + width]
    np.testing.assert_array_equal(recording.color(1), expected)
    assert (recording.depth(0)[: 200 - top] == 1.5).all()
    assert (recording.depth(0)[200 - top :] == 3.0).all()
    assert recording.camera.cx == pytest.approx(325.58 - left)


def test_nyu_frame_without_depth(tmp_path):
    path = tmp_path / "nyu.mat"
    write_nyu_mat(path)
    with h5py.File(path, "a") as file:
        file["depths"][0] = np.nan
    recording = open_recording(str(path))
    assert not recording.depth(0).any() and recording.depth(1).all()


# --- Described folders ---


def test_folder_sequence(tmp_path):
    expected = synthetic.write_folder(tmp_path)
    for source in (f"folder:{tmp_path}", str(tmp_path), str(tmp_path / "dataset.toml")):
        recording = open_recording(source)
        check_protocol(recording, 3)
        assert recording.frame_names == ["000010", "000015", "000020"]
        np.testing.assert_allclose(recording.timestamps_s, [5.0, 5.1, 5.2])
        np.testing.assert_allclose(recording.poses, expected, atol=1e-8)
        assert recording.depth(2).max() == 1.5
        assert recording.camera == Camera(32, 24, 30.0, 31.0, 15.5, 11.5, (0.1, -0.2, 0.0, 0.001, 0.0))


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("{index:03d}/color.jpg", ["010/color", "015/color", "020/color"]),
        ("f{index}/rgb/left.jpg", ["f10/rgb/left", "f15/rgb/left", "f20/rgb/left"]),
        ("../images/{index}/0.jpg", ["../images/10/0", "../images/15/0", "../images/20/0"]),
        ("color/frame.{index}", ["color/frame", "color/frame.15", "color/frame.20"]),
    ],
)
def test_folder_frames_have_names_that_differ(tmp_path, pattern, names):
    folder = tmp_path / "walk"
    synthetic.write_folder(folder, synthetic.SEQUENCE_TOML.replace("color/{index:06d}.jpg", pattern))
    for index in (10, 15, 20):
        image = folder / pattern.format(index=index)
        image.parent.mkdir(parents=True, exist_ok=True)
        (folder / f"color/{index:06d}.jpg").rename(image)
    recording = open_recording(str(folder))
    check_protocol(recording, 3)
    assert recording.frame_names == names


def test_folder_with_stop_and_without_depth(tmp_path):
    toml = synthetic.SEQUENCE_TOML.replace("count = 3", "stop = 21")
    toml = "\n".join(line for line in toml.splitlines() if not line.startswith("depth"))
    synthetic.write_folder(tmp_path, toml)
    recording = open_recording(str(tmp_path))
    check_protocol(recording, 3)
    assert not recording.has_depth


def test_folder_without_poses(tmp_path):
    synthetic.write_folder(tmp_path, synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', "rate_hz = 20"))
    recording = open_recording(str(tmp_path))
    check_protocol(recording, 3)
    assert recording.poses is None and recording.has_depth
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.05, 0.1])


def test_a_byte_order_mark_is_no_text(tmp_path):
    synthetic.write_folder(tmp_path)
    path = tmp_path / "dataset.toml"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    check_protocol(open_recording(str(tmp_path)), 3)


@pytest.mark.data
def test_real_nyu_pairs(data_root):
    recording = open_recording(str(data_root / "nyu-labelled"))
    check_protocol(recording, 1449)
    assert recording.poses is None
    assert recording.camera.width == 304
    depth_m = recording.depth(700)
    assert 0.5 < depth_m[depth_m > 0].min() < depth_m.max() <= 10.0


# --- Video ---


VIDEO = ReaderOptions(camera=Camera(64, 48, 50.0, 50.0, 31.0, 23.0))


def test_video_is_read_in_any_order(tmp_path):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    recording = open_recording(str(path), VIDEO)
    check_protocol(recording, 6)
    assert open_recording(f"video:{path}", VIDEO).camera == recording.camera == VIDEO.camera
    assert recording.poses is None
    assert not recording.has_depth
    np.testing.assert_allclose(recording.timestamps_s, np.arange(6) / 10.0)
    for index in (0, 1, 4, 2, 5, 5, 0):
        assert abs(recording.color(index).mean() - 20 * (index + 1)) < 3


def test_video_has_the_times_of_its_frames(tmp_path):
    path = tmp_path / "walk.mp4"
    synthetic.write_uneven_video(path, [1, 1, 4, 2, 2, 2])
    recording = open_recording(str(path), VIDEO)
    check_protocol(recording, 6)
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.05, 0.1, 0.3, 0.4, 0.5])


def test_video_has_the_frames_that_can_be_decoded(tmp_path):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    synthetic.overstate_frames(path, 9)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) == 9
    check_protocol(open_recording(str(path), VIDEO), 6)


# --- Images, registry, selection ---


BENT, STRAIGHT = (0.02, -0.01, 0.001, 0.0, 0.0), (0.0,) * 5


@pytest.mark.parametrize(
    ("format_name", "own"),
    [
        ("7scenes", seven_scenes.COLOR_CAMERA.distortion),
        ("tum", (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
        ("rgbd-scenes-v2", STRAIGHT),
        ("folder", (0.1, -0.2, 0.0, 0.001, 0.0)),
    ],
)
def test_given_intrinsics_leave_the_distortion_that_they_do_not_name(tmp_path, format_name, own):
    folder = tmp_path / "freiburg1_desk"
    write = {
        "7scenes": synthetic.write_seven_scenes,
        "tum": synthetic.write_tum,
        "rgbd-scenes-v2": synthetic.write_rgbd_scenes_v2,
        "folder": synthetic.write_folder,
    }
    folder.mkdir()
    write[format_name](folder)
    width, height = (32, 24) if format_name == "folder" else (640, 480)
    given = Camera(width, height, 0.9 * width, 0.9 * width, (width - 1) / 2, (height - 1) / 2)
    for distortion, is_kept, expected in ((STRAIGHT, True, own), (BENT, False, BENT), (STRAIGHT, False, STRAIGHT)):
        options = ReaderOptions(replace(given, distortion=distortion), keeps_distortion=is_kept)
        assert open_recording(f"{format_name}:{folder}", options).camera == replace(given, distortion=expected)


@pytest.mark.parametrize("value", [0, 65535])
def test_a_depth_image_may_have_no_depth(tmp_path, value):
    synthetic.write_folder(tmp_path)
    synthetic.write_depth(tmp_path / "depth/000015.png", np.full((24, 32), value, dtype=np.uint16))
    recording = open_recording(str(tmp_path))
    check_protocol(recording, 3)
    assert not recording.depth(1).any() and recording.depth(2).any()


@pytest.mark.parametrize("kind", ["grey", "rgba", "16-bit", "16-bit grey"])
def test_colour_images_of_other_kinds_become_rgb(tmp_path, kind):
    synthetic.write_folder(tmp_path, synthetic.SEQUENCE_TOML.replace(".jpg", ".png"))
    rgb = synthetic.make_color(32, 24)
    grey = rgb[..., 0]
    stored, expected = {
        "grey": (grey, np.repeat(grey[..., None], 3, axis=-1)),
        "rgba": (np.dstack([rgb[..., ::-1], grey]), rgb),
        "16-bit": (rgb[..., ::-1].astype(np.uint16) * 257, rgb),
        "16-bit grey": (grey.astype(np.uint16) * 257, np.repeat(grey[..., None], 3, axis=-1)),
    }[kind]
    for index in (10, 15, 20):
        cv2.imwrite(str(tmp_path / f"color/{index:06d}.png"), stored)
    np.testing.assert_array_equal(open_recording(str(tmp_path)).color(0), expected)


def test_a_path_with_a_colon_is_a_path_if_it_exists(tmp_path):
    synthetic.write_folder(tmp_path / "walk:2")
    assert len(open_recording(str(tmp_path / "walk:2"))) == 3


def test_known_formats():
    assert sorted(FORMATS) == ["7scenes", "folder", "nyu", "rgbd-scenes-v2", "tum", "video"]


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ("0:3:2", [0, 2]),
        ("1:", [1, 2]),
        (":2", [0, 1]),
        ("::2", [0, 2]),
        (":", [0, 1, 2]),
        ("0:400", [0, 1, 2]),
    ],
)
def test_select_frames(tmp_path, frames, expected):
    synthetic.write_folder(tmp_path)
    recording = open_recording(str(tmp_path))
    selection = select_frames(recording, frames)
    check_protocol(selection, len(expected))
    np.testing.assert_array_equal(selection.positions, expected)
    assert selection.frame_names == [recording.frame_names[p] for p in expected]
    np.testing.assert_array_equal(selection.color(0), recording.color(expected[0]))
    np.testing.assert_array_equal(selection.depth(0), recording.depth(expected[0]))


def test_readers_import_neither_torch_nor_h5py():
    code = (
        "import sys, monoloc.io.registry; "
        "assert not {'torch', 'h5py', 'scipy'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
