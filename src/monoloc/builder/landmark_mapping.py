"""Mapping of landmarks: corners that several build frames saw in the same place, and what they can be trusted for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.landmark_evidence import LandmarkEvidence, measure_landmarks, measure_views
from monoloc.builder.landmark_triangulation import corners_of, landmarks_of
from monoloc.fusion.bias_model import BiasModel
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.landmarks.features import KeypointDetector
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.progress import Progress

_MOST_FRAMES = 300  # computation time is quadratic in their number


def build_landmarks(
    recording: Recording, depth_of: Callable[[int], NDArray[np.float32]], progress: Progress
) -> tuple[Landmarks, BiasModel, LandmarkEvidence]:
    """Map the landmarks of a recording, and measure the bias of landmark poses and what their number says.

    At the reference poses, each half of the frames is localised by the landmarks of the other half. Elsewhere,
    the frames of held-out regions are localised by landmarks from all other frames.

    Args:
        recording: posed frames, at least five; if there are more than 300, an even selection of 300 is used.
        depth_of: returns a frame's depth, (H, W) metres, 0 where there is none.
        progress: shows the number of frames done.

    Returns:
        Landmarks, bias and evidence; no landmarks if too few are seen repeatedly to determine poses.
    """
    poses = recording.poses
    assert poses is not None
    detect = KeypointDetector(recording.camera)
    frames = evenly_spaced(len(recording), _MOST_FRAMES)
    poses = poses[frames]
    with progress.task("landmarks", len(frames)) as show:
        corners = []
        for each in corners_of(recording, frames, detect, depth_of):
            corners.append(each)
            show(len(corners))
        measured = measure_landmarks(corners, recording.camera, detect.camera, poses)
        if measured is None:
            return Landmarks.none(), BiasModel(), LandmarkEvidence()
    bias, evidence = measured
    landmarks = landmarks_of(corners, detect.camera, poses)
    views, familiar_found, strange_found = measure_views(landmarks, corners, recording.camera, poses)
    evidence = replace(evidence, familiar_found=familiar_found, strange_found=strange_found)
    return replace(landmarks, views=views), bias, evidence
