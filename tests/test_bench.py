"""The measuring of speed: keys, plausible figures and errors. How fast anything is, no test says."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning

from cli_helpers import json_of
from map_helpers import make_mixture
from monoloc.bundle import write_bundle
from monoloc.cli.main import invoke
from monoloc.map.em import fit_mixture, initial_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc_lab.bench import timing
from monoloc_lab.bench.alternatives import DenseWeigher, sklearn_mixture, sklearn_scorer
from monoloc_lab.bench.fitting import FitSizes
from monoloc_lab.bench.kernels import KernelSizes, peak_gflops, weigh_flops
from monoloc_lab.bench.scenes import building, made_up_cloud, near_surface, weighing
from monoloc_lab.cli import bench as bench_command
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture, write_recording

FRAMES = 12
KERNEL_KEYS = {
    "weigh_ms",
    "weigh_ratio_dense",
    "weigh_ratio_sklearn",
    "weigh_error_mean_nat",
    "weigh_error_max_nat",
    "weigh_ratio_k2000",
    "weigh_ratio_k100000",
    "index_bytes",
    "gflops",
    "peak_gflops",
}
FIT_KEYS = {"fit_s", "fit_ratio_sklearn", "loglik", "loglik_sklearn"}
PIPELINE_KEYS = {"step_ms_median", "step_ms_p95", "stage_ms", "peak_memory_mb"}


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    return made_up_cloud(3000, np.random.default_rng(0))


@pytest.fixture(scope="module")
def mixture(cloud: np.ndarray) -> GaussianMixture:
    return fit_mixture(cloud, 20, np.random.default_rng(0), max_iterations=10).mixture


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes that take a moment."""
    sizes = KernelSizes(particles=40, points=20, components=10, more=20, most=60, rounds=2, slow_rounds=1)
    monkeypatch.setattr(bench_command, "KERNEL_SIZES", sizes)
    monkeypatch.setattr(bench_command, "FIT_SIZES", FitSizes(points=800, components=6, rounds=1))
    monkeypatch.setattr(bench_command, "_CLOUD_POINTS", 3000)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording ``walk`` and a bundle of its room."""
    folder = tmp_path_factory.mktemp("bench")
    recording = RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)
    write_recording(folder / "walk", recording)
    write_bundle(folder / "room.monoloc", make_bundle(room_mixture(Room()), recording))
    return folder


@pytest.mark.usefixtures("small")
def test_kernels_gives_every_figure(capfd: pytest.CaptureFixture[str]) -> None:
    figures = json_of(capfd, "bench", "kernels")
    assert set(figures) == KERNEL_KEYS
    assert all(value > 0 and math.isfinite(value) for value in figures.values())
    assert figures["weigh_error_mean_nat"] <= 0.01
    assert figures["weigh_error_max_nat"] <= 0.1
    assert figures["gflops"] < figures["peak_gflops"]


@pytest.mark.usefixtures("small")
def test_map_gives_every_figure(capfd: pytest.CaptureFixture[str]) -> None:
    figures = json_of(capfd, "bench", "map")
    assert set(figures) == FIT_KEYS
    assert figures["fit_s"] > 0.0
    assert figures["loglik"] >= figures["loglik_sklearn"] - 1e-3


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("what", "missing"),
    [("kernels", {"weigh_ratio_sklearn"}), ("map", {"fit_ratio_sklearn", "loglik_sklearn"})],
)
def test_without_scikit_learn_its_figures_are_null(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, what: str, missing: set[str]
) -> None:
    monkeypatch.setattr(timing, "find_spec", lambda name: None)
    assert invoke(["bench", what, "--json"]) == 0
    out, err = capfd.readouterr()
    figures = json.loads(out)
    assert {name for name, value in figures.items() if value is None} == missing
    said = " ".join(err.split())
    assert "scikit-learn is not installed, so these are left out: " in said
    assert all(name in said for name in missing)


@pytest.mark.usefixtures("small")
def test_a_room_can_be_given(capfd: pytest.CaptureFixture[str], made: Path) -> None:
    assert set(json_of(capfd, "bench", "map", str(made / "walk"))) == FIT_KEYS


@pytest.mark.usefixtures("small")
def test_people_get_a_table(capfd: pytest.CaptureFixture[str]) -> None:
    assert invoke(["bench", "map"]) == 0
    out, _ = capfd.readouterr()
    assert all(name in out for name in FIT_KEYS)


def test_pipeline_gives_every_figure(capfd: pytest.CaptureFixture[str], made: Path) -> None:
    figures = json_of(capfd, "bench", "pipeline", str(made / "walk"), "--bundle", str(made / "room.monoloc"))
    assert set(figures) == PIPELINE_KEYS
    assert 0.0 < figures["step_ms_median"] <= figures["step_ms_p95"]
    assert {
        "depth",
        "scan",
        "odometry",
        "level",
        "landmarks",
        "predict",
        "weigh",
        "estimate",
        "resample",
        "other",
    } == set(figures["stage_ms"])
    assert all(
        ms > 0.0
        for name, ms in figures["stage_ms"].items()
        if name not in ("other", "level", "landmarks", "resample")
    )
    assert 20.0 < figures["peak_memory_mb"] < 2000.0


@pytest.mark.slow
def test_pipeline_builds_a_bundle_where_none_is_given(capfd: pytest.CaptureFixture[str], made: Path) -> None:
    assert set(json_of(capfd, "bench", "pipeline", str(made / "walk"))) == PIPELINE_KEYS


def test_what_is_timed_needs_neither_torch_nor_matplotlib() -> None:
    script = "import sys, monoloc_lab.bench.steps; print(*{'torch', 'matplotlib', 'sklearn'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("kernels", "nowhere"), ".*/nowhere: does not exist; .*"),
        (("kernels", "--frames", "::2"), "--frames: has no meaning for a made-up room; leave it out"),
        (("map", "walk", "--frames", "x"), "--frames: 'x' is not START:STOP:STEP; .*"),
        (("pipeline", "walk", "--bundle", "nowhere"), "nowhere: is not a bundle .*; .*monoloc build"),
        (("pipeline",), "Missing argument 'SOURCE'.*"),
    ],
)
def test_bad_input_is_one_line(
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    made: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(made)
    capfd.readouterr()
    assert invoke(["bench", *arguments]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("monoloc: ")
    assert re.match(message, lines[0].removeprefix("monoloc: ")), lines[0]


def test_a_frame_that_the_process_cannot_read_is_one_line(
    capfd: pytest.CaptureFixture[str], made: Path, tmp_path: Path
) -> None:
    walk = shutil.copytree(made / "walk", tmp_path / "walk")
    frame = walk / "color" / "000007.png"
    frame.write_bytes(frame.read_bytes()[:2000])
    capfd.readouterr()
    assert invoke(["bench", "pipeline", str(walk), "--bundle", str(made / "room.monoloc")]) == 2
    assert capfd.readouterr() == ("", f"monoloc: {frame}: is cut short; copy the file again\n")


# --- What the figures are made of ---


def test_alternatives_compute_the_same(cloud: np.ndarray, mixture: GaussianMixture) -> None:
    given = weighing(cloud, 15, 30, np.random.default_rng(1))
    exact = mixture.log_density(given.points_world)
    near = exact > np.log(0.1 / mixture.volume_m3)
    np.testing.assert_allclose(DenseWeigher(mixture).log_density(given.points_world)[near], exact[near], atol=0.02)
    np.testing.assert_allclose(sklearn_scorer(mixture).score_samples(given.points_world), exact, rtol=1e-6)
    share, volume = 0.1, mixture.volume_m3
    ours = mixture.index().weigh(given.poses, given.log_scales, given.scan, outlier_share=share, volume_m3=volume)
    theirs = DenseWeigher(mixture).weigh(given.points_world, 15, share, volume)
    np.testing.assert_allclose(theirs, ours, atol=0.02 * 30)


def test_sklearn_starts_where_we_do(cloud: np.ndarray) -> None:
    start = initial_mixture(cloud, 5, np.random.default_rng(0), 0.01)
    oracle = sklearn_mixture(replace(start), 0.01, 1)
    with pytest.warns(ConvergenceWarning):  # one iteration, whose bound is that of the start
        oracle.fit(cloud)
    assert oracle.lower_bound_ == pytest.approx(start.log_density(cloud).mean(), abs=1e-3)


def test_a_building_is_the_room_again_and_again(mixture: GaussianMixture) -> None:
    rooms = building(mixture, 75, np.random.default_rng(0))
    assert len(rooms) == 80
    np.testing.assert_allclose(rooms.means[:20], mixture.means)
    lower, upper = mixture.bounds_m()
    assert rooms.bounds_m()[1][0] - rooms.bounds_m()[0][0] > 1.9 * (upper - lower)[0]


def test_a_scan_lies_on_the_cloud(cloud: np.ndarray) -> None:
    given = weighing(cloud, 3, 50, np.random.default_rng(0))
    assert given.scan.shape == (50, 3)
    assert given.scan[:, 2].min() > 0.0  # in front of the camera
    assert given.points_world.shape == (150, 3)
    moved = near_surface(cloud, 0.1, np.random.default_rng(0))
    assert np.linalg.norm(moved[len(cloud) :] - cloud, axis=1).max() <= 0.1 + 1e-12


def test_operations_are_counted_by_what_is_evaluated() -> None:
    crowded = make_mixture(300)
    given = weighing(crowded.sample(2000, np.random.default_rng(0)), 10, 20, np.random.default_rng(0))
    few, many = weigh_flops(crowded.index(0.05), given), weigh_flops(crowded.index(0.4), given)
    assert 0.0 < few < many
    assert peak_gflops() > 0.1


def test_turns_are_taken() -> None:
    calls: list[str] = []
    times = timing.fastest_s({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=2)
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert set(times) == {"a", "b"}
