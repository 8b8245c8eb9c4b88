"""The components of a localizer; each is a protocol and can be replaced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPredictor, DepthSource
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import LandmarkLocalizer, NoLandmarks
from monoloc.likelihood import make_likelihood
from monoloc.likelihood.protocol import ScanLikelihood
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.motion import Odometry
from monoloc.odometry.visual import VisualOdometry


@dataclass(frozen=True)
class Components:
    """Components of one localizer. They keep state of a flight, so no two localizers may share them.

    Attributes:
        depth: predicts the depth of a colour image.
        odometry: measures the camera's motion by its images; None for a random walk.
        likelihood: the likelihood of a scan under the map.
        landmarks: measures the pose by landmarks.
    """

    depth: DepthSource
    odometry: Odometry | None
    likelihood: ScanLikelihood
    landmarks: LandmarkLocalizer[Any] = field(default_factory=NoLandmarks)


ComponentsFactory = Callable[[Bundle, Camera, LocalizerConfig], Components]
"""Makes the components for one localizer, of a bundle, for a camera, with settings."""


def default_components(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
    """The bundle's network, map and landmarks, and visual odometry.

    Raises:
        DataError: the bundle's network does not take the camera's images.
    """
    return Components(
        depth=DepthPredictor(bundle.depth_model, camera),
        odometry=VisualOdometry(camera, config.odometry) if config.motion == "visual" else None,
        likelihood=make_likelihood(bundle.adapted, config.likelihood),
        landmarks=OrbLandmarkLocalizer(bundle.landmarks, camera) if len(bundle.landmarks) else NoLandmarks(),
    )
