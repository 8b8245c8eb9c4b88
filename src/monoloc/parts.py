"""Parts of the localizer that can be left out, to see what each of them does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.localizer_config import PARTS, Part

_SETTINGS: dict[Part, dict[str, Any]] = {
    "odometry": {"motion": "random-walk"},
    "depth-scale": {"log_scale_sd": 0.0},
    "scale-tilt": {"scale_tilt": None},
}


def leave_out(bundle: Bundle) -> Bundle:
    """The bundle and its settings, without the parts that these leave out.

    - ``landmarks``: poses by landmarks.
    - ``scan``: particles are weighed neither by depth scans nor by odometry's corners. Depth still scales odometry.
    - ``odometry``: visual odometry; particles walk at random. Another sensor's motion still counts.
    - ``depth-scale``: each particle's own scale of depth.
    - ``scale-tilt``: the correction of a depth image's scale and tilt by odometry's corners.
    - ``known-bias``: the correction by the bias measured at the reference poses; the bias is wider by as much.
    - ``bias``: the biases in the belief, and ``known-bias``; each frame's belief is the particles' pose alone, then
      that of landmarks.
    - ``gravity``: alignment with an observed direction of gravity.
    - ``relocalization``: the search for a lost camera.

    The scan, the last two, and the belief's memory are left out where they are used: a bundle does not hold them.
    """
    config = bundle.settings
    without = config.without
    if not without:
        return bundle
    changes = {name: value for part in without for name, value in _SETTINGS.get(part, {}).items()}
    if "bias" in without or "known-bias" in without:
        changes = {"particle_bias": _with_known_part(config.particle_bias, bundle.reference_poses)} | changes
        bundle = replace(bundle, reference_poses=ReferencePoses.without_bias(bundle.reference_poses.poses))
    if "bias" in without:
        noise = config.landmark_bias.model_dump(include={"common_error", "common_error_growth"})
        changes |= {"particle_bias": BiasModel(), "landmark_bias": LandmarkBiasModel(**noise)}
    if "landmarks" in without:
        bundle = replace(bundle, landmarks=Landmarks.none())
    return replace(bundle, settings=config.model_copy(update=changes))


def _with_known_part(model: BiasModel, known: ReferencePoses) -> BiasModel:
    """The model of a bias of which no part is subtracted."""
    if not len(known):
        return model
    squares = np.mean([known.forward_bias**2, known.backward_bias**2], axis=(0, 1))
    position, rotation = squares.reshape(2, 3).mean(axis=1)
    return model.model_copy(
        update={
            "sd_at_reference_m": float(np.sqrt(model.sd_at_reference_m**2 + position)),
            "sd_at_reference_rad": float(np.sqrt(model.sd_at_reference_rad**2 + rotation)),
        }
    )


def parse_parts(text: str) -> tuple[Part, ...]:
    """Parts by their names, separated by commas.

    Raises:
        SettingError: a name is none of theirs.
    """
    chosen = []
    for name in (part.strip() for part in text.split(",")):
        part = next((part for part in PARTS if part == name), None)
        if part is None:
            raise SettingError("--without", f"has {name!r}", f"choose from {', '.join(PARTS)}")
        chosen.append(part)
    return tuple(dict.fromkeys(chosen))
