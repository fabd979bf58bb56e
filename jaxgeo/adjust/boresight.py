"""Two-step boresight and lever arm calibration from adjusted orientations and navigation.

No `solver` argument: the orientations are eliminated in the banded matrix of the adjustment, which leaves 3 or 6
unknowns; a general solver sees 6 more for each image (`benchmarks/solvers.py`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgeo._blas_threads import one_thread
from jaxgeo._compile import sized_filter_jit
from jaxgeo._numerics import matmul3
from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.arrays import Problem, free_columns
from jaxgeo.adjust.banded import Tridiagonal, factored
from jaxgeo.adjust.collinearity import Observed, navigation_residual
from jaxgeo.adjust.navigation import Navigation
from jaxgeo.adjust.problem import observed_of
from jaxgeo.adjust.reduction import on_diagonal, solve_reduced, undamped
from jaxgeo.adjust.values import POSE, STRIP, Values
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import Mount

STEPS = 8
HELD = 1e-10  # smallest accepted eigenvalue of the correlations: below it the requested parameters are not separable


class TwoStep(NamedTuple):
    """A mount from orientations: `turn` (3), the boresight rotation vector in rad; `lever` (3) in m, body axes;
    `covariance` (6, 6) of both, of unit weight (zero where fixed); the navigation's `sigma0`; and the `mount`."""

    mount: Mount
    turn: np.ndarray
    lever: np.ndarray
    covariance: np.ndarray
    sigma0: float


@one_thread()
def two_step_boresight(
    adjustment: Adjustment,
    mount: str | None = None,
    *,
    lever: bool = False,
    navigation: Navigation | None = None,
) -> TwoStep:
    """Boresight, and with `lever` the lever arm, of a mount that was fixed in an adjustment: the second step.

    Compares the adjusted orientations with the navigation, which must not have influenced them: use an adjustment on
    control with `loosened` navigation, and pass the original one as `navigation` (Xue et al. 2019, after their Eq 5;
    here with full rotations instead of first-order angles). Weights are those of the navigation and, with all
    correlations, of the adjusted orientations. Raises `ValueError` without navigation, for fewer than two images, and
    for navigation or a flight that does not determine the requested parameters.
    """
    ready, block = adjustment.prepared, adjustment.block
    navigation = block.navigation if navigation is None else navigation
    if navigation is None or ready.problem.observed is None:
        raise ValueError("the block has no navigation to compare orientations with.")
    names = list(ready.names.mount)
    if mount is None and len(names) > 1:
        raise ValueError(f"say which mount: {', '.join(names)}.")
    name = names[0] if mount is None else mount
    if name not in names:
        raise ValueError(f"there is no mount {name!r}; there are {', '.join(names)}.")
    own = np.flatnonzero(np.asarray(ready.problem.mount_of) == names.index(name))
    if len(own) < 2:
        raise ValueError(f"mount {name} has {len(own)} images; a boresight in two steps takes at least two.")
    problem, values = ready.problem, adjustment.solution.values
    offsets = np.asarray(ready.problem.strip.free)[:, STRIP:]
    observed = observed_of(replace(block, navigation=navigation), ready.names, offsets)
    found = _two_step(
        problem,
        undamped(problem, adjustment.solution.equations)[1],
        observed,
        values,
        jnp.asarray(names.index(name)),
        lever,
    )
    turn, arm, covariance, sigma0 = (np.asarray(x) for x in found)
    size = 6 if lever else 3
    own = covariance[:size, :size]
    sigma = np.sqrt(np.where(np.diagonal(own) > 0.0, np.diagonal(own), np.nan))
    if not np.all(np.isfinite(own)) or not np.linalg.eigvalsh(np.nan_to_num(own / np.outer(sigma, sigma)))[0] > HELD:
        what = "boresight and the lever arm" if lever else "boresight"
        raise ValueError(
            f"the navigation of mount {name} does not tell the {what}: observe what does, or fly in several directions."
        )
    given, level = navigation.mounts[name]
    R = np.asarray(R_from_rotation_vector(jnp.asarray(turn)))
    where = (lambda m: m.R_head_from_camera) if level else (lambda m: m.R_body_from_base)
    result = eqx.tree_at(where, given, R @ np.asarray(where(given), np.float64))
    result = eqx.tree_at(lambda m: m.lever_body, result, arm)
    return TwoStep(result, turn, arm, covariance, float(sigma0))


