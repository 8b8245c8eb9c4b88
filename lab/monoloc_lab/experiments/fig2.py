"""The layers of the depth network and their sizes, read from the network (figure 2 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monoloc.extras import training_extra
from monoloc.viz.picture import BLUE, GREEN, INK, ORANGE, VERMILION, picture
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import network_of
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from torch import nn

    from monoloc.depth.training.network import DepthNetwork

_INPUT = (160, 128)  # width and height for a camera with the field of view of NYU
_COLOURS = {"encoder": BLUE, "decoder": GREEN, "last layer": VERMILION, "error": ORANGE}


_LANES_FROM, _LANE = 1.02, 0.19  # heights of the lines from encoder to decoder; boxes reach 0.9


@dataclass(frozen=True)
class Layer:
    """A part of the network.

    Attributes:
        name, group: of the part; groups are encoder, decoder, last layer and error.
        convolutions, parameters: their numbers.
        channels, stride: of its output; the stride is that of the network up to there.
    """

    name: str
    group: str
    convolutions: int
    parameters: int
    channels: int
    stride: int


def tasks(study: Study) -> Sequence[Task]:
    return ()


def layers_of(network: DepthNetwork) -> list[Layer]:
    """The parts in the order of the data flow, with the sizes of their outputs."""
    import torch

    outputs: dict[str, tuple[int, int]] = {}

    def watch(name: str) -> Any:
        def note(_: nn.Module, __: object, output: torch.Tensor) -> None:
            outputs[name] = (output.shape[1], _INPUT[0] // output.shape[3])

        return note

    parts = _parts(network)
    hooks = [module.register_forward_hook(watch(name)) for name, _, module in parts]
    with torch.no_grad():
        network.eval().with_error(torch.zeros(1, 3, _INPUT[1], _INPUT[0]))
    for hook in hooks:
        hook.remove()
    return [
        Layer(
            name,
            group,
            sum(isinstance(child, torch.nn.Conv2d) for child in module.modules()),
            sum(parameter.numel() for parameter in module.parameters()),
            *outputs[name],
        )
        for name, group, module in parts
        # A pooling block without stages passes its input on.
        if name in outputs and any(True for _ in module.parameters())
    ]


def _parts(network: DepthNetwork) -> list[tuple[str, str, nn.Module]]:
    encoder, decoder = network.encoder, network.decoder
    parts = [
        ("first convolution" if name == "0" else f"bottleneck {name}", "encoder", block)
        for name, block in encoder.features.named_children()
    ]
    parts += [
        (f"lateral {name}", "decoder", layer) for name, layer in zip(encoder.taps, decoder.laterals, strict=True)
    ]
    for level, pooling in enumerate(decoder.pooling):
        parts.append((f"pooling {level + 1}", "decoder", pooling))
        if level < len(decoder.adapt):
            parts.append((f"fusion {level + 1}", "decoder", decoder.adapt[level]))
    parts += [("before depth", "decoder", decoder.pre_depth), ("depth", "last layer", network.head)]
    if network.error_head is not None:
        parts.append(("error", "error", network.error_head))
    return parts


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    with training_extra():
        from monoloc.depth.training.family import named_config
        from monoloc.depth.training.network import DepthNetwork
    networks = {size: DepthNetwork(named_config(network_of(size))) for size in study.sizes}
    found = {size: layers_of(network) for size, network in networks.items()}
    numbers: dict[str, dict[str, Any]] = {
        size: {
            "parameters": network.parameter_count(),
            "multiply_adds": network.multiply_adds(*_INPUT),
            "layers": [vars(layer) for layer in found[size]],
        }
        for size, network in networks.items()
    }
    path = folder / "fig2.png"
    widest = max(_columns(layers) for layers in found.values())
    with picture(path, 13.0, 2.6 * len(found)) as figure:
        axes = figure.subplots(len(found), 1, squeeze=False)[:, 0]
        for axis, (size, layers) in zip(axes, found.items(), strict=True):
            parameters, work = numbers[size]["parameters"], numbers[size]["multiply_adds"]
            axis.set_title(
                f"{size}: {parameters:,} parameters, {work / 1e6:.1f} M multiply-adds, "
                f"{sum(layer.convolutions for layer in layers)} convolutions"
            )
            _draw_network(axis, layers, widest)
    rows = [
        (size, group, str(_sum(layers, group, "convolutions")), f"{_sum(layers, group, 'parameters'):,}")
        for size, layers in found.items()
        for group in _COLOURS
    ]
    head = ("size", "part", "convolutions", "parameters")
    return Drawn(
        numbers=numbers,
        pictures=[path],
        tables={"Parameters by part": (head, rows)},
        text=_text(networks[study.sizes[0]], found[study.sizes[0]]),
    )


def _sum(layers: Sequence[Layer], group: str, name: str) -> int:
    return sum(int(getattr(layer, name)) for layer in layers if layer.group == group)


def _columns(layers: Sequence[Layer]) -> int:
    """Number of boxes in a row; laterals are drawn as lines."""
    return sum(1 for layer in layers if not layer.name.startswith("lateral"))


def _draw_network(axis: Axes, layers: Sequence[Layer], widest: int) -> None:
    """Draw boxes from left to right, with heights by resolution, channels inside and parameters below."""
    boxes = [layer for layer in layers if not layer.name.startswith("lateral")]
    laterals = [layer for layer in layers if layer.name.startswith("lateral")]
    at = {layer.name: float(place) for place, layer in enumerate(boxes)}
    for layer in boxes:
        x = at[layer.name]
        _draw_box(axis, x, _height(layer.stride), _COLOURS[layer.group])
        axis.annotate(f"{layer.channels}", (x, 0.0), ha="center", va="center", fontsize=8.5, color="white")
        count = f"{layer.parameters / 1e3:.1f}k" if layer.parameters < 99_950 else f"{layer.parameters / 1e3:.0f}k"
        axis.annotate(count, (x, -1.07), ha="center", fontsize=7.5, color=INK)
        axis.annotate(_short(layer.name), (x, -1.28), ha="center", fontsize=7.0, color="#666666")
    levels = sorted({lateral.stride for lateral in laterals}, reverse=True)
    for lane, lateral in enumerate(reversed(laterals)):  # the deepest is the shortest, so the lowest
        _draw_lateral(axis, lateral, at, levels.index(lateral.stride), _LANES_FROM + _LANE * lane)
    for group, colour in _COLOURS.items():
        inside = [at[layer.name] for layer in boxes if layer.group == group]
        if inside:
            axis.plot([inside[0] - 0.36, inside[-1] + 0.36], [-1.36] * 2, color=colour, linewidth=2.0)
            axis.annotate(
                group.partition(" ")[0],
                (0.5 * (inside[0] + inside[-1]), -1.6),
                ha="center",
                fontsize=8.5,
                color=colour,
                weight="bold",
            )
    top = _LANES_FROM + _LANE * len(laterals)
    axis.set(xlim=(-0.7, widest - 0.2), ylim=(-1.7, top), xticks=[], yticks=[])
    axis.grid(False)
    axis.spines[:].set_visible(False)


def _short(name: str) -> str:
    """The name of a part, short enough to fit below its box."""
    kind, _, number = name.partition(" ")
    return {"first": "conv", "bottleneck": f"b{number}", "pooling": "pool", "fusion": "fuse", "before": "mix"}.get(
        kind, name
    )


def _height(stride: int) -> float:
    """Height of a box by the stride of its output."""
    return {2: 1.7, 4: 1.5, 8: 1.15, 16: 0.85}.get(stride, 0.6)


def _draw_box(axis: Axes, x: float, height: float, colour: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    shape = "round,pad=0,rounding_size=0.08"
    axis.add_patch(FancyBboxPatch((x - 0.36, -0.5 * height), 0.72, height, shape, color=colour, linewidth=0.0))


def _draw_lateral(axis: Axes, lateral: Layer, at: dict[str, float], level: int, lane: float) -> None:
    """A line from a bottleneck over the boxes to the decoder level that takes its output."""
    start = at[f"bottleneck {lateral.name.removeprefix('lateral ')}"]
    entry = next(name for name in (f"pooling {level + 1}", f"fusion {level + 1}", "before depth") if name in at)
    foot = 0.5 * _height(lateral.stride) + 0.03
    end = at[entry]
    axis.plot([start, start, end, end], [foot, lane, lane, foot + 0.1], color="#9A9A9A", linewidth=1.0)
    axis.plot(end, foot + 0.06, "v", color="#9A9A9A", markersize=4.5)
    count = f"{lateral.parameters / 1e3:.1f}k"
    axis.annotate(count, (start + 0.12, lane), (0, 1.5), textcoords="offset points", fontsize=6.5, color="#666666")


def _text(network: DepthNetwork, layers: Sequence[Layer]) -> str:
    last = _sum(layers, "last layer", "parameters")
    first = sum(parameter.numel() for parameter in network.encoder.first_layers.parameters())
    return (
        "MobileNetV2 bottlenecks and a Light-Weight RefineNet decoder; smaller networks leave layers out. Numbers in "
        "the boxes are channels, numbers below them parameters. Higher boxes have a higher resolution. Lines are 1×1 "
        f"convolutions from encoder to decoder. The paper tunes the last layer, {last:,} parameters. monoloc tunes "
        f"all but the first layers of the encoder up to stride 4, which have {first:,} parameters."
    )


FIGURE = Figure("fig2", "The depth network by size", "Figure 2", tasks, draw)
