"""Improved iteration (Guo 2002), as printed and as a secant.

H. Guo, "Research on monolithic mapping and inspection technology based on satellite remote sensing image", Zhengzhou
Information Engineering University, 2002, as described by Li et al. (2023), section 3 and figure 8. As printed:

    Z = Z0, A the point of the ray at height Z
    repeat: 1 = the ground below A (above it, if A is in the ground)
            2 = where the horizontal line from A outward meets the ground
            A = where the line through 1 and 2 meets the ray, Z its height
    until |Z - h(Z)| <= eps

As a secant of D(Z) = Z - h(Z), which needs no horizontal line:

    repeat: h = h(Z); Z = Z - D(Z) (h - Z) / (D(h) - D(Z))
    until |D(Z)| <= eps
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar, ScalarField
from jaxgeo.terrain.search.literature.descent import DemSample, Descent
from jaxgeo.terrain.search.literature.fixed_point import iterate, middle_height
from jaxgeo.terrain.search.literature.studied import EPS, AbstractStudiedSearch, Search


class ImprovedLiteral(AbstractStudiedSearch):
    """Intersects the ray with the line through the ground below the point and the ground hit horizontally outward.

    Outward is away from the camera for a point above ground, and out of the hill, back towards the camera, for one
    below: the interpretation under which the method converges on slopes that face the camera, as printed. (Away from
    the camera in both cases it finds the first hit for 65 instead of 90 % of the rays over rough mountains.)

    `eps` in m ends it; `start` is the initial height in m (the middle between lowest and highest post if None); `limit`
    the maximum number of steps, far more than a converging ray takes. The horizontal line is followed over at most
    `outward` posts, with every DEM evaluation counted; if it hits no ground (never on level or falling ground), the
    line through 1 is level, which makes the step photogrammetric.
    """

    eps: ScalarField = EPS
    start: ScalarField | None = None
    limit: ScalarField = 100
    outward: ScalarField = 200

    def search(self, descent: Descent) -> Search:
        most = jnp.asarray(self.outward)
        start = middle_height(descent, self.start)

        def step(descent: Descent, sample: DemSample) -> tuple[Scalar, Index]:
            return _to_line(descent, sample, most)

        return iterate(descent, start, step, jnp.asarray(self.eps), jnp.asarray(self.limit))


class ImprovedSecant(AbstractStudiedSearch):
    """Secant of D through Z and h(Z), two evaluations per step; the practical variant of the improved iteration.

    `eps` in m ends it; `start` is the initial height in m (the middle between lowest and highest post if None); `limit`
    the maximum number of steps, far more than a converging ray takes.
    """

    eps: ScalarField = EPS
    start: ScalarField | None = None
    limit: ScalarField = 100

    def search(self, descent: Descent) -> Search:
        start = middle_height(descent, self.start)
        return iterate(descent, start, secant_step, jnp.asarray(self.eps), jnp.asarray(self.limit))


def secant_step(descent: Descent, sample: DemSample) -> tuple[Scalar, Index]:
    """Next height by the secant through (Z, D(Z)) and (h, D(h)); infinite if the secant is level."""
    below = descent.sample_at(sample.ground)
    rise = below.clearance - sample.clearance
    height = sample.height + sample.clearance**2 / jnp.where(rise == 0.0, 1.0, rise)
    return jnp.where(rise == 0.0, jnp.inf, height), jnp.asarray(1, jnp.int32)


class _Outward(Record):
    """State of the walk along the horizontal line: posts passed, and clearances of the last two samples."""

    count: Index
    before: Scalar
    now: Scalar


def _to_line(descent: Descent, sample: DemSample, most: Index) -> tuple[Scalar, Index]:
    """Intersection of the ray with the line through 1 (ground below A) and 2 (ground hit horizontally outward)."""
    unit = descent.post_step() * jnp.where(sample.clearance > 0.0, 1.0, -1.0)

    def is_going_on(walk: _Outward) -> Flag:
        return ((walk.now > 0.0) == (sample.clearance > 0.0)) & (walk.count < most)

    def advance(walk: _Outward) -> _Outward:
        ahead = descent.sample_along(sample.distance + unit * (walk.count + 1), sample.height)
        return _Outward(walk.count + 1, walk.now, ahead.clearance)

    walk = _Outward(jnp.asarray(0, jnp.int32), sample.clearance, sample.clearance)
    walk = jax.lax.while_loop(is_going_on, advance, walk)
    is_met = (walk.now > 0.0) != (sample.clearance > 0.0)
    part = walk.before / jnp.where(is_met, walk.before - walk.now, 1.0)
    outward = unit * (walk.count - 1 + part)
    fall = descent.sinking(sample.distance)
    climb = jnp.where(is_met, sample.clearance / jnp.where(is_met, outward, 1.0), 0.0)
    meeting = fall + climb
    height = sample.height - fall * sample.clearance / jnp.where(meeting == 0.0, 1.0, meeting)
    return jnp.where(meeting == 0.0, jnp.inf, height), walk.count
