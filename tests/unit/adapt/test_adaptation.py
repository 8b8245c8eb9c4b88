"""Adaptation as a whole: a hold-out run that measures, and a final run on all frames."""

from __future__ import annotations

import copy
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from adapt_helpers import RedAndNear, RoomMap, redness, room_map
from depth_helpers import ROOM, SMALL_CAMERA, exported_model, looking_around, small_recording, tiny_network
from monoloc.adapt import adaptation
from monoloc.adapt.adaptation import adapt
from monoloc.adapt.result import Score
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import Views
from monoloc.adapt.tuning import Adaptation
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.build_plan import expected_stages
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.depth.training.checkpoint import save_network
from monoloc.depth.training.network import DepthNetwork
from monoloc.evaluation.hold_out import hold_out_regions
from monoloc.progress import NoProgress, Step
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def mapped_room() -> RoomMap:
    return room_map()


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return small_recording(12)


@pytest.fixture
def network_file(tmp_path: Path) -> Path:
    save_network(tiny_network(), tmp_path / "network.safetensors")
    return tmp_path / "network.safetensors"


def first_depth(model: DepthModel, recording: RoomRecording) -> NDArray[np.float32]:
    return DepthPredictor(model, recording.camera)(recording.color(0)).depth_m


@pytest.fixture
def as_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exported models are the networks themselves, because an export takes a second."""
    monkeypatch.setattr(adaptation, "export_model", lambda network, _: copy.deepcopy(network))


def head_bias(network: DepthNetwork | DepthModel) -> Tensor:
    assert isinstance(network, DepthNetwork) and network.head.bias is not None
    return network.head.bias.detach()


@pytest.mark.usefixtures("as_networks")
@pytest.mark.parametrize(("best", "steps"), [(5, 20), (0, 0)])
def test_final_run_by_likelihood_needs_a_hold_out_run_that_improved(
    mapped_room: RoomMap,
    recording: RoomRecording,
    network_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    best: int,
    steps: int,
) -> None:
    """The paper's variant."""
    monkeypatch.setattr(Adaptation, "best_step", lambda *_: best)
    config = AdaptConfig(tune="last", steps=20, batch_views=4, pixels_per_view=16)
    result = adapt(recording, mapped_room[1], mapped_room[0], network_file, config, 0, NoProgress())
    assert result.steps == steps
    assert (result.kl > 1e-9) == (steps > 0)
    assert torch.equal(head_bias(result.depth_model), head_bias(tiny_network())) == (steps == 0)


@pytest.mark.usefixtures("as_networks")
def test_hold_out_run_sees_no_held_out_frame_and_gives_the_model_to_measure_with(
    mapped_room: RoomMap, network_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By depth, the final run goes on from the hold-out run on all frames, whatever that run improved."""
    seen: list[tuple[Views, NDArray[np.int64] | None]] = []

    @torch.no_grad()
    def run(
        self: Adaptation,
        training: Views,
        steps: int,
        _: object,
        held_out: NDArray[np.int64] | None = None,
        *__: object,
        **___: object,
    ) -> list[Score]:
        seen.append((training, held_out))
        self.network.head.bias += 0.1
        self.map.transform.output.bias += 0.01
        return [] if held_out is None else [self.score(training.of_frames(held_out, only_whole=True), 0)]

    monkeypatch.setattr(Adaptation, "run", run)
    recording = RedAndNear(ROOM, looking_around(12), SMALL_CAMERA)
    recording.marked = np.concatenate(hold_out_regions(recording.poses, 2, 0.15))
    config = AdaptConfig(tune="decoder", steps=2, synthesised_views=24)
    result = adapt(recording, mapped_room[1], mapped_room[0], network_file, config, 0, NoProgress())
    held_out = np.sort(np.concatenate(result.held_out))
    (views, judged_on), (final, not_judged) = seen
    assert judged_on is not None and not_judged is None and views is final
    np.testing.assert_array_equal(held_out, np.sort(recording.marked))
    np.testing.assert_array_equal(judged_on, held_out)
    np.testing.assert_array_equal(np.unique(final.frame), np.arange(12))
    drawn = views[torch.nonzero(views.odds(held_out)).ravel()]
    assert len(final) == 36 and len(drawn) == 36 - 3 * len(held_out)
    assert redness(views.of_frames(held_out, only_whole=True)).min() > 0.3 and redness(drawn).max() == 0.0
    untuned = head_bias(tiny_network())
    torch.testing.assert_close(head_bias(result.hold_out_model), untuned + 0.1)
    torch.testing.assert_close(head_bias(result.depth_model), untuned + 0.2)
    np.testing.assert_allclose(result.hold_out_map.means, result.original.means + 0.01, atol=1e-6)
    np.testing.assert_allclose(result.adapted.means, result.original.means + 0.02, atol=1e-6)


@pytest.mark.usefixtures("as_networks")
def test_expected_stages_are_those_of_an_adaptation(
    mapped_room: RoomMap, recording: RoomRecording, network_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Adaptation, "run", lambda *_, **__: [Score(0, 0.0, 0.0, 0.0)])
    config = AdaptConfig(synthesised_views=0)
    stages: list[str] = []

    class Names:
        def task(self, name: str, total: int | None, alike: bool = True) -> AbstractContextManager[Step]:
            stages.append(name)
            return NoProgress().task(name, total)

    adapt(recording, mapped_room[1], mapped_room[0], network_file, config, 0, Names())
    assert stages == list(expected_stages(12, BuildConfig(adapt=config)))[3:6]


@pytest.mark.slow
def test_adapting_nothing_returns_the_input(
    mapped_room: RoomMap, recording: RoomRecording, network_file: Path
) -> None:
    config = AdaptConfig(tune="none", map_transform=False)
    result = adapt(recording, mapped_room[1], mapped_room[0], network_file, config, 0, NoProgress())
    np.testing.assert_allclose(result.adapted.means, result.original.means, atol=1e-9)
    assert result.steps == 0 and result.kl == pytest.approx(0.0, abs=1e-9)
    untouched = first_depth(exported_model(tiny_network()), recording)
    np.testing.assert_allclose(first_depth(result.depth_model, recording), untouched, rtol=1e-5)
