"""``monoloc map info``, ``render`` and ``export`` on the bundle of a synthetic room."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from cli_helpers import json_of, outputs, refused, succeeds
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli import map_looking
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import rotation_to_quaternion
from monoloc.io.cloud_files import read_cloud
from monoloc.map.depth_rendering import cloud_depth, point_spacing_m
from monoloc.map.mixture import GaussianMixture
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture

RENDER = ("map", "render", "room.monoloc", "--out", "a.png")
EXPORT = ("map", "export", "room.monoloc", "--out")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    recording = RoomRecording(Room(), make_path(12, rate_hz=2.0), SMALL_CAMERA)
    bundle = make_bundle(room_mixture(Room(), 120), recording, range(12))
    write_bundle(folder / "room.monoloc", bundle)
    # The same room without the third box, and a map of no room.
    means = bundle.original.means
    is_box = np.all((means > [-0.45, 0.6, 1.05]) & (means < [0.55, 1.15, 1.85]), axis=1)
    moved = replace(bundle.original, means=means - is_box[:, None] * np.array([0.0, 1.2, 0.0]))
    write_bundle(folder / "later.monoloc", replace(bundle, original=moved))
    ball = GaussianMixture(np.ones(1), np.zeros((1, 3)), 0.1 * np.eye(3)[None])
    bare = replace(bundle, original=ball, adapted=ball, reference_poses=ReferencePoses.none())
    write_bundle(folder / "bare.monoloc", bare)
    return folder


@pytest.fixture
def here(workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(workspace, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(map_looking, "_DRAWN_POINTS", 10_000)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_info_says_what_a_bundle_holds_and_what_was_seen(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    info = json_of(capfd, "map", "info", "room.monoloc")
    assert info["components"] == 120 and info["bytes"] == 4800 and info["reference_poses"] == info["frames"] == 12
    assert info["files_bytes"] == {file.name: file.stat().st_size for file in (here / "room.monoloc").iterdir()}
    assert info["scale_sd"] is None and info["tune"] == "none" and info["recording"] == "room"
    room_m3 = 5.0 * 2.6 * 5.0
    assert 0.1 * room_m3 < info["free_volume_m3"] < room_m3
    assert info["surface_volume_m3"] == pytest.approx(0.1 * (2.0 * (25.0 + 13.0 + 13.0) + 12.0), rel=0.4)
    assert "files bytes" in succeeds(capfd, "map", "info", "room.monoloc")


def test_info_tells_the_extent_of_the_room_not_of_the_map_that_was_bent_to_the_network(
    capfd: pytest.CaptureFixture[str], here: Path
) -> None:
    bundle = read_bundle(here / "room.monoloc")
    bent = replace(bundle.adapted, means=1.3 * bundle.adapted.means)
    write_bundle(here / "bent.monoloc", replace(bundle, adapted=bent))
    room, info = (json_of(capfd, "map", "info", name) for name in ("room.monoloc", "bent.monoloc"))
    assert [info[key] for key in ("lower_m", "upper_m")] == [room[key] for key in ("lower_m", "upper_m")]


def test_bundles_of_two_worlds_beside_each_other_are_warned_of(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    room = read_bundle(here / "room.monoloc")
    elsewhere = replace(room.original, means=room.original.means + np.array([20.0, 0.0, 0.0]))
    write_bundle(here / "other.monoloc", replace(room, original=elsewhere))
    warning = "warning: other.monoloc: at most 0% of its surfaces are also in room.monoloc; both must be of one world"
    assert warning in outputs(capfd, *RENDER, "--beside", "other.monoloc")[1]
    assert "warning" not in outputs(capfd, *RENDER, "--beside", "later.monoloc")[1]


def test_a_picture_whose_up_is_a_guess_is_not_in_the_frame_that_flights_publish(
    capfd: pytest.CaptureFixture[str], here: Path
) -> None:
    (here / "room.monoloc").rename(here / "level.monoloc")
    (here / "bare.monoloc").rename(here / "room.monoloc")  # a ball, which shows no floor
    assert "not those of ROS's frame map" in outputs(capfd, *RENDER)[1]
    assert "warning" not in outputs(capfd, "map", "render", "level.monoloc", "--out", "b.png")[1]


@pytest.mark.parametrize("extra", [(), ("--reference", "3"), ("--beside", "later.monoloc")])
def test_map_is_drawn(capfd: pytest.CaptureFixture[str], here: Path, extra: tuple[str, ...]) -> None:
    content = json_of(capfd, *RENDER, *extra)
    assert content == {
        "picture": "a.png",
        "from": "pose" if "--reference" in extra else "above",
        "bundles": 2 if "--beside" in extra else 1,
    }
    image = cv2.imread("a.png")
    assert image is not None and len(np.unique(image.reshape(-1, 3)[::7] @ (1, 256, 65536))) > 100


def test_pose_and_its_reference_give_the_same_picture(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    pose = read_bundle(here / "room.monoloc").reference_poses.poses[5]
    numbers = [*pose[:3, 3], *rotation_to_quaternion(pose[:3, :3])]
    succeeds(capfd, *RENDER, "--beside", "later.monoloc", "--pose", ",".join(f"{value:.9f}" for value in numbers))
    by_pose = cv2.imread("a.png")
    succeeds(capfd, *RENDER, "--beside", "later.monoloc", "--reference", "5")
    assert np.mean(np.any(cv2.imread("a.png") != by_pose, axis=-1)) < 0.01


def test_a_view_does_not_show_through_a_near_surface(
    capfd: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board that fills the view from 40 cm holds one in 150 of the map's points; a wall behind it, the rest."""
    board, wall = (0.6, 0.5), (9.0, 5.0)  # metres
    areas = np.array([np.prod(board), np.prod(wall)])
    deviations = np.array([[*board, 0.01], [*wall, 0.01]]) / np.sqrt(12.0)
    covariances = np.stack([np.diag(each**2) for each in deviations])
    map_ = GaussianMixture(areas / areas.sum(), np.array([[0.0, 0.0, 0.4], [0.0, 0.0, 3.0]]), covariances)
    bundle = read_bundle(here / "room.monoloc")
    write_bundle(here / "near.monoloc", replace(bundle, original=map_, adapted=map_))
    clouds = []
    monkeypatch.setattr(map_looking, "plot_from_pose", lambda out, views, *view: clouds.append(views[0].cloud))
    succeeds(capfd, "map", "render", "near.monoloc", "--out", "a.png", "--pose", "0,0,0,0,0,0,1")
    seen = cloud_depth(clouds[0], bundle.camera, np.eye(4), point_spacing_m(clouds[0]))
    assert np.mean(seen > 1.0) < 0.02 and np.mean(seen > 0.0) > 0.2  # 0.5 with a twentieth of the points


