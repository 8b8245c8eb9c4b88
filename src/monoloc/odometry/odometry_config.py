"""Settings of the visual odometry."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class OdometryConfig(BaseModel):
    """Settings of the visual odometry. Pixels refer to the tracking image, which is ``width`` wide.

    Attributes:
        width: width of the tracking image.
        corners: maximum number of tracked corners.
        min_distance_px: minimum distance between corners.
        search_px: window size of Lucas-Kanade.
        forward_backward_px: maximum distance between a corner and its position after tracking forward and backward.
        reprojection_px: RANSAC's inlier threshold.
        min_inliers, min_inlier_share: minimum number of inliers, and minimum share of inliers among the tracked
            corners; otherwise odometry fails.
        depth_jump: corners within a pixel of a larger relative depth step are not back-projected, because they are at
            an occlusion edge.
        keyframes: number of keyframes in the adjusted window.
        keyframe_motion_px: median motion of corners since the last keyframe that triggers a new keyframe.
        keyframe_share: a new keyframe is also taken when a smaller share of the last keyframe's corners is tracked.
        corner_sd_px: standard deviation of a corner's position.
        log_depth_sd: standard deviation of the logarithm of the depth source, from corner to corner.
        scale_memory: weight of the window's scale in a new keyframe; the rest is the weight of the depth source.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    width: int = Field(320, ge=80, le=4096)
    corners: int = Field(300, ge=20, le=10000)
    min_distance_px: float = Field(7.0, gt=0.0, le=1000.0)
    search_px: int = Field(15, ge=5, le=200)
    forward_backward_px: float = Field(0.7, gt=0.0, le=100.0)
    reprojection_px: float = Field(1.5, gt=0.0, le=100.0)
    min_inliers: int = Field(15, ge=6, le=10000)
    min_inlier_share: float = Field(0.4, ge=0.0, le=1.0)
    depth_jump: float = Field(0.15, gt=0.0, le=10.0)
    keyframes: int = Field(12, ge=2, le=200)
    keyframe_motion_px: float = Field(10.0, gt=0.0, le=1000.0)
    keyframe_share: float = Field(0.75, gt=0.0, le=1.0)
    corner_sd_px: float = Field(0.7, ge=1e-3, le=100.0)
    log_depth_sd: float = Field(0.3, ge=1e-3, le=10.0)
    scale_memory: float = Field(0.95, ge=0.0, le=1.0)
