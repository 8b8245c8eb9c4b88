"""``monoloc reproduce --benchmark``: a data set's published split, a row a scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.adapt.settings import QUICK
from monoloc.builder.build_config import BuildConfig
from monoloc.cli.common import note, print_json, print_table, say_written
from monoloc.cli.output_checks import check_folder
from monoloc.config import override
from monoloc.errors import SettingError
from monoloc.files import json_text, write_whole
from monoloc_lab.cli.study_run import carry_out_shown
from monoloc_lab.experiments.provenance import provenance
from monoloc_lab.experiments.published import BENCHMARKS, over_scenes, read_scene, scene_row, scene_runs
from monoloc_lab.experiments.study import SIZES, WIDTH


def reproduce_benchmark(
    benchmark: str,
    data: Path | None,
    scenes: Sequence[str],
    out: Path,
    quick: bool,
    sizes: Sequence[str],
    workers: int,
    dask: str | None,
    json: bool,
) -> None:
    """Build every scene from its training sequences, fly its test sequences, and write ``OUT/BENCHMARK.json``.

    Args:
        data: folder of the data set, in its published layout.
        scenes: some of its scenes; all if empty.
        sizes: at most one size of the depth network; the largest if empty.

    Raises:
        DataError, SettingError: an option is invalid, or a scene is not as published.
        TaskError: a build or a flight failed because of its input, after all others are done.
    """
    check_folder(out, "--out")
    network = f"{_size_of(sizes)}-{WIDTH}"
    names = _scenes_of(benchmark, scenes)
    if data is None:
        raise SettingError("--data", "is needed with --benchmark", "give the folder that has the scenes")
    config = override(BuildConfig(), adapt=QUICK) if quick else BuildConfig()
    chosen = [read_scene(benchmark, data, name) for name in names]
    for scene in chosen:
        for line in scene.notes:
            note(scene.name, line)
    runs = [scene_runs(scene, network, config) for scene in chosen]
    out = out.resolve()
    out.mkdir(exist_ok=True)
    wanted = [run for of_scene in runs for run in of_scene.values()]
    results = carry_out_shown(wanted, out, workers, dask)
    rows = [scene_row(scene, of_scene, results) for scene, of_scene in zip(chosen, runs, strict=True)]
    whole = len(rows) == len(BENCHMARKS[benchmark].scenes)
    content = {
        "benchmark": BENCHMARKS[benchmark].title,
        "all_scenes": whole,
        "network": network,
        "quick": quick,
        "builds": 1,
        "rows": rows,
        **over_scenes(rows),
        "provenance": provenance(),
    }
    file = out / f"{benchmark}.json"
    write_whole(file, json_text(content).encode())
    if json:
        print_json(content)
        return
    _print_rows(f"{BENCHMARKS[benchmark].title}: one build a scene, without a start", content)
    say_written(file)


def _size_of(sizes: Sequence[str]) -> str:
    if len(sizes) > 1:
        raise SettingError("--size", f"is given {len(sizes)} times", "give one size with --benchmark")
    size = sizes[0] if sizes else SIZES[0]
    if size not in SIZES:
        raise SettingError("--size", f"is {size!r}", f"choose from {', '.join(SIZES)}")
    return size


def _scenes_of(benchmark: str, scenes: Sequence[str]) -> list[str]:
    if benchmark not in BENCHMARKS:
        raise SettingError("--benchmark", f"is {benchmark!r}", f"choose from {', '.join(BENCHMARKS)}")
    known = BENCHMARKS[benchmark].scenes
    unknown = next((scene for scene in scenes if scene not in known), None)
    if unknown is not None:
        raise SettingError("--scene", f"is {unknown!r}", f"choose from {', '.join(known)}")
    return [scene for scene in known if not scenes or scene in scenes]


def _print_rows(title: str, content: dict[str, Any]) -> None:
    columns = ["", "lost frames", "position (cm)", "rotation (deg)", "within 5 cm, 5 deg"]
    rows = [[row["scene"], f"{row['lost_frames']} of {row['test_frames']}", *_texts(row)] for row in content["rows"]]
    print_table(title, columns, [*rows, *([name, "", *_texts(content[name])] for name in ("mean", "median"))])


def _texts(figures: dict[str, Any]) -> list[str]:
    return [
        f"{figures['position_median_cm']:.1f}",
        f"{figures['rotation_median_deg']:.2f}",
        f"{100.0 * figures['within_5cm_5deg']:.1f} %",
    ]
