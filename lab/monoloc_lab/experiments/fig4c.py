"""SSIM of predicted and measured depth by network size (figure 4 c of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.evaluation.depth_metrics import SSIM_RANGE_M
from monoloc.viz.picture import BLUE, GREEN, ORANGE, picture
from monoloc_lab.experiments.drawing import legend_below, logarithmic
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import depth_task, mean_depth, network_of, parameters_of, usual_recording
from monoloc_lab.experiments.methods import bundle_of
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_KINDS = {"unadapted": ORANGE, "last layer and map": GREEN, "network and map": BLUE}
_METRICS = {"ssim": "SSIM", "absrel": "AbsRel"}


def depth_tasks(study: Study, split: Split, size: str) -> dict[str, Task]:
    """Unadapted and adapted depth in the light of the build frames."""
    recording = usual_recording(split)
    sources: tuple[Task | str, ...] = (
        network_of(size),
        *(bundle_of(study, split, size, variant) for variant in ("last+map", "joint")),
    )
    return {kind: depth_task(source, recording) for kind, source in zip(_KINDS, sources, strict=True)}


def tasks(study: Study) -> Sequence[Task]:
    return [
        task for split in study.splits for size in study.sizes for task in depth_tasks(study, split, size).values()
    ]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {
        "reference": "depth sensor",
        "range_m": SSIM_RANGE_M,
        "parameters": {size: parameters_of(size) for size in study.sizes},
    }
    rows = []
    for split in study.splits:
        recording = usual_recording(split)
        numbers[split.name] = {kind: {} for kind in _KINDS}
        for size in study.sizes:
            for kind, task in depth_tasks(study, split, size).items():
                values = {name: mean_depth(results[task], split, recording, name) for name in (*_METRICS, "delta1")}
                numbers[split.name][kind][size] = values
                shown = (f"{values['ssim']:.3f}", f"{values['absrel']:.3f}", f"{values['delta1']:.3f}")
                rows.append((split.name, size, f"{parameters_of(size):,}", kind, *shown))

    path = folder / "fig4c.png"
    with picture(path, 9.6, 4.2) as figure:
        axes = figure.subplots(1, 2 if len(study.splits) == 1 else len(study.splits), squeeze=False)[0]
        for axis, (split, metric) in zip(axes, _panels(study), strict=True):
            _draw_panel(axis, study, numbers[split.name], metric)
            title = f"{_METRICS[metric]} of depth" if len(study.splits) == 1 else f"{_METRICS[metric]}, {split.name}"
            axis.set_title(title)
        legend_below(figure, list(axes), 3)
    head = ("split", "size", "parameters", "network", "SSIM", "AbsRel", "delta1")
    return Drawn(
        numbers=numbers,
        pictures=[path],
        tables={"Depth on unseen frames": (head, rows)},
        text=_text(study, numbers),
    )


def _panels(study: Study) -> list[tuple[Split, str]]:
    """SSIM of every split; for a single split also the relative error."""
    if len(study.splits) == 1:
        return [(study.splits[0], metric) for metric in _METRICS]
    return [(split, "ssim") for split in study.splits]


def _draw_panel(axis: Any, study: Study, kinds: dict[str, Any], metric: str) -> None:
    for kind, colour in _KINDS.items():
        values = [kinds[kind][size][metric] for size in study.sizes]
        parameters = [parameters_of(size) / 1e6 for size in study.sizes]
        axis.plot(parameters, values, "o-", color=colour, markeredgecolor="white", markersize=7, label=kind)
    logarithmic(axis.xaxis)
    ticks = [parameters_of(size) / 1e6 for size in study.sizes]
    axis.set_xticks(ticks, [f"{size}\n{tick:.2f} M" for size, tick in zip(study.sizes, ticks, strict=True)])
    axis.set_xlim(0.8 * min(ticks), 1.25 * max(ticks))
    axis.set(xlabel="parameters", ylabel="SSIM (1 is identical)" if metric == "ssim" else "relative error of depth")


def _text(study: Study, numbers: dict[str, Any]) -> str:
    large, small = study.sizes[0], study.sizes[-1]
    split = study.splits[0]
    plain, ours = (numbers[split.name][kind] for kind in ("unadapted", "network and map"))
    change = plain[small]["ssim"] - plain[large]["ssim"]
    falls = "falls" if change < 0.0 else "does not fall"
    return (
        f"SSIM of predicted and sensor depth in metres, over a range of {SSIM_RANGE_M:g} m, in the light of the "
        f"build frames. {split.name.capitalize()}: without adaptation it {falls} with the size ({large} "
        f"{plain[large]['ssim']:.3f}, {small} {plain[small]['ssim']:.3f}). Adapted: {ours[large]['ssim']:.3f} and "
        f"{ours[small]['ssim']:.3f}."
    )


FIGURE = Figure("fig4c", "Similarity of depth by network size", "Figure 4 c", tasks, draw)
