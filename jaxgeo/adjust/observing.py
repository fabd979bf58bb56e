"""Linearised observations other than image points: control, terrain and navigation."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._record import Record
from jaxgeo._typing import Scalar
from jaxgeo.adjust.arrays import Problem
from jaxgeo.adjust.collinearity import navigation_linear
from jaxgeo.adjust.equations import known_points, navigation_columns, of_images
from jaxgeo.adjust.values import POSE, Values


class Observing(Record):
    """Weighted derivatives by free unknowns: of control (rows, 3, 3) and terrain (rows, 3) by the point, of the
    navigation, and of further observations of orientations, by the pose (n, k, 6) and the shared parameters (n, k, s);
    and the weighted residuals of each."""

    control: Float[Array, "rows 3 3"]
    terrain: Float[Array, "rows 3"]
    by_pose: Float[Array, "n k 6"]
    by_shared: Float[Array, "n k s"]
    of_control: Float[Array, "rows 3"]
    of_terrain: Float[Array, " rows"]
    of_navigation: Float[Array, "n k"]
    weights: tuple[Float[Array, "rows 3"], Float[Array, " rows"], Float[Array, "n k"]]

    def alike(self, size: Scalar) -> Observing:
        """A copy with unit weights on lengths in m, and on rotations as displacements at a distance of `size` m."""
        control, terrain, navigation = (jnp.where(w > 0.0, 1.0 / jnp.where(w > 0.0, w, 1.0), 0.0) for w in self.weights)
        further = jnp.ones(navigation.shape[1] - 6)
        navigation = navigation * jnp.concatenate([jnp.ones(3), jnp.full(3, size), further])[None]
        return Observing(
            self.control * control[:, :, None],
            self.terrain * terrain[:, None],
            self.by_pose * navigation[:, :, None],
            self.by_shared * navigation[:, :, None],
            self.of_control * control,
            self.of_terrain * terrain,
            self.of_navigation * navigation,
            self.weights,
        )

    def along(self, images: Any, shared: Any, points: Any) -> tuple[Array, Array, Array]:
        """Weighted changes of control, terrain and navigation for changes of images (n, c), shared parameters (s,)
        and points (3, rows)."""
        by_pose = jnp.einsum("nka,na->nk", self.by_pose, images[:, :POSE])
        return (
            jnp.einsum("rki,ir->rk", self.control, points),
            jnp.einsum("ri,ir->r", self.terrain, points),
            by_pose + jnp.einsum("nka,a->nk", self.by_shared, shared),
        )

    def flat(self, images: Float[Array, "d n c"], points: Float[Array, "d 3 rows"]) -> Float[Array, "d k"]:
        """The same for several changes of images and points, each as one row."""
        shared = jnp.zeros(self.by_shared.shape[2])
        found = jax.vmap(lambda z, x: self.along(z, shared, x))(images, points)
        return jnp.concatenate([part.reshape(images.shape[0], -1) for part in found], axis=1)

    @property
    def residuals(self) -> Float[Array, " k"]:
        """Weighted residuals in the order of `flat`."""
        return jnp.concatenate([x.ravel() for x in (self.of_control, self.of_terrain, self.of_navigation)])

    def normal(
        self, images: Float[Array, "d n c"], points: Float[Array, "d 3 rows"]
    ) -> tuple[Float[Array, "d n c"], Float[Array, "d s"], Float[Array, "d 3 rows"]]:
        """Normal matrix of these observations times several changes."""

        def one(z: Array, x: Array) -> Any:
            shared = jnp.zeros(self.by_shared.shape[2])
            return jax.linear_transpose(self.along, z, shared, x)(self.along(z, shared, x))

        return jax.vmap(one)(images, points)


def observing(problem: Problem, values: Values, control_root: Float[Array, " rows"] | None = None) -> Observing:
    """Observations other than image points at given values; `control_root` is the square root of the loss weight of
    each control point."""
    free, rows, n = problem.free_point, values.points.shape[0], problem.n
    root = jnp.ones(rows) if control_root is None else control_root
    control = problem.known_point * free[:, None, :] * root[:, None, None]
    height, slope = jnp.zeros(rows), jnp.zeros((rows, 3))
    if problem.terrain is not None:
        height, slope = problem.terrain.linearised(values.points)
    columns = 12 + values.strip.shape[1] + values.common.shape[0]
    off, by = jnp.zeros((n, 6)), jnp.zeros((n, 6, columns))
    weights = jnp.zeros((n, 6))
    if problem.observed is not None:
        observed = problem.observed
        off, by = jax.vmap(navigation_linear)(observed, *of_images(problem, values))
        parts = (observed.information_position, observed.information_attitude)
        weights = jnp.concatenate([jnp.linalg.norm(x, axis=2) for x in parts], axis=1)
        if observed.rows is not None:  # their weights are those of positions
            weights = jnp.concatenate([weights, jnp.linalg.norm(observed.rows.by_pose[:, :, :3], axis=2)], axis=1)
    return Observing(
        control=control,
        terrain=slope * free,
        by_pose=by[..., :POSE] * problem.free_pose[:, None, :],
        by_shared=navigation_columns(problem, by),
        of_control=known_points(problem, values) * root[:, None],
        of_terrain=height,
        of_navigation=off,
        weights=(jnp.linalg.norm(control, axis=2), jnp.linalg.norm(slope, axis=1), weights),
    )
