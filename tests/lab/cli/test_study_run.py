"""An interrupted study says how it continues."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from monoloc_lab.cli import study_run


def test_interruption_says_that_the_same_command_continues(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study_run, "carry_out", interrupted)
    with pytest.raises(KeyboardInterrupt):
        study_run.carry_out_shown([], tmp_path, 1, None)
    kept = f"tasks that are done are kept in {tmp_path / 'results'}"
    assert capfd.readouterr().err == f"{kept}; the same command continues with the others\n"
