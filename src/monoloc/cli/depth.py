"""``monoloc depth``: train, evaluate and export depth networks."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from monoloc.bundle import read_network
from monoloc.cli.common import (
    DepthScaleOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    SourceArgument,
    naming,
    open_source,
    print_figures,
    print_json,
    print_table,
    refuse_frames,
    stderr,
    warn,
)
from monoloc.cli.output_checks import check_apart, check_folder, check_outputs, check_picture, check_suffix
from monoloc.config import load_settings, override
from monoloc.depth.models import is_shipped, shipped_models
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.scale_fit import fit_to_depth
from monoloc.depth.spec import monoloc_spec, network_images
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.network_evaluation import evaluate_network
from monoloc.extras import require_extra, training_extra
from monoloc.files import write_whole
from monoloc.io.file_access import require_file
from monoloc.io.recording import Recording
from monoloc.progress import ConsoleProgress, NoProgress
from monoloc.viz.calibration_plot import plot_calibration
from monoloc.viz.plots import plot_depth, plot_training

app = typer.Typer(help="Train, evaluate and export depth networks.", no_args_is_help=True, rich_markup_mode=None)

_PICTURES = 4

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="Depth network: a name from depth list, a .safetensors, .onnx, bundle, or .toml of another network.",
        show_default=False,
    ),
]


@app.command()
def train(
    source: SourceArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for network.safetensors, history and curves.")],
    frames: FramesOption = "::",
    validate: Annotated[
        str | None, typer.Option("--validate", metavar="START:STOP:STEP", help="Validation frames.")
    ] = None,
    also: Annotated[
        list[str] | None,
        typer.Option(
            "--also", metavar="SOURCE", help="Additional training frames; can be repeated.", show_default=False
        ),
    ] = None,
    encoder: Annotated[
        Path | None, typer.Option("--encoder", help="Initial MobileNetV2 weights (.npz, torchvision's names).")
    ] = None,
    start: Annotated[Path | None, typer.Option("--start", help="Initial network, instead of --encoder.")] = None,
    settings: Annotated[Path | None, typer.Option("--settings", help="TOML file of training settings.")] = None,
    epochs: Annotated[int | None, typer.Option("--epochs", help="Number of epochs; overrides the settings.")] = None,
    json: JsonOption = False,
) -> None:
    """Train a depth network on frames with depth.

    The same command resumes an interrupted run.

    \b
    Examples:
      monoloc depth train folder:nyu-labelled --frames 0:1349 --validate 1349: \\
          --encoder mobilenet_v2_0.35_imagenet.npz --settings one-third-0.35.toml --out one-third
      monoloc depth train nyu:nyu_depth_v2_labeled.mat --validate 1349: --frames :1349 --epochs 30 --out short
      monoloc depth train folder:nyu-labelled --frames :1349 --also folder:rooms --start one-third.safetensors \\
          --validate 1349: --settings one-third-0.35-finish.toml --out with-rooms
    """
    check_folder(out, "--out")
    check_apart(out / "network.safetensors", "--out", (start,))
    if encoder is not None and start is not None:
        raise SettingError("--start", "conflicts with --encoder", "give one of them")
    for weights in (encoder, start):
        if weights is not None:
            require_file(weights, "check the path")
    with training_extra():
        from monoloc.depth.training.train import EpochRecord, TrainConfig, train_network
    require_extra("report")
    with naming({"epochs": "--epochs"}):
        config = override(TrainConfig() if settings is None else load_settings(settings, TrainConfig), epochs=epochs)
    training = [open_source(source, frames), *(open_source(other, "::") for other in also or ())]
    validation = open_source(source, validate, frames_option="--validate") if validate is not None else training[0]
    # Under torchrun, only the first process of a run evaluates, writes files and prints.
    is_first = os.environ.get("RANK", "0") == "0"
    progress = ConsoleProgress(stderr) if is_first else NoProgress()
    if is_first and (problem := _trained_on(training[0], validation)) is not None:
        warn(source, problem)

    def draw(history: list[EpochRecord]) -> None:
        records = [asdict(record) for record in history]
        plot_training(out / "curves.png", [{k: v for k, v in r.items() if k != "seconds"} for r in records])

    history = train_network(training, validation, config, out, encoder, start, progress, draw)
    if not history:
        return
    last = asdict(history[-1])
    if json:
        print_json({"network": str(out / "network.safetensors"), **last})
    else:
        stderr.print(f"{out / 'network.safetensors'}: AbsRel {last['absrel']:.3f}, delta1 {last['delta1']:.3f}")


def _trained_on(training: Recording, validation: Recording) -> str | None:
    """What is wrong with the validation frames of a recording, if some are among its training frames."""
    shared = set(training.frame_names) & set(validation.frame_names)
    if not shared:
        return None
    problem = f"{len(shared)} of its {len(validation)} validation frames are trained on, so accuracies are too good"
    return f"{problem}; give --validate frames that --frames leaves out"


@app.command()
def evaluate(
    model: ModelArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    fit: Annotated[
        bool, typer.Option("--fit-scale", help="Fit one scale for all frames first; implied for relative depth.")
    ] = False,
    plot: Annotated[Path | None, typer.Option("--plot", help="PNG to write: predicted and true depth.")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="PNG to write: actual error over the error that the network states."),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    json: JsonOption = False,
) -> None:
    """Evaluate a network's depth against measured depth.

    \b
    Examples:
      monoloc depth evaluate full-0.35 folder:nyu-labelled --frames 1349: --json
      monoloc depth evaluate kitchen.monoloc 7scenes:redkitchen --frames 1::4 --plot depth.png
      monoloc depth evaluate full-0.35 7scenes:redkitchen --fit-scale --calibration error.png
      monoloc depth evaluate midas.toml 7scenes:redkitchen --frames ::10     (another network)
    """
    check_outputs({"--plot": plot, "--calibration": calibration}, (model, source))
    check_picture(plot, "--plot")
    check_picture(calibration, "--calibration")
    recording = open_source(source, frames, intrinsics, depth_scale)
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth", "evaluate on a recording with depth images")
    progress = ConsoleProgress(stderr)
    network = read_network(model)
    if fit or not network.spec.is_usable:
        with progress.task("fit", len(recording)) as step:
            network = fit_to_depth(network, recording, recording.depth, step)
        if not fit:
            stderr.print(f"{model}: relative depth, fitted to these frames")
    predictor = DepthPredictor(network, recording.camera, threads=2)
    with progress.task("evaluate", len(recording)) as step:
        evaluation = evaluate_network(predictor, recording, step)
    if plot is not None:
        evaluated = evaluation.evaluated
        places = np.linspace(0, len(evaluated) - 1, min(_PICTURES, len(evaluated))).astype(int)
        shown = [evaluated[place] for place in places]
        plot_depth(
            plot,
            [recording.color(index) for index in shown],
            [_predict(predictor, recording, index) for index in shown],
            [recording.depth(index) for index in shown],
        )
    if calibration is not None:
        if evaluation.calibration is None:
            problem = f"{model} does not state its error, or at too few pixels of known depth"
            raise SettingError("--calibration", problem, "leave it out")
        plot_calibration(calibration, {model: evaluation.calibration})
    metrics = {
        **asdict(evaluation.metrics),
        "frames": len(evaluation.evaluated),
        "predicted_share": evaluation.predicted_share,
        "scale": 1.0 if network.spec.scale is None else network.spec.scale,
    }
    if network.spec.has_shift:
        metrics["shift"] = network.spec.shift
    print_figures(f"{model} on {source}", metrics, json)


@app.command()
def export(
    network: Annotated[
        Path, typer.Argument(metavar="NETWORK", help="Network to export, a network.safetensors.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help=".onnx file to write.")],
    int8: Annotated[
        str | None,
        typer.Option("--int8", metavar="SOURCE", help="Quantise to 8 bits, calibrated on images of this recording."),
    ] = None,
    frames: FramesOption = "::",
    json: JsonOption = False,
) -> None:
    """Export a network to ONNX and check that its depth is the same.

    \b
    Examples:
      monoloc depth export one-third/network.safetensors --out depth.onnx
      monoloc depth export one-third/network.safetensors --out small.onnx --int8 folder:nyu-labelled --frames ::10
    """
    if is_shipped(str(network)):
        problem = f"{network} comes with monoloc in ONNX already"
        raise SettingError("network", problem, "use its name, as in build --network")
    check_outputs({"--out": out}, (network, int8))
    check_suffix(out, "--out", ".onnx", "an ONNX file")
    if int8 is None:
        refuse_frames(frames, "an export in 32 bits")
    with training_extra():
        from monoloc.depth.training.checkpoint import load_network
        from monoloc.depth.training.export import export_onnx
        from monoloc.depth.training.quantise import quantise
    loaded = load_network(network)
    content, report = export_onnx(loaded)
    result: dict[str, object] = asdict(report)
    if int8 is not None:
        recording = open_source(int8, frames)
        with ConsoleProgress(stderr).task("quantise", None):
            images = network_images(recording, monoloc_spec(loaded.config.focal_px))
            content, difference = quantise(content, images)
        result |= asdict(difference)
    write_whole(out, content)
    if json:
        print_json({"onnx": str(out), **result})
        return
    stderr.print(f"{out}: {len(content) / 1e6:.2f} MB, differs by at most {report.parity_max:.1e} in log-depth")
    if int8 is not None:
        mean, most = difference.difference_mean, difference.difference_max
        stderr.print(f"in 8 bits it differs by {mean:.3f} on average, and by at most {most:.2f}")


@app.command(name="list")
def list_models(json: JsonOption = False) -> None:
    """List the networks that come with monoloc.

    \b
    Examples:
      monoloc depth list
      monoloc depth list --json
    """
    models = shipped_models()
    if json:
        print_json({"models": [asdict(model) for model in models]})
        return
    rows = [
        [
            model.name,
            f"{model.parameters / 1e6:.2f} M",
            f"{model.macs / 1e6:.0f} M",
            f"{model.bytes_fp32 / 1e6:.2f}, {model.bytes_int8 / 1e6:.2f}",
            f"{model.absrel:.3f}, {model.absrel_int8:.3f}",
            f"{model.delta1:.3f}, {model.delta1_int8:.3f}",
        ]
        for model in models
    ]
    columns = ["name", "params", "MACs", "MB", "AbsRel", "delta1"]
    print_table("Networks in 32 bits, and in 8 bits as NAME-int8; evaluated on 100 NYU pairs", columns, rows)


def _predict(predictor: DepthPredictor, recording: Recording, index: int) -> NDArray[np.float32]:
    """Predicted depth of a frame at the size of its image, 0 where it is unknown."""
    return predictor(recording.color(index)).resized(recording.camera.width, recording.camera.height)
