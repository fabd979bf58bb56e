"""From cell to cell: a march crosses no line of posts unseen, and never stands still."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.terrain.search.march import ON_A_LINE, _exit
from jaxgeo.terrain.track import Quartic

COUNT = 20_000


@pytest.mark.parametrize("bend, beyond", [(0.02, 1e-8), (3.0, 1e-6)])
def test_a_piece_ends_at_the_next_line_even_where_the_track_turns_just_behind_it(bend: float, beyond: float) -> None:
    """The extremum lies 1e-14 to 1e-2 cells behind a line of posts; on or just before one no crossing is due."""
    random = np.random.default_rng(0)
    tau = random.uniform(-1.0, 0.9, COUNT)
    turn = tau + (1.0 - tau) * random.uniform(0.0, 1.0, COUNT)
    curve = random.uniform(-bend, bend, COUNT)
    cubic, quartic = (bend * size * random.normal(size=COUNT) for size in (1e-5, 1e-7))
    behind = 10.0 ** random.uniform(-14.0, -2.0, COUNT)
    # height of the parabola at its turn: so far behind line 5
    top = 5.0 + np.sign(-curve) * behind
    axis = Quartic(*map(jnp.asarray, (top + curve * turn**2, -2.0 * curve * turn, curve, cubic, quartic)))
    exit_ = np.asarray(jax.jit(jax.vmap(_exit))(axis, jnp.asarray(tau), jnp.ones(COUNT)))
    at = jax.vmap(Quartic.at)
    begin, end, middle = (np.asarray(at(axis, jnp.asarray(t))) for t in (tau, exit_, 0.5 * (tau + exit_)))
    assert np.all(exit_ > tau)
    assert np.all(exit_ <= 1.0)
    cell = np.floor(middle)
    for place in (begin, end):
        assert np.all(place > cell - beyond - ON_A_LINE)
        assert np.all(place < cell + 1.0 + beyond + ON_A_LINE)


def test_bounds_of_a_track_hold_between_its_ends() -> None:
    """Deviation from the chord of any section, and slope; both are reached by some."""
    random = np.random.default_rng(1)
    begin, end = np.sort(random.uniform(-1.0, 1.0, (2, COUNT)), axis=0)
    coefficients = random.normal(size=(5, COUNT)) * random.choice([0.0, 1.0], (5, COUNT))
    axis, share = Quartic(*map(jnp.asarray, coefficients)), np.linspace(0.0, 1.0, 33)[:, None]
    tau = begin + share * (end - begin)
    at, slope = (jax.vmap(jax.vmap(each), (None, 0)) for each in (Quartic.at, Quartic.slope))
    first, *_, last = values = np.asarray(at(axis, jnp.asarray(tau)))
    away = np.max(np.abs(values - (first + share * (last - first))), axis=0)
    away /= np.asarray(jax.vmap(Quartic.sag)(axis)) * (end - begin) ** 2 + 1e-12
    assert 0.999 < away.max() <= 1.0 + 1e-9
    steep = np.max(np.abs(slope(axis, jnp.asarray(tau))), axis=0) / (np.asarray(jax.vmap(Quartic.speed)(axis)) + 1e-12)
    assert 0.99 < steep.max() <= 1.0 + 1e-9
