"""The hash of the source that a result depends on."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from monoloc_lab.experiments import source_version

KINDS = ("work_rooms", "work_runs", "work_posenets")


@pytest.mark.slow
def test_hash_covers_imported_modules_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    roots = {}
    for name, root in source_version._ROOTS.items():
        roots[name] = tmp_path / name
        shutil.copytree(root, roots[name], ignore=shutil.ignore_patterns("living", "*.onnx", "*.so"))
    (tmp_path / "_core.so").touch()
    monkeypatch.setattr(source_version, "_ROOTS", roots)
    monkeypatch.setattr(source_version._core, "__file__", str(tmp_path / "_core.so"))

    def hashes() -> list[str]:
        compute = source_version.source_sha256.__wrapped__  # as another process computes it
        return [compute(f"monoloc_lab.experiments.{kind}") for kind in KINDS]

    for name, expected in {
        "monoloc/__init__.py": (True, True, True),
        "_core.so": (True, True, True),
        "monoloc/io/tum_recording.py": (True, True, True),
        "monoloc/adapt/__init__.py": (True, False, True),
        "monoloc/adapt/tuning.py": (True, False, False),  # imported within a function
        "monoloc/fusion/bias_filter.py": (True, True, False),
        "monoloc_lab/experiments/work_runs.py": (False, True, False),
        "monoloc_lab/baselines/posenet_training.py": (False, False, True),
        "monoloc_lab/experiments/tasks.py": (False, False, False),
        "monoloc_lab/experiments/fig1.py": (False, False, False),
        "monoloc/cli/main.py": (False, False, False),
        "monoloc/viz/viewer.py": (False, False, False),
        "monoloc/viz/rerun_viewer.py": (False, False, False),
    }.items():
        before = hashes()
        with (tmp_path / name).open("a") as file:
            file.write("\n")
        assert tuple(one != other for one, other in zip(hashes(), before, strict=True)) == expected, name
