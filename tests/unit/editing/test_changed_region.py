"""The region that a run's JSON names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from monoloc.editing.changed_region import read_changed_region
from refusals import refuses_data


def written(folder: Path, body: Any) -> Path:
    path = folder / "run.json"
    path.write_text(body if isinstance(body, str) else json.dumps(body))
    return path


def region(at: float, frames: int) -> dict[str, Any]:
    return {"lower_m": [at, 0.0, 0.0], "upper_m": [at + 1.0, 1.0, 1.0], "frames": frames}


def test_region_that_most_frames_named_is_taken(tmp_path: Path) -> None:
    path = written(tmp_path, {"frames": 9, "changed_regions": [region(1.0, 3), region(5.0, 8)]})
    lower, upper = read_changed_region(path)
    assert lower.tolist() == [5.0, 0.0, 0.0] and upper.tolist() == [6.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("body", "problem", "fix"),
    [
        ({"changed_regions": []}, "names no changed region", "--box"),
        ({"frames": 3}, "changed_regions: Field required", "monoloc localize"),
        (
            {"changed_regions": [{"lower_m": [0, 0], "upper_m": [1, 1, 1], "frames": 2}]},
            "lower_m",
            "monoloc localize",
        ),
        ({"changed_regions": [region(1.0, 3) | {"upper_m": [0, 0, 0]}]}, "without volume", "monoloc localize"),
        ("{", "is no JSON", "monoloc localize"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, body: Any, problem: str, fix: str) -> None:
    path = written(tmp_path, body)
    refuses_data(lambda: read_changed_region(path), path, problem, fix)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    refuses_data(
        lambda: read_changed_region(tmp_path / "no.json"), tmp_path / "no.json", "cannot be read", "localize"
    )