def test_points_are_on_the_room_in_both_formats(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    for name in ("a.ply", "a.pcd"):
        assert json_of(capfd, *EXPORT, name, "--points", "5000")["points"] == 5000
        cloud = read_cloud(here / name)
        assert len(cloud) == 5000 and np.percentile(np.abs(Room().distance_m(cloud)), 90.0) < 0.1
    vertices, normals, _ = cv2.loadPointCloud("a.ply")
    eyes = read_bundle(here / "room.monoloc").reference_poses.poses[:, :3, 3].mean(axis=0)
    towards = np.einsum("ni,ni->n", normals[:, 0], eyes - vertices[:, 0])
    assert np.mean(towards > 0.0) > 0.9


def test_ellipsoids_are_a_mesh(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    content = json_of(capfd, *EXPORT, "a.ply", "--ellipsoids")
    assert content["components"] == 120 and content["triangles"] > 120 * 20
    assert len(read_cloud(here / "a.ply")) > 120 * 20


def test_voxels_and_grid_are_in_the_frame_that_ros_shows(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    voxels = json_of(capfd, *EXPORT, "a.bt", "--voxel", "0.1")
    assert voxels["free_voxels"] > voxels["occupied_voxels"] > 1000
    assert (here / "a.bt").read_bytes().startswith(b"# Octomap OcTree binary file\n")
    # y points down in this room: at the height of the cameras, the grid is the plane of x and z.
    grid = json_of(capfd, *EXPORT, "map.yaml", "--voxel", "0.1")
    assert grid["height_m"] == pytest.approx(0.0, abs=0.15)
    server, image = yaml.safe_load((here / "map.yaml").read_text()), cv2.imread("map.pgm", cv2.IMREAD_UNCHANGED)
    assert image.shape == tuple(grid["cells"][::-1])

    def at(x_m: float, y_m: float) -> int:
        column, row = ((np.array([x_m, y_m]) - server["origin"][:2]) / server["resolution"]).astype(int)
        return int(image[::-1][row, column])

    # The map's x axis is the room's, and its y axis is to the left: the room's -z.
    assert at(0.0, 0.3) == 254 and at(2.5, 0.0) == 0 and image[0, 0] == 205
    assert grid["occupied_share"] + grid["free_share"] + grid["unknown_share"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("command", "names", "problem", "fix"),
    [
        (("map", "info", "no.npz"), "no.npz", "there is no such file", "map fit"),
        ((*RENDER[:3], "--out", "a.pdf"), "--out", "a.pdf would be a PNG by another name", "NAME.png"),
        ((*RENDER, "--beside", "no"), "no", "is not a bundle", "monoloc build"),
        ((*RENDER, "--pose", "1,2"), "--pose", "is '1,2'", "write TX,TY,TZ,QX,QY,QZ,QW in metres"),
        ((*RENDER, "--pose", "90,90,90,0,0,0,1"), "--pose", "shows nothing of the map", "--reference 0"),
        ((*RENDER, "--reference", "12"), "--reference", "room.monoloc has 12 reference poses", "0 to 11"),
        (("map", "render", "bare.monoloc", "--out", "a.png", "--reference", "0"), "--reference", "has 0", "--pose"),
        ((*RENDER, "--reference", "1", "--pose", "1,2"), "--reference", "together with --pose", "give one"),
        ((*EXPORT, "a.stl"), "--out", "ends in .stl", "choose from .ply, .pcd, .bt, .yaml"),
        ((*EXPORT, "room.monoloc/a.ply"), "--out", "lies in the bundle", "another place"),
        ((*EXPORT, "a.pcd", "--ellipsoids"), "--ellipsoids", "has no meaning for .pcd", "leave it out"),
        ((*EXPORT, "a.ply", "--voxel", "0.1"), "--voxel", "has no meaning for .ply", "leave it out"),
        ((*EXPORT, "a.bt", "--points", "10"), "--points", "has no meaning for .bt", "leave it out"),
        ((*EXPORT, "a.bt", "--height", "1"), "--height", "has no meaning for .bt", "leave it out"),
        (
            (*EXPORT, "a.ply", "--ellipsoids", "--points", "9"),
            "--points",
            "no meaning for ellipsoids",
            "leave it out",
        ),
        ((*EXPORT, "a.yaml", "--height", "nan"), "--height", "is nan", "metres"),
        ((*EXPORT, "a.yaml", "--height", "7"), "--height", "is 7, where the map has nothing", "choose from -"),
        ((*EXPORT, "a.bt", "--voxel", "0.0001"), "--voxel", "is 0.0001 for a map of", "or more"),
        (
            ("map", "export", "bare.monoloc", "--out", "a.bt"),
            "bare.monoloc",
            "does not give the direction of gravity",
            ".ply",
        ),
    ],
)
def test_what_cannot_be_shown_is_refused(
    capfd: pytest.CaptureFixture[str], here: Path, command: tuple[str, ...], names: str, problem: str, fix: str
) -> None:
    refused(capfd, here, command, names, problem, fix)


def test_grid_without_cameras_needs_a_height(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    bundle = replace(read_bundle(here / "room.monoloc"), reference_poses=ReferencePoses.none())
    write_bundle(here / "blind.monoloc", bundle)
    command = ("map", "export", "blind.monoloc", "--out", "a.yaml")
    refused(capfd, here, command, "--height", "is needed: the bundle keeps no reference poses", "give metres")
    assert json_of(capfd, *command, "--height", "0")["free_share"] == 0.0
