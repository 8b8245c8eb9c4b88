"""Faults of a camera in flight: what they do to its frames, its clock or its intrinsics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from monoloc.geometry import FloatArray
from monoloc_lab.bench.judged_flight import FlightFrame, Image

FAULT_S = 3.0
"""How long a fault lasts, if nothing else is said."""

_DARK_LEVELS = 12  # of a covered lens, whose sensor only gives noise
_COVER_LEVEL = 30  # of a hand before half of the lens
_BLUR_PX = 25
_FLICKER = (1.8, 0.35)  # factors on brightness, in turn
_JPEG_QUALITY = 10
_GUARDS_SHARE = 0.2  # of the image, in its four corners
_DROPS, _DROP_RADII, _DROP_SHRINKS = 14, (0.04, 0.12), 3.0  # radii in image widths


@dataclass(frozen=True)
class Surroundings:
    """What a fault may need beside its frames.

    Attributes:
        last: the frame before the fault.
        elsewhere: the k-th image of another room, as the camera would give it.
        rng: of noise.
    """

    last: FlightFrame
    elsewhere: Callable[[int], Image]
    rng: np.random.Generator


Change = Callable[[Sequence[FlightFrame], Surroundings], list[FlightFrame]]


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        name: as users write it.
        change: the frames in the fault -> those that arrive.
        seconds: how long it lasts.
        focal_factor: on the focal lengths that the localizer is given.
        is_of_whole_flight: whether it lasts from the first frame to the last.
        is_blinding: whether its images tell nothing of where the camera is, so that soon no pose can be vouched for.
    """

    name: str
    change: Change
    seconds: float = FAULT_S
    focal_factor: float = 1.0
    is_of_whole_flight: bool = False
    is_blinding: bool = False


