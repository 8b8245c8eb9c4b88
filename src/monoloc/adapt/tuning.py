"""Joint tuning of the depth network and the map transform."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.adapt.frozen_layers import batches, frozen_outputs
from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.objective import matched_kl, ray_log_likelihood, volume_log_likelihood
from monoloc.adapt.pose_step import pose_step_loss, pose_steps
from monoloc.adapt.result import Score
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import Views
from monoloc.depth.training.losses import LossConfig, depth_loss, laplace_loss
from monoloc.depth.training.memory import keep_freed_memory
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.precision import learns_in_bfloat16
from monoloc.depth.training.schedule import one_cycle

_STEPS_A_MAP_STEP = 4  # of tuning by depth; the map changes little meanwhile
_ENCODER_RATE = 0.5  # of the other layers' learning rate
_NO_DIFFERENCE = 0.05  # share of the held-out gain that counts as no difference; longer tuning generalises better


@dataclass(frozen=True)
class _Constants:
    """What tuning does not change of V views.

    Attributes:
        views: the views.
        outputs: of the network's frozen layers, see :func:`monoloc.adapt.frozen_layers.frozen_outputs`.
        of_poses: (V, 6, h * w) from log-depth errors to camera steps; None where the loss does not use them.
    """

    views: Views
    outputs: list[Tensor]
    of_poses: Tensor | None


class Adaptation:
    """Joint tuning of a network and a map; call :meth:`run`.

    Args:
        network: starts from its current weights and is changed in place; batch normalisation keeps the statistics of
            its training.
        adapted_map: changed in place if the map transform is tuned.
        config: what to tune and how.
    """

    def __init__(self, network: DepthNetwork, adapted_map: AdaptedMap, config: AdaptConfig) -> None:
        self.network = network.eval()
        self.map = adapted_map
        self.config = config
        network.requires_grad_(False)
        network.head.requires_grad_(config.tune != "none")
        network.decoder.requires_grad_(config.tunes_features)
        network.encoder.requires_grad_(config.tune == "all")
        network.encoder.first_layers.requires_grad_(False)
        if network.error_head is not None:
            network.error_head.requires_grad_(config.by_depth)
        adapted_map.requires_grad_(config.map_transform)
        self._map_every = _STEPS_A_MAP_STEP if config.by_depth else 1
        self._bent = adapted_map.means, adapted_map.covariances
        self._constants: _Constants | None = None

    @property
    def is_trivial(self) -> bool:
        return self.config.tune == "none" and not self.config.map_transform

    def run(
        self,
        training: Views,
        steps: int,
        generator: torch.Generator,
        held_out: Sequence[int] | NDArray[np.int64] | None = None,
        evaluate_every: int = 100,
        progress: Callable[[int], None] | None = None,
    ) -> list[Score]:
        """Tune for ``steps`` steps; with held-out frames, restore the best state on them.

        A further run continues from the state that the one before it left.

        Args:
            training: views to tune on; what does not change by tuning is kept for a further run on the same views.
            steps: optimiser steps; the learning rate decays to zero over them.
            generator: draws views and pixels.
            held_out: frames whose views are not tuned on, but evaluated every ``evaluate_every`` steps.
            evaluate_every: steps between two evaluations.
            progress: called with the number of steps done; first with 0, when they begin.

        Returns:
            Scores on the held-out frames, the first before any step; empty without held-out frames.
        """
        keep_freed_memory()
        judged = None if held_out is None else training.of_frames(held_out, only_whole=True)
        scores = [self.score(judged, 0)] if judged is not None else []
        if self.is_trivial:
            return scores
        best = self._state() if judged is not None else None
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # an export undoes it
        odds = training.odds(() if held_out is None else held_out)
        if self.config.fits_scale:
            self.fit_bias(training[torch.nonzero(training.whole & (odds > 0.0)).ravel()])
        constants = self._constants_of(training, np.random.default_rng(generator.initial_seed()))
        optimizer = self._optimizer()
        schedule = one_cycle(optimizer, steps)
        if progress is not None:
            progress(0)
        for step in range(steps):
            chosen = torch.multinomial(odds, self.config.batch_views, replacement=True, generator=generator)
            shown = chosen
            if self.config.share_relit > 0.0:
                is_relit = torch.rand(len(chosen), generator=generator) < self.config.share_relit
                shown = chosen + len(training) * is_relit
            inputs = [part[shown] for part in constants.outputs]
            of_chosen = None if constants.of_poses is None else constants.of_poses[chosen]
            loss = self._loss(training[chosen], inputs, of_chosen, step, steps, generator)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
            if judged is not None and ((step + 1) % evaluate_every == 0 or step + 1 == steps):
                scores.append(self.score(judged, step + 1))
                if self.best_step(scores) == step + 1:
                    best = self._state()
            if progress is not None:
                progress(step + 1)
        if best is not None:
            self._restore(best)
        return scores

    def best_step(self, scores: list[Score]) -> int:
        """Return the last step that reaches nearly all of the best step's gain over the first."""
        values = [self._criterion(score) for score in scores]
        enough = min(values) + _NO_DIFFERENCE * (values[0] - min(values))
        return max(score.step for score, value in zip(scores, values, strict=True) if value <= enough)

    def _optimizer(self) -> torch.optim.Optimizer:
        network, rate = self.network, self.config.rate
        encoder = [p for p in network.encoder.parameters() if p.requires_grad]
        others = [p for name, p in network.named_parameters() if p.requires_grad and not name.startswith("encoder.")]
        groups = [
            {"params": others, "lr": rate},
            {"params": encoder, "lr": _ENCODER_RATE * rate},
            {"params": [p for p in self.map.parameters() if p.requires_grad], "lr": self.config.map_rate},
        ]
        # Fused: one call for all of about two hundred tensors.
        return torch.optim.Adam([group for group in groups if group["params"]], fused=True)

    def _constants_of(self, views: Views, light: np.random.Generator) -> _Constants:
        if self._constants is None or self._constants.views is not views:
            of_poses = None
            if self.config.by_depth and self.config.pose_weight > 0.0:
                of_poses = pose_steps(views.output_depth_m[:, 0].numpy(), views.rays)
            outputs = frozen_outputs(self.network, views.colors, self.config, light)
            self._constants = _Constants(views, outputs, of_poses)
        return self._constants

    @torch.no_grad()
    def fit_bias(self, views: Views) -> None:
        """Add the median log ratio of true to predicted depth to the last layer's bias, before the first step."""
        if self.config.tune == "none":
            return
        whole = views[torch.nonzero(views.whole).ravel()]
        ratio = _log_ratio(self.predict(whole), whole.output_depth_m)
        assert self.network.head.bias is not None
        if ratio.numel():
            self.network.head.bias += ratio.median()

    @torch.no_grad()
    def predict(self, views: Views) -> Tensor:
        """Metric log-depth of views, (V, 1, h, w)."""
        return torch.cat([self.network(images) for images in batches(views.colors)]) + views.log_focal_ratio

    @torch.no_grad()
    def score(self, views: Views, step: int) -> Score:
        log_depth = self.predict(views)
        means, covariances = self.map()
        nll = -self._log_likelihood(log_depth, views, means, covariances, None).mean()
        ratio = _log_ratio(log_depth, views.output_depth_m)
        absrel = (torch.expm1(-ratio)).abs().mean() if ratio.numel() else torch.tensor(float("nan"))
        loss = depth_loss(log_depth, views.depth_m, LossConfig(gradient=0.0))
        return Score(step, float(nll), float(loss), float(absrel))

    @torch.no_grad()
    def kl(self) -> float:
        """Current KL(M || M_A), nats."""
        return float(self._kl(*self.map()))

    def _kl(self, means: Tensor, covariances: Tensor) -> Tensor:
        m = self.map
        return matched_kl(m.log_weights, m.means, m.covariances, m.log_weights, means, covariances)

    def _criterion(self, score: Score) -> float:
        if self.config.by_depth:
            return self.config.depth_weight * score.depth_loss + self.config.likelihood_weight * score.nll
        return score.nll

    def _loss(
        self,
        views: Views,
        inputs: list[Tensor],
        of_poses: Tensor | None,
        step: int,
        steps: int,
        generator: torch.Generator,
    ) -> Tensor:
        config, done = self.config, step / steps
        features = self._features(inputs)
        log_depth = self.network.head(features) + views.log_focal_ratio
        moves_map = config.map_transform and step % self._map_every == 0
        if moves_map:
            self._bent = self.map.by_cells()
        means, covariances = self._bent
        inflation = (config.inflation_m * max(0.0, 1.0 - 2.0 * done)) ** 2 * torch.eye(3, dtype=torch.float64)
        pixels = torch.randint(log_depth[0].numel(), (config.pixels_per_view,), generator=generator)
        log_likelihood = self._log_likelihood(log_depth, views, means, covariances + inflation, pixels).mean()
        if not self.config.by_depth:
            loss = -log_likelihood
        else:
            # The gradient term keeps planes smooth and depth edges sharp while the decoder is tuned.
            of_depth = depth_loss(log_depth, views.depth_m, LossConfig(scale_invariant=0.5))
            loss = config.depth_weight * of_depth - config.likelihood_weight * log_likelihood
            if of_poses is not None:
                loss = loss + config.pose_weight * pose_step_loss(log_depth, views.output_depth_m, of_poses)
            if self.network.error_head is not None:
                # The features change, so the error head must follow them.
                loss = loss + laplace_loss(log_depth, self.network.error_head(features.detach()), views.depth_m)
        if moves_map:
            self._bent = means.detach(), covariances.detach()
            weight = config.lambda_kl * (config.likelihood_weight if self.config.by_depth else 1.0)
            loss = loss + weight * self._kl(means, covariances)
        return loss

    def _log_likelihood(
        self, log_depth: Tensor, views: Views, means: Tensor, covariances: Tensor, pixels: Tensor | None
    ) -> Tensor:
        flat, rays = log_depth.reshape(len(views), -1).double(), views.rays_world
        if pixels is None:
            pixels = torch.arange(0, flat.shape[1], 7)
        flat, rays = flat[:, pixels], rays[:, pixels]
        origins = views.origins[:, None].expand_as(rays).reshape(-1, 3)
        flat, rays = flat.reshape(-1), rays.reshape(-1, 3)
        log_weights, share = self.map.log_weights, self.config.outlier_share
        if self.config.likelihood == "ray":
            return ray_log_likelihood(flat, rays, origins, log_weights, means, covariances, share)
        points = origins + flat.exp()[:, None] * rays
        smoothed = covariances + self.config.noise_sd_m**2 * torch.eye(3, dtype=torch.float64)
        return volume_log_likelihood(points, log_weights, means, smoothed, share, self.map.volume_m3)

    def _features(self, inputs: list[Tensor]) -> Tensor:
        """Features that the last layer reads, from the outputs of the frozen layers, with gradients."""
        if not self.config.tunes_features:
            return inputs[0].float()
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=learns_in_bfloat16("cpu")):
            taps = self.network.encoder.after_first(inputs[0]) if self.config.tune == "all" else inputs
            features: Tensor = self.network.decoder(taps)
        return features.float()

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return copy.deepcopy(self.network.state_dict()), copy.deepcopy(self.map.state_dict())

    def _restore(self, state: tuple[dict[str, Tensor], dict[str, Tensor]]) -> None:
        self.network.load_state_dict(state[0])
        self.map.load_state_dict(state[1])


def _log_ratio(log_depth: Tensor, truth: Tensor) -> Tensor:
    """Log of true over predicted depth at the pixels with known depth, (n,)."""
    valid = truth > 0.0
    return torch.log(truth[valid]) - log_depth[valid]
