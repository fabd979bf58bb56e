"""Online exposure timing from a stream of navigation records."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_finite, concrete
from jaxgeo._numerics import dot
from jaxgeo._record import Record
from jaxgeo._typing import IndexField, Scalar, ScalarField
from jaxgeo.coverage._checks import checked_positive
from jaxgeo.coverage.geometry import velocity_height_of_overlap

AT_ONCE = 16  # maximum number of images due between two records
NEWTON_STEPS = 8
GAUSS = np.polynomial.legendre.leggauss(8)  # exact to rounding while the range changes by less than half of itself


class ExposureClock(Record):
    """Integral of speed over slant range since the last image: Li et al. (2020), Eq 36.

    Each `record` returns the updated clock and the times of the images due since the record before; the first record
    is the first image. Speed and range are linear in time between records, and an image time is where the integral
    reaches its mark, not the next record. `mark` is the growth of the integral from image to image, `counted` its
    value since the last image; `time` in s, `speed` in m/s and `slant_range` in m are those of the last record, NaN
    before the first.
    """

    mark: ScalarField
    counted: ScalarField
    time: ScalarField
    speed: ScalarField
    slant_range: ScalarField

    @classmethod
    def of(cls, *, overlap: ArrayLike, field_of_view: ArrayLike) -> ExposureClock:
        """A clock for a target overlap and the angle of view along the flight, at the near end of the image, in rad.

        For a narrow field: for a wide field seen from near its edge, Eq 36 is only a rough length (`VelocityHeight`
        measures it).

        Raises `ValueError` for an overlap outside [0, 1) and a field of view outside (0, pi).
        """
        mark = velocity_height_of_overlap(overlap=overlap, off_nadir=0.0, field_of_view=field_of_view)
        unknown = jnp.asarray(jnp.nan)
        return cls(mark, jnp.zeros(()), unknown, unknown, unknown)

    def record(
        self, *, time: ArrayLike, speed: ArrayLike, slant_range: ArrayLike
    ) -> tuple[ExposureClock, Float[Array, " due"], IndexField]:
        """(the clock after a record, times in s of the images due since the last one, their number).

        `speed` in m/s is that of the ground point at the near end along the flight; `slant_range` in m its distance,
        over the ground seen there: that of `near_edge`, or H / cos(theta) over level ground. Unused ones of the 16
        times are infinite. Works under `jit` and `lax.scan`. Raises `ValueError` for a time that does not increase, a
        speed or range that is not positive, and records with more than 16 images due between them; for traced values,
        the times are NaN, or the number exceeds 16.
        """
        check_finite(time, "time", "s")
        speed, slant_range = checked_positive(speed, "speed", "m/s"), checked_positive(slant_range, "slant_range", "m")
        given: Any = as_float64((time, speed, slant_range), "record")
        _check_order(self.time, given[0])
        clock, due, count = _counted(self, *given)
        known = concrete(count)
        if known is not None and known > AT_ONCE:
            raise ValueError(
                f"{int(known)} images fell due between the records at {float(self.time):.9g} s and "
                f"{float(given[0]):.9g} s, more than {AT_ONCE}: give records more often, or one clock for each part of "
                "the flight."
            )
        return clock, due, count

    def expected(self) -> Scalar:
        """Time of the next image at the present speed and range, s."""
        clock = as_float64(self, "clock")
        return clock.time + (clock.mark - clock.counted) * clock.slant_range / clock.speed


@jax.jit
def _counted(
    clock: ExposureClock, time: Scalar, speed: Scalar, slant_range: Scalar
) -> tuple[ExposureClock, Float[Array, " due"], IndexField]:
    is_first = jnp.isnan(clock.time)
    start = jnp.where(is_first, time, clock.time)
    speeds = jnp.stack([jnp.where(is_first, speed, clock.speed), speed])
    ranges = jnp.stack([jnp.where(is_first, slant_range, clock.slant_range), slant_range])
    span = time - start

    def rate(share: Scalar) -> Scalar:
        return span * (speeds[0] + share * (speeds[1] - speeds[0])) / (ranges[0] + share * (ranges[1] - ranges[0]))

    def integral(share: Scalar) -> Scalar:
        nodes, weights = (jnp.asarray(x) for x in GAUSS)
        return 0.5 * share * dot(weights, jax.vmap(rate)(0.5 * share * (nodes + 1.0)))

    grown = integral(jnp.ones(()))
    total = clock.counted + grown
    count = jnp.floor(total / clock.mark).astype(int)

    def when(number: Array) -> Scalar:
        missing = (number + 1.0) * clock.mark - clock.counted

        def nearer(_: Any, share: Scalar) -> Scalar:
            slope = jnp.where(rate(share) > 0.0, rate(share), 1.0)
            return jnp.clip(share + (missing - integral(share)) / slope, 0.0, 1.0)

        first = jnp.clip(missing / jnp.where(grown > 0.0, grown, 1.0), 0.0, 1.0)
        share = jax.lax.fori_loop(0, NEWTON_STEPS, nearer, first)
        return jnp.where(number < count, start + share * span, jnp.inf)

    due = jax.vmap(when)(jnp.arange(AT_ONCE))
    due = jnp.where(is_first, jnp.full(AT_ONCE, jnp.inf).at[0].set(time), due)
    due = jnp.where(span >= 0.0, due, jnp.nan)
    after = ExposureClock(clock.mark, total - count * clock.mark, time, speed, slant_range)
    return after, due, jnp.where(is_first, 1, count)


def _check_order(before: ScalarField, time: Scalar) -> None:
    last, now = concrete(before), concrete(time)
    if last is not None and now is not None and not (np.isnan(last) or now > last):
        raise ValueError(
            f"time runs backwards: a record at {float(now):.9g} s after one at {float(last):.9g} s. Sort the records, "
            "and drop those that are there twice."
        )
