"""The native core refuses arrays whose lengths disagree, whoever calls it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import monoloc._core as core

POINTS, SCAN = np.zeros((7, 3)), np.ones((5, 3), np.float32)
MIXTURE = np.array([0.5, 0.5]), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
POSES, LOG_SCALES = np.tile(np.eye(4), (3, 1, 1)), np.zeros(3)
PIXELS, DESCRIPTORS = np.zeros((4, 2)), np.zeros((4, 32), np.uint8)
RAYS, DEPTHS = np.zeros((7, 3, 2)), np.zeros((7, 3))
STAGES, OF_STAGES = np.ones((3, 4), np.float32), np.ones((2, 3, 4), np.float32)
IMAGES, FEWER = np.zeros((2, 8, 8, 4), np.uint16), np.zeros((2, 8, 7, 4), np.uint16)


def weigh_by_index(log_scales: np.ndarray, weights: np.ndarray | None) -> None:
    core.MixtureIndex(*MIXTURE, 0.1, 1e-9, 1e-3).weigh(POSES, log_scales, SCAN, weights, 0.3, 100.0)


def weigh_by_rays(log_scales: np.ndarray, weights: np.ndarray | None) -> None:
    core.RayMixture(*MIXTURE).weigh(POSES, log_scales, SCAN, weights, 0.1, 0.3, 3.0)


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: core.log_density(POINTS, MIXTURE[0][:1], *MIXTURE[1:]), "number of components"),
        (lambda: core.expectation(POINTS, *MIXTURE[:2], MIXTURE[2][:1]), "number of components"),
        (lambda: core.MixtureIndex(MIXTURE[0], MIXTURE[1][:1], MIXTURE[2], 0.1, 1e-9, 1e-3), "number of components"),
        (lambda: core.RayMixture(MIXTURE[0], MIXTURE[1][:1], MIXTURE[2]), "number of components"),
        (lambda: weigh_by_index(LOG_SCALES[:2], None), "log_scales"),
        (lambda: weigh_by_index(LOG_SCALES, np.ones(4, np.float32)), "point_weights"),
        (lambda: weigh_by_rays(LOG_SCALES[:2], None), "log_scales"),
        (lambda: weigh_by_rays(LOG_SCALES, np.ones(4, np.float32)), "point_weights"),
        (lambda: core.max_pool(IMAGES, 1, FEWER, IMAGES.copy()), "largest"),
        (lambda: core.max_pool(IMAGES, 1, IMAGES.copy(), FEWER), "from_"),
        (lambda: core.max_pool_gradient(IMAGES, FEWER, 1, IMAGES.copy()), "from_"),
        (lambda: core.max_pool_gradient(IMAGES, IMAGES, 1, FEWER), "out"),
        (lambda: core.chain_pools(IMAGES, STAGES[:, :3], 1, IMAGES.copy()), "weights"),
        (lambda: core.chain_pools(IMAGES, STAGES[:0], 1, IMAGES.copy()), "weights"),
        (lambda: core.chain_pools(IMAGES, STAGES, 1, FEWER), "out"),
        (lambda: core.chain_pools_gradient(IMAGES, FEWER, STAGES, 1, IMAGES.copy(), OF_STAGES), "gradient"),
        (lambda: core.chain_pools_gradient(IMAGES, IMAGES, STAGES, 1, FEWER, OF_STAGES), "out"),
        (lambda: core.chain_pools_gradient(IMAGES, IMAGES, STAGES, 1, IMAGES.copy(), OF_STAGES[:1]), "of_weights"),
        (
            lambda: core.draw_points(
                POINTS,
                np.eye(4),
                np.ones(12),
                False,
                np.ones(4),
                0.0,
                np.zeros((4, 5), np.uint32),
                np.zeros((4, 4), np.float32),
            ),
            "front and depth",
        ),
        (lambda: core.match_descriptors(PIXELS, DESCRIPTORS[:3], PIXELS, DESCRIPTORS, 9.0, 64), "expected and known"),
        (lambda: core.nearest_descriptors(DESCRIPTORS, DESCRIPTORS, len(DESCRIPTORS) + 1, 64), "kept must be at"),
        (lambda: core.match_descriptors(PIXELS, DESCRIPTORS, PIXELS[:3], DESCRIPTORS, 9.0, 64), "pixels and desc"),
        (lambda: core.fit_pose(POINTS, PIXELS, PIXELS, np.eye(4), np.eye(6), np.ones(1), 0.1), "points, rays and sd"),
        (
            lambda: core.leverages(POINTS[:4], PIXELS, PIXELS, np.eye(4), np.eye(6), np.ones(3), 0.1),
            "points, rays, sd and weights",
        ),
        (
            lambda: core.fit_log_focal(POINTS[:4], PIXELS, PIXELS[:3], np.eye(4), np.eye(7), np.ones(1), 0.1),
            "points, rays and sd",
        ),
        (
            lambda: core.fit_log_aspect(POINTS[:4], PIXELS, PIXELS[:3], np.eye(4), np.eye(8), np.ones(1), 0.1),
            "points, rays and sd",
        ),
        (
            lambda: core.fit_pose(POINTS[:4], PIXELS, PIXELS, np.eye(4), np.eye(6), np.ones(0), 0.1),
            "kernel_sds",
        ),
        (lambda: core.adjust_window(POSES, POINTS, RAYS[:6], DEPTHS, 0.1, 0.1, 3), "points, rays and log_depth"),
        (lambda: core.adjust_window(POSES, POINTS, RAYS, DEPTHS[:6], 0.1, 0.1, 3), "points, rays and log_depth"),
        (lambda: core.adjust_window(POSES[:2], POINTS, RAYS, DEPTHS, 0.1, 0.1, 3), "poses, rays and log_depth"),
        (lambda: core.adjust_window(POSES, POINTS, RAYS, DEPTHS[:, :2], 0.1, 0.1, 3), "poses, rays and log_depth"),
    ],
)
def test_lengths_that_disagree_are_refused(call: Callable[[], object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        call()


def test_lengths_that_agree_are_taken() -> None:
    weigh_by_index(LOG_SCALES, np.ones(5, np.float32))
    weigh_by_rays(LOG_SCALES, None)
