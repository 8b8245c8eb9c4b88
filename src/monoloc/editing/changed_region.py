"""The region that a localised recording has named as changed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.bundle import digest_of
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.run_json import GIVE_RUN, figures_of, read_run_json

_Corner = tuple[float, float, float]


class _Region(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    lower_m: _Corner
    upper_m: _Corner
    frames: int = Field(ge=1)


class _RunFigures(BaseModel):
    digest: str
    changed_regions: list[_Region]


def read_changed_region(path: Path, bundle: Path) -> tuple[FloatArray, FloatArray]:
    """Corners (3,) each, world frame, metres, of the region that most frames of a run named.

    Args:
        path: JSON of ``monoloc localize``.
        bundle: that it was localised in: other bundles have other worlds, and after an edit the region may be mended.

    Raises:
        DataError: the file is not that, or no frame named a region.
        BundleError: there is no bundle.
    """
    run = figures_of(path, read_run_json(path), _RunFigures)
    if run.digest != digest_of(bundle):
        problem = f"is a run in another bundle than {bundle}, or before its last edit"
        raise DataError(path, problem, "localize in this one again, or give the box: --box")
    if not run.changed_regions:
        raise DataError(path, "names no changed region: no frame was map-changed", "give the box: --box")
    named = max(run.changed_regions, key=lambda region: region.frames)
    lower, upper = np.array(named.lower_m), np.array(named.upper_m)
    if np.any(upper <= lower):
        raise DataError(path, "names a region without volume", GIVE_RUN)
    return lower, upper
