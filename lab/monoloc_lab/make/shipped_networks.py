"""Export trained networks into the package, in 32 and 8 bits, with the catalogue.

    python -m monoloc_lab.make.shipped_networks --runs runs/family --data ../shared/data/nyu-labelled

Reads ``runs/family/NAME/network.safetensors`` and writes into ``src/monoloc/depth/models``.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from monoloc.depth import models
from monoloc.depth.model_files import read_model
from monoloc.depth.models import ShippedModel
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import monoloc_spec, network_images, network_size
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.export import export_onnx
from monoloc.depth.training.family import SIZES
from monoloc.depth.training.quantise import quantise
from monoloc.evaluation.network_evaluation import evaluate_network
from monoloc.io.registry import open_recording, select_frames

_CALIBRATION, _VALIDATION = "0:1349:10", "1349:"
_WIDTH = 0.35


def export_all(runs: Path, data: Path, out: Path) -> None:
    """Export every network of the family.

    Args:
        data: NYU's labelled pairs, in the ``folder`` format.
        out: folder of the ONNX files and ``models.json``.
    """
    pairs = open_recording(f"folder:{data}")
    calibration, validation = select_frames(pairs, _CALIBRATION), select_frames(pairs, _VALIDATION)
    catalogue = []
    for name in (f"{size}-{_WIDTH}" for size in SIZES):
        network = load_network(runs / name / "network.safetensors")
        camera = calibration.camera.resized(*network_size(calibration.camera, network.config.focal_px))
        content, report = export_onnx(network)
        small, difference = quantise(content, network_images(calibration, monoloc_spec(network.config.focal_px)))
        metrics = []
        for suffix, onnx in (("", content), ("-int8", small)):
            path = out / f"{name}{suffix}.onnx"
            path.write_bytes(onnx)
            predictor = DepthPredictor(read_model(path), validation.camera)
            metrics.append(evaluate_network(predictor, validation).metrics)
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
                delta1=round(metrics[0].delta1, 4),
                absrel=round(metrics[0].absrel, 4),
                delta1_int8=round(metrics[1].delta1, 4),
                absrel_int8=round(metrics[1].absrel, 4),
            )
        )
        print(name, report, difference)
    (out / "models.json").write_text(json.dumps([asdict(model) for model in catalogue], indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, required=True, help="folder of the trained networks")
    parser.add_argument("--data", type=Path, required=True, help="NYU's labelled pairs")
    parser.add_argument("--out", type=Path, default=Path(models.__file__).parent)
    arguments = parser.parse_args()
    export_all(arguments.runs, arguments.data, arguments.out)


if __name__ == "__main__":
    main()
