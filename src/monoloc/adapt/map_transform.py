"""The map transform and the adapted map (torch)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from monoloc.adapt.objective import UPPER
from monoloc.map.em import FLOOR_M
from monoloc.map.learnt_transform import HIDDEN, LearntTransform
from monoloc.map.mixture import GaussianMixture

_SYMMETRIC = (0, 1, 2, 1, 3, 4, 2, 4, 5)  # index of each entry of a symmetric 3 x 3 matrix in UPPER
_BLOCK = 4096
_NEIGHBOURS = 8  # responsibilities stored per point; on fitted maps the others sum to less than 1e-3
_CELL_M = 0.15  # edge of the cells whose points a tuning step displaces alike; the transform is smooth over a cell


class MapTransform(nn.Module):
    """``f(x) = x + W2 tanh(W1 (x - c) / r + b1) + b2``, a 3-128-3 perceptron that starts as the identity.

    Source: Shukla et al. 2023, section 3. The residual form and the zero initialisation are ours.

    Args:
        centre, radius: centre and radius of the room, metres; they normalise points to about [-1, 1].
    """

    centre: Tensor
    radius: Tensor

    def __init__(self, centre: Tensor, radius: float) -> None:
        super().__init__()
        self.register_buffer("centre", centre.double())
        self.register_buffer("radius", torch.tensor(radius, dtype=torch.float64))
        self.hidden, self.output = nn.Linear(3, HIDDEN), nn.Linear(HIDDEN, 3)
        # PyTorch's default initialisation, but from a fixed seed, so that the result does not depend on global state.
        generator = torch.Generator().manual_seed(0)
        for parameter in self.hidden.parameters():
            nn.init.uniform_(parameter, -(3.0**-0.5), 3.0**-0.5, generator=generator)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, points: Tensor) -> Tensor:
        """Transform points: (..., 3) -> (..., 3), metres, world frame."""
        normalised = ((points - self.centre) / self.radius).to(self.hidden.weight.dtype)
        # The displacement is small, so the perceptron computes it in its own precision; the sum is in float64.
        # Points are columns, not rows: the gradients of such narrow products then take a quarter of the time.
        columns = normalised.reshape(-1, 3).T.contiguous()
        hidden = torch.tanh(torch.addmm(self.hidden.bias[:, None], self.hidden.weight, columns))
        displacement = torch.addmm(self.output.bias[:, None], self.output.weight, hidden)
        return points + displacement.T.reshape(points.shape)

    def learnt(self) -> LearntTransform:
        """The transform as it is now, without PyTorch."""
        layers = (self.hidden.weight, self.hidden.bias, self.output.weight, self.output.bias)
        return LearntTransform(
            self.centre.numpy(), float(self.radius), *(layer.detach().double().numpy() for layer in layers)
        )


def _sparse_rows(rows: Tensor, columns: Tensor, values: Tensor, shape: tuple[int, int]) -> Tensor:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sparse", UserWarning)  # beta state and unchecked invariants
        return torch.sparse_coo_tensor(torch.stack([rows, columns]), values, shape).coalesce().to_sparse_csr()


class _SparseProduct(torch.autograd.Function):
    """``A @ x`` for a constant sparse A; PyTorch's own would sort A's transpose in every backward pass."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, matrix: Tensor, transposed: Tensor) -> Tensor:
        ctx.transposed = transposed
        return matrix @ x

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return ctx.transposed @ gradient, None, None


