"""Records of a track: the target's estimated states, the innovation tests, and what they mean in words."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import numpy as np
import scipy  # submodules load lazily, when first used
from jax.typing import ArrayLike

from jaxgeo._record import Record
from jaxgeo._typing import IndexField, Matrix3Field, PixelField, ScalarField, StatusField, Vector3Field
from jaxgeo.earth import Geodetic
from jaxgeo.status import Status, count_statuses
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.metrics.exact import level_of
from jaxgeo.uncertainty.radii import radii_of_many
from jaxgeo.uncertainty.target_motion import AbstractTarget
from jaxgeo.uncertainty.validation import SIGNIFICANCE, Size

NAMED = 5  # looks in a sentence
AMBIGUOUS, LEAST_APART = 2.0, 1.0  # times SE90, and m: farther apart, batch and filter are at different solutions
HORIZONTAL, VERTICAL, ALL_AXES = slice(0, 2), slice(2, 3), slice(0, 3)  # of east, north, up


class TargetState(Record):
    """Estimated state of a target at one time, or at many (leading axis).

    `time` in s; `position` and `p_ecef` (m) are the same point, `cov_enu` (..., 3, 3) its covariance in m2 in east,
    north, up there; `velocity_enu` in m/s and `velocity_cov_enu` in (m/s)2, zero for a target at rest. `status` is
    `hit`, or `weak_intersection` while the looks do not determine the position (its standard deviation exceeds a
    tenth of the range), `leaves_terrain` if the ground at the position is not known, `not_converged` of an adjustment.
    Values that are not determined are NaN.
    """

    time: ScalarField
    position: Geodetic
    p_ecef: Vector3Field
    cov_enu: Matrix3Field
    velocity_enu: Vector3Field
    velocity_cov_enu: Matrix3Field
    status: StatusField

    @property
    def ok(self) -> Any:
        """Whether the status is `hit`."""
        return np.asarray(self.status) == Status.hit

    @property
    def ce90(self) -> Any:
        """CE90: radius in m of the horizontal circle about the position that contains the target with 90 %."""
        return self.circular_error(0.9)

    @property
    def le90(self) -> Any:
        """LE90: height in m above and below the position that contains the target with 90 %."""
        return self.linear_error(0.9)

    def circular_error(self, probability: ArrayLike) -> Any:
        """Radius in m of the horizontal circle about the position that contains the target with a probability."""
        return _radii(self.cov_enu, HORIZONTAL, probability)

    def linear_error(self, probability: ArrayLike) -> Any:
        """Height in m above and below the position that contains the target with a probability."""
        return _radii(self.cov_enu, VERTICAL, probability)

    def spherical_error(self, probability: ArrayLike) -> Any:
        """Radius in m of the sphere about the position that contains the target with a probability."""
        return _radii(self.cov_enu, ALL_AXES, probability)

    def __getitem__(self, index: Any) -> TargetState:
        """One or several of many."""
        if not np.ndim(self.status):
            raise IndexError("this is one state; there is nothing to index.")
        return jax.tree.map(lambda leaf: np.asarray(leaf)[index], self)

    def __len__(self) -> int:
        if not np.ndim(self.status):
            raise TypeError("this is one state; it has no length.")
        return len(np.asarray(self.status))

    def __str__(self) -> str:
        if np.ndim(self.status):
            known = np.asarray(self.ok)
            text = f"{np.count_nonzero(known)} of {len(self)} states are determined"
            return f"{text}; the last: {self[-1]}"
        status = Status(int(np.asarray(self.status)))
        if status is not Status.hit:
            return f"no position: {status.name}: {status.message}"
        lat, lon, height = (float(x) for x in self.position.to_degrees())
        text = f"{lat:.6f} deg, {lon:.6f} deg, {height:z.1f} m, CE90 {figure(self.ce90)} m, LE90 {figure(self.le90)} m"
        east, north, _ = np.asarray(self.velocity_enu)
        if east == north == 0.0 or not math.isfinite(east + north):
            return text
        sigma = math.sqrt(max(np.trace(np.asarray(self.velocity_cov_enu)[:2, :2]), 0.0))
        heading = math.degrees(math.atan2(east, north)) % 360.0
        speed = f"{figure(math.hypot(east, north))} m/s (sigma {figure(sigma)})"
        return f"{text}, {speed} towards {heading:.0f} deg"


class Track(Record):
    """Track of one target from n looks of one or several sensors, in the order of time.

    - `times` (n,) of exposure in s, `sensor` (n,) and `look` (n,): number of the `Looks` and of the look in them.
    - `status` (n,): `hit` for the looks that are used, for others why there is no line of sight or no fix on the
      terrain. These are in no estimate.
    - `batch`: state at the last look, by least squares of all looks with their joint covariance.
    - `filtered` (n,): state after each look, by the filter with the shared errors as states.
    - `independent` (n,): the covariance that a filter claims which takes the errors of all looks for independent;
      `actual_enu` (n, 3, 3) in m2 is the covariance that its position has under the error model.
    - `floor_enu` (3, 3) in m2: the covariance of `batch` if nothing but shared errors were left. More looks from the
      same places do not get below.
    - `innovations` (n, 2): differences of each look from what the filter predicts, to the right and upwards in the
      image plane, standardised: independent standard normal if the model is true. `nis` (n,) is their squared length,
      with `degrees` (n,) of freedom: 0 while a look only completes the state.
    - `rounds`: number of linearisations of `batch`.
    - `note`: what linear propagation leaves out of errors that are not normal.
    """

    times: ScalarField
    sensor: IndexField
    look: IndexField
    status: StatusField
    batch: TargetState
    filtered: TargetState
    independent: TargetState
    actual_enu: Matrix3Field
    floor_enu: Matrix3Field
    innovations: PixelField
    nis: ScalarField
    degrees: IndexField
    target: AbstractTarget
    rounds: int = eqx.field(static=True, default=0)
    note: str | None = eqx.field(static=True, default=None)

    @property
    def used(self) -> Any:
        """Whether each look is used."""
        return np.asarray(self.status) == Status.hit

    @property
    def overconfidence(self) -> Any:
        """Actual CE90 of the filter of independent looks, divided by the CE90 that it claims, after each look (n,)."""
        return _radii(self.actual_enu, HORIZONTAL, 0.9) / self.independent.ce90

    @property
    def actual_ce90(self) -> Any:
        """Actual CE90 of the filter of independent looks after each look, m (n,)."""
        return _radii(self.actual_enu, HORIZONTAL, 0.9)

    @property
    def floor_ce90(self) -> Any:
        """CE90 in m of `floor_enu`."""
        return _radii(self.floor_enu, HORIZONTAL, 0.9)

    @property
    def size(self) -> Size | None:
        """Chi-square test of the sum of `nis`; None if no look is redundant."""
        degrees = int(np.sum(np.asarray(self.degrees)))
        return Size.of(float(np.sum(np.asarray(self.nis))), degrees) if degrees else None

    @property
    def whiteness(self) -> tuple[float, float]:
        """(sum of products of consecutive innovations, divided by its standard deviation; its two-sided p-value).

        Close to a standard normal number if the innovations are white; NaN for fewer than two pairs.
        """
        whole = np.asarray(self.innovations)[np.asarray(self.degrees) == 2]
        if len(whole) < 3:
            return math.nan, math.nan
        z = float(np.sum(whole[1:] * whole[:-1]) / math.sqrt(2.0 * (len(whole) - 1)))
        return z, float(2.0 * scipy.stats.norm.sf(abs(z)))

    @property
    def apart(self) -> float:
        """Distance in m between the positions of `batch` and, after the last look, of `filtered`; NaN without both."""
        return float(np.linalg.norm(np.asarray(self.batch.p_ecef) - np.asarray(self.filtered.p_ecef)[-1]))

    @property
    def is_ambiguous(self) -> bool:
        """Whether `batch` and `filtered` end at different places: the looks have several solutions on the terrain."""
        return self.apart > max(AMBIGUOUS * float(self.batch.spherical_error(0.9)), LEAST_APART)

    @property
    def is_consistent(self) -> bool:
        """Whether neither test of the innovations refuses the model at 5 % together (Bonferroni), and the batch and the
        filter end at one place."""
        if self.is_ambiguous:
            return False
        size, (_, p) = self.size, self.whiteness
        found = [x for x in ((size.p if size is not None else math.nan), p) if not math.isnan(x)]
        return all(x >= SIGNIFICANCE / len(found) for x in found)

    def __str__(self) -> str:
        used = np.asarray(self.used)
        count = np.count_nonzero(used)
        sensors = len(np.unique(np.asarray(self.sensor)))
        span = float(np.asarray(self.times)[-1] - np.asarray(self.times)[0])
        last = str(self.batch).rstrip(".")
        lines = [
            f"{self.target.words[0].upper()}{self.target.words[1:]}: {count} looks used of "
            f"{sensors} sensor{'s' if sensors > 1 else ''} in {figure(span)} s. At the last: {last}."
        ]
        if self.note is not None:
            lines.append(self.note)
        left_out = self._left_out()
        if not bool(self.batch.ok):
            return "\n".join([*lines, self._tests(), *left_out])
        if self.is_ambiguous:
            lines.append(
                f"Ambiguous: the filter ends {figure(self.apart)} m away from this. The looks fit several places on "
                "the terrain, and no CE90 here covers the others; sample single looks, or add looks from other sides."
            )
        first = int(np.argmax(np.asarray(self.filtered.ok)))
        lines.append(
            f"CE90 {figure(self.filtered.ce90[first])} m after look {first}, {figure(self.filtered.ce90[-1])} m after "
            f"the last, and {figure(self.floor_ce90)} m if only the errors that looks share were left."
        )
        lines.append(
            f"A filter of independent looks claims CE90 {figure(self.independent.ce90[-1])} m, and has "
            f"{figure(self.actual_ce90[-1])} m: {figure(self.overconfidence[-1])} times what it claims."
        )
        return "\n".join([*lines, self._tests(), *left_out])

    def _tests(self) -> str:
        size, (z, p) = self.size, self.whiteness
        if size is None:
            return "Innovations: no look is redundant, so that nothing can be tested."
        verdict = "as large as the model says"
        if size.p < SIGNIFICANCE:
            verdict = "larger than the model says" if size.factor > 1.0 else "smaller than the model says"
        text = (
            f"Innovations are {verdict}: NIS {figure(size.nees, 4)} of {figure(size.low, 4)} to "
            f"{figure(size.high, 4)} expected (p = {size.p:.2g})"
        )
        if math.isnan(z):
            return f"{text}."
        white = "independent of each other" if p >= SIGNIFICANCE else "correlated with the ones before"
        return f"{text}, and {white} (p = {p:.2g})."

    def _left_out(self) -> list[str]:
        """A sentence for each status of looks that are not used."""
        statuses, sensor, look = (np.asarray(x) for x in (self.status, self.sensor, self.look))
        several = len(np.unique(sensor)) > 1
        lines = []
        for status, number in count_statuses(statuses[statuses != Status.hit]).items():
            places = np.flatnonzero(statuses == status)[:NAMED]
            names = [f"{look[k]} of sensor {sensor[k]}" if several else f"{look[k]}" for k in places]
            more = ", ..." if number > NAMED else ""
            lines.append(
                f"Left out {number} of {len(statuses)} looks ({', '.join(names)}{more}): {status.name}: "
                f"{status.message}"
            )
        return lines


def _radii(cov_enu: Any, axes: slice, probability: ArrayLike) -> Any:
    """Radii of some axes of one or many covariances."""
    level_of(probability)
    cov = np.asarray(cov_enu)[..., axes, axes]
    return radii_of_many(cov, np.asarray(probability), np.zeros(cov.shape[:-1]))
