"""Figures drawn from synthetic results: their numbers are those of the results."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas

from experiment_helpers import is_dark, plausible_rmse, synthetic_results
from monoloc.depth.training.family import network_config
from monoloc.errors import SettingError
from monoloc_lab.experiments import (
    ablation,
    fig2,
    fig3,
    fig4d,
    fig5b,
    kl_weight,
    map_size,
    robustness,
    variants,
)
from monoloc_lab.experiments.comparison import COVERAGE, ODOMETRY_RATIO
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.figures import FIGURES, chosen_figures, draw_figure
from monoloc_lab.experiments.gather import MEDIAN, RMSE
from monoloc_lab.experiments.methods import JOINT, POSENET, UNADAPTED
from monoloc_lab.experiments.study import Study, builtin
from monoloc_lab.experiments.task import Result, Task

NAMES = ["fig1", "fig2", "fig3", "fig4ab", "fig4c", "fig4d", "fig5top", "fig5a", "fig5b", "table1", "variants"]
NAMES += ["map-size", "lambda", "frames"]
ON_REQUEST = ["ablation", "adapt-settings", "robustness", "ladder", "claims-by-method", "posenets"]
ONLY_IN_FULL = {"map-size", "lambda", "frames"}
ROOM = "living room"


@pytest.fixture(scope="module")
def quick() -> Study:
    return builtin(True)


@pytest.fixture(scope="module")
def full() -> Study:
    """Two splits, few sizes and seeds."""
    study = builtin(False)
    split = study.splits[0]
    splits = (split, dataclasses.replace(split, name="interpolation"))
    return dataclasses.replace(study, splits=splits, sizes=("full", "one-third"), seeds=2)


@pytest.fixture
def without_plots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws nothing on a canvas, which takes most of the time."""

    @contextmanager
    def picture(path: Path, width_in: float, height_in: float) -> Iterator[Canvas]:
        with matplotlib.rc_context():
            yield Canvas(figsize=(width_in, height_in))
        path.touch()

    for figure in (fig2, fig4d, fig5b, kl_weight, map_size, variants):
        monkeypatch.setattr(figure, "picture", picture)
    monkeypatch.setattr(fig3, "plot_map_change", lambda path, *others: path.touch())


Done = tuple[Path, dict[Task, Result]]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """The folder of the synthetic results, and the results so far."""
    return tmp_path_factory.mktemp("synthetic"), {}


def drawn_from(figure: Figure, study: Study, done: Done, folder: Path) -> Drawn:
    tasks = figure.tasks(study)
    assert tasks is not None
    return draw_figure(figure, study, synthetic_results(tasks, done[0], results=done[1]), folder)


# --- All figures ---


def test_figures_are_chosen_by_name() -> None:
    assert [figure.name for figure in FIGURES] == [*NAMES, *ON_REQUEST]
    assert [figure.name for figure in chosen_figures(["lambda", "fig1"])] == ["fig1", "lambda"]
    assert [figure.name for figure in chosen_figures([])] == NAMES
    assert [figure.name for figure in chosen_figures(["robustness"])] == ["robustness"]
    with pytest.raises(SettingError, match=r"^FIGURE: is 'fig9'; choose from fig1, fig2, .*, posenets$"):
        chosen_figures(["fig4d", "fig9"])


@pytest.mark.slow
def test_quick_study_leaves_out_expensive_figures(quick: Study, full: Study) -> None:
    assert {figure.name for figure in FIGURES if figure.tasks(quick) is None} == ONLY_IN_FULL
    assert all(figure.tasks(full) is not None for figure in FIGURES)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMES, *ON_REQUEST])
def test_every_figure_is_drawn_with_its_numbers(name: str, full: Study, done: Done, tmp_path: Path) -> None:
    drawn = drawn_from(chosen_figures([name])[0], full, done, tmp_path)
    written = json.loads((tmp_path / f"{name}.json").read_text())
    assert written.keys() == drawn.numbers.keys() and written
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.json", *(path.name for path in drawn.pictures)}
    for path in drawn.pictures:
        image = cv2.imread(str(path))
        assert image is not None and min(image.shape[:2]) > 300
        assert len(np.unique(image.reshape(-1, 3)[::7] @ (1, 256, 65536))) > 20
    for head, rows in drawn.tables.values():
        assert rows and all(len(row) == len(head) for row in rows)
    assert drawn.pictures or drawn.tables
    sentences = " ".join([drawn.text, *(claim.figure for claim in drawn.claims)])
    assert drawn.text.endswith(".") and not re.search(r"\bnan\b|\bNone\b", sentences)


