"""Scale by depth: the recording's own in some frames, or a network's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import read_network
from monoloc.depth.models import DEFAULT
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.depth.scale_ratio import scale_ratio
from monoloc.errors import SettingError
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.structure_from_motion.dense_depth import small_camera
from monoloc.structure_from_motion.metric_scale import MetricScale, from_log_ratios
from monoloc.structure_from_motion.sparse_model import SparseModel

_NETWORK_FRAMES = 60
# Of a frame's log-ratio of depth, from the median: beyond the second, this part of the model is bent, and so are
# frames beside it that are beyond the first. In six models of the desk and of RedKitchen it was 0.12 at most, in a
# bent part of the desk 0.26 to 0.61, and 0.14 in its last frame.
_LOG_RATIO_BESIDE, _MOST_LOG_RATIO = 0.1, 0.2
# Of a depth sensor's own scale: by it, RedKitchen and the desk were 1.2 % and 1.8 % smaller than by their poses.
_SENSOR_SD = 0.015
# Of a shipped network's scale in a room: by it, frames 0:300 of RedKitchen were 4 % too large and 0:350 of the desk
# 48 %, which is 0.28 in the root mean square of the logarithm.
_NETWORK_SD = 0.3


@dataclass(frozen=True)
class DepthScale:
    """The recording's own depth, which also tells where the model is bent: there, it has another scale."""

    def frames(self, recording: Recording) -> list[int]:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.frames`."""
        if not recording.has_depth:
            raise SettingError("scale", f"is depth, but {recording.name} has none", "give another --scale")
        return []

    def measure(self, recording: Recording, model: SparseModel, depths: Sequence[NDArray[np.float32]]) -> MetricScale:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.measure`."""
        camera = small_camera(model.camera)
        ratios = [
            scale_ratio(recording.depth(int(frame)), model.camera, DepthPrediction(depth, camera))
            for frame, depth in zip(model.frames, depths, strict=True)
        ]
        logs = [float(np.log(ratio)) for ratio in ratios if ratio is not None]
        scale = from_log_ratios(logs, _SENSOR_SD, f"depth of {len(logs)} frames", recording.name)
        off = np.abs([0.0 if ratio is None else np.log(ratio / scale.metres) for ratio in ratios])
        is_off = off > _LOG_RATIO_BESIDE
        run = np.cumsum(np.diff(is_off, prepend=is_off[:1]))  # number of the run of frames that are off, or are not
        return replace(scale, is_bent=is_off & np.isin(run, run[off > _MOST_LOG_RATIO]))


@dataclass(frozen=True)
class NetworkScale:
    """Depth that a network predicts.

    Attributes:
        network: as :func:`monoloc.bundle.read_network` takes it.
    """

    network: str = DEFAULT

    def frames(self, recording: Recording) -> list[int]:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.frames`."""
        if read_network(self.network).spec.scale is None:
            problem = f"is network, but {self.network} does not state its scale"
            fix = "name a network that predicts metres, as network:NAME, or state its scale in its .toml"
            raise SettingError("scale", problem, fix)
        return []

    def measure(self, recording: Recording, model: SparseModel, depths: Sequence[NDArray[np.float32]]) -> MetricScale:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.measure`."""
        predict = DepthPredictor(read_network(self.network), model.camera)
        camera = small_camera(model.camera)
        logs = []
        for frame in evenly_spaced(len(depths), _NETWORK_FRAMES).tolist():
            ratio = scale_ratio(depths[frame], camera, predict(recording.color(int(model.frames[frame]))))
            if ratio is not None:
                logs.append(-float(np.log(ratio)))
        return from_log_ratios(logs, _NETWORK_SD, f"predicted depth of {len(logs)} frames", recording.name)
