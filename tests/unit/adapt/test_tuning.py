"""Tuning of network and map: what gets a gradient, in which light and precision, and which state is retained."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from adapt_helpers import QUICK, RoomMap, generator, room_map, start_adaptation, views_of
from depth_helpers import TINY, small_recording, tiny_network
from monoloc.adapt import frozen_layers
from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.pose_step import pose_step_loss, pose_steps
from monoloc.adapt.training_views import Views
from monoloc.adapt.tuning import Adaptation, Score
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def mapped_room() -> RoomMap:
    return room_map()


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return small_recording(12)


@pytest.fixture(scope="module")
def views(recording: RoomRecording) -> Views:
    """The whole view of every frame, and two views synthesised near it."""
    return views_of(recording, 24)


@pytest.mark.parametrize(
    ("tune", "map_transform"), [("none", True), ("last", True), ("decoder", False), ("decoder", True), ("all", True)]
)
def test_only_what_is_tuned_gets_a_gradient(
    mapped_room: RoomMap, views: Views, tune: str, map_transform: bool
) -> None:
    adaptation = start_adaptation(mapped_room, tune=tune, map_transform=map_transform, lambda_kl=0.1)
    before = copy.deepcopy(adaptation.network.state_dict())
    # In the first step the transform's first layer stands behind a zero; with the decoder it moves every fourth.
    adaptation.run(views, 5, generator())
    tuned = {
        "none": (),
        "last": ("head.",),
        "decoder": ("head.", "decoder."),
        # The encoder's first layers, up to stride 4, stay.
        "all": ("head.", "decoder.", *(f"encoder.features.{block}." for block in range(4, 18))),
    }[tune]
    for name, parameter in adaptation.network.named_parameters():
        if name.startswith(tuned):
            assert parameter.grad is not None and bool(parameter.grad.abs().max() > 0.0), name
            assert not torch.equal(parameter, before[name]), name
        else:
            assert parameter.grad is None, name
    statistics = {name for name, _ in adaptation.network.named_buffers()}  # of batch normalisation
    for name, tensor in adaptation.network.state_dict().items():
        if name in statistics or not name.startswith(tuned):
            torch.testing.assert_close(tensor, before[name], rtol=0.0, atol=0.0, msg=name)
    for name, parameter in adaptation.map.named_parameters():
        if map_transform:
            assert parameter.grad is not None and bool(parameter.grad.abs().max() > 0.0), name
        else:
            assert parameter.grad is None, name
    assert (adaptation.kl() > 0.0) == map_transform


@pytest.mark.parametrize("tune", ["last", pytest.param("all", marks=pytest.mark.slow)])
def test_relit_views_are_learned_from_as_if_taken_in_that_light(
    mapped_room: RoomMap, views: Views, monkeypatch: pytest.MonkeyPatch, tune: str
) -> None:
    """All of them, here."""
    monkeypatch.setattr(frozen_layers, "random_exposure", lambda color, *_: color // 8)
    monkeypatch.setattr(Adaptation, "fit_bias", lambda *_: None)  # which uses the views as they are
    dark = replace(views, colors=views.colors // 8)

    def tuned(learned_from: Views, share: float) -> Tensor:
        adaptation = start_adaptation(mapped_room, tune=tune, learns_from="depth", relit_share=share)
        adaptation.run(learned_from, 3, generator())
        network = adaptation.network
        return network.head.weight if tune == "last" else network.encoder.features[4].conv[0][0].weight

    # A share of nearly none draws the same random numbers.
    relit, taken_dark, as_taken = tuned(views, 1.0), tuned(dark, 1e-9), tuned(views, 1e-9)
    torch.testing.assert_close(relit, taken_dark, rtol=0.0, atol=1e-4)
    assert float((relit - as_taken).detach().abs().max()) > 1e-2


@pytest.mark.parametrize("tune", ["last", "all", pytest.param("decoder", marks=pytest.mark.slow)])
def test_stated_error_follows_features_that_move_and_changes_nothing_else(
    mapped_room: RoomMap, views: Views, tune: str
) -> None:
    """Where they stay, so does it."""
    config = QUICK.model_copy(update={"tune": tune})
    states = []
    for uncertainty in (False, True):
        network = tiny_network(config=TINY.model_copy(update={"uncertainty": uncertainty}))
        plain = tiny_network().state_dict()
        network.load_state_dict(plain, strict=False)
        Adaptation(network, AdaptedMap(*mapped_room), config).run(views, 3, generator())
        states.append(network.state_dict())
    weight, bias = (states[1].pop(f"error_head.{name}") for name in ("weight", "bias"))
    moved = bool((weight != 0.0).any()) and float(bias) != pytest.approx(np.log(0.2))
    assert moved == (tune != "last")
    assert states[0].keys() == states[1].keys()
    for name, tensor in states[0].items():
        torch.testing.assert_close(states[1][name], tensor, rtol=0.0, atol=0.0)


@pytest.mark.parametrize(("tune", "learns_from"), [("last", "depth"), ("all", "map")])
def test_what_is_learned_from_does_not_depend_on_what_is_tuned(
    mapped_room: RoomMap, views: Views, tune: str, learns_from: str
) -> None:
    """By the map alone, true depth changes nothing after the scale is fitted."""
    wrong = replace(views, depth_m=0.5 * views.depth_m)
    heads = []
    for learned_from in (views, wrong):
        config = {"tune": tune, "learns_from": learns_from, "fits_scale": False, "relit_share": 0.0}
        adaptation = start_adaptation(mapped_room, **config)
        adaptation.run(learned_from, 3, generator())
        heads.append(adaptation.network.head.weight)
    assert torch.equal(*heads) == (learns_from == "map")


def test_bias_is_fitted_first(mapped_room: RoomMap, views: Views) -> None:
    adaptation = start_adaptation(mapped_room, tune="last")
    with torch.no_grad():
        adaptation.network.head.bias += 1.5
    assert adaptation.score(views, 0).absrel > 2.0
    adaptation.fit_bias(views)
    whole = views.of_frames(range(12), only_whole=True)
    ratio = (whole.depth_m[..., 1::2, 1::2] / adaptation.predict(whole).exp()).median()
    assert float(ratio) == pytest.approx(1.0, rel=0.01)


def test_bias_is_unchanged_without_depth(mapped_room: RoomMap, views: Views) -> None:
    """Where none is known, or none at the output's pixels."""
    for known in (None, (0, 0)):
        depth_m = torch.zeros_like(views.depth_m)
        if known is not None:
            depth_m[..., known[0], known[1]] = 2.0
        adaptation = start_adaptation(mapped_room, tune="last")
        before = adaptation.network.head.bias.detach().clone()
        adaptation.fit_bias(replace(views, depth_m=depth_m))
        torch.testing.assert_close(adaptation.network.head.bias.detach(), before)