def _images(change: Callable[[Image, int, np.random.Generator], Image]) -> Change:
    """A change of each image, by its number in the fault."""

    def changed(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
        def image(index: int, frame: FlightFrame) -> Image:
            return change(frame.image(), index, around.rng)

        return [replace(frame, image=partial(image, index, frame)) for index, frame in enumerate(frames)]

    return changed


def _half_covered(rows: slice, columns: slice) -> Change:
    """Of the image: slices of an image that is two pixels high and wide."""

    def cover(image: Image, index: int, rng: np.random.Generator) -> Image:
        height, width = image.shape[:2]
        covered = np.zeros((2, 2), dtype=np.uint8)
        covered[rows, columns] = 1
        mask = cv2.resize(covered, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.bool_)
        return np.where(mask[..., None], np.uint8(_COVER_LEVEL), image)

    return _images(cover)


def _enlarged(x: float, y: float) -> Change:
    """By a factor along each axis, about the middle of the image: by a longer lens alike, else stretched."""

    def enlarge(image: Image, index: int, rng: np.random.Generator) -> Image:
        height, width = image.shape[:2]
        middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
        factors = np.array([x, y])
        mapping = np.column_stack([np.diag(factors), (1.0 - factors) * middle])
        return np.asarray(cv2.warpAffine(image, mapping, (width, height)), dtype=np.uint8)

    return _images(enlarge)


def _nothing(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    return list(frames)


def _dropped(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    return []


def _frozen(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    return [replace(frame, image=around.last.image) for frame in frames]


def _time_backwards(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    times_s = [around.last.time_s, *(frame.time_s for frame in frames)]
    return [
        replace(frame, stated_elapsed_s=-step) for frame, step in zip(frames, np.diff(times_s).tolist(), strict=True)
    ]


def _other_room(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    return [replace(frame, image=partial(around.elsewhere, index), truth=None) for index, frame in enumerate(frames)]


def _propeller_guards(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    guards = around.elsewhere(0)
    height, width = guards.shape[:2]
    mask = np.zeros((height, width), dtype=np.uint8)
    radius = round(np.sqrt(_GUARDS_SHARE * width * height / np.pi))
    for corner in ((0, 0), (width, 0), (0, height), (width, height)):
        cv2.circle(mask, corner, radius, 1, -1)
    return _images(lambda image, index, rng: np.where(mask[..., None] > 0, guards, image))(frames, around)


def _drops(frames: Sequence[FlightFrame], around: Surroundings) -> list[FlightFrame]:
    """Each drop shows what is around it, small and upside down (Roser & Geiger 2009)."""
    height, width = frames[0].image().shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    seen_x, seen_y = x.copy(), y.copy()
    middles = around.rng.uniform((0.0, 0.0), (width, height), (_DROPS, 2))
    for middle, radius in zip(middles, around.rng.uniform(*_DROP_RADII, _DROPS) * width, strict=True):
        inside = np.hypot(x - middle[0], y - middle[1]) < radius
        seen_x[inside] = (middle[0] - _DROP_SHRINKS * (x - middle[0]))[inside]
        seen_y[inside] = (middle[1] - _DROP_SHRINKS * (y - middle[1]))[inside]
    is_drop = ((seen_x != x) | (seen_y != y))[..., None]

    def drip(image: Image, index: int, rng: np.random.Generator) -> Image:
        refracted = cv2.remap(image, seen_x, seen_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.where(is_drop, cv2.blur(refracted, (5, 5)), image).astype(np.uint8)

    return _images(drip)(frames, around)


def _covered(image: Image, index: int, rng: np.random.Generator) -> Image:
    return rng.integers(0, _DARK_LEVELS, image.shape, dtype=np.uint8)


def _noise(image: Image, index: int, rng: np.random.Generator) -> Image:
    return rng.integers(0, 256, image.shape, dtype=np.uint8)


def _blurred(image: Image, index: int, rng: np.random.Generator) -> Image:
    return np.asarray(cv2.blur(image, (_BLUR_PX, 1)), dtype=np.uint8)


def _flickering(image: Image, index: int, rng: np.random.Generator) -> Image:
    brightness: FloatArray = np.clip(image * _FLICKER[index % len(_FLICKER)], 0.0, 255.0)
    return brightness.astype(np.uint8)


def _compressed(image: Image, index: int, rng: np.random.Generator) -> Image:
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return np.asarray(cv2.cvtColor(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB), np.uint8)


_ALL = (
    Fault("none", _nothing),
    Fault("black", _images(lambda image, index, rng: np.zeros_like(image)), is_blinding=True),
    Fault("covered", _images(_covered)),
    Fault("frozen", _frozen, is_blinding=True),
    Fault("saturated", _images(lambda image, index, rng: np.full_like(image, 255))),
    Fault("noise", _images(_noise)),
    Fault("half-covered-left", _half_covered(slice(None), slice(1))),
    Fault("half-covered-right", _half_covered(slice(None), slice(1, None))),
    Fault("half-covered-lower", _half_covered(slice(1, None), slice(None))),
    Fault("blurred", _images(_blurred)),
    Fault("flickering", _images(_flickering)),
    Fault("dropped-2s", _dropped, seconds=2.0),
    Fault("dropped-10s", _dropped, seconds=10.0),
    Fault("time-backwards", _time_backwards),
    Fault("other-room", _other_room, is_blinding=True),
    Fault("mirrored", _images(lambda image, index, rng: np.ascontiguousarray(image[:, ::-1])), is_blinding=True),
    Fault("turned-180", _images(lambda image, index, rng: np.ascontiguousarray(image[::-1, ::-1]))),
    Fault("intrinsics-plus-10", _nothing, focal_factor=1.1, is_of_whole_flight=True),
    Fault("intrinsics-minus-10", _nothing, focal_factor=0.9, is_of_whole_flight=True),
    Fault("intrinsics-plus-30", _nothing, focal_factor=1.3, is_of_whole_flight=True),
    Fault("intrinsics-minus-30", _nothing, focal_factor=0.7, is_of_whole_flight=True),
    Fault("longer-lens-10", _enlarged(1.1, 1.1), is_of_whole_flight=True),
    Fault("longer-lens-30", _enlarged(1.3, 1.3), is_of_whole_flight=True),
    Fault("stretched-x-10", _enlarged(1.1, 1.0), is_of_whole_flight=True),
    Fault("stretched-x-33", _enlarged(4.0 / 3.0, 1.0), is_of_whole_flight=True),
    Fault("stretched-y-10", _enlarged(1.0, 1.1), is_of_whole_flight=True),
    Fault("stretched-y-33", _enlarged(1.0, 4.0 / 3.0), is_of_whole_flight=True),
    Fault("propeller-guards", _propeller_guards, is_of_whole_flight=True),
    Fault("drops", _drops, is_of_whole_flight=True),
    Fault("jpeg-quality-10", _images(_compressed)),
)

FAULTS = {fault.name: fault for fault in _ALL}
"""All faults by name; ``none`` is the control."""
