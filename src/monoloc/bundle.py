"""The bundle: a room as a folder ``NAME.monoloc`` that is copied to the drone.

``manifest.json`` (schema, SHA-256 of every file, specification of the network, settings, camera, provenance,
likelihood thresholds, list of edits), ``map.npz`` (original and adapted mixture, the transform between them,
reference poses and the bias at each), ``landmarks.npz``, ``depth.onnx``, and ``edits.npz`` (what undoes the edits)
where there are any. It is written whole or not at all, and read only if every byte is as written. A signature
(:mod:`monoloc.bundle_signature`) may lie beside them.
"""

from __future__ import annotations

import hashlib
import os
import zlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import decode_arrays, encode_arrays
from monoloc.bundle_manifest import (
    CHECK_PERMISSIONS,
    COPY_AGAIN,
    MANIFEST,
    NETWORK,
    SCHEMA,
    Manifest,
    container_of,
    manifest_content,
    parse_manifest,
    seal,
)
from monoloc.bundle_manifest import CloudSize as CloudSize
from monoloc.bundle_manifest import Provenance as Provenance
from monoloc.bundle_signature import SIGNATURE, read_public_key
from monoloc.camera import Camera
from monoloc.depth.model_files import read_model
from monoloc.depth.models import is_shipped
from monoloc.depth.network_check import check_network
from monoloc.depth.spec import DepthModel
from monoloc.edit_record import Edit
from monoloc.errors import BundleError
from monoloc.files import read_regular, target_of, write_folder
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, se3_exp, se3_log
from monoloc.landmarks.landmark_map import LEAST_RELOCALIZED, Landmarks
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.down_direction import down_of
from monoloc.map.learnt_transform import LearntTransform
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.estimate import UNKNOWN_POSITION_SD_M
from monoloc.supervision.integrity import IntegrityModel, SensorModel
from monoloc.version import __version__

_MAP, _LANDMARKS, _EDITS = "map.npz", "landmarks.npz", "edits.npz"
_CONTENTS = (_MAP, _LANDMARKS, NETWORK)
_TRANSFORM = "transform_"
_WRITABLE = 0o222  # write bits of owner, group and others
_REFERENCES = ("reference_poses", "forward_bias", "backward_bias")  # twists (V, 6), float32


@dataclass(frozen=True)
class Bundle:
    """A room that a camera can be localised in.

    Attributes:
        original, adapted: the room's mixture and the one the filter uses, world frame.
        depth_model: the depth network; one that is not our own comes with the scale and shift fitted to the room.
        settings: settings of the localizer, including the calibrated ones.
        camera: the colour camera of the build recording.
        provenance: what it was built from.
        thresholds: thresholds of the scan's likelihood.
        reference_poses: poses of the frames that built it, with the bias at each.
        landmarks: landmarks that these frames saw.
        integrity: what distinguishes right from wrong beliefs in the room.
        sensor: the same for a depth sensor in place of the network.
        transform: from the original to the adapted map; None if both are the same.
        cloud: size of the cloud that the map was fitted to; None in bundles of earlier versions, which lack it.
        edits: edits of the map since the build, the newest last.
    """

    original: GaussianMixture
    adapted: GaussianMixture
    depth_model: DepthModel
    settings: LocalizerConfig
    camera: Camera
    provenance: Provenance
    thresholds: LikelihoodThresholds
    reference_poses: ReferencePoses
    landmarks: Landmarks = field(default_factory=Landmarks.none)
    integrity: IntegrityModel = field(default_factory=IntegrityModel)
    sensor: SensorModel = field(default_factory=SensorModel)
    transform: LearntTransform | None = None
    cloud: CloudSize | None = None
    edits: tuple[Edit, ...] = ()

    @property
    def supports_relocalization(self) -> bool:
        """Whether a lost camera can be found: by landmarks, or by scans that distinguish the room's places."""
        by_landmarks = self.supports_landmark_search and len(self.reference_poses) > 0
        return self.supports_scan_search or by_landmarks

    @property
    def supports_scan_search(self) -> bool:
        """Whether one scan can tell where in the room a lost camera is."""
        tells = self.integrity.supports_scan_search and len(self.reference_poses) > 0
        # A belief that begins so wide would be lost again before anything confirms it.
        tells &= self.settings.particle_bias.relocalization_sd_m < UNKNOWN_POSITION_SD_M
        return tells and not {"scan", "relocalization"} & {*self.settings.without}

    @property
    def supports_landmark_search(self) -> bool:
        """Whether landmarks can tell where in the room a lost camera is."""
        is_left_out = bool({"landmarks", "relocalization"} & {*self.settings.without})
        return len(self.landmarks) >= LEAST_RELOCALIZED and not is_left_out

    @cached_property
    def down(self) -> FloatArray | None:
        """Direction of gravity, (3,) unit vector, world frame.

        None if neither the recording nor the room's surfaces show it.
        """
        down = np.asarray(self.provenance.down_world)
        if self.provenance.knows_down:
            return down
        kept = self.provenance.kept_down
        return down_of(self.original, down) if kept is None else np.asarray(kept)


