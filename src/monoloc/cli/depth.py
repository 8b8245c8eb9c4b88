"""``monoloc depth``: train, judge and export depth networks."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from monoloc.bundle import read_bundle
from monoloc.cli.common import (
    DepthScaleOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    SourceArgument,
    check_folder,
    check_writable,
    open_source,
    print_json,
    print_table,
    stderr,
)
from monoloc.config import load_settings, override
from monoloc.datasets.base import Recording
from monoloc.depth.runtime import DepthPredictor
from monoloc.errors import DataError
from monoloc.evaluation.depth import DepthAccumulator, fit_scale
from monoloc.evaluation.plots import plot_depth, plot_training
from monoloc.extras import require_plotting, training_extra
from monoloc.files import write_whole
from monoloc.models import SHIPPED_ONNX
from monoloc.progress import ConsoleProgress

app = typer.Typer(help="Train, judge and export depth networks.", no_args_is_help=True, rich_markup_mode=None)

_SHIPPED = "full-0.35"
_PICTURES = 4

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL", help=f"A network.safetensors, an .onnx, a bundle, or {_SHIPPED}.", show_default=False
    ),
]


@app.command()
def train(
    source: SourceArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for network.safetensors, history and curves.")],
    frames: FramesOption = "::",
    validate: Annotated[
        str | None, typer.Option("--validate", metavar="START:STOP:STEP", help="Frames kept for validation.")
    ] = None,
    encoder: Annotated[
        Path | None, typer.Option("--encoder", help="MobileNetV2 weights (.npz, torchvision's names) to start from.")
    ] = None,
    settings: Annotated[Path | None, typer.Option("--settings", help="TOML file of training settings.")] = None,
    epochs: Annotated[int | None, typer.Option("--epochs", help="In place of the settings'.")] = None,
    json: JsonOption = False,
) -> None:
    """Train a depth network on frames with depth.

    \b
    Examples:
      monoloc depth train folder:nyu-labelled --frames 0:1349 --validate 1349: \\
          --encoder mobilenet_v2_0.35_imagenet.npz --out runs/nyu
      monoloc depth train nyu:nyu_depth_v2_labeled.mat --validate 1349: --frames :1349 --epochs 30 --out runs/short
    """
    with training_extra():
        from monoloc.depth.train import TrainConfig, train_network
    check_folder(out, "--out")
    require_plotting()
    config = override(TrainConfig() if settings is None else load_settings(settings, TrainConfig), epochs=epochs)
    training = open_source(source, frames)
    validation = open_source(source, validate) if validate is not None else training
    with ConsoleProgress(stderr).task("train", config.epochs) as step:
        history = train_network(training, validation, config, out, encoder, lambda record: step(record.epoch + 1))
    plot_training(out / "curves.png", [{k: v for k, v in asdict(r).items() if k != "seconds"} for r in history])
    last = asdict(history[-1])
    if json:
        print_json({"network": str(out / "network.safetensors"), **last})
    else:
        stderr.print(f"{out / 'network.safetensors'}: AbsRel {last['absrel']:.3f}, delta1 {last['delta1']:.3f}")


@app.command()
def evaluate(
    model: ModelArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    fit: Annotated[bool, typer.Option("--fit-scale", help="Fit one scale for all frames first.")] = False,
    plot: Annotated[Path | None, typer.Option("--plot", help="PNG of predicted and true depth.")] = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    json: JsonOption = False,
) -> None:
    """Judge a network's depth against measured depth.

    \b
    Examples:
      monoloc depth evaluate full-0.35 folder:nyu-labelled --frames 1349: --json
      monoloc depth evaluate kitchen.monoloc 7scenes:redkitchen --frames 1::4 --plot depth.png
      monoloc depth evaluate full-0.35 7scenes:redkitchen --fit-scale
    """
    check_writable(plot, "--plot")
    if plot is not None:
        require_plotting()
    recording = open_source(source, frames, intrinsics, depth_scale)
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth", "judge on a recording with depth images")
    predictor = DepthPredictor(onnx_of(model), recording.camera, threads=2)
    scale = _fitted_scale(predictor, recording) if fit else 1.0
    accumulator = DepthAccumulator()
    with ConsoleProgress(stderr).task("evaluate", len(recording)) as step:
        for index in range(len(recording)):
            truth = recording.depth(index)
            accumulator.add(scale * _predict(predictor, recording, index), truth)
            step(index + 1)
    if plot is not None:
        shown = np.linspace(0, len(recording) - 1, min(_PICTURES, len(recording))).astype(int)
        plot_depth(
            plot,
            [recording.color(int(i)) for i in shown],
            [scale * _predict(predictor, recording, int(i)) for i in shown],
            [recording.depth(int(i)) for i in shown],
        )
    metrics = {**asdict(accumulator.mean()), "frames": len(recording), "scale": scale}
    if json:
        print_json(metrics)
    else:
        rows = [[name, "-" if value is None else f"{value:.4g}"] for name, value in metrics.items()]
        print_table(f"{model} on {source}", ["figure", "value"], rows)


@app.command()
def export(
    network: Annotated[Path, typer.Argument(help="A network.safetensors.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="The .onnx file to write.")],
    json: JsonOption = False,
) -> None:
    """Export a network to ONNX and check that it gives the same depth.

    \b
    Examples:
      monoloc depth export runs/nyu/network.safetensors --out depth.onnx
    """
    with training_extra():
        from monoloc.depth.checkpoint import load_network
        from monoloc.depth.export import export_onnx
    check_writable(out, "--out")
    content, report = export_onnx(load_network(network))
    write_whole(out, content)
    if json:
        print_json({"onnx": str(out), **asdict(report)})
    else:
        stderr.print(f"{out}: {report.bytes / 1e6:.2f} MB, differs by at most {report.parity_max:.1e} in log-depth")


def onnx_of(model: str) -> Path | bytes:
    """ONNX file or bytes of a model by name, bundle, .onnx or .safetensors.

    Raises:
        DataError: no such file.
        MissingExtraError: a .safetensors without PyTorch.
    """
    path = Path(model)
    if model == _SHIPPED:
        return SHIPPED_ONNX
    if path.is_dir():
        return read_bundle(path).depth_model
    if not path.is_file():
        raise DataError(path, "does not exist", f"give a .safetensors, .onnx, a bundle, or {_SHIPPED}")
    if path.suffix != ".safetensors":
        return path
    with training_extra():
        from monoloc.depth.checkpoint import load_network
        from monoloc.depth.export import export_onnx
    return export_onnx(load_network(path))[0]


def _predict(predictor: DepthPredictor, recording: Recording, index: int) -> np.ndarray:
    size = (recording.camera.width, recording.camera.height)
    return np.asarray(cv2.resize(predictor(recording.color(index)).depth_m, size, interpolation=cv2.INTER_LINEAR))


def _fitted_scale(predictor: DepthPredictor, recording: Recording) -> float:
    """Median over frames of each frame's best scale."""
    scales = [
        fit_scale(_predict(predictor, recording, index), recording.depth(index)) for index in range(len(recording))
    ]
    return float(np.median(scales))
