"""Evidence for and against a change of many things, added up over flights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray

PRIOR_ODDS = 0.01
"""That one landmark or voxel has changed, before anything was seen."""

MOST_NATS = 4.0
"""Evidence that one flight may give, so that no single flight decides."""

_LEAST_FLIGHTS, _LEAST_ODDS = 2, 10.0  # in a row that must show a change, and its odds, for it to be proposed
_MOST_COUNT = 60_000  # of views
_NAMES = ("log_odds", "expected", "agreeing", "flights")


@dataclass(frozen=True)
class Tally:
    """What flights said of N things.

    Attributes:
        log_odds: of the change, (N,) float32. They fall no lower than the prior, so that what was seen unchanged for
            years does not outweigh a change: the cumulative sum test of Page (*Continuous Inspection Schemes*, 1954).
        expected: views that looked at the thing since the odds left the prior, (N,) int64.
        agreeing: those of them that speak for the change, (N,) int64.
        flights: in a row that spoke for the change, (N,) int64.
    """

    log_odds: NDArray[np.float32]
    expected: NDArray[np.int64]
    agreeing: NDArray[np.int64]
    flights: NDArray[np.int64]

    @classmethod
    def new(cls, count: int) -> Tally:
        """Of things of which nothing was seen."""
        zeros = np.zeros(count, dtype=np.int64)
        return cls(np.full(count, np.log(PRIOR_ODDS), dtype=np.float32), zeros, zeros, zeros)

    def __len__(self) -> int:
        return len(self.log_odds)

    def __getitem__(self, chosen: NDArray[Any]) -> Tally:
        return Tally(*(getattr(self, name)[chosen] for name in _NAMES))

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in _NAMES))

    @property
    def odds(self) -> FloatArray:
        return np.exp(self.log_odds.astype(np.float64))

    def after_flight(self, expected: NDArray[np.int64], agreeing: NDArray[np.int64], nats: FloatArray) -> Tally:
        """The tally after one more flight.

        Args:
            expected, agreeing: views of the flight, (N,) each.
            nats: evidence that they give for the change, (N,); what one flight gives is bounded.
        """
        prior = np.log(PRIOR_ODDS)
        log_odds = np.maximum(prior, self.log_odds + np.clip(nats, -MOST_NATS, MOST_NATS))
        is_anew = (log_odds <= prior) & (expected > 0)
        flights = np.where(nats > 0.0, self.flights + 1, np.where(nats < 0.0, 0, self.flights))
        expected, agreeing = (
            np.where(is_anew, 0, np.minimum(before + more, _MOST_COUNT))
            for before, more in ((self.expected, expected), (self.agreeing, agreeing))
        )
        ceiling = np.log(_LEAST_ODDS) + MOST_NATS
        return Tally(np.minimum(log_odds, ceiling).astype(np.float32), expected, agreeing, flights)

    @property
    def is_proven(self) -> NDArray[np.bool_]:
        """Whether the change of each thing may be proposed, (N,)."""
        return np.asarray((self.log_odds >= np.log(_LEAST_ODDS)) & (self.flights >= _LEAST_FLIGHTS))

    @property
    def is_above_prior(self) -> NDArray[np.bool_]:
        """Whether anything speaks for the change of each thing, (N,); the odds fall no lower than the prior."""
        return np.asarray(self.log_odds > np.float32(np.log(PRIOR_ODDS)))

    def to_arrays(self, prefix: str) -> dict[str, NDArray[Any]]:
        return {
            prefix + "log_odds": self.log_odds,
            **{prefix + name: getattr(self, name).astype(np.uint16) for name in _NAMES[1:]},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], prefix: str) -> Tally:
        """Inverse of :meth:`to_arrays`.

        Raises:
            KeyError, ValueError: an array is missing, has another length or is not finite.
        """
        log_odds = arrays[prefix + "log_odds"].astype(np.float32)
        counts = [arrays[prefix + name].astype(np.int64) for name in _NAMES[1:]]
        if log_odds.ndim != 1 or any(each.shape != log_odds.shape for each in counts):
            raise ValueError(f"{prefix}* must be (N,) each")
        if not np.isfinite(log_odds).all():
            raise ValueError(f"{prefix}log_odds must be finite")
        return cls(log_odds, *counts)


def bernoulli_nats(
    expected: NDArray[np.int64], agreeing: NDArray[np.int64], if_changed: FloatArray, if_not: FloatArray
) -> FloatArray:
    """Log-likelihood ratio of so many agreeing views of those expected, (N,), given how often they agree."""
    return np.asarray(
        agreeing * np.log(if_changed / if_not) + (expected - agreeing) * np.log((1.0 - if_changed) / (1.0 - if_not))
    )