def require_bundle(bundle: object) -> None:
    """Refuse what is no bundle: for a path, the error would come from deep inside.

    Raises:
        TypeError: it is a path, or anything else.
    """
    if not isinstance(bundle, Bundle):
        raise TypeError(f"bundle must be a bundle, as monoloc.load(PATH) gives it, got {type(bundle).__name__}")


def fingerprint(color: NDArray[np.uint8]) -> int:
    """Checksum of an image, which identifies a frame whatever its name."""
    return zlib.crc32(np.ascontiguousarray(color).tobytes())


def digest_of(path: Path) -> str:
    """SHA-256 of a bundle's manifest, which holds those of the other files: equal only for the same bundle.

    Raises:
        BundleError: there is no bundle at the path.
    """
    return hashlib.sha256(manifest_content(path)).hexdigest()


def check_target(path: Path) -> None:
    """Refuse a path where a bundle must not be written, before the work is done.

    Raises:
        BundleError: ``path`` exists and is not a bundle, holds more than a bundle or is write-protected; its parent
            folder cannot be written to; or it lies in a bundle or a place.
    """
    if (container := container_of(path)) is not None:
        raise BundleError(path, f"lies in {container}", "choose another folder")
    parent = target_of(path).parent if path.is_symlink() else path.parent
    if not parent.is_dir():
        raise BundleError(path, "its folder does not exist", f"make {parent} first")
    if not os.access(parent, os.W_OK):
        raise BundleError(path, "its folder cannot be written to", "choose another folder")
    if path.exists() and not (path / MANIFEST).is_file():
        raise BundleError(path, "exists and is not a bundle", "choose another name")
    # A folder is replaced whole: what monoloc did not put there must not go with it.
    known = {MANIFEST, SIGNATURE, _EDITS, *_CONTENTS}
    parts = [path, *sorted(path.iterdir())] if path.exists() else []
    if others := [part.name for part in parts[1:] if part.name not in known]:
        raise BundleError(path, f"holds more than a bundle ({others[0]})", "move that away or choose another name")
    # The system would allow it, since the folder around it changes; who protects a bundle wants it to stay. To root
    # the system allows all, so the mode counts too.
    if not all(os.access(part, os.W_OK) and part.stat().st_mode & _WRITABLE for part in parts):
        raise BundleError(path, "is write-protected", f"choose another name, or run: chmod -R u+w {path}")


def replaced_edits(path: Path) -> int:
    """Number of edits of the bundle that :func:`write_bundle` would replace; 0 if none can be read."""
    try:
        return len(parse_manifest(manifest_content(path), path / MANIFEST).edits)
    except BundleError:
        return 0


def write_bundle(path: str | Path, bundle: Bundle) -> int:
    """Write a bundle, replacing an older one with its signature, also through a link; returns its size in bytes.

    Raises:
        BundleError: as in :func:`check_target`.
        DataError: the disk cannot hold it.
        TypeError: path and bundle are given in the other order, or the bundle is none.
    """
    if not isinstance(bundle, Bundle):
        raise TypeError(f"bundle must be a bundle, after its path, got {type(bundle).__name__}")
    path = Path(path)
    check_target(path)
    return write_folder(path, contents_of(bundle))


def contents_of(bundle: Bundle) -> dict[str, bytes]:
    """The files of a bundle, by name, as :func:`write_bundle` writes them."""
    contents = {
        _MAP: _pack_maps(bundle),
        _LANDMARKS: encode_arrays(bundle.landmarks.to_arrays()),
        NETWORK: bundle.depth_model.content,
    }
    if bundle.edits:
        undo = {str(number): np.frombuffer(edit.undo, np.uint8) for number, edit in enumerate(bundle.edits)}
        contents[_EDITS] = encode_arrays(undo)
    manifest = Manifest(
        schema_version=SCHEMA,
        monoloc_version=__version__,
        sha256={name: hashlib.sha256(content).hexdigest() for name, content in contents.items()},
        network=bundle.depth_model.name,
        network_spec=bundle.depth_model.spec,
        settings=bundle.settings,
        camera=bundle.camera,
        provenance=bundle.provenance,
        thresholds=bundle.thresholds,
        integrity=bundle.integrity,
        sensor=bundle.sensor,
        cloud=bundle.cloud,
        edits=[edit.record for edit in bundle.edits],
    )
    contents[MANIFEST] = seal(manifest)
    return contents


def read_bundle(path: str | Path, public_key: str | Path | None = None) -> Bundle:
    """Read a bundle and check it byte for byte.

    Args:
        path: path of the bundle.
        public_key: file with the key of the required signer; None accepts a bundle from anybody.

    Raises:
        BundleError: it is not a bundle, is cut short or edited, has an unknown schema or a network that
            :func:`monoloc.depth.network_check.check_network` refuses, or lacks the required signature.
        DataError, MissingExtraError: as in :func:`monoloc.bundle_signature.read_public_key`; only with a key.
    """
    path = Path(path)
    key = None if public_key is None else read_public_key(public_key)
    while True:
        content = manifest_content(path)
        try:
            if key is not None:
                key.check(path, content)
            return read_described(path, content)
        except BundleError:
            if manifest_content(path) == content:  # else, another command has replaced it meanwhile
                raise


