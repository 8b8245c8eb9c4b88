"""``monoloc bench``: JSON keys, plausible values, and refusals. No test depends on the speed of the machine."""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from cli_helpers import json_of, python, refused, succeeds
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.config import override
from monoloc_lab.bench import kernels, scaling, timing, tuning_steps
from monoloc_lab.bench.fitting import FitSizes
from monoloc_lab.bench.kernels import KernelSizes
from monoloc_lab.bench.scaling import ScalingSizes
from monoloc_lab.bench.tuning_steps import TuningSizes
from monoloc_lab.bench.whole_step import bench_pipeline
from monoloc_lab.cli import bench
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture, write_recording

FIT_KEYS = {"fit_s", "fit_ratio_sklearn", "loglik", "loglik_sklearn"}
PIPELINE_KEYS = {"step_ms_median", "step_ms_p95", "stage_ms", "peak_memory_mb"}
STAGES = {"depth", "scan", "odometry", "predict", "likelihood", "estimate"}
RARE_STAGES = {"scale and tilt", "landmarks", "resample", "other"}


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small sizes."""
    kernel_sizes = KernelSizes(particles=40, points=20, components=10, more=20, most=60, rounds=2, slow_rounds=1)
    scales = ScalingSizes(20, 10, 10, (10, 20), (5, 10), (10, 20), (30,), rounds=1, slow_rounds=1)
    monkeypatch.setattr(bench, "KernelSizes", lambda: kernel_sizes)
    monkeypatch.setattr(kernels, "_PEAK_ROUNDS", 200_000)
    monkeypatch.setattr(bench, "FitSizes", lambda: FitSizes(points=800, components=6, rounds=1))
    monkeypatch.setattr(scaling, "ScalingSizes", lambda: scales)
    monkeypatch.setattr(tuning_steps, "TuningSizes", lambda: TuningSizes(steps=1, views=2, rounds=1))
    monkeypatch.setattr(bench, "_CLOUD_POINTS", 3000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recording ``flight`` and a bundle of its room."""
    path = tmp_path_factory.mktemp("bench")
    recording = RoomRecording(Room(), make_path(12), SMALL_CAMERA)
    write_recording(path / "flight", recording)
    write_bundle(path / "room.monoloc", make_bundle(room_mixture(Room(), 50), recording))
    return path


@pytest.mark.usefixtures("small")
def test_kernels_reports_every_figure(capfd: pytest.CaptureFixture[str]) -> None:
    figures = json_of(capfd, "bench", "kernels")
    assert set(figures) == {
        "weigh_ms", "weigh_ratio_dense", "weigh_ratio_sklearn", "weigh_error_mean_nat", "weigh_error_max_nat",
        "weigh_ratio_k2000", "weigh_ratio_k100000", "index_bytes", "gflops", "peak_gflops",
    }  # fmt: skip
    assert all(value > 0 and math.isfinite(value) for value in figures.values())
    assert figures["weigh_error_mean_nat"] <= 0.01
    assert figures["weigh_error_max_nat"] <= 0.1
    assert figures["gflops"] < figures["peak_gflops"]


@pytest.mark.usefixtures("small")
def test_scaling_reports_every_size(capfd: pytest.CaptureFixture[str]) -> None:
    figures = json_of(capfd, "bench", "scaling")
    assert list(figures["ms_by_particles"]) == ["10", "20"] and list(figures["ms_by_rooms"]) == ["30"]
    assert set(figures["index_mb"]) == {"10", "20", "30"}
    assert {"NumPy, single, in blocks", "torch, double", "scikit-learn"} < set(figures["dense_ratios"])
    assert all(value > 0.0 for group in figures.values() for value in group.values())


@pytest.mark.usefixtures("small")
def test_map_reports_every_figure(capfd: pytest.CaptureFixture[str], folder: Path) -> None:
    figures = json_of(capfd, "bench", "map", str(folder / "flight"))
    assert set(figures) == FIT_KEYS
    assert figures["fit_s"] > 0.0
    assert figures["loglik"] >= figures["loglik_sklearn"] - 1e-3
    table = succeeds(capfd, "bench", "map")
    assert all(key.removesuffix("_s").replace("_", " ") in table for key in FIT_KEYS)


