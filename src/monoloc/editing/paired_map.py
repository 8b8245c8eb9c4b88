"""The map of a bundle as pairs of components: as the room is, and as the network sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle, CloudSize
from monoloc.geometry import FloatArray
from monoloc.map.em import FLOOR_M, clamp_covariances
from monoloc.map.learnt_transform import LearntTransform
from monoloc.map.local_fit import Components, estimated_points

_VOXEL_M = 0.03  # of builds that did not note theirs: the default


def cloud_of(bundle: Bundle) -> CloudSize:
    """The cloud that a bundle's map stands for, estimated from the map's area where the bundle did not note it."""
    if bundle.cloud is not None:
        return bundle.cloud
    return CloudSize(points=estimated_points(bundle.original, _VOXEL_M), voxel_m=_VOXEL_M)


@dataclass(frozen=True)
class PairedMap:
    """Components of equal index of the original and the adapted map.

    Attributes:
        original, adapted: K components each, of the same mass.
        transform: from one to the other; None where both are the same.
        voxel_m: edge of the voxels whose points are the unit of mass.
    """

    original: Components
    adapted: Components
    transform: LearntTransform | None
    voxel_m: float

    @classmethod
    def of(cls, bundle: Bundle) -> PairedMap:
        cloud = cloud_of(bundle)
        original, adapted = (Components.of(each, cloud.points) for each in (bundle.original, bundle.adapted))
        return cls(original, adapted, bundle.transform, cloud.voxel_m)

    def __len__(self) -> int:
        return len(self.original)

    @property
    def components_a_point(self) -> float:
        """Density of components, as what is added shall have it."""
        return len(self.original) / float(self.original.mass.sum())

    def select(self, chosen: NDArray[np.bool_]) -> PairedMap:
        """Some of the components (K,)."""
        return replace(self, original=self.original[chosen], adapted=self.adapted[chosen])

    def with_new(self, new: Components) -> PairedMap:
        """With components of the original map added; the learnt transform adapts them.

        Their adapted moments are those of the transformed component.
        """
        adapted = new
        if self.transform is not None and len(new):
            means, covariances = self.transform.moments(new.means, new.covariances)
            adapted = Components(new.mass, means, clamp_covariances(covariances, FLOOR_M))
        return replace(self, original=self.original + new, adapted=self.adapted + adapted)

    def on(self, bundle: Bundle) -> Bundle:
        """The bundle with this map."""
        points = max(1, round(float(self.original.mass.sum())))
        return replace(
            bundle,
            original=self.original.mixture(),
            adapted=self.adapted.mixture(),
            cloud=CloudSize(points=points, voxel_m=self.voxel_m),
        )


def down_direction(bundle: Bundle) -> FloatArray:
    """Down, (3,) unit vector, world frame: of the room's surfaces, or of the build's cameras."""
    down = bundle.down if bundle.down is not None else np.asarray(bundle.provenance.down_world, dtype=np.float64)
    length = float(np.linalg.norm(down))
    return down / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
