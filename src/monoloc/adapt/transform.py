"""The map transform and the adapted map (torch, float64)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from monoloc.map.mixture import GaussianMixture

_HIDDEN = 128
_NEIGHBOURS = 8  # responsibilities kept a point; the rest weigh less than 1e-3 together on fitted maps


class MapTransform(nn.Module):
    """``f(x) = x + W2 tanh(W1 (x - c) / r + b1) + b2``, a 3-128-3 perceptron that starts as the identity.

    Source: Shukla et al. 2023, section 3; residual form and zero start are ours.

    Args:
        centre, radius: of the room, metres; they bring the points to about [-1, 1].
    """

    centre: Tensor
    radius: Tensor

    def __init__(self, centre: Tensor, radius: float) -> None:
        super().__init__()
        self.register_buffer("centre", centre.double())
        self.register_buffer("radius", torch.tensor(radius, dtype=torch.float64))
        self.hidden = nn.Linear(3, _HIDDEN, dtype=torch.float64)
        self.output = nn.Linear(_HIDDEN, 3, dtype=torch.float64)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, points: Tensor) -> Tensor:
        """Bent points: (..., 3) -> (..., 3), metres, world frame."""
        hidden = torch.tanh(self.hidden((points - self.centre) / self.radius))
        bent: Tensor = points + self.output(hidden)
        return bent


class AdaptedMap(nn.Module):
    """The mixture M_A of a bent cloud, differentiable in the bending.

    Every point keeps its responsibilities under the original mixture, so component i of M_A is component i of M:
    its mean and covariance are those of the bent points, weighted by gamma_ni; mixing proportions stay.
    Moments are taken about the original means in float64: the naive second moment loses the covariance.

    Args:
        mixture: the original map M.
        cloud: (N, 3) float64 points that M was fitted to, metres, world frame.
        floor_m: standard deviation added to every covariance, as in the fit.
    """

    cloud: Tensor
    log_weights: Tensor
    means: Tensor
    covariances: Tensor
    _nearest: Tensor
    _gamma: Tensor
    _mass: Tensor

    def __init__(self, mixture: GaussianMixture, cloud: NDArray[np.float64], floor_m: float = 0.01) -> None:
        super().__init__()
        kept = min(_NEIGHBOURS, len(mixture.weights))
        gamma, nearest = torch.from_numpy(mixture.responsibilities(cloud)).topk(kept, dim=1)
        gamma = gamma / gamma.sum(dim=1, keepdim=True)
        self.register_buffer("cloud", torch.from_numpy(np.asarray(cloud, dtype=np.float64)))
        self.register_buffer("log_weights", torch.from_numpy(mixture.weights).log())
        self.register_buffer("_nearest", nearest)
        self.register_buffer("_gamma", gamma)
        mass = torch.zeros(len(mixture.weights), dtype=torch.float64).index_add(0, nearest.ravel(), gamma.ravel())
        self.register_buffer("_mass", mass)
        self._floor = floor_m**2 * torch.eye(3, dtype=torch.float64)
        centre = 0.5 * (self.cloud.amin(dim=0) + self.cloud.amax(dim=0))
        radius = float(0.5 * (self.cloud.amax(dim=0) - self.cloud.amin(dim=0)).max())
        self.transform = MapTransform(centre, radius)
        # The original, by the same sums: M itself up to EM's last step, so that the identity has a KL of zero.
        self.register_buffer("means", torch.from_numpy(mixture.means))
        means, covariances = self._moments(self.cloud)
        self.register_buffer("means", means)
        self.register_buffer("covariances", covariances)

    def forward(self) -> tuple[Tensor, Tensor]:
        """Adapted means (K, 3) and covariances (K, 3, 3)."""
        return self._moments(self.transform(self.cloud))

    def _moments(self, points: Tensor) -> tuple[Tensor, Tensor]:
        count = len(self.means)
        index = self._nearest.ravel()
        mass = self._mass.clamp(min=1e-12)[:, None]
        weighted = self._gamma.ravel()[:, None]
        relative = (points[:, None, :] - self.means[self._nearest]).reshape(-1, 3)
        shift = torch.zeros(count, 3, dtype=torch.float64).index_add(0, index, weighted * relative) / mass
        outer = (relative[:, :, None] * relative[:, None, :]).reshape(-1, 9)
        second = torch.zeros(count, 9, dtype=torch.float64).index_add(0, index, weighted * outer) / mass
        covariances = second.reshape(-1, 3, 3) - shift[:, :, None] * shift[:, None, :] + self._floor
        return self.means + shift, covariances

    def original_mixture(self) -> GaussianMixture:
        return self._as_mixture(self.means, self.covariances)

    @torch.no_grad()
    def adapted_mixture(self) -> GaussianMixture:
        return self._as_mixture(*self())

    def _as_mixture(self, means: Tensor, covariances: Tensor) -> GaussianMixture:
        return GaussianMixture(self.log_weights.exp().numpy(), means.numpy(), covariances.numpy())