@pytest.mark.usefixtures("small")
def test_without_scikit_learn_its_figures_are_null(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(timing, "find_spec", lambda name: None)
    assert invoke(["bench", "map", "--json"]) == 0
    out, err = capfd.readouterr()
    assert {name for name, value in json.loads(out).items() if value is None} == {
        "fit_ratio_sklearn",
        "loglik_sklearn",
    }
    message = " ".join(err.split())
    assert "scikit-learn is not installed, so these are left out: fit_ratio_sklearn, loglik_sklearn" in message


def test_networks_reports_every_shipped_network(capfd: pytest.CaptureFixture[str]) -> None:
    networks = json_of(capfd, "bench", "networks", "--runs", "10")["networks"]
    assert {"full-0.35", "tiny-0.35-int8"} < set(networks)
    for latency in networks.values():
        assert 0.0 < latency["ms_median"] <= latency["ms_p95"] and latency["gflops"] > 0.0


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_tuning_reports_every_optimisation(capfd: pytest.CaptureFixture[str], folder: Path) -> None:
    figures = json_of(capfd, "bench", "tuning", str(folder / "flight"))
    assert {"pooling kernels", "precision by processor", "all"} < set(figures["step_ratios"])
    assert all(value > 0.0 for value in (*figures["step_ratios"].values(), figures["step_ms"], figures["view_ms"]))


def test_pipeline_reports_every_stage(capfd: pytest.CaptureFixture[str], folder: Path) -> None:
    figures = json_of(capfd, "bench", "pipeline", str(folder / "flight"), "--bundle", str(folder / "room.monoloc"))
    assert set(figures) == PIPELINE_KEYS
    assert 0.0 < figures["step_ms_median"] <= figures["step_ms_p95"]
    assert set(figures["stage_ms"]) == STAGES | RARE_STAGES
    assert all(figures["stage_ms"][name] > 0.0 for name in STAGES)
    assert 20.0 < figures["peak_memory_mb"] < 2000.0


def test_pipeline_reports_the_likelihood_of_the_volume(
    capfd: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    """That of the paper's method."""
    room = read_bundle(folder / "room.monoloc")
    settings = override(room.settings, likelihood={"kind": "volume"})
    write_bundle(tmp_path / "room.monoloc", replace(room, settings=settings))
    flight = ("bench", "pipeline", str(folder / "flight"), "--bundle", str(tmp_path / "room.monoloc"))
    assert json_of(capfd, *flight)["stage_ms"]["likelihood"] > 0.0


@pytest.mark.skipif(sys.platform == "win32", reason="it has no sessions")
def test_ctrl_c_does_not_reach_the_timed_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would print a traceback beside the one line of the command."""
    reports = f'import json, os; print(json.dumps({dict.fromkeys(PIPELINE_KEYS, 0)} | {{"stage_ms": os.getsid(0)}}))'
    stand_in = tmp_path / "python"
    stand_in.write_text(f"#!/bin/sh\nexec {shlex.quote(sys.executable)} -c {shlex.quote(reports)}\n")
    stand_in.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(stand_in))
    assert bench_pipeline(tmp_path, "flight", "::", 0).stage_ms != os.getsid(0)


@pytest.mark.slow
def test_pipeline_builds_a_bundle_if_none_is_given(capfd: pytest.CaptureFixture[str], folder: Path) -> None:
    assert set(json_of(capfd, "bench", "pipeline", str(folder / "flight"))) == PIPELINE_KEYS


def test_timed_process_needs_neither_torch_nor_matplotlib() -> None:
    script = "import sys, monoloc_lab.bench.steps; print(*{'torch', 'matplotlib', 'sklearn'} & set(sys.modules))"
    done = python(script)
    assert done.returncode == 0 and done.stdout.strip() == ""


def test_frames_of_a_synthetic_room_are_refused(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    refused(
        capfd, tmp_path, ("bench", "kernels", "--frames", "::2"), "--frames", "for a synthetic room", "leave it out"
    )


def test_unreadable_frame_in_the_timed_process_is_refused(
    capfd: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    flight = shutil.copytree(folder / "flight", tmp_path / "flight")
    frame = flight / "color" / "000007.png"
    frame.write_bytes(frame.read_bytes()[:2000])
    arguments = ("bench", "pipeline", str(flight), "--bundle", str(folder / "room.monoloc"))
    refused(capfd, tmp_path, arguments, f"{frame}: ", "cut short", "copy the file again")
