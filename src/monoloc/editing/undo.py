"""What undoes an edit: the difference from the bundle after it to the bundle before it.

Tables of a bundle (components, landmarks, reference poses) are compared row by row, as bytes. A row that the edit
left is kept as its place in the new table; a row that it took away or changed is kept whole. Whatever an edit does,
the bytes grow with what it changed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import MOST_ARRAYS, decode_arrays, encode_arrays
from monoloc.bundle import Bundle, CloudSize, Provenance
from monoloc.edit_record import Edit, EditRecord
from monoloc.errors import BundleError, SettingError
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import se3_exp, se3_log
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.supervision.integrity import IntegrityModel, SensorModel

_Rows = NDArray[np.uint8]
_Arrays = dict[str, NDArray[Any]]

# Parts of the manifest that an edit may change, and how each is read again.
_PARTS: dict[str, Callable[[Any], Any]] = {
    "settings": LocalizerConfig.model_validate,
    "thresholds": LikelihoodThresholds.model_validate,
    "integrity": IntegrityModel.model_validate,
    "sensor": SensorModel.model_validate,
    "provenance": Provenance.model_validate,
    "cloud": lambda body: None if body is None else CloudSize.model_validate(body),
}


_FRAMES = "frames"  # beside the parts: number of the provenance's frames that an edit left


def with_edit(before: Bundle, after: Bundle, record: EditRecord) -> Bundle:
    """The edited bundle with one more line in its list of edits, and what undoes it.

    The first line is dropped where there are as many as a bundle's archive may hold.
    """
    arrays: _Arrays = {"weights": before.original.to_arrays()["weights"]}
    views = before.landmarks.views
    count = 0 if views is None else len(views.poses)
    arrays |= _difference("components", _components(before), _components(after))
    arrays |= _difference("landmarks", _landmarks(before, count), _landmarks(after, count))
    arrays |= _difference("references", _references(before), _references(after))
    if views is not None:
        arrays["views"] = se3_log(views.poses).astype(np.float32)
    changed = {name: _body(before, name) for name in _PARTS if getattr(before, name) != getattr(after, name)}
    if "provenance" in changed and (left := _frames_before(before, after)) is not None:
        changed["provenance"]["frames"], changed[_FRAMES] = {}, left
    arrays["manifest"] = np.frombuffer(json.dumps(changed).encode(), np.uint8)
    return replace(after, edits=(*before.edits, Edit(record, encode_arrays(arrays)))[-MOST_ARRAYS:])


def undone(bundle: Bundle) -> Bundle:
    """The bundle as it was before its last edit.

    Raises:
        SettingError: it has none.
        ValueError: what undoes it is damaged.
    """
    if not bundle.edits:
        raise SettingError("undo", "there is no edit to take back", "see: monoloc map edit BUNDLE log")
    arrays = decode_arrays(bundle.edits[-1].undo)
    try:
        return _restored(bundle, arrays)
    except (KeyError, IndexError, TypeError, RecursionError) as error:
        raise ValueError(f"the last edit cannot be taken back ({error})") from error


def states(bundle: Bundle) -> Iterator[Bundle]:
    """The bundle, what it was before its last edit, and so on, to before its first one.

    Raises:
        BundleError: what undoes an edit is damaged.
    """
    yield bundle
    while bundle.edits:
        try:
            bundle = undone(bundle)
        except ValueError as error:
            problem = f"edit {len(bundle.edits)} cannot be taken back ({error})"
            raise BundleError("edits.npz", problem, "copy the bundle again or rebuild it") from error
        yield bundle


def _restored(bundle: Bundle, arrays: _Arrays) -> Bundle:
    components = _before("components", _components(bundle), arrays).view(np.float32).reshape(-1, 2, 9)
    original, adapted = (
        GaussianMixture.from_arrays({"weights": arrays["weights"], "means": each[:, :3], "cholesky": each[:, 3:]})
        for each in (components[:, 0], components[:, 1])
    )
    references = _before("references", _references(bundle), arrays).view(np.float32).reshape(-1, 3, 6)
    poses, forward, backward = (references[:, column].astype(np.float64) for column in range(3))
    changed = json.loads(arrays["manifest"].tobytes())
    if (frames := changed.pop(_FRAMES, None)) is not None:
        if not 0 <= frames <= len(bundle.provenance.frames):
            raise ValueError(f"the last edit cannot be taken back ({frames} frames before it)")
        changed["provenance"]["frames"] = dict(islice(bundle.provenance.frames.items(), frames))
    return replace(
        bundle,
        original=original,
        adapted=adapted,
        landmarks=_landmarks_before(bundle, arrays),
        reference_poses=ReferencePoses(se3_exp(poses), forward, backward),
        edits=bundle.edits[:-1],
        **{name: _PARTS[name](body) for name, body in changed.items()},
    )


def _landmarks_before(bundle: Bundle, arrays: _Arrays) -> Landmarks:
    poses = se3_exp(arrays["views"].astype(np.float64)) if "views" in arrays else None
    rows = _before("landmarks", _landmarks(bundle, 0 if poses is None else len(poses)), arrays)
    points, descriptors = np.ascontiguousarray(rows[:, :12]).view(np.float32), np.ascontiguousarray(rows[:, 12:44])
    if poses is None:
        return Landmarks(points, descriptors)
    found = np.unpackbits(rows[:, 44:], axis=1, count=len(poses)).T.astype(np.bool_)
    return Landmarks(points, descriptors, LandmarkViews(poses, found))


def _frames_before(before: Bundle, after: Bundle) -> int | None:
    """How many of an edited bundle's frames are those from before; None if these are not its first ones.

    Every update adds frames: if each edit kept all from before, bundles would grow with the square of their number.
    """
    earlier, later = list(before.provenance.frames.items()), list(after.provenance.frames.items())
    return len(earlier) if later[: len(earlier)] == earlier else None


def _body(bundle: Bundle, name: str) -> Any:
    value = getattr(bundle, name)
    return None if value is None else value.model_dump(mode="json")


def _components(bundle: Bundle) -> _Rows:
    """Mean and Cholesky factor of each component of both maps, (K, 72); weights change with every edit."""
    parts = [each.to_arrays() for each in (bundle.original, bundle.adapted)]
    return _bytes_of(np.concatenate([part[name] for part in parts for name in ("means", "cholesky")], axis=1))


def _landmarks(bundle: Bundle, views: int) -> _Rows:
    """Point, descriptor and which of the first views found it, of each landmark, (L, 44 + views / 8)."""
    landmarks = bundle.landmarks
    columns = [_bytes_of(landmarks.points), landmarks.descriptors]
    if landmarks.views is not None:
        columns.append(np.packbits(landmarks.views.found[:views].T, axis=1))
    return np.concatenate(columns, axis=1)


def _references(bundle: Bundle) -> _Rows:
    """Twists of pose and biases, (V, 72)."""
    known = bundle.reference_poses
    values = np.concatenate([se3_log(known.poses), known.forward_bias, known.backward_bias], axis=1)
    return _bytes_of(values.astype(np.float32))


def _bytes_of(values: NDArray[np.float32]) -> _Rows:
    return np.ascontiguousarray(values).view(np.uint8)


def _difference(name: str, before: _Rows, after: _Rows) -> _Arrays:
    """Where each row (N, B) of the table before is after, -1 for nowhere, as steps; and the rows that are nowhere."""
    width = before.shape[1]
    places = {row.tobytes(): place for place, row in enumerate(after[:, :width])} if len(after) else {}
    where = np.array([places.get(row.tobytes(), -1) for row in before], dtype=np.int32)
    steps = np.diff(where, prepend=np.int32(0))  # mostly ones, which compress well
    return {f"{name}_steps": steps, f"{name}_rows": before[where < 0]}


def _before(name: str, after: _Rows, arrays: _Arrays) -> _Rows:
    where = np.cumsum(arrays[f"{name}_steps"], dtype=np.int64)
    missing = arrays[f"{name}_rows"]
    rows = np.zeros((len(where), missing.shape[1]), np.uint8)
    rows[where >= 0] = after[where[where >= 0], : missing.shape[1]]
    rows[where < 0] = missing
    return rows
