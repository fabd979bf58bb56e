"""Joint covariance of several fixes, differences between targets, and fusion of observations of one target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._record import Record
from jaxgeo._typing import Matrix3, Vector3
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.uncertainty.linear import Propagation
from jaxgeo.uncertainty.sharing import Occasion

SINGULAR = 1e-10  # of the largest eigenvalue: smaller ones are rounding
Joint = Float[Array, "coordinates coordinates"]


class JointFixes(Record):
    """Fixes with their joint covariance, `cov_ecef` (3 n, 3 n) in ECEF m2, in the order of the fixes."""

    p_ecef: Float[Array, "fixes 3"]
    cov_ecef: Joint

    def baseline(self, here: int, there: int) -> tuple[Vector3, Matrix3]:
        """(vector from one fix to another in east, north, up at the first, m; its covariance, m2).

        Common errors of the two fixes cancel.
        """
        a, b = slice(3 * here, 3 * here + 3), slice(3 * there, 3 * there + 3)
        cov = self.cov_ecef[a, a] + self.cov_ecef[b, b] - self.cov_ecef[a, b] - self.cov_ecef[b, a]
        R = R_ecef_from_enu(WGS84.to_geodetic(self.p_ecef[here]))
        return R.T @ (self.p_ecef[there] - self.p_ecef[here]), R.T @ cov @ R

    def fused(self) -> tuple[Vector3, Matrix3]:
        """(best linear unbiased estimate of one target from all observations, ECEF m; its covariance in ENU there, m2).

        Generalised least squares with all correlations: correlated observations count for less than their number. The
        covariance may be singular, as for fixes on one known surface (Rao 1971, "Unified theory of linear
        estimation").
        """
        count = self.p_ecef.shape[0]
        stacked = jnp.tile(jnp.eye(3), (count, 1))
        scale = jnp.sqrt(jnp.trace(self.cov_ecef) / (3 * count))
        widened = self.cov_ecef / scale**2 + stacked @ stacked.T
        inverse = jnp.linalg.pinv(widened, rtol=SINGULAR, hermitian=True)
        wide = jnp.linalg.inv(stacked.T @ inverse @ stacked)
        cov = wide - jnp.eye(3)
        reference = self.p_ecef[0]
        offsets = (self.p_ecef - reference[None, :]).reshape(-1)
        p_ecef = reference + wide @ (stacked.T @ inverse @ offsets)
        R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))
        return p_ecef, R.T @ (cov * scale**2) @ R


def joint_covariance(
    propagations: Sequence[Propagation],
    *,
    shots: Sequence[int] | None = None,
    times: Sequence[float] | None = None,
    flights: Sequence[int] | None = None,
) -> JointFixes:
    """Fixes of several observations with their joint covariance, from the sharing of each error source.

    `shots` numbers the shot of each observation (default: all different; two targets in one image have the same
    number), `times` gives each in s, for time-correlated errors, `flights` the flight (default: all the same). All must
    come from the same error model. Raises `ValueError` for models that differ, or lists of other lengths.
    """
    count = len(propagations)
    if count < 1:
        raise ValueError("joint_covariance needs at least one propagation; got none.")
    given = {"shots": shots, "times": times, "flights": flights}
    for name, values in given.items():
        if values is not None and len(values) != count:
            raise ValueError(f"{name} must have an entry for each of the {count} observations; got {len(values)}.")
    first = propagations[0].model
    for number, one in enumerate(propagations):
        if one.model.axes != first.axes:
            raise ValueError(f"observation {number} has other error sources than observation 0; use one model for all.")
    occasions = [
        Occasion(
            number,
            number if shots is None else shots[number],
            0 if flights is None else flights[number],
            0.0 if times is None else times[number],
        )
        for number in range(count)
    ]
    rows = [
        jnp.concatenate([_cross(a, b, (i, j)) for b, j in zip(propagations, occasions, strict=True)], axis=1)
        for a, i in zip(propagations, occasions, strict=True)
    ]
    p_ecef = jnp.stack([jnp.asarray(one.fix.ecef) for one in propagations])
    return JointFixes(p_ecef, jnp.concatenate(rows, axis=0))


@jax.jit
def _cross(here: Propagation, there: Propagation, when: tuple[Occasion, Occasion]) -> Matrix3:
    """Covariance between two fixes in ECEF, m2."""
    total = jnp.zeros((3, 3))
    for (source, place), (other, _) in zip(here.model.parts(), there.model.parts(), strict=True):
        cov: Any = source.cross_covariance(other, when)
        total = total + here.jacobian[:, place] @ cov @ there.jacobian[:, place].T
    return here.nominal.R_ecef_from_enu @ total @ there.nominal.R_ecef_from_enu.T
