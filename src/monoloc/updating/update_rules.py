"""When a map may learn from a flight, and when what it has learnt may change the map."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class UpdateRules(BaseModel):
    """Rules of an update; chosen on RedKitchen 0:200 and by reason, not on the figures that are reported.

    Attributes:
        least_tracking_share: share of a flight's frames that must be *tracking* or *map-changed*.
        least_views: usable frames that a flight must have.
        least_witnesses: landmarks outside of the changed region that must agree with a frame's pose.
        least_familiar_share: of the share of familiar landmarks that the build found, at least found in a frame,
            outside of the changed region.
        apart_m: pose distance between usable frames: nearer ones err alike.
        least_flights: in a row that must show a change.
        prior_odds: that one landmark or voxel has changed, before anything was seen.
        least_odds: posterior odds from which on a change is proposed.
        most_nats: evidence that one flight may give, so that no single flight decides.
        gone_seen, there_seen: share of views in which a voxel looks gone if it is, and if it is not.
        voxel_m: edge of the voxels of surfaces.
        most_point_sd_m: of a depth point that may show a new surface.
        least_voxels, least_landmarks: that a proposal must have; scattered landmarks are proposed together.
        most_landmarks: of a map, up to which new ones are added; in one that has more, as many as are retired.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    least_tracking_share: float = Field(0.5, ge=0.0, le=1.0)
    least_views: int = Field(5, ge=1)
    least_witnesses: int = Field(20, ge=15)
    least_familiar_share: float = Field(0.5, ge=0.0, le=1.0)
    apart_m: float = Field(0.05, gt=0.0)
    least_flights: int = Field(2, ge=1)
    prior_odds: float = Field(0.01, gt=0.0)
    least_odds: float = Field(10.0, gt=0.0)
    most_nats: float = Field(4.0, gt=0.0)
    gone_seen: float = Field(0.8, gt=0.0, lt=1.0)
    there_seen: float = Field(0.05, gt=0.0, lt=1.0)
    voxel_m: float = Field(0.15, ge=0.1, le=0.2)
    most_point_sd_m: float = Field(0.1, gt=0.0)
    least_voxels: int = Field(3, ge=1)
    least_landmarks: int = Field(5, ge=1)
    most_landmarks: int = Field(7500, ge=1)