@pytest.mark.parametrize(
    ("tune", "steps"), [("last", 80), ("decoder", 30), pytest.param("all", 24, marks=pytest.mark.slow)]
)
def test_tuning_improves_the_fit(mapped_room: RoomMap, views: Views, tune: str, steps: int) -> None:
    # A network this small learns little about depth while it learns about poses or the map.
    only_depth = {"pose_weight": 0.0, "likelihood_weight": 0.0}  # without effect on the last layer alone
    adaptation = start_adaptation(mapped_room, tune=tune, lambda_kl=0.1, inflation_m=0.1, **only_depth)
    adaptation.fit_bias(views)
    before = adaptation.score(views, 0)
    adaptation.run(views, steps, generator())
    after = adaptation.score(views, steps)
    if tune == "last":
        assert after.nll < before.nll - 0.05
    else:
        assert after.depth_loss < before.depth_loss


@pytest.mark.parametrize("tune", ["last", "all", pytest.param("decoder", marks=pytest.mark.slow)])
def test_tuning_repeats(mapped_room: RoomMap, views: Views, tune: str) -> None:
    states = []
    for _ in range(2):
        adaptation = start_adaptation(mapped_room, tune=tune, lambda_kl=0.1, inflation_m=0.1)
        adaptation.run(views, 5, generator())
        states.append({**adaptation.network.state_dict(), **adaptation.map.state_dict()})
    for name, tensor in states[0].items():
        torch.testing.assert_close(states[1][name], tensor, rtol=0.0, atol=0.0)


