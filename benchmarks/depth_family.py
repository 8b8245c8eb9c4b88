"""The family of depth networks: pack what was trained into the package, and measure it.

    python benchmarks/depth_family.py pack --runs runs/family --data ../shared/data
    python benchmarks/depth_family.py measure --data ../shared/data --out runs/figures

``pack`` exports every ``runs/family/NAME/network.safetensors`` in 32 and 8 bits into ``src/monoloc/depth/models`` and
writes the catalogue. ``measure`` prints the report's tables: accuracy on NYU's last 100 pairs and on RedKitchen,
whose camera and room were not trained on, latency on one core, and where the time goes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray

from monoloc.depth.model_files import DepthModel, read_model
from monoloc.depth.models import DEFAULT, ShippedModel, shipped_models
from monoloc.evaluation.network_evaluation import Judgement, judge_network
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.scale_fit import fit_to_depth
from monoloc.depth.spec import monoloc_spec, network_images, network_size
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.export import export_onnx
from monoloc.depth.training.family import SIZES
from monoloc.depth.training.quantise import quantise
from monoloc.evaluation.uncertainty import plot_calibration
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording, select_frames
from monoloc.viz.plots import plot_depth

_MODELS = Path(__file__).parents[1] / "src" / "monoloc" / "models"
_TRAINING, _VALIDATION = "0:1349", "1349:"
_WIDTH = 0.35
_REDKITCHEN_BUILD, _REDKITCHEN = "0:400:8", "2:400:8"
_TIMED_RUNS = 300


def pairs_of(data: Path, frames: str) -> Recording:
    return select_frames(open_recording(f"folder:{data / 'nyu-labelled'}"), frames)


def redkitchen(data: Path, frames: str) -> Recording:
    return select_frames(open_recording(f"7scenes:{data / '7scenes' / 'redkitchen'}"), frames)


def pack(runs: Path, data: Path) -> None:
    training, validation = pairs_of(data, _TRAINING + ":10"), pairs_of(data, _VALIDATION)
    catalogue = []
    for name in (f"{size}-{_WIDTH}" for size in SIZES):
        network = load_network(runs / name / "network.safetensors")
        camera = training.camera.resized(*network_size(training.camera, network.config.focal_px))
        content, report = export_onnx(network)
        small, difference = quantise(content, network_images(training, monoloc_spec(network.config.focal_px)))
        figures = []
        for suffix, onnx in (("", content), ("-int8", small)):
            (_MODELS / f"{name}{suffix}.onnx").write_bytes(onnx)
            figures.append(judge(read_model(_MODELS / f"{name}{suffix}.onnx"), validation).metrics)
        catalogue.append(
            ShippedModel(
                name=name,
                width=network.config.width,
                parameters=network.parameter_count(),
                macs=network.multiply_adds(camera.width, camera.height),
                bytes_fp32=report.bytes,
                bytes_int8=difference.bytes,
                input_width=camera.width,
                input_height=camera.height,
                delta1=round(figures[0].delta1, 4),
                absrel=round(figures[0].absrel, 4),
                delta1_int8=round(figures[1].delta1, 4),
                absrel_int8=round(figures[1].absrel, 4),
            )
        )
        print(name, report, difference)
    (_MODELS / "models.json").write_text(json.dumps([asdict(model) for model in catalogue], indent=1) + "\n")


def judge(model: DepthModel, recording: Recording) -> Judgement:
    return judge_network(DepthPredictor(model, recording.camera), recording)


def scaled(model: DepthModel, scale: float) -> DepthModel:
    return replace(model, spec=model.spec.model_copy(update={"scale": scale}))


class Cropped:
    """The middle of a recording's images: a camera of half the width and height and so of a narrower view."""

    def __init__(self, source: Recording) -> None:
        full = source.camera
        self._left, self._top = full.width // 4, full.height // 4
        self.camera = full.cropped(self._left, self._top, full.width // 2, full.height // 2)
        self.name, self.frame_names, self.timestamps_s = source.name, source.frame_names, source.timestamps_s
        self.poses, self.has_depth = source.poses, source.has_depth
        self._source = source

    def __len__(self) -> int:
        return len(self._source)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self._crop(self._source.color(index))

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._crop(self._source.depth(index))

    def _crop(self, image: NDArray[Any]) -> NDArray[Any]:
        return image[self._top :, self._left :][: self.camera.height, : self.camera.width].copy()


def fitted_scale(model: DepthModel, recording: Recording) -> float:
    """One scale for all frames of a recording."""
    scale = fit_to_depth(model, recording, recording.depth, lambda done: None).spec.scale
    assert scale is not None
    return scale


def canonical_table(data: Path, name: str) -> list[list[object]]:
    """AbsRel on RedKitchen, whole images and their middles, with and without the canonical focal length.

    Without it the network is fed images of one width, as it was on average trained on. Scales are fitted on build
    frames: each view its own, and the whole view's for the middle, as for a drone that changes its lens.
    """
    rows = []
    build, test = redkitchen(data, _REDKITCHEN_BUILD), redkitchen(data, _REDKITCHEN)
    model = read_model(name)
    fixed = model.spec.model_copy(update={"width": 160, "height": 128, "focal_px": None})
    for label, used in (("canonical", model), ("160 x 128 whatever the lens", replace(model, spec=fixed))):
        scale, narrow_scale = fitted_scale(used, build), fitted_scale(used, Cropped(build))
        whole = judge(scaled(used, scale), test).metrics.absrel
        own, kept = (judge(scaled(used, s), Cropped(test)).metrics.absrel for s in (narrow_scale, scale))
        rows.append([label, scale, whole, narrow_scale, own, kept])
    return rows


def latencies(content: bytes, width: int, height: int) -> list[float]:
    """Milliseconds of runs on one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, height, width)).astype(np.float32)
    times = []
    for _ in range(_TIMED_RUNS):
        started = time.perf_counter()
        session.run(None, {"image": image})
        times.append(1e3 * (time.perf_counter() - started))
    return times[_TIMED_RUNS // 10 :]


def profile(content: bytes, width: int, height: int) -> list[tuple[str, float]]:
    """Share of the time of every kind of operator, the largest first."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_profiling = True
    with tempfile.TemporaryDirectory() as folder:
        options.profile_file_prefix = str(Path(folder) / "profile")
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        for _ in range(50):
            session.run(None, {"image": np.zeros((1, 3, height, width), np.float32)})
        events = json.loads(Path(session.end_profiling()).read_text())
    times: Counter[str] = Counter()
    for event in events:
        if event.get("cat") == "Node" and event["name"].endswith("kernel_time"):
            times[event["args"]["op_name"]] += event["dur"]
    return [(name, time_ / sum(times.values())) for name, time_ in times.most_common(6)]


def peak_gflops() -> float:
    """What one thread reaches in a large matrix product, multiplications and additions counted singly."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    a = torch.rand(1024, 1024)
    best = 1e9
    for _ in range(20):
        started = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - started)
    torch.set_num_threads(threads)
    return 2 * 1024**3 / best / 1e9


def measure(data: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    validation = pairs_of(data, _VALIDATION)
    build, kitchen = redkitchen(data, _REDKITCHEN_BUILD), redkitchen(data, _REDKITCHEN)
    pictures = np.linspace(0, len(validation) - 1, 4).astype(int)
    calibrations = {}
    accuracy, kitchen_rows, speed = [], [], []
    peak = peak_gflops()
    for entry in shipped_models():
        for bits, name in (("fp32", entry.name), ("int8", f"{entry.name}-int8")):
            model = read_model(name)
            judgement = judge(model, validation)
            m = judgement.metrics
            accuracy.append([name, m.delta1, m.delta2, m.delta3, m.absrel, m.rmse_m, m.log10, m.ssim])
            scale = fitted_scale(model, build)
            m = judge(scaled(model, scale), kitchen).metrics
            kitchen_rows.append([name, scale, m.delta1, m.delta2, m.delta3, m.absrel, m.rmse_m, m.log10, m.ssim])
            if bits == "fp32":
                predictor = DepthPredictor(model, validation.camera)
                if judgement.calibration is not None:
                    calibrations[name] = judgement.calibration
                shown = [int(i) for i in pictures]
                truths = [validation.depth(i) for i in shown]
                depths = [
                    predictor(validation.color(i)).resized(*truth.shape[::-1])
                    for i, truth in zip(shown, truths, strict=True)
                ]
                plot_depth(out / f"{name}.png", [validation.color(i) for i in shown], depths, truths)
            times = latencies(model.content, 160, 128)
            gflops = 2 * entry.macs / np.median(times) / 1e6
            parts = ", ".join(f"{op} {share:.0%}" for op, share in profile(model.content, 160, 128))
            speed.append(
                [name, entry.parameters, entry.macs / 1e6, len(model.content), np.median(times),
                 np.percentile(times, 95), gflops, gflops / peak, parts]
            )  # fmt: skip
            print(name, "measured", flush=True)
    plot_calibration(out / "calibration.png", calibrations)
    print(f"peak of one thread (fp32 matrix product): {peak:.0f} GFLOP/s")
    print_rows("| NYU, last 100 | delta1 | delta2 | delta3 | AbsRel | RMSE, m | log10 | SSIM |", accuracy)
    print_rows("| RedKitchen | scale | delta1 | delta2 | delta3 | AbsRel | RMSE, m | log10 | SSIM |", kitchen_rows)
    print_rows(
        "| RedKitchen, full-0.35 | scale | AbsRel | scale of the middle | AbsRel | AbsRel with the whole's scale |",
        canonical_table(data, DEFAULT),
    )
    print_rows("| 160 x 128 | parameters | M MACs | bytes | ms | ms p95 | GFLOP/s | of peak | time goes to |", speed)
    rows = [[name, c.nll, c.nll_constant, *c.coverage[[9, 17]]] for name, c in calibrations.items()]
    print_rows("| stated error | NLL, nats | with one scale | within 50% | within 90% |", rows)


def print_rows(header: str, rows: list[list[object]]) -> None:
    print(f"\n{header}\n|" + "---|" * (header.count("|") - 1))
    for row in rows:
        print("| " + " | ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("pack", "measure"))
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--runs", type=Path, help="folder of the trained networks, for pack")
    parser.add_argument("--out", type=Path, help="folder for pictures, for measure")
    arguments = parser.parse_args()
    if arguments.what == "pack":
        pack(arguments.runs, arguments.data)
    else:
        measure(arguments.data, arguments.out)


if __name__ == "__main__":
    main()
