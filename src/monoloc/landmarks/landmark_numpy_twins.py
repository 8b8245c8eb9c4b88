"""NumPy twins of the native kernels of landmarks: readable reference implementations for tests.

Tests check that ``monoloc._core`` gives the same results.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert, make_pose, ray_twist_jacobian, se3_exp, se3_log, transform

_MOST_FITS = 4  # of a pose to the landmarks that agree with it
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


def match_descriptors(
    expected: FloatArray,
    known: NDArray[np.uint8],
    pixels: FloatArray,
    descriptors: NDArray[np.uint8],
    radius_px: float,
    most_bits: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """As :func:`monoloc.landmarks.features.match_descriptors`, of descriptors that differ by fewer than some bits."""
    by_x = np.argsort(pixels[:, 0], kind="stable")
    first, last = (np.searchsorted(pixels[by_x, 0], expected[:, 0] + side * radius_px) for side in (-1.0, 1.0))
    counts = last - first
    which = np.repeat(np.arange(len(expected)), counts)
    where = by_x[np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts - first, counts)]
    is_near = np.abs(expected[which, 1] - pixels[where, 1]) < radius_px
    which, where = which[is_near], where[is_near]
    bits = _ONES[known[which] ^ descriptors[where]].sum(axis=1, dtype=np.int64)
    matches = bits < most_bits
    which, where, bits = which[matches], where[matches], bits[matches]
    order = np.argsort(bits, kind="stable")
    first_which, first_where = np.full(len(expected), -1), np.full(len(pixels), -1)
    first_which[which[order[::-1]]] = order[::-1]  # the last to be written is the best match
    first_where[where[order[::-1]]] = order[::-1]
    both = np.flatnonzero(
        (first_which[which] == np.arange(len(which))) & (first_where[where] == np.arange(len(which)))
    )
    return which[both], where[both]


def nearest_descriptors(
    descriptors: NDArray[np.uint8], known: NDArray[np.uint8], kept: int, most_bits: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """As :func:`monoloc.landmarks.features.nearest_descriptors`."""
    bits = _ONES[descriptors[:, None] ^ known].sum(axis=2, dtype=np.int32)
    nearest = np.argsort(bits, axis=1, kind="stable")[:, :kept]
    bits = np.take_along_axis(bits, nearest, axis=1)
    counts = bits < most_bits
    return np.where(counts, bits, 257).astype(np.int32), np.where(counts, nearest, 0)


def fit_pose(
    points: FloatArray,
    rays: FloatArray,
    sd: FloatArray,
    prior: FloatArray,
    information: FloatArray,
    kernel_sds: FloatArray,
    nearest_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pose from landmarks (M, 3), world frame, seen as rays, of which some are wrong matches: Gauss-Newton.

    Args:
        rays, sd: (M, 2) image coordinates at z = 1, and their standard deviations.
        prior, information: ``T_world_camera``, (4, 4), and the inverse covariance of its twist, (6, 6).
        kernel_sds: (S,) standard deviations at which a landmark's weight is a quarter, one of each step.
        nearest_m: depth of a landmark, at least.

    Returns:
        The pose, (4, 4), and there, with the last kernel and without the prior: normal matrix (6, 6) and gradient
        (6,) of its twist, and weights (M,) of the landmarks.
    """
    pose = prior
    for kernel_sd in kernel_sds:
        normal, gradient, _ = _normal_equations(pose, points, rays, sd, kernel_sd, nearest_m)
        offset = se3_log(invert(prior) @ pose)
        pose = pose @ se3_exp(-np.linalg.solve(normal + information, gradient + information @ offset))
    return pose, *_normal_equations(pose, points, rays, sd, kernel_sds[-1], nearest_m)


def leverages(
    points: FloatArray,
    rays: FloatArray,
    sd: FloatArray,
    pose: FloatArray,
    covariance: FloatArray,
    weights: FloatArray,
    nearest_m: float,
) -> FloatArray:
    """By how much each landmark determines a pose that is fitted to all, (M,).

    The trace of its part of the hat matrix (Rousseeuw and Leroy, *Robust Regression and Outlier Detection*, 1987):
    between 0 and 2, since it has two coordinates, and 6 in all.

    Args:
        covariance: (6, 6) of the pose's twist by all landmarks.
        weights: (M,), as of the fit.
    """
    _, jacobian = _residuals(pose, points, rays, sd, nearest_m)
    return np.asarray(weights * np.einsum("mri,ij,mrj->m", jacobian, covariance, jacobian))


