"""Evidence adds up over flights, no flight decides alone, and what was long unchanged can still change."""

from __future__ import annotations

import numpy as np

from monoloc.updating.tally import PRIOR_ODDS, Tally, bernoulli_nats

THERE, STRANGE = np.asarray(0.6), np.asarray(0.05)


def flown(tally: Tally, expected: int, missed: int) -> Tally:
    """After a flight that expected one landmark so many times."""
    counts = np.array([expected]), np.array([missed])
    return tally.after_flight(*counts, bernoulli_nats(*counts, 1.0 - STRANGE, 1.0 - THERE))


def test_one_flight_decides_nothing_however_long_it_is() -> None:
    once = flown(Tally.new(1), 1000, 1000)
    assert not once.is_proven[0]
    twice = flown(once, 10, 10)
    assert twice.is_proven[0] and twice.flights[0] == 2 and twice.expected[0] == 1010


def test_what_was_seen_for_long_is_retired_as_soon_as_what_is_new() -> None:
    tally = Tally.new(1)
    for _ in range(50):
        tally = flown(tally, 20, 5)
    assert flown(flown(tally, 10, 10), 10, 10).is_proven[0]


def test_a_find_in_between_begins_anew() -> None:
    tally = flown(flown(flown(Tally.new(1), 10, 10), 10, 2), 10, 10)
    assert not tally.is_proven[0] and tally.flights[0] == 1


def test_a_flight_that_looked_elsewhere_changes_nothing() -> None:
    once = flown(Tally.new(1), 10, 10)
    assert flown(once, 0, 0).to_arrays("") == once.to_arrays("")
    assert flown(flown(once, 0, 0), 10, 10).is_proven[0]


def test_odds_are_those_of_bayes_where_nothing_bounds_them() -> None:
    tally = flown(Tally.new(1), 4, 3)
    ratio = 0.95**3 * 0.05 / (0.4**3 * 0.6)
    np.testing.assert_allclose(tally.odds, PRIOR_ODDS * ratio, rtol=1e-5)