@pytest.mark.parametrize(("capability", "precision"), [("AVX2", torch.float32), ("AVX512", torch.bfloat16)])
def test_tuning_uses_the_precision_that_suits_the_processor(
    mapped_room: RoomMap, views: Views, capability: str, precision: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    adaptation = start_adaptation(mapped_room, tune="all", inflation_m=0.1, pose_weight=0.0)
    adaptation.fit_bias(views)
    before = adaptation.score(views, 0)
    features: list[torch.dtype] = []
    adaptation.network.decoder.register_forward_hook(lambda _, __, output: features.append(output.dtype))
    adaptation.run(views, 12, generator())
    assert features[1:] == [precision] * 12  # the first is for the bias
    assert adaptation.score(views, 12).depth_loss < before.depth_loss


@pytest.mark.slow
def test_pose_weight_reduces_errors_that_would_move_the_camera(mapped_room: RoomMap, views: Views) -> None:
    truth = views.output_depth_m
    steps = pose_steps(truth[:, 0].numpy(), views.rays)
    lengths = []
    for weight in (0.0, 3.0):
        adaptation = start_adaptation(mapped_room, map_transform=False, pose_weight=weight)
        adaptation.run(views, 40, generator())
        lengths.append(pose_step_loss(adaptation.predict(views), truth, steps).item())
    assert lengths[1] < 0.95 * lengths[0]


@pytest.mark.parametrize("tune", [pytest.param("last", marks=pytest.mark.slow), "all"])
def test_state_that_is_best_on_held_out_frames_is_restored(
    mapped_room: RoomMap, views: Views, tune: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Held-out scores scripted to be best at the ninth step, whatever is tuned."""
    held_out = [9, 10, 11]
    adaptation = start_adaptation(mapped_room, tune=tune)
    states: dict[int, dict[str, Tensor]] = {}

    def state() -> dict[str, Tensor]:
        return copy.deepcopy({**adaptation.network.state_dict(), **adaptation.map.state_dict()})

    def scripted(self: Adaptation, evaluated: Views, step: int) -> Score:
        assert evaluated.frame.tolist() == held_out and bool(evaluated.whole.all())
        states[step] = state()
        return Score(step, nll=abs(step - 9.0), depth_loss=abs(step - 9.0), absrel=0.0)

    monkeypatch.setattr(Adaptation, "score", scripted)
    scores = adaptation.run(views, 16, generator(), held_out, evaluate_every=3)
    assert [score.step for score in scores] == [0, 3, 6, 9, 12, 15, 16]
    assert adaptation.best_step(scores) == 9
    restored = state()
    for name, tensor in restored.items():
        torch.testing.assert_close(tensor, states[9][name], rtol=0.0, atol=0.0)
    assert not torch.equal(restored["head.weight"], states[16]["head.weight"])
    assert not torch.equal(restored["transform.output.weight"], states[16]["transform.output.weight"])


@pytest.mark.parametrize(("later", "chosen"), [(0.145, 200), (0.155, 100)])
def test_longer_tuning_is_preferred_where_it_is_nearly_as_good(
    mapped_room: RoomMap, later: float, chosen: int
) -> None:
    """The best gains from 1.1 to 0.1, so scores up to 0.15 are nearly as good."""
    adaptation = start_adaptation(mapped_room, tune="last")
    values = {0: 1.1, 100: 0.1, 200: later, 300: 0.3}
    scores = [Score(step, nll=value, depth_loss=0.0, absrel=0.0) for step, value in values.items()]
    assert adaptation.best_step(scores) == chosen


def test_nothing_changes_where_nothing_is_tuned(mapped_room: RoomMap, views: Views) -> None:
    adaptation = start_adaptation(mapped_room, tune="none", map_transform=False)
    before = copy.deepcopy(adaptation.network.state_dict())
    assert adaptation.is_trivial
    scores = adaptation.run(views, 10, generator(), [0])
    assert [score.step for score in scores] == [0]
    assert adaptation.run(views, 10, generator()) == []
    assert adaptation.kl() == pytest.approx(0.0, abs=1e-9)
    for name, tensor in adaptation.network.state_dict().items():
        torch.testing.assert_close(tensor, before[name], rtol=0.0, atol=0.0)
