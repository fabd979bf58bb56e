"""The record of accuracy, of one fix or of many."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import by_numpy_if_known
from jaxgeo._record import Record
from jaxgeo._renamed import warn_renamed
from jaxgeo._typing import IndexField, Matrix3Field, ScalarField, Vector3Field
from jaxgeo.fix import Fix
from jaxgeo.status import Status, count_statuses
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.host_arrays import take
from jaxgeo.uncertainty.linear import Propagation
from jaxgeo.uncertainty.method_selection import (
    NO_FIX,
    Diagnostics,
    Method,
    explain_method,
    relative_margin,
    select_method,
)
from jaxgeo.uncertainty.profile import Profile
from jaxgeo.uncertainty.sampled import Sampled


class OldNames:
    """Fields of an accuracy by their old names, for one release."""

    @property
    def trust(self: Any) -> Any:
        """Deprecated: `method`."""
        warn_renamed(f"{type(self).__name__}.trust", f"{type(self).__name__}.method")
        is_known = np.ndim(self.method) == 0 and not isinstance(self.method, jax.core.Tracer)
        return Method(int(self.method)) if is_known and int(self.method) != NO_FIX else self.method

    @property
    def signs(self: Any) -> Diagnostics:
        """Deprecated: `diagnostics`."""
        warn_renamed(f"{type(self).__name__}.signs", f"{type(self).__name__}.diagnostics")
        return self.diagnostics


class Accuracy(OldNames, Record):
    """Accuracy of one fix, or of many with leading axes: radii in m that contain the true point with `probability`.

    `circular` is horizontal, `linear` vertical, `spherical` in space. They are infinite where too many samples have no
    fix, and NaN where samples are needed but not drawn or there is no fix. `method` is the propagation method (codes
    of `Method`), `NO_FIX` (-1) without a fix: `fix.status` then gives the reason. `cov_enu` (..., 3, 3) in m² and
    `bias_enu` (..., 3) in m, east, north, up, are those of linear propagation, NaN where it is not valid. The radii are
    then those of this covariance, times the ratio of the figure over the terrain profile to that over the plane: within
    5 % of samples in 97 % of looks at rough and real terrain (benchmarks/verdict.py). `failed` is the share of samples
    without a fix, NaN if none were drawn; `count` is the number of samples drawn where they are needed. `diagnostics`
    selected the method. `propagation`, `sampled` and the terrain `profile` hold the details of one fix outside `jit`.
    `note` says what linear propagation leaves out of errors that are not normal, None if all are normal.

    A pytree for `jit` and `vmap`. `found[3]` is one of many; `str(found)` describes one, and summarises many.
    """

    fix: Fix
    probability: ScalarField
    circular: ScalarField
    linear: ScalarField
    spherical: ScalarField
    method: IndexField
    cov_enu: Matrix3Field
    bias_enu: Vector3Field
    failed: ScalarField
    diagnostics: Diagnostics
    count: int = eqx.field(static=True, default=0)
    propagation: Propagation | None = None
    sampled: Sampled | None = None
    profile: Profile | None = None
    note: str | None = eqx.field(static=True, default=None)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch; () for one fix."""
        return jnp.shape(self.method)

    @property
    def has_fix(self) -> Any:
        """Whether each observation has a fix."""
        return jnp.asarray(self.method) != NO_FIX

    def __getitem__(self, index: Any) -> Accuracy:
        """One or several of many, without details of single fixes."""
        if not self.shape:
            raise IndexError("this is the accuracy of one fix; there is nothing to index.")
        return take(self, index)

    @property
    def words(self) -> str | None:
        """Name of the method of one fix, None without a fix; host only."""
        code = int(np.asarray(self._one("words").method))
        return None if code == NO_FIX else Method(code).words

    @property
    def because(self) -> str | None:
        """Why the method of one fix was selected and no cheaper one, None without a fix; host only.

        Raises `ValueError` for many fixes: take one, `found[3].because`.
        """
        code = int(np.asarray(self._one("because").method))
        return None if code == NO_FIX else _because(self.diagnostics, Method(code), self.note)

    @property
    def circular_interval(self) -> tuple[Any, Any]:
        """Interval from low to high, m, that holds the exact circular error of 95 % of fixes.

        By linear propagation it follows from the terrain's shape within the error region, and was set on looks at
        synthetic and real terrain of which samples tell the 90 % circular error (benchmarks/verdict.py). By samples it
        is their confidence interval, of one fix with its details; NaN of others.
        """
        if self.sampled is None:
            return by_numpy_if_known(_linear_interval, self.circular, self.method, self.diagnostics)
        found = self.sampled.circular_error(self.level())
        return jnp.asarray(found.low), jnp.asarray(found.high)

    def level(self) -> float:
        """The probability common to all radii; host only. Raises `ValueError` if there are several."""
        given = np.asarray(self.probability, np.float64)
        levels = np.unique(given[~np.isnan(given)])
        if levels.size != 1:
            raise ValueError(f"the radii must be of one probability; got {levels}.")
        return float(levels[0])

    def __str__(self) -> str:
        if self.shape:
            return summary(self, "observations")
        status = Status(int(np.asarray(self.fix.status)))
        if self.words is None:
            return f"No fix: {status.name}: {status.message}"
        percent = f"{100.0 * self.level():g}"
        radii = (("CE", self.circular), ("LE", self.linear), ("SE", self.spherical))
        texts = [f"{name}{percent} {figure(radius, 4)} m" for name, radius in radii]
        low, high = map(float, self.circular_interval)
        texts[0] += f" ({figure(low)} to {figure(high)})" if np.isfinite(low + high) else ""
        figures = ", ".join(texts)
        drawn = "" if self.count or self.words != Method.samples.words else ", which were not drawn"
        return f"{figures}, by {self.words}{drawn}. {self.because}"

    def _one(self, name: str) -> Accuracy:
        if self.shape:
            raise ValueError(f"{name} is that of one fix; this is the accuracy of {self.shape}: found[3].{name}.")
        return self


