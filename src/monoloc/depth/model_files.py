"""Depth networks by name or file: shipped networks, exported monoloc networks, and any ONNX file with a TOML."""

from __future__ import annotations

from pathlib import Path

import onnxruntime

from monoloc.config import load_settings
from monoloc.depth.models import is_quantised, is_shipped, shipped_file, shipped_models
from monoloc.depth.network_check import MOST_NETWORK_BYTES
from monoloc.depth.predictor import check_input
from monoloc.depth.session import load_session
from monoloc.depth.spec import FOCAL_KEY, DepthModel, ModelSpec, monoloc_spec
from monoloc.errors import DataError
from monoloc.extras import training_extra
from monoloc.files import read_regular

_TOML, _SAFETENSORS = ".toml", ".safetensors"
# A tensor of every float monoloc network and of no 8-bit one. The raw bytes are searched, because onnx is an extra.
_WEIGHTS = b"encoder.features.0.0.weight"


class _Description(ModelSpec):
    """TOML description of a network: the fields of :class:`ModelSpec`, and ``file``, the path of its ONNX file."""

    file: str


def read_model(network: str | Path) -> DepthModel:
    """Read a network by name or from a .toml, .onnx or .safetensors file, and check that it can be loaded.

    Raises:
        DataError: no such network, a description that is wrong or does not match the network, or a graph that cannot
            be loaded.
        MissingExtraError: the file is a .safetensors and PyTorch is not installed.
    """
    if is_shipped(str(network)):
        return _own_model(shipped_file(str(network)).read_bytes(), str(network), str(network))
    path = _checked_path(network)
    if path.suffix == _TOML:
        return _described_model(path)
    if path.suffix == _SAFETENSORS:
        with training_extra():
            from monoloc.depth.training.checkpoint import load_network
            from monoloc.depth.training.export import export_model
        return export_model(load_network(path), path.stem)
    return _own_model(_read(path), path, path.stem)


def trainable_file(network: str | Path) -> Path | None:
    """Return the file from which a network can be tuned; None for a network that can only be run.

    Those are the networks of bundles, third-party networks and 8-bit monoloc networks.

    Raises:
        DataError: no such file, or an .onnx that monoloc did not export.
    """
    if is_shipped(str(network)):
        file = shipped_file(str(network))
        return None if is_quantised(str(network)) else file
    if Path(network).is_dir():
        return None
    path = _checked_path(network)
    if path.suffix == _TOML:
        return None
    if path.suffix == _SAFETENSORS:
        return path
    return path if _WEIGHTS in read_model(path).content else None


def _checked_path(network: str | Path) -> Path:
    """Path of a network that is not shipped with monoloc.

    Raises:
        DataError: the file does not exist.
    """
    path = Path(network)
    if not path.is_file():
        names = ", ".join(model.name for model in shipped_models())
        fix = f"give a .safetensors, .onnx or .toml file, a bundle, or one of {names}"
        raise DataError(path, "does not exist", fix)
    return path


def _read(path: Path) -> bytes:
    try:
        return read_regular(path, MOST_NETWORK_BYTES)
    except ValueError as error:
        raise DataError(path, f"cannot be read ({error})", "give a depth network as ONNX") from error


def _own_model(content: bytes, label: str | Path, name: str) -> DepthModel:
    """Load a network that monoloc exported; its metadata says how to use it."""
    session = load_session(content, label)
    focal_px = _canonical_focal_px(session, label)
    model = DepthModel(content, monoloc_spec(focal_px), name)
    check_input(session, model.spec, label)
    return model


def _canonical_focal_px(session: onnxruntime.InferenceSession, label: str | Path) -> float:
    metadata = session.get_modelmeta().custom_metadata_map
    if FOCAL_KEY not in metadata:
        fields = "file, width and height (or focal_px), mean, std, output and metric"
        fix = f"write a TOML with {fields}, and give that (docs/how-to/another-depth-network.md)"
        raise DataError(label, "was not exported by monoloc, so how it is used is not known", fix)
    try:
        focal_px = float(metadata[FOCAL_KEY])
        if 0.0 < focal_px < float("inf"):
            return focal_px
        raise ValueError
    except ValueError as error:
        problem = f"has metadata {FOCAL_KEY} = {metadata[FOCAL_KEY]}, which is no focal length"
        raise DataError(label, problem, "export it with: monoloc depth export") from error


def _described_model(path: Path) -> DepthModel:
    """Load a third-party network: a TOML and the ONNX file that it names."""
    description = load_settings(path, _Description)
    file = path.parent / description.file
    try:
        content = read_regular(file, MOST_NETWORK_BYTES)
    except (OSError, ValueError) as error:
        raise DataError(path, f"file: {file} cannot be read", "name the ONNX file, relative to the TOML") from error
    spec = ModelSpec(**description.model_dump(exclude={"file"}))
    check_input(load_session(content, file), spec, path)
    return DepthModel(content, spec, path.stem)
