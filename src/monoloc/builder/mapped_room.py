"""The mapped room: its frames, their poses, the cloud and the mixture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_frames, check_recording
from monoloc.builder.pose_refinement import PosePrior, refine_poses, rounds
from monoloc.builder.room_map import fit_map
from monoloc.bundle import fingerprint
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError
from monoloc.evaluation.trajectory import PoseErrors, pose_errors
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress, Progress


@dataclass(frozen=True)
class MappedRoom:
    """The mapped room, before adaptation.

    Attributes:
        recording: with refined poses, if they were refined.
        poses: of its frames, (N, 4, 4).
        frames: name and fingerprint of each.
        cloud: (N, 3) world frame, metres.
        refinement: how far refinement moved the poses; None without it.
    """

    recording: Recording
    poses: FloatArray
    frames: dict[str, int]
    cloud: FloatArray
    mixture: GaussianMixture
    refinement: PoseErrors | None
    warnings: list[str]


def map_room(
    recording: Recording,
    whole: Recording,
    cloud: FloatArray | None,
    config: BuildConfig,
    model: DepthModel,
    seed: int,
    rng: np.random.Generator,
    progress: Progress,
) -> MappedRoom:
    """Cloud and mixture, of poses that are refined if that is asked for.

    Args:
        whole: recording that the frames were chosen from.
    """
    frames = {name: fingerprint(recording.color(index)) for index, name in enumerate(recording.frame_names)}
    if len(frames) < len(recording):
        raise DataError(recording.name, "has frames of the same name", "give every frame a name of its own")
    cloud_is_given = cloud is not None
    warnings = check_recording(whole, cloud, config, progress)
    cloud, mixture = fit_map(recording, cloud, config, rng, progress)
    warnings += check_frames(recording, cloud, mixture, cloud_is_given, model, np.random.default_rng(seed))
    refinement = None
    if config.refine_poses:
        recording, refinement = _refined(recording, mixture, cloud_is_given, config, rng, progress)
        if not cloud_is_given:
            cloud, mixture = fit_map(recording, None, config, rng, progress)
    assert recording.poses is not None
    return MappedRoom(recording, recording.poses, frames, cloud, mixture, refinement, warnings)


def _refined(
    recording: Recording,
    mixture: GaussianMixture,
    map_is_given: bool,
    config: BuildConfig,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[Recording, PoseErrors]:
    """The recording with poses aligned with the map, and how far they moved."""

    def remap(moved: Recording) -> GaussianMixture:
        return fit_map(moved, None, config, rng, NoProgress())[1]

    prior = PosePrior(config.pose_sd_m, float(np.deg2rad(config.pose_sd_deg)))
    again = None if map_is_given else remap
    with progress.task("refine poses", rounds(again) * len(recording)) as step:
        refined = refine_poses(recording, mixture, again, prior, rng, step)
    assert refined.poses is not None and recording.poses is not None
    return refined, pose_errors(refined.poses, recording.poses)
