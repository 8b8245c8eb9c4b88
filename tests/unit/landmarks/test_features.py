"""Keypoints: detected in images of any shape, and matched with landmarks."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc.camera import Camera
from monoloc.landmarks.features import FOCAL_PX, MATCH_BITS, KeypointDetector, match_descriptors


@given(seed=st.integers(0, 2**32 - 1), landmarks=st.integers(0, 25), keypoints=st.integers(0, 25))
@settings(max_examples=60)
def test_matches_are_mutual_nearest_neighbours_within_the_radius(seed: int, landmarks: int, keypoints: int) -> None:
    rng = np.random.default_rng(seed)
    expected, pixels = rng.uniform(0.0, 40.0, (landmarks, 2)), rng.uniform(0.0, 40.0, (keypoints, 2))
    appearances = rng.integers(0, 256, (5, 32)).astype(np.uint8)
    known, seen = (
        appearances[rng.integers(5, size=count)] ^ (rng.uniform(size=(count, 32)) < 0.2).astype(np.uint8)
        for count in (landmarks, keypoints)
    )
    bits = np.unpackbits(known[:, None] ^ seen[None], axis=2).sum(axis=2, dtype=int)
    far = np.abs(expected[:, None] - pixels[None]).max(axis=2) >= 10.0
    bits[far | (bits >= MATCH_BITS)] = 999
    which, where = match_descriptors(expected, known, pixels, seen, 10.0)
    matches = set(zip(which.tolist(), where.tolist(), strict=True))
    assert len(set(which.tolist())) == len(set(where.tolist())) == len(matches) == len(which)
    for landmark, keypoint in matches:
        assert bits[landmark, keypoint] == bits[landmark].min() == bits[:, keypoint].min() < 999
    # None is missing where both have one best match.
    for landmark, keypoint in np.argwhere(bits < 999).tolist():
        least = bits[landmark, keypoint]
        unique = (bits[landmark] <= least).sum() == 1 == (bits[:, keypoint] <= least).sum()
        assert not unique or (landmark, keypoint) in matches


def test_keypoints_are_pixels_of_the_resized_image() -> None:
    """The corners of a bright square, at half the size, are found where they are."""
    image = np.zeros((480, 640, 3), np.uint8)
    cv2.rectangle(image, (240, 180), (399, 299), (200, 200, 200), -1)
    detector = KeypointDetector(Camera(640, 480, 2.0 * FOCAL_PX, 2.0 * FOCAL_PX, 319.5, 239.5))
    assert (detector.camera.width, detector.camera.height) == (320, 240)
    corners = np.array([[119.5, 89.5], [199.5, 89.5], [119.5, 149.5], [199.5, 149.5]])
    distances_px = np.linalg.norm(detector(image).pixels[:, None] - corners[None], axis=2)
    assert np.all(distances_px.min(axis=0) < 3.0)
    assert len(detector(np.zeros((480, 640, 3), np.uint8)).pixels) == 0


@pytest.mark.parametrize(("width", "height", "focal_px"), [(640, 480, 3000.0), (640, 64, 272.0), (90, 70, 60.0)])
def test_images_of_any_shape_have_keypoints(width: int, height: int, focal_px: float) -> None:
    """ORB ignores a margin of 31 pixels, which at the usual focal length would be all of these."""
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 256, (height // 8, width // 8, 3)).astype(np.uint8), (width, height))
    camera = Camera(width, height, focal_px, focal_px, width - 0.5, height / 2.0)  # centre on the image's border
    detector = KeypointDetector(camera)
    found = detector(image)
    assert len(found.pixels) > 15
    assert np.all(found.pixels >= 0.0) and np.all(found.pixels < [detector.camera.width, detector.camera.height])
