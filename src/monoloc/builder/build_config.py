"""Settings of a build."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from monoloc.adapt.settings import AdaptConfig
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