def _linear_interval(xp: Any, circular: Any, method: Any, diagnostics: Any) -> tuple[Any, Any]:
    """Interval of circular errors by linear propagation, NaN of others."""
    is_linear = (method == Method.facet.value) | (method == Method.footprint.value)
    factor = xp.exp(relative_margin(xp, diagnostics))
    return xp.where(is_linear, circular / factor, xp.nan), xp.where(is_linear, circular * factor, xp.nan)


def summary(accuracy: Any, noun: str, meaning: Callable[[Status], str] = lambda status: status.message) -> str:
    """Number of fixes, quantiles of the circular errors, and counts of methods and statuses."""
    method, statuses = np.asarray(accuracy.method), np.asarray(accuracy.fix.status)
    circular, linear = np.asarray(accuracy.circular), np.asarray(accuracy.linear)
    has_fix = method != NO_FIX
    lines = [f"{np.count_nonzero(has_fix)} of {has_fix.size} {noun} have a fix."]
    known = circular[~np.isnan(linear)]
    if known.size:
        low, high = (float(np.quantile(known, share, method="higher")) for share in (0.5, 0.9))
        percent = f"{100.0 * accuracy.level():g}"
        lines[0] += (
            f" CE{percent} up to {figure(low)} m in half of those with figures, {figure(high)} m in nine tenths."
        )
    for one in Method:
        drawn = f", {accuracy.count} each" if accuracy.count else ", not drawn"
        words = one.words + (drawn if one is Method.samples else "")
        lines.append(f"  {np.count_nonzero(method == one):8d}  {words}")
    for status, number in count_statuses(statuses[~has_fix]).items():
        lines.append(f"  {number:8d}  {status.name}: {meaning(status)}")
    if getattr(accuracy, "note", None) is not None:
        lines.append(accuracy.note)
    return "\n".join(lines)


def reasons(accuracy: Accuracy) -> list[str | None]:
    """The sentences `because` of many fixes (n,)."""
    rows = np.stack([np.asarray(one) for one in accuracy.diagnostics], axis=-1).tolist()
    codes = np.asarray(accuracy.method).tolist()
    return [
        None if code == NO_FIX else _because(Diagnostics(*row), Method(code), accuracy.note)
        for code, row in zip(codes, rows, strict=True)
    ]


def _because(diagnostics: Diagnostics, method: Method, note: str | None) -> str:
    """Why a method was selected, with the `note` on errors that are not normal."""
    if note is None:
        return explain_method(diagnostics, method)
    by_ground = Method(int(select_method(diagnostics)))
    if method is not Method.samples:
        return f"{explain_method(diagnostics, method)} {note}"
    if by_ground is Method.samples:
        return explain_method(diagnostics, method)
    return f"The error of the fix is far from normal. {note}"


def batch_of(
    fix: Fix,
    probability: float,
    radii_and_failed: tuple[np.ndarray, ...],
    method: np.ndarray,
    cov_enu: np.ndarray,
    bias_enu: np.ndarray,
    diagnostics: Diagnostics,
    count: int,
    shape: tuple[int, ...],
    note: str | None,
) -> Accuracy:
    """Accuracy of many fixes from arrays (n, ...) on the host, reshaped to a batch."""
    is_linear = np.isin(method, [Method.facet, Method.footprint])
    cov_enu, bias_enu = (np.where(is_linear[:, *[None] * (x.ndim - 1)], x, np.nan) for x in (cov_enu, bias_enu))
    circular, linear, spherical, failed = radii_and_failed
    levels = np.full(method.shape, probability)
    flat = (fix, levels, circular, linear, spherical, method, cov_enu, bias_enu, failed, diagnostics)
    arrays: Any = jax.device_put(jax.tree.map(lambda leaf: np.reshape(leaf, shape + np.shape(leaf)[1:]), flat))
    return Accuracy(*arrays, count=count, note=note)
