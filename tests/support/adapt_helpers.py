"""What tests of adaptation share: a small map and its cloud, views of a small recording, and quick settings."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from depth_helpers import ROOM, TINY, tiny_network
from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import Views, make_views
from monoloc.adapt.tuning import Adaptation
from monoloc.map.em import FLOOR_M, initial_mixture, maximise_likelihood
from monoloc.map.mixture import GaussianMixture
from synthetic_room import RoomRecording

FloatArray = NDArray[np.float64]
RoomMap = tuple[GaussianMixture, FloatArray]

NONE_HELD_OUT = np.zeros(0, dtype=np.int64)
QUICK = AdaptConfig(
    tune="decoder", steps=200, batch_views=6, pixels_per_view=24, lambda_kl=0.0, network_rate=0.01, map_rate=0.01
)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def room_map(spacing_m: float = 0.2, components: int = 30) -> RoomMap:
    """A mixture at EM's fixed point, and its cloud."""
    cloud = ROOM.cloud(spacing_m)
    start = initial_mixture(cloud, components, np.random.default_rng(0), FLOOR_M)
    fit = maximise_likelihood(cloud, start, max_iterations=500, tolerance=1e-7)
    return fit.mixture, cloud


def bend(adapted: AdaptedMap, sd: float) -> None:
    """Draw the weights of the transform's last layer at random."""
    random = generator()
    with torch.no_grad():
        adapted.transform.output.weight.normal_(0.0, sd, generator=random)
        adapted.transform.output.bias.normal_(0.0, sd, generator=random)


def as_tensors(mixture: GaussianMixture) -> tuple[Tensor, Tensor, Tensor]:
    """Log weights, means and covariances in float64."""
    log_weights, means, covariances = (
        torch.from_numpy(array) for array in (np.log(mixture.weights), mixture.means, mixture.covariances)
    )
    return log_weights, means, covariances


def views_of(recording: RoomRecording, synthesised: int = 0, held_out: NDArray[np.int64] = NONE_HELD_OUT) -> Views:
    """Views of every frame, and synthesised ones, for :data:`depth_helpers.TINY`."""
    rng = np.random.default_rng(0)
    return make_views(recording, recording.depth, TINY.focal_px, synthesised, held_out, rng)


def start_adaptation(mapped_room: RoomMap, **changes: object) -> Adaptation:
    """Adaptation of an untrained network by :data:`QUICK`, with changes."""
    return Adaptation(tiny_network(), AdaptedMap(*mapped_room), QUICK.model_copy(update=changes))


class RedAndNear(RoomRecording):
    """The room, except for marked frames: red all over, and nearer than everything else."""

    marked: NDArray[np.int64] = np.array([3, 4, 9])

    def color(self, index: int) -> NDArray[np.uint8]:
        color = super().color(index)
        return np.full_like(color, [255, 0, 0]) if index in self.marked else color // 2

    def depth(self, index: int) -> NDArray[np.float32]:
        depth = super().depth(index)
        return np.full_like(depth, 0.5) if index in self.marked else depth


def redness(views: Views) -> FloatArray:
    """Share of each view's pixels that are redder than any pixel of an unmarked frame."""
    return np.asarray((views.colors[..., 0] > 153).mean(axis=(1, 2)))
