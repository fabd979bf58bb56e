"""Passes of the filter over looks: all about one state, the batch of all, and the estimates after each look."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.uncertainty.host_arrays import concatenate
from jaxgeo.uncertainty.look_equations import About
from jaxgeo.uncertainty.look_filter import AfterLook, Carry, Mode, filtered, start_of
from jaxgeo.uncertainty.look_scene import Scene

ROUNDS = 3  # linearisations of the filter at each look
MOST_ROUNDS, DAMPED_AFTER = 40, 8  # linearisations of the batch; later steps are halved every few rounds
NEAR_ENOUGH = 1e-3  # of the standard deviation: longest last step where the ground has kinks, after damping
CLOSE_ENOUGH = 1e-4  # m, and of the standard deviation: longest last step; the next one is a tenth of it or less
FIRST_START = 2  # looks of the first starting batch; each later one has twice as many
SETTLED, IN_TURN = 0.1, 2  # of the standard deviation: two starting batches in turn that move the estimate by less end
NEAR_START = 0.01  # of the standard deviation: longest last step of a starting batch


class _Batch(NamedTuple):
    """Estimates linearised at the last of them, the filter after them, number of rounds, and whether it converged."""

    after: AfterLook
    carry: Carry
    rounds: int
    has_converged: bool


def mode_of(shared: float = 1.0, fresh: float = 1.0, rounds: int = 0) -> Mode:
    """How a pass treats the looks, as arrays."""
    return Mode(jnp.asarray(shared), jnp.asarray(fresh), jnp.asarray(rounds))


def last_of(found: AfterLook) -> About:
    """The state after the last look."""
    return jax.tree.map(lambda leaf: leaf[-1], found.about)


def about_one(scene: Scene, about: About, mode: Mode) -> AfterLook:
    """Estimates after each look as NumPy arrays (n, ...), all looks linearised about one state."""
    return _pass(scene, start_of(scene.target, scene.counts), (0, scene.count), about, mode)[0]


def batch_of_all(scene: Scene, start: np.ndarray) -> tuple[AfterLook, int, bool]:
    """(estimates after each look, all linearised at the estimate of all; number of rounds; whether it converged)."""
    found = _batch(scene, scene.count, About(start, np.zeros(())))
    return found.after, found.rounds, found.has_converged


def after_each(scene: Scene) -> AfterLook:
    """Estimates after each look from it and the looks before, as NumPy arrays (n, ...).

    A look is linearised at the estimate from the looks up to it, and keeps that linearisation: the extended filter,
    with iterated updates. The first looks are linearised far from the target, or on another slope: after 2, 4, 8 and
    more looks they are linearised anew, all at the estimate of them together (a batch), and the filter goes on from
    there. This ends when two batches in turn have moved the estimate by less than a tenth of its standard deviation.
    """
    nowhere = About(np.zeros(scene.target.unknowns), np.zeros(()))
    recursive = mode_of(rounds=ROUNDS)
    carry, parts, done, settled = start_of(scene.target, scene.counts), [], 0, 0
    ends = FIRST_START
    while done < scene.count:
        end = min(ends, scene.count) if settled < IN_TURN else scene.count
        found, carry = _pass(scene, carry, (done, end), nowhere, recursive)
        before = last_of(found)
        if settled < IN_TURN:
            batch = _batch(scene, end, before, NEAR_START)
            after = last_of(batch.after)
            step = np.max(np.abs(after.state - before.state)[: scene.target.axes])
            settled = settled + 1 if step < SETTLED * after.reach else 0
            if batch.has_converged:
                carry = batch.carry
                found = _with_last(found, batch.after)
        parts.append(found)
        done, ends = end, 2 * ends
    return concatenate(parts, scene.count)


def _with_last(found: AfterLook, batch: AfterLook) -> AfterLook:
    """The estimates with the last one of a batch; its innovation is that of the filter before the look."""
    last = jax.tree.map(lambda whole, one: np.concatenate([whole[:-1], one[-1:]]), found, batch)
    return last._replace(innovation=found.innovation, nis=found.nis, degrees=found.degrees)


def _pass(scene: Scene, carry: Carry, span: tuple[int, int], about: About, mode: Mode) -> tuple[AfterLook, Carry]:
    """(estimates after the looks of a span as NumPy arrays; the filter after them)."""
    parts, size = [], len(scene.blocks[0][1])
    for number, (lines, used) in enumerate(scene.blocks):
        limits = np.clip(np.array(span) - number * size, 0, size)
        if limits[0] < limits[1]:
            carry, after = filtered(carry, lines, used, limits, about, scene.world, mode, scene.target, scene.counts)
            parts.append(_part(after, slice(*limits)))
    return concatenate(parts, span[1] - span[0]), carry


def _part(tree: AfterLook, within: slice) -> AfterLook:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[within], tree)


def _batch(scene: Scene, count: int, about: About, near: float = 0.0) -> _Batch:
    """The first looks, all linearised at the estimate of them together, by Gauss-Newton.

    `near` is the longest last step in standard deviations, where it may be longer than `CLOSE_ENOUGH`.
    """
    for number in range(MOST_ROUNDS):
        found, carry = _pass(scene, start_of(scene.target, scene.counts), (0, count), about, mode_of())
        after = last_of(found)
        step, turned = after.state - about.state, abs(after.reach - about.reach)
        longest = max(np.max(np.abs(step[: scene.target.axes])), turned)
        damped = number - DAMPED_AFTER
        of_reach = max(near, NEAR_ENOUGH if damped >= 0 else 0.0)
        if longest <= max(CLOSE_ENOUGH * (1.0 + after.reach), of_reach * after.reach):
            return _Batch(found, carry, number + 1, True)
        state = about.state + (step if damped < 0 else 0.5 ** (1 + damped // DAMPED_AFTER) * step)
        about = About(state, after.reach)
    return _Batch(found, carry, MOST_ROUNDS, False)
