"""What adaptation leaves behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.spec import DepthModel
from monoloc.map.learnt_transform import LearntTransform
from monoloc.map.mixture import GaussianMixture


@dataclass(frozen=True)
class Score:
    """Scores on real frames: mean negative log-likelihood (nats), depth loss and AbsRel."""

    step: int
    nll: float
    depth_loss: float
    absrel: float


@dataclass(frozen=True)
class AdaptResult:
    """Map and network after adaptation, and those to evaluate with.

    Attributes:
        original, adapted: the map before and after; component i of one corresponds to component i of the other.
        depth_model: the network, tuned on all frames.
        hold_out_model, hold_out_map: result of the hold-out run, tuned without the held-out frames; used for
            evaluation.
        held_out: frame indices of the held-out frames, one array per region; empty if nothing was tuned.
        scores: scores on the held-out frames; the first is before tuning, the last is of the selected state. Empty if
            nothing was tuned.
        steps: steps of the final run; 0 if the likelihood is the only objective and the hold-out run did not improve
            the held-out frames.
        kl: KL(M || M_A), nats.
        transform: that adapted the map; None if it was not tuned.
    """

    original: GaussianMixture
    adapted: GaussianMixture
    depth_model: DepthModel
    hold_out_model: DepthModel
    hold_out_map: GaussianMixture
    held_out: list[NDArray[np.int64]]
    scores: list[Score]
    steps: int
    kl: float
    transform: LearntTransform | None

    @classmethod
    def untuned(cls, mixture: GaussianMixture, model: DepthModel) -> AdaptResult:
        """A map and a network as they were."""
        return cls(mixture, mixture, model, model, mixture, held_out=[], scores=[], steps=0, kl=0.0, transform=None)

    def evaluation_frames(self, count: int) -> NDArray[np.int64]:
        """Indices of the frames held out; of all ``count`` frames if nothing was tuned."""
        return np.sort(np.concatenate(self.held_out)) if self.held_out else np.arange(count)
