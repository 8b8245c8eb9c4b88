"""Sizes of networks with equal parameters, of the map and of the transform (table I of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.depth.models import shipped_models
from monoloc.extras import training_extra
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import network_of
from monoloc_lab.experiments.methods import bundle_of
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task

_FLOAT_BYTES = 4


def _bundles(study: Study) -> list[Task]:
    return [bundle_of(study, study.splits[0], size, "joint") for size in study.sizes]


def _posenets(study: Study) -> list[Task]:
    return [factories.posenet(study, study.splits[0], size, 0) for size in study.sizes]


def tasks(study: Study) -> Sequence[Task]:
    return [*_bundles(study), *_posenets(study)]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    shipped = {model.name: model for model in shipped_models()}
    numbers: dict[str, Any] = {"depth networks": {}, "PoseNets": {}}
    rows = []
    for size, bundle, posenet in zip(study.sizes, _bundles(study), _posenets(study), strict=True):
        model, built, theirs = shipped[network_of(size)], results[bundle].figures, results[posenet].figures
        numbers["depth networks"][size] = {
            "parameters": model.parameters,
            "multiply_adds": model.macs,
            "bytes": built["network_bytes"],
            "bytes_8_bit": model.bytes_int8,
        }
        numbers["PoseNets"][size] = {name: theirs[name] for name in ("parameters", "multiply_adds", "bytes")}
        for kind, of in (("depth network", numbers["depth networks"][size]), ("PoseNet", numbers["PoseNets"][size])):
            eighth = f"{of['bytes_8_bit'] / 1e6:.2f} MB" if "bytes_8_bit" in of else "–"
            work = f"{of['multiply_adds'] / 1e6:.1f} M"
            rows.append((size, kind, f"{of['parameters']:,}", work, f"{of['bytes'] / 1e6:.2f} MB", eighth))
    map_bytes = results[_bundles(study)[0]].figures["map_bytes"]
    components = results[_bundles(study)[0]].figures["components"]
    transform = _transform_parameters()
    numbers["map"] = {"components": components, "parameters": 10 * components, "bytes": map_bytes}
    numbers["map transform"] = {"parameters": transform, "bytes": _FLOAT_BYTES * transform, "carried": False}
    rows.append(
        ("all", f"map of {components} components", f"{10 * components:,}", "–", f"{map_bytes / 1e3:.1f} kB", "–")
    )
    rows.append(
        (
            "all",
            "map transform (for edits of the map)",
            f"{transform:,}",
            "–",
            f"{_FLOAT_BYTES * transform / 1e3:.1f} kB",
            "–",
        )
    )
    image = shipped[network_of(study.sizes[0])]
    work = f"multiply-adds, {image.input_width} x {image.input_height}"
    head = ("size", "what", "parameters", work, "bytes, 32 bits", "8 bits")
    return Drawn(numbers=numbers, tables={"Equivalent sizes": (head, rows)}, text=_text(numbers))


def _transform_parameters() -> int:
    """Of the perceptron that transforms the map."""
    with training_extra():
        import torch

        from monoloc.adapt.map_transform import MapTransform
    return sum(parameter.numel() for parameter in MapTransform(torch.zeros(3), 1.0).parameters())


def _text(numbers: dict[str, Any]) -> str:
    networks, posenets = numbers["depth networks"], numbers["PoseNets"]
    apart = max(abs(posenets[size]["parameters"] / networks[size]["parameters"] - 1.0) for size in networks)
    return (
        f"The parameters of PoseNet and depth network of a size differ by at most {100.0 * apart:.2f} %. Both serve "
        f"one room: a room costs its network, which is tuned to it, and its map of "
        f"{numbers['map']['bytes'] / 1e3:.1f} kB, and by default landmarks besides. The bundle keeps the "
        "transform for edits of the map; flights do not use it."
    )


FIGURE = Figure("table1", "Equivalent sizes", "Table I", tasks, draw)
