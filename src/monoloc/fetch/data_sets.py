"""Public recordings that :command:`monoloc fetch` knows by name."""

from __future__ import annotations

from dataclasses import dataclass

_SEVEN_SCENES = "https://download.microsoft.com/download/2/8/5/28564B23-0828-408F-8631-23B1EFF1DAC8"
_TUM = "https://cvg.cit.tum.de/rgbd/dataset"


@dataclass(frozen=True)
class DataSet:
    """A recording on the web.

    Attributes:
        title: what it is, and whose.
        terms: page with the terms of use.
        archive: address of a ``.zip`` or ``.tgz``.
        source: SOURCE of the unpacked recording, relative to the folder that the archive is unpacked into.
        sha256: of the archive; None if its publisher states none, so that the first download's is recorded.
    """

    title: str
    terms: str
    archive: str
    source: str
    sha256: str | None = None


def _seven_scenes(name: str) -> DataSet:
    terms = "https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/"
    return DataSet(f"{name} of 7-Scenes, Microsoft", terms, f"{_SEVEN_SCENES}/{name}.zip", f"7scenes:{name}")


def _tum(camera: str, name: str) -> DataSet:
    folder = f"rgbd_dataset_{camera}_{name}"
    terms = "https://cvg.cit.tum.de/data/datasets/rgbd-dataset"
    return DataSet(f"{camera}/{name} of TUM RGB-D", terms, f"{_TUM}/{camera}/{folder}.tgz", f"tum:{folder}")


DATA_SETS = {
    **{name: _seven_scenes(name) for name in ("chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs")},
    **{f"fr1-{name}": _tum("freiburg1", name) for name in ("desk", "room", "rpy")},
    "fr3-office": _tum("freiburg3", "long_office_household"),
}
"""Recordings by name. Neither publisher states checksums."""