def fit_lens(
    points: FloatArray,
    rays: FloatArray,
    sd: FloatArray,
    pose: FloatArray,
    information: FloatArray,
    kernel_sds: FloatArray,
    nearest_m: float,
) -> tuple[float, float]:
    """Logarithm of a true over a stated property of the lens, and its standard deviation, from landmarks (M, 3).

    With seven unknowns, of the focal length; with eight, of the aspect: the focal length along y over that along x,
    fitted together with the focal length. The residuals of a wrong focal length grow with the radius; a step along
    the view takes up a part of them. So pose and lens are estimated together, again from a wide kernel, since
    landmarks that agreed with a wrong lens are near the centre.

    Args:
        pose, information: prior ``T_world_camera``, (4, 4), and the inverse covariance of its twist and of the
            logarithms, (7, 7) or (8, 8).
    """
    start, logarithms = pose, np.zeros(len(information) - 6)
    # What each does to a ray's x and y.
    effect = np.array([[1.0, 1.0], [0.0, 1.0]])[: len(logarithms)]
    for kernel_sd in kernel_sds:
        shrink = np.exp(-logarithms @ effect)  # a ray is a pixel over the focal length, and so is its deviation
        residuals, jacobian = _residuals(pose, points, shrink * rays, shrink * sd, nearest_m)
        by_logarithms = (residuals + rays / sd)[..., None] * effect.T
        columns = np.concatenate([jacobian, by_logarithms], axis=2).reshape(-1, len(information))
        weighted = columns * np.repeat(_weights(residuals, kernel_sd), 2)[:, None]
        normal = weighted.T @ columns + information
        offset = np.append(se3_log(invert(start) @ pose), logarithms)
        step = -np.linalg.solve(normal, weighted.T @ residuals.ravel() + information @ offset)
        pose, logarithms = pose @ se3_exp(step[:6]), logarithms + step[6:]
    return float(logarithms[-1]), float(np.sqrt(np.linalg.inv(normal)[-1, -1]))