def read_described(path: Path, content: bytes) -> Bundle:
    """Read the bundle that a manifest describes, and check it byte for byte.

    Args:
        content: of the manifest, which may have been replaced since.

    Raises:
        BundleError: as :func:`read_bundle`, or the files are those of another manifest.
    """
    manifest = parse_manifest(content, path / MANIFEST)
    contents = {name: _read_content(path / name, manifest) for name in _CONTENTS}
    check_network(contents[NETWORK], path / NETWORK, BundleError)
    try:
        arrays = decode_arrays(contents[_MAP])
        original, adapted = (GaussianMixture.from_arrays(arrays, name) for name in ("original_", "adapted_"))
        poses, forward, backward = (arrays[name].reshape(-1, 6).astype(np.float64) for name in _REFERENCES)
        reference_poses = ReferencePoses(se3_exp(poses), forward, backward)
        transform = LearntTransform.from_arrays(arrays, _TRANSFORM)
        if transform is None and manifest.provenance.map_transform:  # bundles of earlier versions
            transform = LearntTransform.between(original, adapted)
    except (KeyError, ValueError, TypeError) as error:
        raise BundleError(path / _MAP, f"is no map ({error})", "rebuild it with this version") from error
    try:
        landmarks = Landmarks.from_arrays(decode_arrays(contents[_LANDMARKS]))
    except (KeyError, ValueError, TypeError) as error:
        fix = "rebuild it with this version"
        raise BundleError(path / _LANDMARKS, f"holds no landmarks ({error})", fix) from error
    return Bundle(
        original=original,
        adapted=adapted,
        depth_model=DepthModel(contents[NETWORK], manifest.network_spec, manifest.network),
        settings=manifest.settings,
        camera=manifest.camera,
        provenance=manifest.provenance,
        thresholds=manifest.thresholds,
        reference_poses=reference_poses,
        landmarks=landmarks,
        integrity=manifest.integrity,
        sensor=manifest.sensor,
        transform=transform,
        cloud=manifest.cloud,
        edits=_read_edits(path, manifest),
    )


def check_bytes(path: Path, content: bytes) -> None:
    """Check a bundle byte for byte, one file after another, without interpreting the files.

    Args:
        content: of its manifest.

    Raises:
        BundleError: it is not a bundle, is cut short or edited, or has an unknown schema.
    """
    manifest = parse_manifest(content, path / MANIFEST)
    for name in (*_CONTENTS, *((_EDITS,) if manifest.edits else ())):
        _read_content(path / name, manifest)


def _read_content(file: Path, manifest: Manifest) -> bytes:
    try:
        content = read_regular(file)
    except FileNotFoundError as error:
        raise BundleError(file, "is missing", "copy the bundle again, whole") from error
    except OSError as error:
        raise BundleError(file, f"cannot be read ({error.strerror})", CHECK_PERMISSIONS) from error
    except ValueError as error:
        raise BundleError(file, f"is not what was written ({error})", COPY_AGAIN) from error
    if hashlib.sha256(content).hexdigest() != manifest.sha256.get(file.name):
        raise BundleError(file, "is not what was written", COPY_AGAIN)
    return content


def _read_edits(path: Path, manifest: Manifest) -> tuple[Edit, ...]:
    if not manifest.edits:
        return ()
    content = _read_content(path / _EDITS, manifest)
    try:
        undo = decode_arrays(content)
        return tuple(Edit(record, undo[str(number)].tobytes()) for number, record in enumerate(manifest.edits))
    except (KeyError, ValueError, TypeError) as error:
        raise BundleError(path / _EDITS, f"does not hold the edits ({error})", COPY_AGAIN) from error


def read_network(network: str | Path) -> DepthModel:
    """Read a depth network from a bundle, or from anything that :func:`monoloc.depth.model_files.read_model` takes.

    Raises:
        BundleError: the folder is not a bundle.
        DataError, MissingExtraError: as in :func:`monoloc.depth.model_files.read_model`.
    """
    if Path(network).is_dir() and not is_shipped(str(network)):
        return read_bundle(Path(network)).depth_model
    return read_model(network)


def _pack_maps(bundle: Bundle) -> bytes:
    arrays: dict[str, Any] = bundle.original.to_arrays("original_") | bundle.adapted.to_arrays("adapted_")
    if bundle.transform is not None:
        arrays |= bundle.transform.to_arrays(_TRANSFORM)
    known = bundle.reference_poses
    values = (se3_log(known.poses), known.forward_bias, known.backward_bias)
    for name, twists in zip(_REFERENCES, values, strict=True):
        arrays[name] = twists.astype(np.float32)
    return encode_arrays(arrays)
