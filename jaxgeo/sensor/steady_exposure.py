"""Exposure times of points in steady motion: from a few samples of the delay, where it is proven to have one root."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._accelerator import by_device
from jaxgeo._typing import Flag, Scalar, StatusCode
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor.delay import Scene, delay_at, image_at
from jaxgeo.sensor.sensor import Sight
from jaxgeo.status import Status

STRETCHES = 8  # of the times at which a point may be exposed
SAFETY = 1.5  # factor on the bound of the motion's unevenness, as the delay's gradient varies along a stretch
EXACT = 1e-12  # of the square of a stretch: product of the last two secant steps; the error is smaller
MOST = 8  # secant steps
BLOCK, BLOCK_ACCELERATOR = 256, 2**16  # points at a time that are searched by all samples

Times = Float[Array, " times"]


def steady_moment(scene: Scene, nodes: Times, sights: Sight, rates: Sight) -> tuple[Scalar, Flag, Flag]:
    """(exposure time in s after the image's, whether the point has one within the nodes, whether that is proven).

    Within a stretch of h s, the delay d of a point changes by its chord and by what the motion strays from uniform
    motion. With the gradient g of the delay by the point's place in the camera, at a distance r, the latter is at most
    h |g| (r |dR/ds - its chord| + |dc/ds - its chord|), taken at all `nodes` (`STRETCHES` times some, and one), with
    the `sights` (R, c) there and their `rates`. If all chords of the delay are larger than that and of one sign, it has
    one root at most; if the delay is farther from zero than a chord and that, it has none. The root is found by secants
    on the exact motion.
    """
    every = (nodes.shape[0] - 1) // STRETCHES
    times, step = nodes[::every], nodes[every] - nodes[0]
    sights = jax.tree.map(lambda x: x[::every], sights)
    turning, moving = _unevenness(sights, rates, step)
    near = scene
    if scene.air is not None:  # refraction hardly changes during the exposure
        seeming = apparent_point(sights.centre[STRETCHES // 2], scene.p_ecef, scene.air)
        near = scene._replace(p_ecef=seeming, air=None)
    delays, statuses = jax.vmap(lambda sight, time: image_at(near, sight, time)[1:])(sights, times)
    middle = jax.tree.map(lambda x: x[STRETCHES // 2], sights)
    p_camera = middle.to_camera(near.p_ecef)

    def delay_of(p_camera: Any) -> Scalar:
        return scene.sensor.camera.image_at(p_camera, times[STRETCHES // 2])[1]

    gradient = jax.grad(delay_of)(p_camera)
    size = lambda v: jnp.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)  # noqa: E731
    uneven = SAFETY * size(gradient) * (turning * size(p_camera) + moving)
    chords = delays[1:] - delays[:-1]
    uneven = uneven + jnp.max(jnp.abs(chords[1:] - chords[:-1]))
    least, most = jnp.min(jnp.abs(chords)), jnp.max(jnp.abs(chords))
    is_level = jnp.all(chords > 0.0) | jnp.all(chords < 0.0)
    is_ahead = jnp.all((statuses == Status.hit) | (statuses == Status.outside_image))
    changes = delays[:-1] * delays[1:] <= 0.0
    crosses = jnp.any(changes)
    is_far = ~crosses & (jnp.min(jnp.abs(delays)) > most + 2.0 * uneven)
    is_steady = is_level & (least > uneven)
    moment, is_exact = _root(scene, times, delays, jnp.argmax(changes), is_ahead & is_steady & crosses)
    is_proven = is_ahead & (is_far | (is_steady & is_exact))
    return jnp.where(crosses, moment, times[STRETCHES // 2]), crosses, is_proven


def _unevenness(sights: Sight, rates: Sight, step: Scalar) -> tuple[Scalar, Scalar]:
    """How far the motion in a stretch strays from its chord: of the orientation in rad, of the place in m."""

    def most(values: Array, slopes: Array) -> Scalar:
        chords = (values[1:] - values[:-1]).reshape(STRETCHES, 1, -1)
        inside = slopes[:-1].reshape(STRETCHES, -1, chords.shape[2])
        after = slopes[1:].reshape(inside.shape)  # so that both ends of a stretch count
        strays = jnp.stack([step * inside - chords, step * after - chords])
        return jnp.sqrt(jnp.max(jnp.sum(strays**2, axis=-1)))

    return most(sights.R_ecef_from_camera, rates.R_ecef_from_camera), most(sights.centre, rates.centre)


def _root(scene: Scene, times: Times, delays: Times, k: Array, is_there: Flag) -> tuple[Scalar, Flag]:
    """(root of the delay in the stretch k by secants, whether it is exact); nothing is done if none is there."""
    step = times[1] - times[0]
    first = jnp.clip(k - (jnp.abs(delays[k]) < jnp.abs(delays[k + 1])), 0, STRETCHES - 2)
    a, b, c = (delays[first + n] for n in range(3))
    # time by delay, quadratic through three samples
    ab, ac, bc = (jnp.where(x == 0.0, 1.0, x) for x in (a - b, a - c, b - c))
    share = a * (2.0 * b / ac - c / ab) / bc
    chord = (delays[k + 1] - delays[k]) / step

    def unfinished(state: tuple[Scalar, Scalar, Scalar, Flag, Array]) -> Flag:
        return ~state[3] & (state[4] < MOST)

    def secant(state: tuple[Scalar, Scalar, Scalar, Flag, Array]) -> tuple[Scalar, Scalar, Scalar, Flag, Array]:
        moment, before, change, _, count = state
        value = delay_at(moment, scene)
        slope = jnp.where(count == 0, chord, (value - before) / jnp.where(change == 0.0, 1.0, change))
        following = -value / jnp.where((slope == 0.0) | ((count > 0) & (change == 0.0)), chord, slope)
        following = jnp.clip(following, -step, step)
        is_exact = (count > 0) & (jnp.abs(change * following) <= EXACT * step * step)
        return moment + following, value, following, is_exact, count + 1

    no = jnp.where(jnp.isfinite(a), 0.0 * a, 0.0)  # of the points' own kind, also where each device has some
    state = (times[first] + step * share, no, no, ~is_there, k - k)
    moment, _, _, is_exact, _ = jax.lax.while_loop(unfinished, secant, state)
    return moment, is_exact


def search_missed(
    search: Callable[[Any], tuple[Scalar, StatusCode]], places: Array, missed: Array, found: tuple[Array, Array]
) -> tuple[Array, Array]:
    """What is `found` for places (leading axis), and the result of `search` for those that are missed."""
    count, size = jnp.sum(missed), places.shape[0]
    if not size:
        return found
    block = min(by_device(BLOCK, BLOCK_ACCELERATOR), size)
    order = jnp.pad(jnp.argsort(~missed, stable=True), (0, -size % block), mode="edge")

    def searched(state: tuple[Array, Any]) -> tuple[Array, Any]:
        first, found = state
        index = jax.lax.dynamic_slice_in_dim(order, first, block)
        # others beside them keep what was found
        some = jax.tree.map(
            lambda new, old: jnp.where(missed[index], new, old[index]), jax.vmap(search)(places[index]), found
        )
        return first + block, jax.tree.map(lambda old, new: old.at[index].set(new), found, some)

    return jax.lax.while_loop(lambda state: state[0] < count, searched, (jnp.zeros_like(count), found))[1]