def _normal_equations(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, kernel_sd: float, nearest_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrix (6, 6) and gradient (6,) of the pose's twist, and weights (M,) of the points."""
    residuals, jacobian = _residuals(pose, points, rays, sd, nearest_m)
    weights = _weights(residuals, kernel_sd)
    flat = jacobian.reshape(-1, 6)
    weighted = flat * np.repeat(weights, 2)[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel(), weights


def _weights(residuals: FloatArray, kernel_sd: float) -> FloatArray:
    """Geman-McClure weights (M,) of residuals (M, 2) in standard deviations."""
    return np.asarray((1.0 + np.sum(residuals**2, axis=1) / kernel_sd**2) ** -2)


def _residuals(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, nearest_m: float
) -> tuple[FloatArray, FloatArray]:
    """Residuals (M, 2) in standard deviations, and their derivative by the pose's twist, (M, 2, 6)."""
    local = transform(invert(pose), points)
    local[:, 2] = np.maximum(local[:, 2], nearest_m)
    return (local[:, :2] / local[:, 2:] - rays) / sd, ray_twist_jacobian(local) / sd[..., None]


def find_consensus(
    points: FloatArray,
    rays: FloatArray,
    sd: FloatArray,
    nearest_m: float,
    most_sd: float,
    most_triples: int,
    confidence: float,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Pose that most of N matched landmarks agree with, without a prior: RANSAC over triples (Fischler, Bolles 1981).

    A pose that more landmarks agree with than before is fitted to them, as long as that makes them more (Chum et al.,
    *Locally Optimized RANSAC*, 2003): three noisy landmarks seldom lead to a pose that all right ones agree with.

    Args:
        points: (N, 3) world frame.
        rays, sd: (N, 2) image coordinates at z = 1, and their standard deviations.
        nearest_m: depth of a landmark that agrees, at least.
        most_sd: standard deviations within which a landmark agrees.
        most_triples: that are drawn, at most.
        confidence: probability with which one of agreeing landmarks is to be drawn.

    Returns:
        ``T_world_camera``, (4, 4), and the indices (A,) of the landmarks that agree with it; zeros and
        no indices without one.
    """
    best, agreeing = np.zeros((4, 4)), np.zeros(0, dtype=np.int64)
    if len(points) < 3:
        return best, agreeing
    directions = np.column_stack([rays, np.ones(len(rays))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def agreeing_with(pose: FloatArray) -> NDArray[np.int64]:
        local = transform(invert(pose), points)
        offsets = (local[:, :2] - rays * local[:, 2:]) / sd
        agree = (local[:, 2] > nearest_m) & (np.sum(offsets**2, axis=1) < (most_sd * local[:, 2]) ** 2)
        return np.flatnonzero(agree)

    numbers = _splitmix64()
    drawn, wanted = 0, float(most_triples)
    while drawn < wanted:
        drawn += 1
        triple = _triple(numbers, len(points))
        for pose in poses_of_triple(points[triple], directions[triple]):
            those, fits = agreeing_with(pose), 0
            while len(those) > len(agreeing):
                best, agreeing, fits = pose, those, fits + 1
                if fits > _MOST_FITS or len(those) < 3:
                    break
                seen = points[those], rays[those], sd[those]
                pose = fit_pose(*seen, pose, np.eye(6), np.array([most_sd, most_sd]), nearest_m)[0]
                those = agreeing_with(pose)
            if fits:
                share = (len(agreeing) / len(points)) ** 3
                wanted = min(wanted, np.log1p(-confidence) / np.log1p(-share) if share < 1.0 else 0.0)
    return (best, agreeing) if len(agreeing) >= 3 else (np.zeros((4, 4)), agreeing[:0])


def poses_of_triple(points: FloatArray, directions: FloatArray) -> list[FloatArray]:
    """``T_world_camera`` (4, 4) of every camera that sees points (3, 3) in directions (3, 3), unit vectors.

    Grunert's equation of 1841, as in Haralick et al., *Review and Analysis of Solutions of the Three Point
    Perspective Pose Estimation Problem* (IJCV 1994).
    """
    a2, b2, c2 = (float(np.sum((points[i] - points[j]) ** 2)) for i, j in ((1, 2), (0, 2), (0, 1)))
    if min(a2, b2, c2) == 0.0 or not np.all(np.isfinite(directions)):
        return []
    cos_a, cos_b, cos_c = (float(directions[i] @ directions[j]) for i, j in ((1, 2), (0, 2), (0, 1)))
    a, c = a2 / b2, c2 / b2
    k = a - c
    quartic = [
        (k - 1) ** 2 - 4 * c * cos_a**2,
        4 * (k * (1 - k) * cos_b - (1 - a - c) * cos_a * cos_c + 2 * c * cos_a**2 * cos_b),
        2 * (k**2 - 1 + 2 * k**2 * cos_b**2 + 2 * (1 - c) * cos_a**2)
        + 4 * ((1 - a) * cos_c**2 - 2 * (a + c) * cos_a * cos_b * cos_c),
        4 * (-k * (1 + k) * cos_b + 2 * a * cos_c**2 * cos_b - (1 - a - c) * cos_a * cos_c),
        (1 + k) ** 2 - 4 * a * cos_c**2,
    ]
    roots = np.roots(quartic)
    poses = []
    for v in np.sort(roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]):  # of poses as good, the first counts
        u = ((k - 1) * v**2 - 2 * k * cos_b * v + 1 + k) / (2 * (cos_c - v * cos_a))
        if v > 0.0 and u > 0.0:
            first = np.sqrt(b2 / (1 + v**2 - 2 * v * cos_b))
            poses.append(_aligned(directions * (first * np.array([1.0, u, v]))[:, None], points))
    return poses


def _aligned(there: FloatArray, here: FloatArray) -> FloatArray:
    """Rigid motion (4, 4) that takes three points there, (3, 3), to three points here."""
    axes = []
    for corners in (there, here):
        first, second = corners[1:] - corners[0]
        x, z = first / np.linalg.norm(first), np.cross(first, second)
        z = z / np.linalg.norm(z)
        axes.append(np.column_stack([x, np.cross(z, x), z]))
    rotation = axes[1] @ axes[0].T
    return make_pose(rotation, here[0] - rotation @ there[0])


def _splitmix64() -> Iterator[int]:
    """Pseudorandom 64-bit numbers (Steele, Lea and Flood, *Fast Splittable Pseudorandom Number Generators*, 2014)."""
    state, most = 0, 2**64 - 1
    while True:
        state = z = (state + 0x9E3779B97F4A7C15) & most
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & most
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB & most
        yield z ^ (z >> 31)


def _triple(numbers: Iterator[int], count: int) -> list[int]:
    """Three different indices below a count; those that repeat an earlier one are drawn again."""
    triple = [next(numbers) % count for _ in range(3)]
    for i in (1, 2):
        while triple[i] in triple[:i]:
            triple[i] = next(numbers) % count
    return triple
