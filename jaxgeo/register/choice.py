"""Interface of candidate selection: at most one candidate per block, all consistent."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgeo._record import Record
from jaxgeo.register.blocks import Matches


class Chosen(Record):
    """The selected candidate of each block, and the data for a significance test.

    `peak` (n,) is the index of the candidate, -1 for none. `area` (n,) in cells2 is the acceptance area in the
    reference, within which a candidate of the block would have agreed. `hypotheses` is the number of hypotheses
    compared, each fitted to candidates of `fitted` blocks.
    """

    peak: Int[Any, " n"]
    area: Float[Any, " n"]
    hypotheses: int = eqx.field(static=True)
    fitted: int = eqx.field(static=True)

    @property
    def is_chosen(self) -> Bool[np.ndarray, " n"]:
        """Flags of blocks with a chosen candidate."""
        return np.asarray(self.peak) >= 0

    @property
    def count(self) -> int:
        """Number of blocks that agree."""
        return int(np.count_nonzero(self.is_chosen))

    def of(self, values: Any) -> np.ndarray:
        """(n, ...): the entries of the chosen candidates in an array (n, peaks, ...); NaN for blocks without one."""
        values, rows = np.asarray(values, float), np.arange(len(self.peak))
        chosen = self.is_chosen.reshape(-1, *(1,) * (values.ndim - 2))
        return np.where(chosen, values[rows, np.maximum(self.peak, 0)], np.nan)


class AbstractChoice(Record):
    """A method of selecting consistent candidates."""

    @abc.abstractmethod
    def choose(self, matches: Matches, jacobian: Any = None, cov_error: Any = None) -> Chosen:
        """At most one candidate of each block.

        `jacobian` (n, 2, axes) in cells is the derivative of a block's shift by the navigation errors, at
        `matches.centre`; `cov_error` (axes, axes) is the covariance of these errors. Some methods need neither.
        """


def none_chosen(matches: Matches, hypotheses: int, fitted: int) -> Chosen:
    """The result if no candidates agree."""
    n = len(matches.outcome)
    return Chosen(np.full(n, -1), np.zeros(n), hypotheses, fitted)


def nearest_within(
    squared: Float[np.ndarray, "*batch n peaks"], limit: float
) -> tuple[Int[np.ndarray, "*batch n"], Float[np.ndarray, "*batch n"]]:
    """(nearest candidate of each block, -1 if none is within `limit`; its squared distance, or the limit).

    Squared distances of missing candidates are infinite.
    """
    if squared.shape[-1] == 0 or squared.size == 0:
        return np.full(squared.shape[:-1], -1), np.full(squared.shape[:-1], limit)
    least = np.min(squared, axis=-1)
    return np.where(least <= limit, np.argmin(squared, axis=-1), -1), np.minimum(least, limit)


def distances_to(matches: Matches, predicted: Float[np.ndarray, "*batch n 2"]) -> Float[np.ndarray, "*batch n peaks"]:
    """Squared distances in cells2 of all candidates from predicted shifts; infinite for missing candidates."""
    squared = np.sum((np.asarray(matches.shift) - predicted[..., None, :]) ** 2, axis=-1)
    return np.where(matches.is_candidate, squared, np.inf)
