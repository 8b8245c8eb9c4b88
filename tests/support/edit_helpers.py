"""A small mapped room for the tests of edits: two walls, a floor and a cube, with landmarks on them."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.bundle import Bundle, CloudSize, Provenance, digest_of, read_bundle, write_bundle
from monoloc.editing.box import Box
from monoloc.editing.undo import undone
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, make_pose
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.map.cloud import cloud_from_recording, voxel_thin
from monoloc.map.em import fit_mixture
from monoloc.map.learnt_transform import HIDDEN, LearntTransform
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from synthetic_room import CAMERA, SETTINGS, Room, RoomRecording, depth_from_blue, make_bundle, make_path

DOWN = np.array([0.0, 1.0, 0.0])
VOXEL_M = 0.03
CUBE = Box.between(np.array([-0.31, 0.39, 1.69]), np.array([0.31, 0.98, 2.31]), DOWN)  # stands on the floor, y = 1
BACK_M = 3.0  # depth of the wall behind it


def faces(lower: FloatArray, upper: FloatArray, spacing_m: float = 0.015) -> FloatArray:
    """Points on the faces of a box, at most so far apart."""
    points = []
    for axis in range(3):
        a, b = (np.arange(lower[other], upper[other], spacing_m) for other in range(3) if other != axis)
        grid = np.stack(np.meshgrid(a, b), axis=-1).reshape(-1, 2)
        points += [np.insert(grid, axis, end[axis], axis=1) for end in (lower, upper)]
    return np.concatenate(points)


def cube_cloud() -> FloatArray:
    """Of the cube's faces, but the one that it stands on."""
    cloud = faces(np.array([-0.3, 0.4, 1.7]), np.array([0.3, 1.0, 2.3]))
    return cloud[cloud[:, 1] < 0.97]


def shifted(cloud: FloatArray, x: float, y: float, z: float) -> FloatArray:
    """A cloud, moved."""
    return np.asarray(cloud + np.array([x, y, z]))


def room_cloud() -> FloatArray:
    """Of the floor and the walls, without the cube."""
    cloud = faces(np.array([-2.0, -1.0, -2.0]), np.array([2.0, 1.0, BACK_M]))
    return cloud[(cloud[:, 1] > -0.99) & (cloud[:, 2] > -1.99)]


def bend() -> LearntTransform:
    """Moves points by some centimetres."""
    rng = np.random.default_rng(5)
    hidden = rng.uniform(-0.5, 0.5, (HIDDEN, 3)), rng.uniform(-0.5, 0.5, HIDDEN)
    return LearntTransform(np.array([0.0, 0.0, 0.5]), 2.6, *hidden, 0.01 * rng.normal(size=(3, HIDDEN)), np.zeros(3))


@cache
def mapped_room() -> Bundle:
    """As a build would leave it: 150 components, two hundred landmarks, of which a quarter on the cube."""
    rng = np.random.default_rng(0)
    cloud = voxel_thin(np.concatenate([room_cloud(), cube_cloud()]), VOXEL_M)
    original = fit_mixture(cloud, 150, rng).mixture
    transform = bend()
    means, covariances = transform.moments(original.means, original.covariances)
    on_cube = rng.permutation(cube_cloud())[:50]
    wall = np.column_stack([rng.uniform(-1.5, 1.5, 150), rng.uniform(-0.8, 0.3, 150), np.full(150, BACK_M)])
    points = np.concatenate([on_cube, wall]).astype(np.float32)
    poses = make_pose(
        np.tile(np.eye(3), (12, 1, 1)), np.column_stack([np.linspace(-0.5, 0.5, 12), np.zeros((12, 2))])
    )
    views = LandmarkViews(poses, np.ones((12, len(points)), dtype=np.bool_))
    bias = np.full((12, 6), 0.02)
    return Bundle(
        original=original,
        adapted=GaussianMixture(original.weights, means, covariances),
        depth_model=depth_from_blue(),
        settings=SETTINGS,
        camera=CAMERA,
        provenance=Provenance(
            recording="room", frames={"0": 1}, tune="none", map_transform=True, lambda_kl=0.1, seed=0
        ),
        thresholds=LikelihoodThresholds(low=-1.5, lost=-2.25),
        reference_poses=ReferencePoses(poses, bias, -bias),
        landmarks=Landmarks(points, rng.integers(0, 256, (len(points), 32)).astype(np.uint8), views),
        transform=transform,
        cloud=CloudSize(points=len(cloud), voxel_m=VOXEL_M),
    )


def built_from_others(bundle: Bundle) -> Bundle:
    """The bundle, as if none of the frames that tests have had built it."""
    return replace(bundle, provenance=bundle.provenance.model_copy(update={"frames": {"0": 1}}))


def written(bundle: Bundle, folder: Path) -> Bundle:
    """As a command finds it that another one has written."""
    write_bundle(folder / "written.monoloc", bundle)
    return read_bundle(folder / "written.monoloc")


def digest(bundle: Bundle, folder: Path) -> str:
    """Of all bytes of the bundle's files."""
    write_bundle(folder / "written.monoloc", bundle)
    return digest_of(folder / "written.monoloc")


def digest_without_last_edit(bundle: Bundle, folder: Path) -> str:
    """Of the bundle's files after the last edit was written, read and taken back."""
    return digest(undone(written(bundle, folder)), folder)


WALK_A, WALK_B = make_path(14, 0.0, 5.0), make_path(14, 3.4, 5.0)  # the second looks further to the left


@cache
def walk(poses_of: str, room_seed: int = 0) -> RoomRecording:
    """A recording of one of two walks through the synthetic room; cached, so nobody may change it."""
    poses = {"A": WALK_A, "B": WALK_B}[poses_of]
    recording = RoomRecording(Room(room_seed), poses)
    recording.name = f"walk-{poses_of}"
    return recording


def in_another_world(recording: RoomRecording, T_other_world: FloatArray) -> RoomRecording:
    """The same images and depth, with poses in another world."""
    moved = copy(recording)
    assert recording.poses is not None
    moved.poses = T_other_world @ recording.poses
    return moved


@cache
def bundle_of_walk(poses_of: str) -> Bundle:
    """As built from one of the walks, with its landmarks; nothing adapted."""
    recording = walk(poses_of)
    cloud = cloud_from_recording(recording, VOXEL_M)
    mixture = fit_mixture(cloud, 60, np.random.default_rng(0)).mixture
    bundle = make_bundle(mixture, recording, range(len(recording)))
    landmarks, bias, _ = build_landmarks(recording, recording.depth, NoProgress())
    settings = bundle.settings.model_copy(update={"landmark_bias": bias})
    size = CloudSize(points=len(cloud), voxel_m=VOXEL_M)
    return replace(bundle, landmarks=landmarks, settings=settings, cloud=size)
