"""Views of a level flight: their rotations, and where a camera is found in a room that was seen from one side."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monoloc.bundle import Bundle
from monoloc.geometry import is_rigid, make_pose
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.level_map import T_map_world
from monoloc.localizability import HEADINGS, found_probability, level_rotations, localizability
from monoloc.progress import NoProgress
from refusals import refuses_data, refuses_setting
from synthetic_room import bundle_with_landmarks_ahead


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return bundle_with_landmarks_ahead()


def test_rotations_are_level_and_pitched() -> None:
    headings_rad, pitch_rad = np.linspace(0.0, 5.0, 7), -0.3
    for rotation, heading in zip(level_rotations(headings_rad, pitch_rad), headings_rad, strict=True):
        right, down, forward = rotation.T
        assert is_rigid(make_pose(rotation, np.zeros(3)))
        assert right[2] == 0.0 and down[2] < -0.9
        assert np.arcsin(forward[2]) == pytest.approx(pitch_rad)
        assert np.angle(np.exp(1j * (np.arctan2(forward[1], forward[0]) - heading))) == pytest.approx(0.0, abs=1e-9)


def test_probability_grows_with_the_number_of_landmarks() -> None:
    probability = found_probability(np.array([0.0, 5.0, 40.0, 400.0]))
    assert probability[0] == 0.0 and probability[1] < 0.02 and probability[2] == 0.5 and probability[3] > 0.99


def test_a_camera_is_found_where_it_looks_as_the_build_did(bundle: Bundle) -> None:
    views = localizability(bundle, "room", 0.25, None, None, NoProgress())
    assert views.landmarks.shape == (len(views.positions), HEADINGS) and np.all(
        views.positions[:, 2] == views.height_m
    )
    # Nearest to the build's cameras, the best direction is theirs, and the opposite one shows nothing.
    cameras = T_map_world(bundle) @ bundle.reference_poses.poses
    nearest = np.linalg.norm(views.positions - cameras[:, :3, 3].mean(axis=0), axis=1).argmin()
    forward = cameras[:, :2, 2].mean(axis=0)
    best = int(views.landmarks[nearest].argmax())
    assert abs(np.angle(np.exp(1j * (views.headings_rad[best] - np.arctan2(*forward[::-1]))))) < np.deg2rad(31.0)
    assert views.probability[nearest, best] > 0.9 and views.probability[nearest, best - HEADINGS // 2] < 0.05


def test_figures_are_those_of_the_views(bundle: Bundle) -> None:
    views = localizability(bundle, "room", 0.5, 0.1, -0.2, NoProgress())
    figures, probability = views.figures(), views.probability
    assert figures["places"] == len(views.positions) and figures["directions"] == HEADINGS
    assert figures["height_m"] == 0.1 and figures["pitch_deg"] == pytest.approx(np.degrees(-0.2))
    assert figures["found_share"] == pytest.approx(probability.mean())
    some = [bool(np.any(row >= 0.5)) for row in probability]
    every = [bool(np.all(row >= 0.5)) for row in probability]
    assert figures["places_found_share"] == np.mean(some) > np.mean(every)
    assert figures["places_found_all_around_share"] == np.mean(every)


def test_a_bundle_without_landmarks_is_refused(bundle: Bundle) -> None:
    bare = replace(bundle, landmarks=Landmarks.none())
    refuses_data(
        lambda: localizability(bare, "room.monoloc", 0.25, None, None, NoProgress()),
        Path("room.monoloc"),
        "keeps no landmarks",
        "build it again",
    )


def test_a_height_without_free_space_is_refused(bundle: Bundle) -> None:
    refuses_setting(
        lambda: localizability(bundle, "room", 0.25, 1.29, None, NoProgress()),
        "height_m",
        "is 1.29, where the build's cameras saw no free space",
        "give another height",
    )
