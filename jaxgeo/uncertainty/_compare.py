"""Comparison of all propagation methods at one fix, validated against Monte Carlo."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty._second_order import second_moments
from jaxgeo.uncertainty.linear import Propagation, propagate_linear
from jaxgeo.uncertainty.method_selection import diagnose
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sampled import Quantile, Sampled, Sampler, Wanted
from jaxgeo.uncertainty.sampling import Sampling, accepts_sampling_options, resolve_sampling
from jaxgeo.uncertainty.slopes import Level

FIGURES = (("CE50", 0.5), ("CE90", 0.9), ("LE90", 0.9), ("SE90", 0.9))
SAMPLES = 100_000
COUNTS = (400_000, 1_600_000)  # while a figure is undecided
SAMPLING = Sampling()


class Row(NamedTuple):
    """Figures of one method in m, in the order of `FIGURES`, and the validity of each against the samples."""

    method: str
    values: tuple[float, ...]
    validity: tuple[str, ...]

    @property
    def is_valid(self) -> bool:
        """Whether all figures agree with the samples to the stated digits."""
        return all(one == "valid" for one in self.validity)


class Comparison(Record):
    """Results of each propagation method at one fix; `str()` gives a table with the verdict.

    A figure is valid if it is within half a unit of the last of `digits` significant digits of the sampled figure
    (JCGM 101:2008, 8.1) over the whole confidence interval of that, and undecided if only over part of it: more samples
    are needed. `jumped` is the share of samples beyond a gap of unseen ground (`beyond_gap` marks them), `failed` the
    share without a fix. `propagations` are the linear propagations by name.
    """

    fix: Fix
    rows: tuple[Row, ...]
    quantiles: tuple[Quantile, ...]
    digits: int
    jumped: float
    failed: float
    sampled: Sampled
    propagations: dict[str, Propagation] = eqx.field(default_factory=dict)
    beyond_gap: np.ndarray | None = None

    @property
    def valid(self) -> tuple[str, ...]:
        """Names of the methods whose figures are all valid."""
        return tuple(row.method for row in self.rows if row.is_valid)

    @property
    def verdict(self) -> str:
        """Summary in one to three sentences."""
        digits = f"to {self.digits} significant digit{'s' if self.digits > 1 else ''} (JCGM 101)"
        unsure = [row.method for row in self.rows if not row.is_valid and "not valid" not in row.validity]
        said = f"Agrees with Monte Carlo {digits}: {'; '.join(self.valid)}."
        if not self.valid:
            said = f"No method {'surely ' if unsure else ''}agrees with Monte Carlo {digits}."
        if unsure:
            said += f" Needs more samples: {'; '.join(unsure)}."
        if self.jumped > 0.0 or self.failed > 0.0:
            jumped, failed = 100.0 * self.jumped, 100.0 * self.failed
            said += f" {figure(jumped, 2)} % of the samples jump to another slope, {figure(failed, 2)} % have no fix."
        return said

    def __str__(self) -> str:
        names = [name for name, _ in FIGURES]
        marks = {"valid": " ", "not valid": "x", "undecided": "?"}
        lines = [f"{'':28s}" + "".join(f"{name:>12s}  " for name in names)]
        for row in self.rows:
            cells = (f"{value:12.4g} {marks[one]}" for value, one in zip(row.values, row.validity, strict=True))
            lines.append(f"{row.method:28s}" + "".join(cells))
        lines.append(f"{f'{self.sampled.count} samples':28s}" + "".join(f"{q.value:12.4g}  " for q in self.quantiles))
        bounds = (f"{f'{q.low:.4g}..{q.high:.4g}':>12s}  " for q in self.quantiles)
        lines.append(f"{'their 95 % interval':28s}" + "".join(bounds))
        return "\n".join(
            [*lines, f"m; x: differs from Monte Carlo to {self.digits} digits, ?: needs more samples. {self.verdict}"]
        )


@accepts_sampling_options
@accepts_observation
def compare(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    sampling: Sampling = SAMPLING,
    digits: int = 2,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> Comparison:
    """Compare linear propagation (facet, footprint, level ground), second order, sigma points and samples at one fix.
    Second order and sigma points are left out if a distribution has no fourth moment.

    Samples are drawn until every figure is surely valid or not, 100 000 at least and 1 600 000 at most, or as many as
    `sampling` says, and kept. Other arguments and exceptions as for `sample`; `digits` is the number of significant
    digits to compare, 1 to 6.
    """
    if not isinstance(digits, int | np.integer) or isinstance(digits, bool) or not 1 <= digits <= 6:
        raise ValueError(f"digits must be a whole number from 1 to 6; got {digits!r}.")
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, inputs)
    model.require_errors("compare")
    is_open = isinstance(sampling, Sampling) and sampling.count is None and sampling.half_width is None
    sampling = resolve_sampling(sampling, SAMPLES)
    nominal = inputs.nominal_fix(search)
    nominal.require_fix(inputs)
    model.check_at(nominal)
    sampler = Sampler.of(inputs, nominal, model, search, sampling)
    drawn = sampler.drawn(keep=True)
    _, facet, footprint, profile = diagnose(inputs, nominal, model)
    methods: dict[str, Any] = {
        "linear, facet": facet,
        "linear, footprint": footprint,
        "linear, level ground": propagate_linear(inputs, nominal, model, Level()),
    }
    if model.finite_orders > 4.0:  # else their variance may be infinite
        methods["second order"] = second_moments(inputs, nominal, model)
        methods["sigma points"] = sampler.moments_of_sigma_points()
    values = {name: tuple(float(value) for value in _figures(result)) for name, result in methods.items()}
    rows, quantiles = _rows(values, drawn, digits)
    for count in COUNTS if is_open else ():
        if not any("undecided" in row.validity for row in rows):
            break
        more = dataclasses.replace(sampling, count=count - drawn.count)
        sampler = Sampler.of(inputs, nominal, model, search, more)
        drawn = drawn.merge(sampler.draw(drawn.count, count - drawn.count, Wanted(keep=True), drawn.centre_enu))
        rows, quantiles = _rows(values, drawn, digits)
    beyond = np.zeros(drawn.count, bool)
    if drawn.errors_enu is not None:
        beyond = profile.beyond_gap(drawn.errors_enu, nominal.direction_enu)
    linear = {name: result for name, result in methods.items() if isinstance(result, Propagation)}
    jumped = float(beyond.mean())
    return Comparison(nominal.fix, rows, quantiles, digits, jumped, drawn.failed, drawn, linear, beyond)


def _rows(
    values: dict[str, tuple[float, ...]], drawn: Sampled, digits: int
) -> tuple[tuple[Row, ...], tuple[Quantile, ...]]:
    """(figures of each method with their validity, the samples' figures)."""
    quantiles = _figures(drawn)
    judged = {name: tuple(map(_validity, own, quantiles, [digits] * len(own))) for name, own in values.items()}
    return tuple(Row(name, own, judged[name]) for name, own in values.items()), quantiles


def _figures(result: Any) -> tuple[Any, ...]:
    figures = {"CE": result.circular_error, "LE": result.linear_error, "SE": result.spherical_error}
    return tuple(figures[name[:2]](probability) for name, probability in FIGURES)


def _validity(value: float, sampled: Quantile, digits: int) -> str:
    """Validity of a figure by JCGM 101:2008, 8.1, with the sampled figure's interval in place of its value."""
    if not math.isfinite(value) or not math.isfinite(sampled.value):
        return "not valid"
    tolerance = 0.5 * 10.0 ** (math.floor(math.log10(max(sampled.value, 1e-300))) - digits + 1)
    low, high = sampled.low - tolerance, sampled.high + tolerance
    if not low <= value <= high:
        return "not valid"
    return "valid" if sampled.high - tolerance <= value <= sampled.low + tolerance else "undecided"
