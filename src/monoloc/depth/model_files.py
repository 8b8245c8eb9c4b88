"""Depth networks by name or file: those that come with monoloc, our own, and any other's ONNX with a TOML."""

from __future__ import annotations

from pathlib import Path

import onnxruntime

from monoloc.config import load_settings
from monoloc.depth.models import is_quantised, is_shipped, shipped_file, shipped_models
from monoloc.depth.predictor import check_input, load_session
from monoloc.depth.spec import FOCAL_KEY, DepthModel, ModelSpec, monoloc_spec
from monoloc.errors import DataError
from monoloc.extras import training_extra

_TOML, _SAFETENSORS = ".toml", ".safetensors"
# A tensor that every network of ours has, and none in 8 bits; looked for in the bytes, for onnx is an extra.
_WEIGHTS = b"encoder.features.0.0.weight"


class _Description(ModelSpec):
    """What a TOML says of a network: :class:`ModelSpec`'s fields, and ``file``, the ONNX beside it."""

    file: str


def read_model(network: str | Path) -> DepthModel:
    """The network of that name, or of a .toml, .onnx or .safetensors file, checked to be loadable.

    Raises:
        DataError: no such network; a description that is wrong or does not fit; a graph that cannot be loaded.
        MissingExtraError: a .safetensors without PyTorch.
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
    return _own_model(path.read_bytes(), path, path.stem)


def trainable_file(network: str | Path) -> Path | None:
    """The file that a network can be tuned from; None for one that can only be run: a bundle's, another's, or one of
    ours in 8 bits.

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
    """The file of a network that does not come with monoloc.

    Raises:
        DataError: it is not there.
    """
    path = Path(network)
    if not path.is_file():
        names = ", ".join(model.name for model in shipped_models())
        fix = f"give a .safetensors, .onnx or .toml file, a bundle, or one of {names}"
        raise DataError(path, "does not exist", fix)
    return path


def _own_model(content: bytes, label: str | Path, name: str) -> DepthModel:
    """A network exported by monoloc, which says itself how it is used."""
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
    """Another's network: a TOML and the ONNX that it names."""
    description = load_settings(path, _Description)
    file = path.parent / description.file
    try:
        content = file.read_bytes()
    except OSError as error:
        raise DataError(path, f"file: {file} cannot be read", "name the ONNX file, relative to the TOML") from error
    spec = ModelSpec(**description.model_dump(exclude={"file"}))
    check_input(load_session(content, file), spec, path)
    return DepthModel(content, spec, path.stem)