class AdaptedMap(nn.Module):
    """The mixture M_A of the transformed cloud, differentiable with respect to the transform.

    Each point keeps its responsibilities gamma_ni under the original mixture, so component i of M_A corresponds to
    component i of M. Its mean and covariance are the gamma-weighted moments of the transformed points; mixing
    proportions do not change. Moments are computed in float64: in float32, subtracting the squared mean from the
    second moment cancels the covariance. The square of the map fit's floor, 1 cm, is added to every variance, which
    keeps covariances positive definite; the fit clamps variances at it instead, but clamping is not differentiable.

    Args:
        mixture: the original map M.
        cloud: (N, 3) float64 points that M was fitted to, metres, world frame.

    Attributes:
        volume_m3: of the original map, see :attr:`monoloc.map.mixture.GaussianMixture.volume_m3`.
    """

    cloud: Tensor
    log_weights: Tensor
    means: Tensor
    covariances: Tensor

    def __init__(self, mixture: GaussianMixture, cloud: NDArray[np.float64]) -> None:
        super().__init__()
        neighbours = min(_NEIGHBOURS, len(mixture.weights))
        blocks = np.array_split(cloud, max(1, len(cloud) // _BLOCK))  # the full (N, K) matrix would not fit in memory
        parts = [torch.from_numpy(mixture.responsibilities(block)).topk(neighbours, dim=1) for block in blocks]
        gamma, nearest = torch.cat([part.values for part in parts]), torch.cat([part.indices for part in parts])
        gamma = gamma / gamma.sum(dim=1, keepdim=True)
        points = torch.from_numpy(np.asarray(cloud, dtype=np.float64))
        rows, columns = nearest.ravel(), torch.arange(len(points)).repeat_interleave(neighbours)
        mass = torch.zeros(len(mixture), dtype=torch.float64).index_add(0, rows, gamma.ravel()).clamp(min=1e-12)
        # Row i averages the cloud with component i's responsibilities. Its transpose serves every backward pass.
        weights = gamma.ravel() / mass[rows]
        self._averaging = _sparse_rows(rows, columns, weights, (len(mixture), len(points)))
        self._averaging_transposed = _sparse_rows(columns, rows, weights, (len(points), len(mixture)))
        centre = 0.5 * (points.amin(dim=0) + points.amax(dim=0))
        radius = float(0.5 * (points.amax(dim=0) - points.amin(dim=0)).max())
        self.transform = MapTransform(centre, radius)
        self.register_buffer("cloud", points)
        _, cell_of = torch.unique(torch.floor(points / _CELL_M), dim=0, return_inverse=True)
        counts = torch.bincount(cell_of)[:, None]
        self._cell_of = cell_of
        self._cells = torch.zeros((len(counts), 3), dtype=torch.float64).index_add(0, cell_of, points) / counts
        self.register_buffer("log_weights", torch.from_numpy(mixture.weights).log())
        self._floor = FLOOR_M**2 * torch.eye(3, dtype=torch.float64)
        self.volume_m3 = mixture.volume_m3
        # Recompute M with the same sums, so that the identity has zero KL; it differs from M by EM's last step and
        # the floor.
        means, covariances = self._moments(points)
        self.register_buffer("means", means)
        self.register_buffer("covariances", covariances)

    def forward(self) -> tuple[Tensor, Tensor]:
        """Return adapted means (K, 3) and covariances (K, 3, 3), world frame, metres."""
        return self._moments(self.transform(self.cloud))

    def by_cells(self) -> tuple[Tensor, Tensor]:
        """As :meth:`forward`, but all points of a cell are displaced like their mean; a sixth of the time."""
        displacement = self.transform(self._cells) - self._cells
        return self._moments(self.cloud + displacement.index_select(0, self._cell_of))

    def _moments(self, points: Tensor) -> tuple[Tensor, Tensor]:
        relative = points - self.transform.centre
        upper = torch.stack([relative[:, i] * relative[:, j] for i, j in UPPER], dim=1)
        averages: Tensor = _SparseProduct.apply(  # type: ignore[no-untyped-call]
            torch.cat([relative, upper], dim=1), self._averaging, self._averaging_transposed
        )
        means, second = averages[:, :3], averages[:, 3:][:, _SYMMETRIC].reshape(-1, 3, 3)
        return means + self.transform.centre, second - means[:, :, None] * means[:, None, :] + self._floor

    def original_mixture(self) -> GaussianMixture:
        return self._as_mixture(self.means, self.covariances)

    @torch.no_grad()
    def adapted_mixture(self) -> GaussianMixture:
        return self._as_mixture(*self())

    def _as_mixture(self, means: Tensor, covariances: Tensor) -> GaussianMixture:
        return GaussianMixture(self.log_weights.exp().numpy(), means.numpy(), covariances.numpy())