@pytest.mark.parametrize("name", ["fig1", "fig4ab"])
def test_figure_of_a_quick_study_is_drawn_and_closes_its_files(
    name: str, quick: Study, done: Done, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = []
    load = np.load
    monkeypatch.setattr(np, "load", lambda *given, **named: opened.append(load(*given, **named)) or opened[-1])
    drawn = drawn_from(chosen_figures([name])[0], quick, done, tmp_path)
    archives = [each for each in opened if isinstance(each, np.lib.npyio.NpzFile)]
    assert opened and all(archive.zip is None for archive in archives)
    assert all(cv2.imread(str(path)) is not None for path in drawn.pictures)


# --- Numbers ---


@pytest.mark.usefixtures("without_plots")
def test_errors_by_size_are_those_of_the_runs(quick: Study, done: Done, tmp_path: Path) -> None:
    drawn = drawn_from(fig4d.FIGURE, quick, done, tmp_path)
    numbers = drawn.numbers[ROOM]
    # The synthetic errors: a centimetre more per seed, a tenth more for the smaller network.
    assert numbers[JOINT.name]["full"]["runs"] == pytest.approx([0.08, 0.09, 0.10, 0.11, 0.12])
    assert numbers[JOINT.name]["full"]["median"] == pytest.approx(0.10)
    assert numbers[JOINT.name]["one-third"]["smallest"] == pytest.approx(0.088)
    assert numbers[UNADAPTED.name]["one-third"]["largest"] == pytest.approx(0.48)
    assert numbers["dead reckoning"]["median"] == pytest.approx(0.12)
    assert numbers["dead reckoning, same start"]["median"] == pytest.approx(0.2)
    assert numbers["light"] == "L2"
    head, rows = next(iter(drawn.tables.values()))
    row = next(row for row in rows if row[1:3] == (JOINT.name, "full"))
    assert row[head.index("RMSE")] == "10.0 cm (8.0 to 12.0)"
    (claim,) = drawn.claims
    assert claim.holds and claim.spread == pytest.approx((0.128 / 0.12, 1.1))


@pytest.mark.slow
@pytest.mark.usefixtures("without_plots")
def test_errors_by_light_are_those_of_the_runs(quick: Study, done: Done, tmp_path: Path) -> None:
    drawn = drawn_from(fig5b.FIGURE, quick, done, tmp_path)
    by_light = drawn.numbers[ROOM]["by light"]
    assert by_light[JOINT.name]["L1"]["median"] == pytest.approx(0.10)
    assert by_light[JOINT.name]["L3"]["median"] == pytest.approx(0.30)
    assert by_light["ORB keypoints"]["L3"]["runs"] == pytest.approx([0.12])
    assert drawn.numbers[ROOM]["in L3 by size"][POSENET.name]["one-third"]["median"] == pytest.approx(1.56)
    head, rows = next(iter(drawn.tables.values()))
    orb = next(row for row in rows if row[1:3] == ("ORB keypoints", "L2"))
    assert orb[head.index("frames without a pose")] == "22 of 150"
    (claim,) = drawn.claims
    assert claim.holds and "full has an error of 30.0 cm" in claim.figure


@pytest.mark.slow
@pytest.mark.usefixtures("without_plots")
def test_failed_claim_of_a_figure_has_an_analysis(quick: Study, tmp_path: Path) -> None:
    tasks = fig5b.FIGURE.tasks(quick)
    assert tasks is not None
    results = synthetic_results(
        tasks, tmp_path / "bright", lambda task: 0.02 if task.kind == "posenet-run" else plausible_rmse(task)
    )
    (claim,) = draw_figure(fig5b.FIGURE, quick, results, tmp_path).claims
    assert not claim.holds and claim.analysis is not None
    assert "PoseNet has an error of 2.0 cm, less than our 30.0 cm" in claim.analysis


@pytest.mark.usefixtures("without_plots")
def test_map_claim_is_that_of_the_default_variant(quick: Study, done: Done, tmp_path: Path) -> None:
    drawn = drawn_from(fig3.FIGURE, quick, done, tmp_path)
    (claim,) = drawn.claims
    assert claim.holds and claim.settings["builds"] == 1
    assert drawn.numbers[ROOM]["joint"]["c2c_median_m"]["median"] == pytest.approx(0.05)


@pytest.mark.usefixtures("without_plots")
def test_variants_use_the_depth_of_what_was_tuned(full: Study, done: Done, tmp_path: Path) -> None:
    numbers = drawn_from(variants.FIGURE, full, done, tmp_path).numbers["interpolation"]
    assert list(numbers) == ["unadapted", "last", "map", "last+map", "joint"]
    assert numbers["map"]["full"]["absrel"] == numbers["unadapted"]["full"]["absrel"] == pytest.approx(0.3)
    assert numbers["last"]["full"]["absrel"] == pytest.approx(0.08)
    assert numbers["map"]["full"][RMSE]["median"] == pytest.approx(0.255)


@pytest.mark.usefixtures("without_plots")
def test_sweeps_have_a_point_per_setting(full: Study, done: Done, tmp_path: Path) -> None:
    sizes = drawn_from(map_size.FIGURE, full, done, tmp_path).numbers
    assert [entry["map_bytes"] for entry in sizes["mixture"]] == [1000, 2000, 4000, 8000, 16000, 32000]
    assert len(sizes["voxels"]) == len(sizes["points"]) == 4
    swept = drawn_from(kl_weight.FIGURE, full, done, tmp_path).numbers
    values = [float(value) for value in swept["joint"]]
    assert max(values) / min(values) == pytest.approx(1e5)  # five decades
    assert str(swept["default"]) in swept["joint"]


@pytest.mark.slow
def test_ablation_changes_one_component_per_row(quick: Study, done: Done, tmp_path: Path) -> None:
    drawn = drawn_from(ablation.FIGURE, quick, done, tmp_path)
    cases = {case["components"]: case for case in drawn.numbers["cases"] if case["light"] == "L3"}
    assert cases["adapted"][MEDIAN]["median"] == pytest.approx(0.9 * 0.324)  # the last size is one-third
    assert cases["unadapted"][RMSE]["smallest"] == pytest.approx(3.0 * 0.44)
    assert cases["adapted"][COVERAGE]["median"] == 0.9
    assert cases["adapted"][ODOMETRY_RATIO]["median"] == pytest.approx(0.324 / 0.2)
    settings = [(run.settings["motion"], run.settings["gravity"]) for run in ablation.FIGURE.tasks(quick) or ()]
    assert set(settings) == {("visual", False), ("visual", True), ("random-walk", False)}


def test_robustness_alters_build_and_evaluation(quick: Study) -> None:
    runs = robustness.FIGURE.tasks(quick)
    assert runs is not None
    altered = {
        (
            run.needs[0].settings["build"]["alteration"],
            run.settings["evaluation"]["alteration"],
            run.needs[0].settings["config"]["refine_poses"],
        )
        for run in runs
    }
    assert altered == {
        (None, None, False),
        ("pose noise", None, False),
        ("pose noise", None, True),
        ("narrow lens", "narrow lens", False),
    }
    assert {run.settings["sensor"] for run in runs} == {True, False}


@pytest.mark.parametrize("size", ["full", "tiny"])
def test_layers_are_those_of_the_network(size: str) -> None:
    from monoloc.depth.training.network import DepthNetwork

    network = DepthNetwork(network_config(size, 0.35))
    layers = fig2.layers_of(network)
    assert sum(layer.parameters for layer in layers) == network.parameter_count()
    assert (layers[0].channels, layers[0].stride) == (16, 2)
    last = next(layer for layer in layers if layer.group == "last layer")
    assert (last.parameters, last.channels, last.stride) == (104 * 9 + 1, 1, 4)


def test_near_darkness_is_recognised_by_light_and_by_folder(quick: Study) -> None:
    split = quick.splits[0]
    dark = [is_dark(JOINT.task(quick, split, "full", recording, 0)) for recording in split.recordings.values()]
    assert dark == [False, False, True]
