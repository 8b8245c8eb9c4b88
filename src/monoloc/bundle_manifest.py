"""The manifest of a bundle, sealed against edits, in this schema and earlier ones."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from monoloc.camera import Camera
from monoloc.config import describe
from monoloc.depth.spec import ModelSpec
from monoloc.edit_record import EditRecord
from monoloc.errors import BundleError
from monoloc.files import read_regular, target_of
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.supervision.integrity import IntegrityModel, SensorModel

SCHEMA = 11
"""Of the bundles that are written."""

READ_SCHEMAS = (9, 10, 11)
"""Of bundles that can be read: what later ones keep beyond these is derived, or has a default."""

MANIFEST = "manifest.json"
PLACE_MANIFEST, PLACE_INDEX = "place.json", "index.npz"
"""Of a place, a folder that names bundles, see :mod:`monoloc.place`."""
NETWORK = "depth.onnx"
"""The network of a bundle."""
COPY_AGAIN = "copy the bundle again or rebuild it"
CHECK_PERMISSIONS = "check the permissions of file and folder, or copy the bundle again"
_VERSIONS = "reference/versions"  # the page that says which schemas are read
_GreyLevel = Annotated[float, Field(ge=0.0, le=255.0)]


class Provenance(BaseModel):
    """Where a bundle comes from.

    Attributes:
        recording: name of the recording.
        frames: name and :func:`fingerprint` of every frame that built the map or tuned the network.
        tune, map_transform, lambda_kl: the adaptation's variant.
        seed: of the build.
        down_world: direction of gravity where the recording states it; or else the mean direction of the cameras' y
            axes over those frames: down, if the camera looked level on average; zero where that is not down.
        knows_down: whether the recording states it.
        kept_down: else, what floor and walls showed before an edit, so that edits do not turn the level.
        scale_sd: relative standard deviation of the map's scale; None where a sensor measured it.
        brightness: median grey level, of 255, of the build's images: mean and standard deviation over the images;
            None in bundles that do not keep it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    recording: str
    frames: dict[str, int]
    tune: str
    map_transform: bool
    lambda_kl: float
    seed: int
    down_world: tuple[float, float, float] = (0.0, 1.0, 0.0)
    knows_down: bool = False
    kept_down: tuple[float, float, float] | None = None
    scale_sd: float | None = None
    brightness: tuple[_GreyLevel, _GreyLevel] | None = None


class CloudSize(BaseModel):
    """Of the cloud that the map was fitted to: what is added to the map gets as many components a point.

    Attributes:
        points: in the cloud, one a voxel.
        voxel_m: edge of a voxel.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    points: int = Field(ge=1)
    voxel_m: float = Field(gt=0.0)


class Manifest(BaseModel):
    """The bundle's table of contents; see :class:`Bundle` for the parts."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_version: int
    monoloc_version: str
    sha256: dict[str, str]
    network: str
    network_spec: ModelSpec
    settings: LocalizerConfig
    camera: Camera
    provenance: Provenance
    thresholds: LikelihoodThresholds
    integrity: IntegrityModel
    sensor: SensorModel
    cloud: CloudSize | None = None
    edits: list[EditRecord] = []


def seal(manifest: Manifest) -> bytes:
    """The manifest as JSON with the digest of all the rest of it, so that an edit shows."""
    body = manifest.model_dump(mode="json")
    body["manifest_sha256"] = digest(body)
    return json.dumps(body, indent=1).encode()


def digest(body: dict[str, object]) -> str:
    """SHA-256 of a manifest's content, whatever its layout."""
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def manifest_content(path: Path) -> bytes:
    """A bundle's manifest, as it lies there.

    Raises:
        BundleError: there is no bundle at the path, or another one in it.
    """
    file = path / MANIFEST
    try:
        content = read_regular(file)
    except PermissionError as error:
        raise BundleError(file, f"cannot be read ({error.strerror})", CHECK_PERMISSIONS) from error
    except OSError as error:
        if not path.exists():
            fix = "check the path, or make it by: monoloc build"
            raise BundleError(path, "is not a bundle (there is no such folder)", fix) from error
        if (path / PLACE_MANIFEST).is_file():
            fix = "name the bundle of one of its rooms: monoloc place info lists them"
            raise BundleError(path, "is a place, and this takes one room", fix, "how-to/many-rooms") from error
        raise BundleError(path, f"is not a bundle (no {MANIFEST})", "give a folder made by: monoloc build") from error
    except ValueError as error:
        raise BundleError(file, "is cut short or edited", COPY_AGAIN) from error
    _check_alone(path)
    return content


def _check_alone(path: Path) -> None:
    """Refuse a bundle with another one in it: the outer one is the older, which nobody means to fly any more.

    ``cp -r`` and ``scp -r`` put a folder into one of the same name that is there already.
    """
    inner = next((file.parent for file in path.glob(f"*/{MANIFEST}")), None)
    if inner is not None:
        fix = f"remove {path.name}, and copy the bundle that you mean to its place"
        raise BundleError(path, f"has another bundle in it ({inner.name}), which a copy put there", fix)


def parse_manifest(content: bytes, file: Path) -> Manifest:
    """The manifest that a file holds.

    Raises:
        BundleError: it was cut short or edited, or is of a schema that cannot be read.
    """
    try:
        body = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise BundleError(file, "is cut short or edited", COPY_AGAIN) from error
    if not isinstance(body, dict) or body.get("schema_version") not in READ_SCHEMAS:
        raise _unknown_schema(file, body)
    if body.pop("manifest_sha256", None) != digest(body):
        raise BundleError(file, "was edited", COPY_AGAIN)
    try:
        return Manifest.model_validate(body)
    except ValidationError as error:
        raise BundleError(file, describe(error), "rebuild it with this version") from error


def _unknown_schema(file: Path, body: object) -> BundleError:
    """The error that names its schema, and what to rebuild it from if the manifest holds that."""
    entries = body if isinstance(body, dict) else {}
    found = entries.get("schema_version")
    problem = f"has schema {found}, this monoloc reads {READ_SCHEMAS[0]} to {SCHEMA}"
    if isinstance(found, int) and found > SCHEMA:
        return BundleError(file, problem, "read it with the monoloc that wrote it, or a newer one", _VERSIONS)
    provenance = entries.get("provenance")
    provenance = provenance if isinstance(provenance, dict) else {}
    recording, frames = provenance.get("recording"), provenance.get("frames")
    if not isinstance(recording, str) or not isinstance(frames, dict) or not frames:
        return BundleError(file, problem, "rebuild it with this version", _VERSIONS)
    names = list(frames)
    what = f"the {len(names)} frames {names[0]} to {names[-1]} of {recording}"
    return BundleError(file, problem, f"rebuild it with this version from {what}", _VERSIONS)


def container_of(path: Path) -> str | None:
    """The bundle or place that a path lies in, in words; each is a folder of its own, which is replaced whole."""
    for parent in (*path.parents, *target_of(path).parents):
        if (parent / MANIFEST).is_file() and (parent / NETWORK).is_file():
            return f"the bundle {parent}"
        if (parent / PLACE_MANIFEST).is_file() and (parent / PLACE_INDEX).is_file():
            return f"the place {parent}"
    return None
