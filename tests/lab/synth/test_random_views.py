"""Training sets of random views."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.io.registry import open_recording
from monoloc.progress import NoProgress, Step
from monoloc_lab.synth import random_views
from monoloc_lab.synth.random_views import render_views
from rendered_room import windowed_room

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitsuba") is None, reason='rendering needs Mitsuba: pip install "./lab[synth]"'
    ),
]


class RecordedProgress(NoProgress):
    """Keeps the reported steps."""

    def __init__(self) -> None:
        self.steps: list[int] = []

    @contextmanager
    def task(self, name: str, total: int | None, alike: bool = True) -> Iterator[Step]:
        yield lambda done, remark="": self.steps.append(done)


def test_views_are_pairs_and_continue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(random_views, "generate_room", lambda seed: windowed_room())
    progress = RecordedProgress()
    render_views(rooms=2, views=1, samples=2, seed=0, out=tmp_path, progress=progress)
    assert progress.steps == [1, 2]
    pairs = open_recording(f"folder:{tmp_path}")
    assert len(pairs) == 2 and pairs.poses is None
    for index in range(2):
        assert 40.0 < pairs.color(index).mean() < 220.0
        assert np.median(pairs.depth(index)) > 1.0
    before = (tmp_path / "color" / "000000.jpg").stat().st_mtime_ns
    (tmp_path / "depth" / "000001.png").unlink()
    progress = RecordedProgress()
    render_views(rooms=2, views=1, samples=2, seed=0, out=tmp_path, progress=progress)
    assert progress.steps == [2]
    assert (tmp_path / "color" / "000000.jpg").stat().st_mtime_ns == before
    assert (tmp_path / "depth" / "000001.png").is_file()
    for other in ({"seed": 1}, {"samples": 3}, {"views": 2}):
        with pytest.raises(DataError, match="has a rendering with other settings; name another folder"):
            render_views(
                **{"rooms": 2, "views": 1, "samples": 2, "seed": 0, **other}, out=tmp_path, progress=NoProgress()
            )
    render_views(rooms=1, views=1, samples=2, seed=0, out=tmp_path, progress=NoProgress())


def test_progress_counts_views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(random_views, "generate_room", lambda seed: windowed_room())
    progress = RecordedProgress()
    render_views(rooms=1, views=2, samples=1, seed=0, out=tmp_path, progress=progress)
    assert progress.steps == [1, 2]
