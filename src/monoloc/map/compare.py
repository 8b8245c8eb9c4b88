"""Comparison of an adapted map with the original map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.map.kmeans import nearest
from monoloc.map.mixture import GaussianMixture


@dataclass(frozen=True)
class MapChange:
    """Change of a map's components by adaptation. The attributes are JSON keys of ``monoloc build``.

    Attributes:
        shift_median_m, shift_p95_m: distance between the means of matching components.
        correspondence_share: share of components whose nearest mean in the other map is that of the matching
            component, which Goldberger's approximation of the divergence assumes.
        size_ratio_median: median ratio of the geometric mean axis length of matching components, adapted to original.
    """

    shift_median_m: float
    shift_p95_m: float
    correspondence_share: float
    size_ratio_median: float


def compare_maps(original: GaussianMixture, adapted: GaussianMixture) -> MapChange:
    """Compare two maps in which components of equal index match.

    Raises:
        ValueError: the numbers of components differ.
    """
    if len(original) != len(adapted):
        raise ValueError(f"maps must have the same components, got {len(original)} and {len(adapted)}")
    shift = np.linalg.norm(adapted.means - original.means, axis=1)
    log_volumes = [np.linalg.slogdet(mixture.covariances)[1] / 2.0 for mixture in (original, adapted)]
    return MapChange(
        shift_median_m=float(np.median(shift)),
        shift_p95_m=float(np.percentile(shift, 95.0)),
        correspondence_share=float(np.mean(nearest(original.means, adapted.means) == np.arange(len(original)))),
        size_ratio_median=float(np.exp(np.median(log_volumes[1] - log_volumes[0]) / 3.0)),
    )
