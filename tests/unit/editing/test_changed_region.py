"""The region that a run's JSON names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from monoloc.bundle import MANIFEST, digest_of
from monoloc.editing.changed_region import read_changed_region
from refusals import refuses_data


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """As much of a bundle as identifies it."""
    (tmp_path / "room.monoloc").mkdir()
    (tmp_path / "room.monoloc" / MANIFEST).write_text("{}")
    return tmp_path / "room.monoloc"


def written(bundle: Path, body: Any) -> Path:
    """A run's JSON, that of a run in the bundle unless it says otherwise."""
    path = bundle.with_name("run.json")
    if isinstance(body, dict):
        body = {"digest": digest_of(bundle), **body}
    path.write_text(body if isinstance(body, str) else json.dumps(body))
    return path


def region(at: float, frames: int) -> dict[str, Any]:
    return {"lower_m": [at, 0.0, 0.0], "upper_m": [at + 1.0, 1.0, 1.0], "frames": frames}


def test_region_that_most_frames_named_is_taken(bundle: Path) -> None:
    path = written(bundle, {"frames": 9, "changed_regions": [region(1.0, 3), region(5.0, 8)]})
    lower, upper = read_changed_region(path, bundle)
    assert lower.tolist() == [5.0, 0.0, 0.0] and upper.tolist() == [6.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("body", "problem", "fix"),
    [
        ({"changed_regions": []}, "names no changed region", "--box"),
        ({"frames": 3}, "changed_regions: is missing", "monoloc localize"),
        (
            {"changed_regions": [{"lower_m": [0, 0], "upper_m": [1, 1, 1], "frames": 2}]},
            "lower_m",
            "monoloc localize",
        ),
        ({"changed_regions": [region(1.0, 3) | {"upper_m": [0, 0, 0]}]}, "without volume", "monoloc localize"),
        ("{", "is no JSON", "monoloc localize"),
        (
            {"digest": "0", "changed_regions": [region(1.0, 3)]},
            "another bundle than .*room.monoloc",
            "in this one again",
        ),
        (json.dumps({"changed_regions": []}), "digest: is missing", "monoloc localize"),
    ],
)
def test_other_files_are_refused(bundle: Path, body: Any, problem: str, fix: str) -> None:
    path = written(bundle, body)
    refuses_data(lambda: read_changed_region(path, bundle), path, problem, fix)


def test_missing_file_is_refused(bundle: Path) -> None:
    path = bundle.with_name("no.json")
    refuses_data(lambda: read_changed_region(path, bundle), path, "cannot be read", "localize")
