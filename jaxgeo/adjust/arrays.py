"""Array representation of a block, and the columns of its unknowns."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._record import Record
from jaxgeo.adjust.collinearity import Observed
from jaxgeo.adjust.layout import Layout
from jaxgeo.adjust.ray_effects import RayEffects
from jaxgeo.adjust.values import POSE, Step, Values
from jaxgeo.sensor import FrameCamera


class Known(Record):
    """Priors of some unknowns: 1 / sigma (zero for none), and 1 for free unknowns, else 0."""

    information: Float[Array, "some size"]
    free: Float[Array, "some size"]


class Problem(Record):
    """A block in the order of its layout, with its unknowns.

    `active` are the unknown columns of the lenses. With `own_lens` each image has its own camera and lens, which is
    eliminated and solved for with the image. `mounts` and `strips` state whether any of these is unknown; `common`
    (1, k) are the numbers of the navigation errors that images share, always unknown. Control points are `place`
    (rows, 3) with `known_point` (rows, 3, 3), W with W' W the inverse covariance. `effects` are those of readout and
    refraction, if any.
    """

    layout: Layout
    cameras: FrameCamera
    observed: Observed | None
    mount_of: Int[Array, " n"]
    strip_of: Int[Array, " n"]
    start: Values
    place: Float[Array, "rows 3"]
    known_point: Float[Array, "rows 3 3"]
    free_point: Float[Array, "rows 3"]
    free_pose: Float[Array, "n 6"]
    lens: Known
    mount: Known
    strip: Known
    common: Known
    terrain: Any
    active: tuple[int, ...] = eqx.field(static=True)
    own_lens: bool = eqx.field(static=True)
    mounts: bool = eqx.field(static=True)
    strips: bool = eqx.field(static=True)
    effects: RayEffects | None = None

    @property
    def n(self) -> int:
        """Number of images."""
        return self.layout.camera.shape[0]

    @property
    def of_image(self) -> int:
        """Columns per image in the reduced system."""
        return POSE + (len(self.active) if self.own_lens else 0)

    @property
    def active_interior(self) -> tuple[int, ...]:
        """The unknown columns of interior orientation and lens, without those of `effects`."""
        return self.active if self.effects is None else tuple(i for i in self.active if i < self.effects.first)

    @property
    def of_lenses(self) -> int:
        """Columns of lenses shared between images."""
        return 0 if self.own_lens else self.lens.free.shape[0] * len(self.active)

    @property
    def shared(self) -> int:
        """Columns of all shared parameters: lenses, mounts, strips, common errors of the navigation."""
        own = self.mounts * self.mount.free.size + self.strips * self.strip.free.size
        return self.of_lenses + own + self.common.free.size


def step_of(problem: Problem, images: Any, shared: Any, points: Any) -> Step:
    """`Step` from solution vectors (n, c), (s,) and (3, rows)."""
    active, first = len(problem.active), problem.of_lenses
    lens = jnp.zeros(problem.lens.free.shape)
    if problem.own_lens and active:
        lens = lens.at[problem.layout.camera].set(images[:, POSE:], unique_indices=True)
    elif first:
        lens = shared[:first].reshape(lens.shape)
    mount, strip = jnp.zeros(problem.mount.free.shape), jnp.zeros(problem.strip.free.shape)
    if problem.mounts:
        mount = shared[first : first + mount.size].reshape(mount.shape)
        first += mount.size
    if problem.strips:
        strip = shared[first : first + strip.size].reshape(strip.shape)
        first += strip.size
    return Step(pose=images[:, :POSE], points=points.T, lens=lens, mount=mount, strip=strip, common=shared[first:])


def free_columns(problem: Problem) -> tuple[Array, Array]:
    """1 for each free column of the images (n, c) and of the shared parameters (s,), else 0."""
    images = problem.free_pose
    if problem.own_lens:
        images = jnp.concatenate([images, problem.lens.free[problem.layout.camera]], axis=1)
    shared = [jnp.zeros(0)]
    shared += [problem.lens.free.ravel()] if problem.of_lenses else []
    shared += [problem.mount.free.ravel()] if problem.mounts else []
    shared += [problem.strip.free.ravel()] if problem.strips else []
    shared += [problem.common.free.ravel()]
    return images, jnp.concatenate(shared)