@sized_filter_jit
def _two_step(
    problem: Problem, matrix: Tridiagonal, observed: Observed, values: Values, mount: Int[Array, ""], with_lever: bool
) -> tuple[Array, Array, Array, Array]:
    """(turn, lever, covariance, sigma0) by generalised least squares over all images.

    The covariance of the adjusted orientations is the inverse of the reduced normal matrix M. With B the derivatives of
    the navigation residuals by the orientations, (1 + B M^-1 B')^-1 = 1 - B (M + B'B)^-1 B', which needs no covariance
    matrix and preserves the block structure of M.
    """
    size, band, lever = 6 if with_lever else 3, problem.layout.band, values.lever[mount]
    mine = problem.mount_of == mount
    free, _ = free_columns(problem)

    def one(x: Float[Array, " size"], step: Float[Array, "6"], image: Any) -> Float[Array, "6"]:
        observed_image, centre, R, strip, common = image
        arm = lever + x[3:] if with_lever else lever
        R = matmul3(R, R_from_rotation_vector(step[3:]))
        return navigation_residual(
            observed_image, centre + step[:3], R, R_from_rotation_vector(x[:3]), arm, strip, common
        )

    def linear(x: Float[Array, " size"], image: Any) -> tuple[Array, Array, Array]:
        none = jnp.zeros(6)
        return one(x, none, image), jax.jacfwd(one)(x, none, image), jax.jacfwd(one, argnums=1)(x, none, image)

    common = jnp.broadcast_to(values.common, (problem.n, values.common.shape[0]))
    images = (observed, values.centre, values.R_frame_from_camera, values.strip[problem.strip_of], common)
    weights = jnp.concatenate([observed.information_position, observed.information_attitude], axis=1)
    count = jnp.sum(jnp.any(weights != 0.0, axis=2) & mine[:, None])

    def improved(_: Any, state: Any) -> tuple[Array, Array, Array]:
        x = state[0]
        off, J, B = (y * mine.reshape(-1, *(1,) * (y.ndim - 1)) for y in jax.vmap(linear, in_axes=(None, 0))(x, images))
        B = jnp.pad(B, ((0, 0), (0, 0), (0, problem.of_image - POSE))) * free[:, None, :]
        own = on_diagonal(band, jnp.einsum("nka,nkb->nab", B, B))[: band.slabs].reshape(matrix.diagonal.shape)
        factor = factored(eqx.tree_at(lambda m: m.diagonal, matrix, matrix.diagonal + own))
        columns = jnp.concatenate([J, off[:, :, None]], axis=2)  # of x and of the misclosure
        right = jnp.einsum("nka,nkj->nja", B, columns)
        none = jnp.zeros((size + 1, problem.shared))
        left = jax.vmap(lambda r, s: solve_reduced(problem, factor, r, s)[0])(jnp.moveaxis(right, 1, 0), none)
        total = jnp.einsum("nki,nkj->ij", columns, columns) - jnp.einsum("nia,jna->ij", right, left)
        normal = total[:size, :size]
        return x - jnp.linalg.solve(normal, total[:size, size]), normal, total[size, size]

    start = (jnp.zeros(size), jnp.zeros((size, size)), jnp.zeros(()))
    x, normal, squares = jax.lax.fori_loop(0, STEPS, improved, start)
    whole = jnp.zeros((6, 6)).at[:size, :size].set(jnp.linalg.inv(normal))
    arm = lever + x[3:] if with_lever else lever
    return x[:3], arm, whole, jnp.sqrt(squares / jnp.maximum(count - size, 1))
