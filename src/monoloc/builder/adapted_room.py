"""Network and map of a mapped room, adapted to each other."""

from __future__ import annotations

from dataclasses import replace

from monoloc.adapt.result import AdaptResult
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.mapped_room import MappedRoom
from monoloc.builder.start_network import StartNetwork, in_8_bits
from monoloc.depth.scale_fit import fit_to_depth
from monoloc.depth.spec import network_images
from monoloc.extras import training_extra
from monoloc.map.depth_rendering import supervision
from monoloc.progress import Progress


def adapt_room(
    room: MappedRoom, network: StartNetwork, config: BuildConfig, seed: int, progress: Progress
) -> AdaptResult:
    """Tune network and map to each other; if nothing is tuned, fit the network's scale where it is unknown."""
    result = _tuned(room, network, config, seed, progress)
    if not config.int8:
        return result
    with progress.task("8 bits", None):
        images = network_images(room.recording, result.depth_model.spec)
        model, hold_out = (in_8_bits(each, images) for each in (result.depth_model, result.hold_out_model))
    return replace(result, depth_model=model, hold_out_model=hold_out)


def _tuned(
    room: MappedRoom, network: StartNetwork, config: BuildConfig, seed: int, progress: Progress
) -> AdaptResult:
    recording = room.recording
    if network.file is not None:
        with training_extra():
            from monoloc.adapt.adaptation import adapt  # the only import that needs PyTorch
        return adapt(recording, room.cloud, room.mixture, network.file, config.adapt, seed, progress)
    model = network.model
    if network.fits_scale:  # one or two numbers, fitted to all frames: each is as good as held out
        with progress.task("depth scale", len(recording)) as step:
            model = fit_to_depth(model, recording, supervision(recording, room.cloud), step)
    return AdaptResult.untuned(room.mixture, model)
