"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import settings

from monoloc.map.mixture import GaussianMixture
from monoloc.supervision.state import LikelihoodThresholds
from synthetic_room import Room, RoomRecording, healthy_range, make_path, room_mixture

# A busy machine must not fail a property; time is watched elsewhere.
settings.register_profile("monoloc", deadline=None)
settings.load_profile("monoloc")

REPOSITORY = Path(__file__).resolve().parent.parent


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


# The room that the online way is followed through; a module says by FRAMES how far.


@pytest.fixture(scope="module")
def recording(request: pytest.FixtureRequest) -> RoomRecording:
    return RoomRecording(Room(), make_path(request.module.FRAMES))


@pytest.fixture(scope="module")
def mixture() -> GaussianMixture:
    return room_mixture(Room())


@pytest.fixture(scope="module")
def healthy(mixture: GaussianMixture, recording: RoomRecording) -> LikelihoodThresholds:
    return healthy_range(mixture, recording)


@contextmanager
def on_one_thread() -> Iterator[None]:
    """PyTorch on one thread: results repeat to the last bit, small tensors are done sooner."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@pytest.fixture
def one_thread() -> Iterator[None]:
    with on_one_thread():
        yield
