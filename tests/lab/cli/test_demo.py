"""``monoloc demo``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_helpers import json_of, python, refused
from monoloc.builder.build_config import BuildConfig
from monoloc.bundle import Bundle
from monoloc.io.recording import Recording
from monoloc_lab.cli import demo
from monoloc_lab.make import demo_bundle
from synthetic_room import room_bundle

LIGHTS = ["L1", "L2", "L3"]


def few_frames(monkeypatch: pytest.MonkeyPatch, build: bool) -> None:
    whole = demo._living(build)
    flights = tuple(replace(flight, frames="0:6") for flight in whole.flights if flight.light == "L3")
    monkeypatch.setattr(demo, "_living", lambda _: replace(whole, flights=flights))


def test_demo_flies_the_shipped_bundle_without_pytorch(tmp_path: Path) -> None:
    """All three lights, but few frames; PyTorch, and what else only builds need, cannot be imported."""
    code = """
import sys
from dataclasses import replace

for name in ("torch", "onnx", "safetensors", "h5py"):
    sys.modules[name] = None
from monoloc.cli.main import invoke
from monoloc_lab.cli import demo

whole = demo._living(build=False)
demo._living = lambda _: replace(whole, flights=tuple(replace(flight, frames="0:3") for flight in whole.flights))
sys.exit(invoke(["demo", "--out", sys.argv[1], "--json"]))
"""
    result = python(code, tmp_path / "out")
    assert result.returncode == 0, result.stderr
    runs = json.loads(result.stdout)["runs"]
    assert [(run["light"], run["adapted"], run["unseen_frames"]) for run in runs] == [
        (name, True, 3) for name in LIGHTS
    ]
    assert max(run["ate_max_m"] for run in runs) < 0.3  # starts are 10 cm off
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {f"{light}-adapted{suffix}" for light in LIGHTS for suffix in (".png", ".txt")}


def test_demo_builds_and_writes_bundles_trajectories_and_plots(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the builds, which the slow test has."""
    few_frames(monkeypatch, build=True)
    bundle = room_bundle(50)
    builds = []

    def build(recording: Recording, config: BuildConfig, *others: Any, network: str) -> tuple[Bundle, None]:
        builds.append((len(recording), config.adapt.tune, config.adapt.map_transform, config.landmarks, network))
        return bundle, None

    monkeypatch.setattr(demo_bundle, "build_bundle", build)
    runs = json_of(capfd, "demo", "--build", "--out", str(tmp_path / "out"))["runs"]
    assert [(run["name"], run["light"], run["adapted"]) for run in runs] == [
        ("L3 unadapted", "L3", False),
        ("L3 adapted", "L3", True),
    ]
    assert builds == [(75, "none", False, False, "one-third-0.35"), (75, "all", True, True, "one-third-0.35")]
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        *("adapted.monoloc", "plain.monoloc", "L3-adapted.png", "L3-adapted.txt"),
        *("L3-unadapted.png", "L3-unadapted.txt"),
    }


def test_absent_recording_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    refused(
        capfd, tmp_path, ("demo", "--data", str(tmp_path)), f"{tmp_path}", "does not exist", "give --data a folder"
    )


@pytest.mark.slow
def test_adaptation_halves_the_error_in_the_living_room(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    result = json_of(capfd, "demo", "--build", "--out", str(tmp_path / "out"))
    runs = result["runs"]
    assert [(run["light"], run["adapted"]) for run in runs] == [(name, a) for name in LIGHTS for a in (False, True)]
    assert result["seconds"] > 0.0
    for run in runs:
        assert run["frames"] == run["unseen_frames"] >= 100
        assert {"name", "ate_median_m", "rot_median_deg", "step_ms_median", "lost_frames", "depth_absrel"} <= set(run)
    # Half in two builds with three starts each; 0.65 at worst in one light.
    unadapted, adapted = (
        np.array([run["ate_median_m"] for run in runs if run["adapted"] == a]) for a in (False, True)
    )
    assert np.all(adapted < unadapted) and adapted.mean() < 0.75 * unadapted.mean()
    for run in runs:
        # 0.64 to 0.70.
        assert not run["adapted"] or run["ate_rmse_m"] < 1.1 * run["odometry_from_start_ate_rmse_m"]
