"""Settings and report of a build."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.bias import KnownBiasCheck
from monoloc.fusion.reference_poses import MOST_POSES
from monoloc.localizer_config import ADDITIONS, LocalizerConfig


class BuildConfig(BaseModel):
    """Settings of a build.

    Attributes:
        most_frames: largest number of frames used; of a longer recording, those that show most of the room are taken.
        components: of the map, or ``bic`` to choose their number.
        voxel_m: edge of the voxels that thin the cloud to one point each.
        max_depth_m: sensor depth beyond it is not used for the map.
        adapt: what is tuned and how.
        refine_poses: whether the frames' poses are aligned with the map first, for poses from another system.
        pose_sd_m, pose_sd_deg: standard deviation of those poses, per axis.
        landmarks: whether the bundle holds landmarks.
        int8: whether the bundle's network is quantised to 8 bits, calibrated on the frames.
        localizer: settings written into the bundle, before calibration.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    most_frames: int = Field(300, ge=10, le=MOST_POSES)
    components: Annotated[int, Field(ge=1, le=1_000_000)] | Literal["bic"] = 200
    voxel_m: float = Field(0.03, ge=0.001, le=10.0)
    max_depth_m: float = Field(4.5, gt=0.0, le=1000.0)
    adapt: AdaptConfig = AdaptConfig()
    refine_poses: bool = False
    pose_sd_m: float = Field(0.02, ge=1e-6, le=10.0)
    pose_sd_deg: float = Field(1.0, ge=1e-6, le=180.0)
    landmarks: bool = True
    int8: bool = False
    localizer: LocalizerConfig = LocalizerConfig()

    @property
    def uncalibrated(self) -> LocalizerConfig:
        """Settings of the localizer before calibration.

        Where the map is tuned by the volume likelihood, the localizer weighs scans with the same one.
        """
        if self.adapt.likelihood == "ray":
            return self.localizer
        same = {"kind": "volume", "noise_sd_m": self.adapt.noise_sd_m, "outlier_share": self.adapt.outlier_share}
        return self.localizer.model_copy(update={"likelihood": self.localizer.likelihood.model_copy(update=same)})


Method = Literal["default", "paper"]

METHODS: dict[Method, BuildConfig] = {
    "default": BuildConfig(),
    "paper": BuildConfig(
        landmarks=False,
        adapt=AdaptConfig(
            tune="last",
            learns_from="map",
            fits_scale=False,
            likelihood="volume",
            synthesised_views=0,
            relit_share=0.0,
            pose_weight=0.0,
        ),
        localizer=LocalizerConfig(without=ADDITIONS),
    ),
}
"""Settings of monoloc's method, and of that of Shukla et al. 2023."""


@dataclass(frozen=True)
class BuildReport:
    """What a build measured; the JSON keys of ``monoloc build``.

    ``frames`` were used of ``recorded_frames``. ``nll`` and AbsRel are of held-out frames, in regions apart from the
    others. The change of the map is as in :class:`monoloc.map.compare.MapChange`. Scale and shift of the network's
    output are None where they were not fitted, see :class:`monoloc.depth.spec.ModelSpec`. ``known_bias_used`` says
    whether flights subtract the bias that was measured at the reference poses. They do if that helped in
    ``known_bias_check``, which is None where no frame was held out, or where no segment of the recording is long
    enough to know a bias of. ``scale_sd`` is the relative standard deviation of the map's scale, None where a sensor
    measured it.
    """

    frames: int
    recorded_frames: int
    cloud_points: int
    components: int
    nll_start: float | None
    nll_end: float | None
    kl: float
    shift_median_m: float
    shift_p95_m: float
    correspondence_share: float
    size_ratio_median: float
    landmarks: int
    held_out_frames: int
    depth_absrel_before: float | None
    depth_absrel_after: float | None
    depth_scale: float | None
    depth_shift: float | None
    steps: int
    known_bias_used: bool
    known_bias_check: KnownBiasCheck | None
    scale_sd: float | None
    pose_shift_median_m: float | None
    pose_turn_median_deg: float | None
    seconds: float
    warnings: list[str]
