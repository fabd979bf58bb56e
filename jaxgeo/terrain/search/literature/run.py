"""Report of one run of a studied search, and its comparison with the first hit."""

from __future__ import annotations

import enum

import jax.numpy as jnp
from jaxtyping import Array, Int, Int8

from jaxgeo._record import Record
from jaxgeo._typing import Index, Scalar, StatusCode


class Ending(enum.IntEnum):
    """How an iteration ended. Runs hold it as an int8 array; `Ending(code).message` is the sentence."""

    converged = 0
    cycled = 1
    diverged = 2
    failed = 3

    @property
    def message(self) -> str:
        """The ending as a full sentence."""
        return _ENDINGS[self]


class Outcome(enum.IntEnum):
    """Quality of a search's result compared with the guaranteed first hit."""

    first_hit = 0
    farther_hit = 1
    nearer_hit = 2
    cycled = 3
    diverged = 4
    failed = 5

    @property
    def message(self) -> str:
        """The outcome as a full sentence."""
        return _OUTCOMES[self]


_ENDINGS = {
    Ending.converged: "The search came within its tolerance of the surface.",
    Ending.cycled: "The iteration still went to and fro when its limit was reached.",
    Ending.diverged: "The iteration ran out of the terrain, or out of the ray.",
    Ending.failed: "The search ended without a point, or had nothing to search.",
}

_OUTCOMES = {
    Outcome.first_hit: "The search found the first point at which the ray meets the terrain.",
    Outcome.farther_hit: "The search found ground that is hidden behind the first hit.",
    Outcome.nearer_hit: "The search stopped where the ray passes within its tolerance above the ground.",
    Outcome.cycled: _ENDINGS[Ending.cycled],
    Outcome.diverged: _ENDINGS[Ending.diverged],
    Outcome.failed: _ENDINGS[Ending.failed],
}


class Run(Record):
    """One run of a search along one ray.

    `distance` is the range in m of its last point, `height` the ellipsoidal height of that point in m, `clearance` its
    height above the surface in m; `cell` the cell below it. `evaluations` counts all DEM evaluations, `iterations` the
    rounds of the method's own loop. `ending` is an int8 `Ending`, `status` the int8 `Status` of the bracket. A run that
    did not converge keeps its last point for study; its bracket has none.
    """

    distance: Scalar
    height: Scalar
    clearance: Scalar
    cell: Int[Array, "2"]
    evaluations: Index
    iterations: Index
    ending: Int8[Array, ""]
    status: StatusCode


def ending_code(ending: Ending) -> Int8[Array, ""]:
    """The ending as an int8 scalar, as in `Run`."""
    return jnp.asarray(ending.value, jnp.int8)


def outcome_of(run: Run, first: Scalar, tolerance: Scalar) -> Int8[Array, ""]:
    """The int8 `Outcome` of a run along a ray whose first hit is at the range `first` in m (`Fix.slant_range`).

    Ranges within `tolerance` m count as the same crossing: a search that stops at a clearance eps is short of the
    surface by eps over the sine of the angle between ray and ground; one post spacing separates neighbouring slopes.
    Without a first hit (NaN) every point is wrong, and counts as farther.
    """
    away = run.distance - first
    reached = jnp.where(away < -tolerance, Outcome.nearer_hit.value, Outcome.farther_hit.value)
    reached = jnp.where(jnp.abs(away) <= tolerance, Outcome.first_hit.value, reached)
    ended = run.ending + (Outcome.cycled.value - Ending.cycled.value)
    return jnp.where(run.ending == Ending.converged, reached, ended).astype(jnp.int8)
