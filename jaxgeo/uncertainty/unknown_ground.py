"""Unknown ground beside a line of sight: voids and the border of a terrain model, which perturbed lines may meet first.

A terrain profile follows the ground in the vertical plane of the line of sight. Lines that errors move aside may pass
over a void that the plane misses: the first ground that they meet is unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._typing import Scalar, Vector3
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.model_inputs import NominalFix
from jaxgeo.uncertainty.sight_plane import SightPlane

ASIDE = np.array([-2.2, -1.6, -1.0, -0.35, 0.35, 1.0, 1.6, 2.2])  # sigmas by which lines are moved
WEIGHTS = np.array([0.0287, 0.0681, 0.1452, 0.2580, 0.2580, 0.1452, 0.0681, 0.0287])  # probability about each
STATIONS = 256  # sample points of each line, in equal steps, staggered so that other lines find other voids
STAGGER = 0.618034 * np.arange(len(ASIDE)) % 1.0
SHARES = (np.arange(STATIONS) + STAGGER[:, None]) / STATIONS
REACH = 3.0  # sigmas of lift between which lines are followed
FLATTEST = 0.02  # smallest descent per m for the length that is followed
BEYOND_NADIR = 1.0  # descent per m from which lines are followed behind the camera too
EARTH = 6.371e6  # m: radius, for the height of a line far from its fix

Levels = Float[Array, " levels"]


class LinesOfSight(NamedTuple):
    """Perturbed lines of sight: the vertical plane of the nominal one, and the standard deviations in m of their height
    over the ground (`lift`) and of their place aside, at distances ahead of the fix in m."""

    plane: SightPlane
    lift: Callable[[Array], Array]
    aside: Callable[[Array], Array]


def lost_beside(
    terrain: AbstractTerrain, nominal: NominalFix, lines: LinesOfSight, levels: Levels, met: Levels
) -> tuple[Scalar, Scalar]:
    """(share of the lines that meet unknown ground beside the nominal one before any other, the smallest number of
    sigmas at which one does).

    The lines are lifted by `levels` sigmas, of equal probability, and independently moved aside. `met` is the distance
    in m ahead of the fix at which those of each level meet the ground in the plane of the nominal one, minus infinity
    for those that are not counted. Lines are followed from where they sink below the top of unknown ground.
    """
    if terrain.void_top is None:
        return jnp.asarray(0.0), jnp.asarray(jnp.inf)
    top = terrain.void_top - jnp.asarray(nominal.fix.position.height)
    plane, fall = lines.plane, lines.plane.fall
    steep = jnp.maximum(fall, FLATTEST)
    behind = REACH * lines.lift(jnp.zeros(())) / steep
    before = jnp.minimum(jnp.maximum(top, 0.0) / steep + behind, nominal.distance * plane.level)
    before = jnp.maximum(before, jnp.where(fall > BEYOND_NADIR, behind, 0.0))
    ends = jnp.stack([-before, 0.5 * (behind - before), behind])
    on_ground = plane.abreast(ends, fall * jnp.clip(ends, -behind, behind))
    paths = _paths(nominal, plane.path, ends, jnp.asarray(ASIDE)[:, None] * lines.aside(on_ground)[None, :])
    known = jax.vmap(terrain.known_along)(paths, jnp.asarray(SHARES))
    ahead = jnp.asarray(SHARES) * (before + behind) - before
    height = ahead**2 / (2.0 * EARTH) - fall * ahead  # of the nominal line over the fix
    wall = top - height
    wall = jnp.where(known, -jnp.inf, wall / lines.lift(plane.abreast(ahead, wall)))
    met = met + (before + behind) / STATIONS  # the ground that they meet may itself be unknown
    stopped = (ahead[:, :, None] < met[None, None, :]) & (wall[:, :, None] >= levels[None, None, :])
    lost = jnp.any(stopped, axis=1)
    sigmas = jnp.hypot(ASIDE[:, None], levels[None, :])
    return jnp.mean(WEIGHTS @ lost), jnp.min(jnp.where(lost, sigmas, jnp.inf))


def _paths(
    nominal: NominalFix, forth: Vector3, ahead: Float[Array, "3"], aside: Float[Array, "lines 3"]
) -> Float[Array, "lines 3 3"]:
    """Points in ECEF, m, at distances along the path `forth` of the fix and aside, to the left."""
    to_side = jnp.stack([-forth[1], forth[0], jnp.zeros(())])
    offset_enu = (ahead[:, None] * forth[None, :])[None] + aside[:, :, None] * to_side[None, None, :]
    return nominal.p_ecef[None, None, :] + offset_enu @ nominal.R_ecef_from_enu.T
