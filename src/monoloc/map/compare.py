"""How far an adapted map is from the one it came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.map.kmeans import nearest
from monoloc.map.mixture import GaussianMixture


@dataclass(frozen=True)
class MapChange:
    """What adaptation did to a map's components; JSON keys of ``monoloc build``.

    Attributes:
        shift_median_m, shift_p95_m: distance from a component's mean to that of its match.
        correspondence_kept: share of components whose nearest mean in the other map is their match's: what
            Goldberger's form of the divergence takes for granted.
        size_ratio_median: geometric mean of a component's axes over its match's, the median of all.
    """

    shift_median_m: float
    shift_p95_m: float
    correspondence_kept: float
    size_ratio_median: float


def compare_maps(original: GaussianMixture, adapted: GaussianMixture) -> MapChange:
    """Compare two maps whose components correspond, component i with component i.

    Raises:
        ValueError: not equally many components.
    """
    if len(original) != len(adapted):
        raise ValueError(f"maps must have the same components, got {len(original)} and {len(adapted)}")
    shift = np.linalg.norm(adapted.means - original.means, axis=1)
    log_volumes = [np.linalg.slogdet(mixture.covariances)[1] / 2.0 for mixture in (original, adapted)]
    return MapChange(
        shift_median_m=float(np.median(shift)),
        shift_p95_m=float(np.percentile(shift, 95.0)),
        correspondence_kept=float(np.mean(nearest(original.means, adapted.means) == np.arange(len(original)))),
        size_ratio_median=float(np.exp(np.median(log_volumes[1] - log_volumes[0]) / 3.0)),
    )
