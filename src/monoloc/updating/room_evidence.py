"""What flights have shown of a room, kept beside its bundle, so that it adds up over flights.

``NAME.evidence.npz`` beside ``NAME.monoloc``. A landmark is known by a checksum of its point and descriptor, so that
evidence outlives edits: of landmarks that have gone or moved it is dropped, of new ones there is none yet. Components
are known likewise: where an edit has put a surface, what flights said of the one before is dropped.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import encode_arrays, read_arrays
from monoloc.bundle import Bundle
from monoloc.editing.paired_map import cloud_of
from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.map.local_fit import Components
from monoloc.map.mixture import GaussianMixture
from monoloc.updating.landmark_ageing import Candidates, candidates_after, landmarks_after, without_known
from monoloc.updating.observed_flight import ObservedFlight, views_of
from monoloc.updating.surface_ageing import Cells, CountedVoxels, Surfaces, cells_of, surfaces_after
from monoloc.updating.tally import Tally

_SCHEMA = 1
_MOST_FRAMES, _MOST_FLIGHTS, _MOST_NAME = 20_000, 200, 80  # that are remembered, the newest


@dataclass(frozen=True)
class Evidence:
    """What flights have shown of a room.

    Attributes:
        landmarks: of each landmark of the bundle, that it is gone.
        candidates: corners that may become landmarks.
        surfaces: that are gone or new.
        flights: names of those that were counted, the newest last.
        frames: checksums of the frames that were used, so that none counts twice.
    """

    landmarks: Tally
    candidates: Candidates
    surfaces: Surfaces
    flights: tuple[str, ...] = ()
    frames: tuple[int, ...] = ()

    @classmethod
    def none(cls, bundle: Bundle) -> Evidence:
        """Of a room in which nobody flew since it was built."""
        return cls(Tally.new(len(bundle.landmarks)), Candidates.none(views_of(bundle)), Surfaces.none())

    def after_flight(
        self,
        bundle: Bundle,
        flight: ObservedFlight,
        is_sensor_depth: bool,
        rng: np.random.Generator,
    ) -> Evidence:
        """With what a flight showed; the same if nothing may be learned from it."""
        if flight.refusal is not None:
            return self
        model = bundle.integrity
        return Evidence(
            landmarks_after(self.landmarks, bundle.landmarks, flight, model),
            candidates_after(self.candidates, bundle.landmarks, flight, is_sensor_depth, model),
            surfaces_after(self.surfaces, bundle, flight, rng),
            (*self.flights, flight.name)[-_MOST_FLIGHTS:],
            (*self.frames, *(frame.checksum for frame in flight.frames))[-_MOST_FRAMES:],
        )


def evidence_path(bundle: Path) -> Path:
    """Where the evidence of a bundle lies."""
    return bundle.with_suffix(".evidence.npz")


def write_evidence(path: Path, evidence: Evidence, bundle: Bundle) -> int:
    """Write evidence, whole or not at all; returns its size in bytes.

    Raises:
        DataError: the file cannot be written.
    """
    views = evidence.candidates.corners.views
    assert views is not None
    arrays: dict[str, NDArray[Any]] = {
        "schema": np.array([_SCHEMA]),
        "room": np.array([_room(bundle)]),
        "keys": landmark_keys(bundle.landmarks),
        "component_keys": _component_keys(bundle.original),
        **evidence.landmarks.to_arrays("landmark_"),
        **{f"corner_{name}": array for name, array in evidence.candidates.corners.to_arrays().items()},
        **evidence.candidates.tally.to_arrays("candidate_"),
        "gone": evidence.surfaces.gone.cells.astype(np.int32),
        **evidence.surfaces.gone.tally.to_arrays("gone_"),
        "new": evidence.surfaces.new.cells.astype(np.int32),
        **evidence.surfaces.new.tally.to_arrays("new_"),
        "new_points": evidence.surfaces.points,
        "flights": np.array([name[:_MOST_NAME] for name in evidence.flights], dtype=f"<U{_MOST_NAME}"),
        "frames": np.array(evidence.frames, dtype=np.uint32),
    }
    content = encode_arrays(arrays)
    write_whole(path, content)
    return len(content)


def read_evidence(path: Path, bundle: Bundle) -> Evidence:
    """The evidence of a bundle, as far as it still holds; none where there is no file.

    Raises:
        DataError: the file is damaged, or that of another room.
    """
    if not path.exists():
        return Evidence.none(bundle)
    fix = "remove it, or put it beside its own bundle"
    try:
        arrays = read_arrays(path)
        if arrays["schema"].tolist() != [_SCHEMA]:
            raise ValueError(f"schema {arrays['schema'].tolist()}")
        if arrays["room"].tolist() != [_room(bundle)]:
            raise DataError(path, "is the evidence of another room", fix)
        return _decoded(arrays, bundle)
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", fix) from error
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise DataError(path, f"holds no evidence ({error})", fix) from error


def landmark_keys(landmarks: Landmarks) -> NDArray[np.uint64]:
    """Checksums of L landmarks, (L,): of point and descriptor."""
    rows = np.concatenate([np.ascontiguousarray(landmarks.points).view(np.uint8), landmarks.descriptors], axis=1)
    return _checksums(rows)


def _component_keys(mixture: GaussianMixture) -> NDArray[np.uint64]:
    """Checksums of K components, (K,): of mean and covariance; weights change with every edit."""
    arrays = mixture.to_arrays()
    return _checksums(np.concatenate([arrays["means"], arrays["cholesky"]], axis=1))


def _checksums(rows: NDArray[Any]) -> NDArray[np.uint64]:
    digests = b"".join(blake2b(row.tobytes(), digest_size=8).digest() for row in rows)
    return np.frombuffer(digests, np.uint64)


def realigned(tally: Tally, keys: NDArray[np.uint64], landmarks: Landmarks) -> Tally:
    """The tally of L landmarks, from that of landmarks with keys (N,); of those that it lacks nothing was seen."""
    places = {key: place for place, key in enumerate(keys.tolist())}
    where = np.array([places.get(key, -1) for key in landmark_keys(landmarks).tolist()], dtype=np.int64)
    return (tally + Tally.new(1))[where]


def _decoded(arrays: Mapping[str, NDArray[Any]], bundle: Bundle) -> Evidence:
    gone, new = (
        CountedVoxels(arrays[name].astype(np.int64).reshape(-1, 3), Tally.from_arrays(arrays, f"{name}_"))
        for name in ("gone", "new")
    )
    points = arrays["new_points"].astype(np.float32).reshape(-1, 3)
    if any(len(each.cells) != len(each.tally) for each in (gone, new)) or not np.isfinite(points).all():
        raise ValueError("voxels and their counts differ in number, or points are not finite")
    return Evidence(
        realigned(Tally.from_arrays(arrays, "landmark_"), arrays["keys"], bundle.landmarks),
        _candidates(arrays, bundle),
        Surfaces(gone.without(_edited_cells(arrays, bundle)), new, points),
        tuple(map(str, arrays["flights"].tolist())),
        tuple(map(int, arrays["frames"].tolist())),
    )


def _edited_cells(arrays: Mapping[str, NDArray[Any]], bundle: Bundle) -> Cells:
    """Voxels, (N, 3), of surfaces that edits have put into the map since the evidence was written."""
    components = Components.of(bundle.original, cloud_of(bundle).points)
    keys = _component_keys(bundle.original)
    new = components[~np.isin(keys, arrays.get("component_keys", keys))]  # earlier versions did not keep them
    if not len(new):
        return np.zeros((0, 3), dtype=np.int64)
    count = int(np.ceil(new.mass.sum()))
    return np.unique(cells_of(new.mixture().sample(count, np.random.default_rng(0))), axis=0)


def _candidates(arrays: Mapping[str, NDArray[Any]], bundle: Bundle) -> Candidates:
    """The candidates, seen from the views that the bundle has now; none where its views are others."""
    corners = Landmarks.from_arrays({name.removeprefix("corner_"): array for name, array in arrays.items()})
    tally = Tally.from_arrays(arrays, "candidate_")
    views, now = corners.views, views_of(bundle)
    if views is None or len(tally) != len(corners):
        raise ValueError("corners and their counts differ in number")
    count = min(len(views.poses), len(now.poses))
    if not np.allclose(views.poses[:count], now.poses[:count], atol=1e-5):
        return Candidates.none(now)
    found = np.zeros((len(now.poses), len(corners)), dtype=np.bool_)
    found[:count] = views.found[:count]
    corners = replace(corners, views=LandmarkViews(now.poses, found))
    return without_known(Candidates(corners, tally), bundle.landmarks)


def _room(bundle: Bundle) -> int:
    """Checksum of the build's frames, which edits keep."""
    first = next(iter(bundle.provenance.frames.items()), ("", 0))
    return zlib.crc32(f"{first} {bundle.provenance.seed} {bundle.provenance.tune}".encode())
