"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.map.mixture import GaussianMixture
from repository import REPOSITORY, on_one_thread
from synthetic_room import Room, RoomRecording, make_path, measured_thresholds, room_mixture

# No deadline: a busy machine must not fail a property.
settings.register_profile("monoloc", deadline=None)
settings.register_profile("quick", deadline=None, max_examples=30)
settings.load_profile("monoloc")


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder of real recordings; tests that ask for it are skipped where it is absent."""
    root = Path(os.environ.get("MONOLOC_DATA", REPOSITORY.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no recordings at {root}; set MONOLOC_DATA to the folder that holds them")
    return root


@pytest.fixture(scope="session")
def weights_file(data_root: Path) -> Path:
    """ImageNet weights of the encoder, beside the recordings."""
    path = data_root.parent / "weights" / "mobilenet_v2_0.35_imagenet.npz"
    if not path.is_file():
        pytest.skip(f"no ImageNet weights at {path}")
    return path


# A recording in the synthetic room, of FRAMES frames of the module that asks for it.


@pytest.fixture(scope="module")
def recording(request: pytest.FixtureRequest) -> RoomRecording:
    return RoomRecording(Room(), make_path(request.module.FRAMES))


@pytest.fixture(scope="module")
def mixture() -> GaussianMixture:
    return room_mixture(Room())


@pytest.fixture(scope="module")
def thresholds(mixture: GaussianMixture, recording: RoomRecording) -> LikelihoodThresholds:
    return measured_thresholds(mixture, recording)


@pytest.fixture
def one_thread() -> Iterator[None]:
    with on_one_thread():
        yield
