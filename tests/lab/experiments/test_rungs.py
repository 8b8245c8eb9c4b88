"""The ladder adds one thing a rung, from the paper's method to the default."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from monoloc.builder.build_config import METHODS, BuildConfig
from monoloc.localizer_config import ADDITIONS
from monoloc_lab.experiments.rungs import LAMBDAS, PAIRS, RUNGS, Rung, all_rungs


def test_ladder_leads_from_the_papers_method_to_the_default() -> None:
    assert RUNGS[0].build == METHODS["paper"] and RUNGS[0].without == ADDITIONS
    assert RUNGS[-1].build == BuildConfig() and RUNGS[-1].without == ()


@pytest.mark.parametrize(("lower", "upper"), list(itertools.pairwise(RUNGS)), ids=lambda rung: rung.name)
def test_rung_changes_the_build_or_the_flight_and_never_takes_away(lower: Rung, upper: Rung) -> None:
    assert upper.name.startswith("+ ")
    assert {*upper.without} <= {*lower.without}
    assert (lower.build == upper.build) != (lower.without == upper.without)


def settings_of(rung: Rung) -> dict[str, Any]:
    return rung.build.adapt.model_dump()


def test_builds_of_neighbours_differ_in_what_the_rung_is_named_after() -> None:
    changes = [
        {name for name, value in settings_of(upper).items() if settings_of(lower)[name] != value}
        for lower, upper in itertools.pairwise(RUNGS[:7])
    ]
    assert changes == [
        {"fits_scale"},
        {"likelihood"},
        {"learns_from"},
        {"synthesised_views", "relit_share"},
        {"pose_weight"},
        {"tune", "steps", "network_rate"},
    ]
    decoder, every = RUNGS[6].build.adapt, RUNGS[7].build.adapt
    # Steps and rate of the decoder are what the default takes for all layers.
    assert (decoder.most_steps, decoder.rate) == (every.most_steps, every.rate)
    assert (decoder.by_depth, decoder.share_relit) == (every.by_depth, every.share_relit)


def test_pairs_fly_alike_and_end_at_the_papers_method_or_the_default() -> None:
    for first, second in PAIRS:
        assert first.without == second.without and first.build != second.build
        assert second == RUNGS[0] or second.build == BuildConfig()


def test_every_method_has_a_name_of_its_own() -> None:
    names = [rung.name for rung in all_rungs()]
    assert len(set(names)) == len(names)
    assert {rung.build.adapt.lambda_kl for rung in (RUNGS[0], *LAMBDAS)} == {0.1, 1.0, 10.0}
