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
_RELIT_SHARE = 0.25  # for ``all``; the layers that see light first must be tuned for it to matter

QUICK = {"steps": 120, "synthesised_views": 200}
"""Changes to :class:`AdaptConfig` for a quick build."""


class AdaptConfig(BaseModel):
    """Settings of adaptation.

    Attributes:
        tune: what is tuned in the network: ``none``; ``last``, the last layer (the paper's choice); ``decoder``, the
            decoder and the last layer; or ``all``, all but the encoder's first layers up to stride 4.
        learns_from: ``map``, the likelihood of predicted depth under the map alone (the paper's choice), or
            ``depth``, the recorded depth too; None selects depth if ``tune`` is ``decoder`` or ``all``.
        fits_scale: whether the network's scale is fitted to the recorded depth before the first step.
        map_transform: whether to tune the map transform.
        likelihood: of predicted depth under the map. ``ray``: of log-depth, given the pixel's ray. ``volume``: the
            map's density at the point (the paper's choice); the localizer then weighs scans with the same one.
        noise_sd_m: standard deviation of the map beyond its components' own spread, for ``volume``, in tuning and in
            the localizer alike.
        lambda_kl: weight of KL(M || M_A) relative to the likelihood. If the network learns from depth,
            ``likelihood_weight`` scales it too.
        steps: optimiser steps of the final run, after half as many of the hold-out run; None selects the default for
            ``tune``. If the likelihood is the only objective and the hold-out run does not improve the held-out
            frames, the final run takes none.
        batch_views, pixels_per_view: size of one step.
        synthesised_views: total number of views synthesised from nearby poses, where the network learns from depth.
        relit_share: share of a step's views with simulated lighting, down to a sixteenth of the light and less: a
            network tuned only in good light loses accuracy in the dark. None selects a quarter for ``all``, else 0.
        network_rate, map_rate: Adam's learning rates; a ``network_rate`` of None selects the default for ``tune``.
        likelihood_weight, depth_weight, pose_weight: weights of the likelihood and, where the network learns from
            depth, of the depth loss and of the pose-step loss (:func:`monoloc.adapt.pose_step.pose_step_loss`).
        outlier_share: epsilon of the likelihood.
        inflation_m: standard deviation added to the map's components at the start, annealed to zero; it gives depth
            far from the map a gradient.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    tune: Tune = "all"
    learns_from: Literal["map", "depth"] | None = None
    fits_scale: bool = True
    map_transform: bool = True
    likelihood: Literal["ray", "volume"] = "ray"
    noise_sd_m: float = Field(0.05, ge=0.0, le=10.0)
    lambda_kl: float = Field(0.1, ge=0.0, le=1e9)
    steps: int | None = Field(None, ge=1, le=10_000_000)
    batch_views: int = Field(16, ge=1, le=10_000)
    pixels_per_view: int = Field(32, ge=1, le=1_000_000)
    synthesised_views: int = Field(1200, ge=0, le=1_000_000)
    relit_share: float | None = Field(None, ge=0.0, le=1.0)
    network_rate: float | None = Field(None, gt=0.0, le=10.0)
    map_rate: float = Field(1e-3, gt=0.0, le=10.0)
    likelihood_weight: float = Field(0.05, ge=0.0, le=1e9)
    depth_weight: float = Field(1.0, ge=0.0, le=1e9)
    pose_weight: float = Field(1.0, ge=0.0, le=1e9)
    outlier_share: float = Field(0.1, gt=0.0, lt=1.0)
    inflation_m: float = Field(0.3, ge=0.0, le=100.0)

    @property
    def by_depth(self) -> bool:
        """Whether the network learns from depth, not only from the map's likelihood."""
        if self.learns_from is None:
            return self.tunes_features
        return self.learns_from == "depth" and self.tune != "none"

    @property
    def tunes_features(self) -> bool:
        """Whether layers before the last are tuned."""
        return self.tune in ("decoder", "all")

    @property
    def share_relit(self) -> float:
        """``relit_share``, or the default for ``tune``."""
        if self.relit_share is None:
            return _RELIT_SHARE if self.tune == "all" else 0.0
        return self.relit_share

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
