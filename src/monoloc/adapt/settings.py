"""Settings of adaptation; free of PyTorch, so that every machine can read them."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Tune = Literal["none", "last", "decoder", "all"]

# Steps and the network's learning rate; a tuned encoder needs a smaller rate than a frozen one.
_SUITED: dict[Tune, tuple[int, float]] = {
    "none": (500, 3e-3),
    "last": (500, 3e-3),
    "decoder": (1400, 3e-3),
    "all": (600, 1.5e-3),
}
_HOLD_OUT_SHARE = 0.5  # of the final run's steps

QUICK = {"steps": 120, "synthesised_views": 200}
"""Changes to :class:`AdaptConfig` for a quick build."""


class AdaptConfig(BaseModel):
    """Settings of adaptation.

    Attributes:
        tune: what is tuned in the network: ``none``; ``last``, the last layer (the paper's choice); ``decoder``, the
            decoder and the last layer; or ``all``, all but the encoder's first layers up to stride 4.
        map_transform: whether to tune the map transform.
        lambda_kl: weight of KL(M || M_A) relative to the likelihood. If the network learns from depth,
            ``likelihood_weight`` scales it too.
        steps: optimiser steps of the final run, after half as many of the hold-out run; None selects the default for
            ``tune``. If the likelihood is the only objective and the hold-out run does not improve the held-out
            frames, the final run takes none.
        batch_views, pixels_per_view: size of one step.
        synthesised_views: total number of views synthesised from nearby poses (for ``decoder`` and ``all``).
        relit_share: share of a step's views with simulated lighting, down to a sixteenth of the light and less (for
            ``all``): a network tuned only in good light loses accuracy in the dark.
        network_rate, map_rate: Adam's learning rates; a ``network_rate`` of None selects the default for ``tune``.
        likelihood_weight, depth_weight, pose_weight: weights of the ray likelihood and, for ``decoder`` and ``all``,
            of the depth loss and of the pose-step loss (:func:`monoloc.adapt.pose_step.pose_step_loss`).
        outlier_share: epsilon of the ray likelihood.
        inflation_m: standard deviation added to the map's components at the start, annealed to zero; it gives depth
            far from the map a gradient.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    tune: Tune = "all"
    map_transform: bool = True
    lambda_kl: float = Field(0.1, ge=0.0, le=1e9)
    steps: int | None = Field(None, ge=1, le=10_000_000)
    batch_views: int = Field(16, ge=1, le=10_000)
    pixels_per_view: int = Field(32, ge=1, le=1_000_000)
    synthesised_views: int = Field(1200, ge=0, le=1_000_000)
    relit_share: float = Field(0.25, ge=0.0, le=1.0)
    network_rate: float | None = Field(None, gt=0.0, le=10.0)
    map_rate: float = Field(1e-3, gt=0.0, le=10.0)
    likelihood_weight: float = Field(0.05, ge=0.0, le=1e9)
    depth_weight: float = Field(1.0, ge=0.0, le=1e9)
    pose_weight: float = Field(1.0, ge=0.0, le=1e9)
    outlier_share: float = Field(0.1, gt=0.0, lt=1.0)
    inflation_m: float = Field(0.3, ge=0.0, le=100.0)

    @property
    def by_depth(self) -> bool:
        """Whether enough of the network is tuned to learn from depth, not only from the map's likelihood."""
        return self.tune in ("decoder", "all")

    @property
    def most_steps(self) -> int:
        """``steps``, or the default for ``tune``."""
        return _SUITED[self.tune][0] if self.steps is None else self.steps

    @property
    def hold_out_steps(self) -> int:
        """Steps of the hold-out run; ``most_steps`` are those of the final run."""
        return max(1, round(_HOLD_OUT_SHARE * self.most_steps))

    @property
    def rate(self) -> float:
        """``network_rate``, or the default for ``tune``."""
        return _SUITED[self.tune][1] if self.network_rate is None else self.network_rate
