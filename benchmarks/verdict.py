"""Validation of the automatic method selection: sampling-free predictions against samples on independent terrain.

Observations are drawn over synthetic and real terrain: every azimuth, 8 to 60 degrees down, 6 to 50 km away, errors
0.15 to 3 times those of a good sensor. Each is predicted without samples, then sampled. `--coverage` measures instead
how often the truth lies within the stated CE90 about the erroneous fix, in simulated measurements. `--steep` looks
within 10 degrees of the nadir, from 0.4 to 50 km away, with attitude errors up to 20 times as large.

Run: python benchmarks/verdict.py [--targets 60] [--steep] [--fresh 0] [--output roc.png] [--cluster local:2]
         [--folder F]
     python benchmarks/verdict.py --coverage [--targets 1000] [--fresh 0]
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import pathlib
import sys
from typing import Any, NamedTuple

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray
from looks import (
    DOWNWARD,
    FIRST_HIT,
    PIXEL,
    SENSOR,
    cases,
    errors,
    item,
    look_from,
    made_up_of,
    sampled,
    steep_cases,
    terrains,
)
from measuring import Column, Table

import jaxgeo
from jaxgeo.cluster import connect
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import ConstantField, Dem
from jaxgeo.uncertainty import Level, Method, method_selection
from jaxgeo.uncertainty.intervals import share_of
from jaxgeo.uncertainty.linear import propagate_linear
from jaxgeo.uncertainty.linear_accuracy import linear_radii, select_linear

LEVELS = (0.01, 0.02, 0.04, 0.06, 0.08, 0.10, 0.15, 0.20, 0.30, 0.50, 1.00)  # agreement thresholds of the trade-off
CLOSE, RIGHT, WRONG = 0.05, 0.10, 0.25  # relative to the samples' circular error


# Predictions against samples.


class Judged(NamedTuple):
    """Observations with a fix: their diagnostics, and CE90 over level ground, by `accuracy` without samples, and by
    samples, m, with half of the width of the samples' 95 % interval."""

    diagnostics: method_selection.Diagnostics
    level: np.ndarray
    stated: np.ndarray
    truth: np.ndarray
    unsure: np.ndarray


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(0, 0, 0, None, None))
def predicted(
    pose: jaxgeo.Pose, scale: Any, attitude: Any, sensor: jaxgeo.Sensor, terrain: Dem
) -> tuple[method_selection.Diagnostics, Any, Any, Any]:
    """(diagnostics, circular error over level ground, that of `accuracy`, whether there is a fix)."""
    look, model = look_from(pose, terrain, sensor=sensor), errors(scale, attitude)
    aim = look.nominal_fix(FIRST_HIT)
    level = propagate_linear(look, aim, model, Level()).circular_error(0.9)
    found = method_selection.diagnose(look, aim, model)
    stated, _, _ = linear_radii(select_linear(found, aim, jnp.asarray(0.9)), jnp.asarray(0.9))
    return found.diagnostics, level, stated, counts_as_fix(aim.fix.status)


def judged(terrain: str, *, count: int, samples: int, fresh: int, steep: bool = False) -> dict[str, np.ndarray]:
    """`count` observations of a terrain, predicted and sampled; whether each has a fix, NaN without."""
    dem, seed = places(fresh)[terrain]
    drawn, sensor = (steep_cases(dem, count, seed), DOWNWARD) if steep else (cases(dem, count, seed), SENSOR)
    scales = jnp.asarray(drawn.scale), jnp.asarray(drawn.attitude)
    diagnostics, level, stated, found = jax.tree.map(np.asarray, predicted(drawn.pose, *scales, sensor, dem))
    truth, unsure = np.full((2, count), np.nan)
    for i in np.flatnonzero(found):
        model = errors(drawn.scale[i], drawn.attitude[i])
        figure = sampled(item(drawn.pose, i), model, dem, i, samples, sensor=sensor).circular_error(0.9)
        truth[i], unsure[i] = figure.value, 0.5 * (figure.high - figure.low)
    figures = {"level": level, "stated": stated, "found": found, "truth": truth, "unsure": unsure}
    return diagnostics._asdict() | figures


@functools.lru_cache(maxsize=1)
def places(fresh: int) -> dict[str, tuple[Dem, int]]:
    """Every terrain with the seed of its observations."""
    each = enumerate(terrains(fresh).items())
    return {
        f"{name}, {k + 1}": (dem, fresh + 100 * number + k)
        for number, (name, dems) in each
        for k, dem in enumerate(dems)
    }


def records(found: xarray.Dataset) -> dict[str, Judged]:
    """The observations with a fix by class of terrain."""
    classes: dict[str, list[Judged]] = {}
    for terrain in found["terrain"].values.tolist():
        own = found.sel(terrain=terrain)
        has_fix = own["found"].values
        fields: dict[str, Any] = {name: own[name].values[has_fix] for name in method_selection.Diagnostics._fields}
        one = Judged(method_selection.Diagnostics(**fields), *(own[x].values[has_fix] for x in Judged._fields[1:]))
        classes.setdefault(terrain.rpartition(", ")[0], []).append(one)
    return {name: joined(parts) for name, parts in classes.items()}


def joined(parts: list[Any]) -> Any:
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def off(figure: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Relative difference of a circular error from the sampled one; 1 where that is infinite."""
    return np.abs(np.where(np.isfinite(truth), figure / truth, 0.0) - 1.0)


def percent(which: np.ndarray) -> float | None:
    return 100.0 * float(np.mean(which)) if which.size else None


WITHIN = [
    Column("terrain"),
    Column("looks"),
    *(Column(method, "% within 10 %", "higher") for method in ("facet", "footprint", "profile", "level ground")),
]
STATED = [
    Column("terrain"),
    Column("looks not sent to samples"),
    Column("within 5 %", "%", "higher"),
    Column("within 10 %", "%", "higher"),
    Column("off, root mean square", "%", "lower"),
    Column("95th percentile", "%", "lower"),
    Column("in the stated interval", "%"),
    Column("half of its width, median", "%", "lower"),
]
CAUGHT = [
    Column("terrain"),
    Column("looks"),
    Column("facet off by > 25 %", "looks"),
    Column("of these caught", "%", "higher"),
    Column("facet within 10 %", "looks"),
    Column("of these flagged", "%", "lower"),
    Column("sent to samples", "%", "lower"),
    Column("facet trusted: off, median", "%", "lower"),
    Column("95th percentile", "%", "lower"),
    Column("footprint trusted: off, median", "%", "lower"),
    Column("95th percentile", "%", "lower"),
]


def within_row(name: str, all_of: Judged) -> list[Any]:
    figures = (all_of.diagnostics.facet, all_of.diagnostics.footprint, all_of.diagnostics.profile, all_of.level)
    return [name, all_of.truth.size, *(percent(off(np.asarray(x), all_of.truth) <= RIGHT) for x in figures)]


def stated_row(name: str, all_of: Judged) -> list[Any]:
    is_linear = np.isfinite(all_of.stated)
    one: Judged = jax.tree.map(lambda x: x[is_linear], all_of)
    miss, half = off(one.stated, one.truth), np.expm1(np.asarray(method_selection.relative_margin(np, one.diagnostics)))
    row = [name, miss.size, percent(miss <= CLOSE), percent(miss <= RIGHT)]
    if not miss.size:
        return row + [None] * 4
    inside = miss <= np.hypot(half, one.unsure / one.truth)  # the samples' figure errs too
    spread = [100.0 * math.sqrt(np.mean(miss**2)), 100.0 * float(np.quantile(miss, 0.95))]
    return [*row, *spread, percent(inside), 100.0 * float(np.median(half))]


def caught_row(name: str, all_of: Judged) -> list[Any]:
    method = np.asarray(method_selection.select_method(all_of.diagnostics))
    miss = off(np.asarray(all_of.diagnostics.facet), all_of.truth)
    wrong, right, flagged = miss > WRONG, miss <= RIGHT, method != Method.facet
    row = [name, method.size, int(wrong.sum()), percent(flagged[wrong]), int(right.sum()), percent(flagged[right])]
    row.append(percent(method == Method.samples))
    for one, figure in ((Method.facet, all_of.diagnostics.facet), (Method.footprint, all_of.diagnostics.footprint)):
        missed = 100.0 * off(np.asarray(figure), all_of.truth)[method == one]
        row += [float(np.quantile(missed, share)) if missed.size else None for share in (0.5, 0.95)]
    return row


def trade_off(all_of: Judged) -> list[tuple[float, float, float, float]]:
    """(agreement threshold, % caught, % flagged wrongly, % sent to samples); height thresholds in proportion."""
    miss, kept = (
        off(np.asarray(all_of.diagnostics.facet), all_of.truth),
        (method_selection.AGREEMENT, method_selection.AGREEMENT_UP),
    )
    rows = []
    try:
        for level in LEVELS:
            method_selection.AGREEMENT, method_selection.AGREEMENT_UP = level, level * kept[1] / kept[0]
            method = np.asarray(method_selection.select_method(all_of.diagnostics))
            flagged, shares = method != Method.facet, (miss > WRONG, miss <= RIGHT)
            caught, wrongly = (percent(flagged[share]) or 0.0 for share in shares)
            rows.append((level, caught, wrongly, percent(method == Method.samples) or 0.0))
    finally:
        method_selection.AGREEMENT, method_selection.AGREEMENT_UP = kept
    return rows


def study(
    targets: int, samples: int, output: pathlib.Path | None, fresh: int, steep: bool = False, **how: Any
) -> list[Table]:
    """Predictions on every terrain against samples, as a sweep with options `how`: `executor`, `folder`."""
    function = functools.partial(judged, count=targets, samples=samples, fresh=fresh, steep=steep)
    axes, dims = {"terrain": list(places(fresh))}, dict.fromkeys([*Judged._fields, "found"], ("look",))
    dims |= dict.fromkeys(method_selection.Diagnostics._fields, ("look",))
    found = records(jaxgeo.sweep(function, axes, dims=dims, vectorize=False, progress=True, **how))
    held_out = joined([part for name, part in found.items() if "set on" not in name])
    found = {"all held out": held_out} | found
    within = Table("Circular errors at 90 % against samples", WITHIN)
    within.rows = [within_row(name, part) for name, part in found.items()]
    stated = Table("CE90 of accuracy without samples against samples", STATED)
    stated.rows = [stated_row(name, part) for name, part in found.items()]
    stated.notes.append("goals: 95 % within 5 %, and 95 % in the interval, widened by that of the samples")
    caught = Table("Verdicts: linear propagation over the facet, trusted or flagged", CAUGHT)
    caught.rows = [caught_row(name, part) for name, part in found.items()]
    caught.notes.append(f"goals: at least 90 % caught, at most 20 % flagged wrongly; {samples} samples a look")
    columns = [Column("agreement", "of a logarithm"), Column("caught", "%", "higher")]
    columns += [Column("flagged wrongly", "%", "lower"), Column("sent to samples", "%", "lower")]
    rates = trade_off(held_out)
    if output is not None:
        draw(rates, output)
    return [
        stated,
        within,
        caught,
        Table("All held out: catches against false flags", columns, [list(row) for row in rates]),
    ]


def draw(rates: list[tuple[float, float, float, float]], output: pathlib.Path) -> None:
    """The trade-off as a figure."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    levels, caught, wrongly, _ = zip(*rates, strict=True)
    figure, axes = plt.subplots(figsize=(5.0, 4.0), layout="constrained")
    axes.plot(wrongly, caught, "o-")
    for level, x, y in zip(levels, wrongly, caught, strict=True):
        axes.annotate(f"{level:g}", (x, y), textcoords="offset points", xytext=(5, -9), fontsize=8)
    axes.axhline(90.0, color="grey", lw=0.8)
    axes.axvline(20.0, color="grey", lw=0.8)
    axes.set(xlabel="flagged of those within 10 %, %", ylabel="caught of those off by more than 25 %, %")
    figure.savefig(output, dpi=150)


# Coverage.


class Measured(NamedTuple):
    """A simulated measurement: its pose, the terrain error, m, and whether it and the truth are fixes.

    `facet` and `footprint` are the stated CE90, `away` the distance of the truth from the measured fix, m.
    """

    pose: jaxgeo.Pose
    raised: Any
    is_case: Any
    facet: Any
    footprint: Any
    method: Any
    away: Any


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(0, 0, 0, 0, None))
def measured(pose: jaxgeo.Pose, pixel: Any, scale: Any, key: Any, terrain: Dem) -> Measured:
    """The measurement with random errors of a true pose over true terrain, and its stated accuracy."""
    true, model = look_from(pose, terrain, pixel), errors(scale)
    error = model.factor() @ jax.random.normal(key, (model.size,))
    moved = look_from(model.moved(true, error).pose, raised_by(terrain, error[-1]), pixel)
    aim, truth = moved.nominal_fix(FIRST_HIT), true.ground(FIRST_HIT)
    diagnostics = method_selection.diagnose(moved, aim, model).diagnostics
    miss = aim.R_ecef_from_enu.T @ (truth.ecef - aim.p_ecef)
    is_case = counts_as_fix(aim.fix.status) & counts_as_fix(truth.status)
    method, away = method_selection.select_method(diagnostics), jnp.sqrt(miss[0] ** 2 + miss[1] ** 2)
    return Measured(moved.pose, error[-1], is_case, diagnostics.facet, diagnostics.footprint, method, away)


def raised_by(terrain: Dem, height: Any) -> Dem:
    return eqx.tree_at(lambda dem: dem.field, terrain, ConstantField(jnp.asarray(height)))


def covered(terrain: Dem, count: int, samples: int, seed: int) -> np.ndarray:
    """(method, whether the truth lies within the CE90 stated about the measured fix) of simulated measurements.

    The pixel is random: pointing at a chosen ground point would depend on the ridges.
    """
    drawn, terrain = cases(terrain, count, seed), terrain.with_field(ConstantField(jnp.asarray(0.0)))
    pixels = np.random.default_rng(seed + 1).uniform(0.0, 2.0 * PIXEL, (count, 2))
    keys = jax.random.split(jax.random.key(seed), count)
    found = measured(drawn.pose, jnp.asarray(pixels), jnp.asarray(drawn.scale), keys, terrain)
    found = jax.tree.map(np.asarray, found)
    radius = np.where(found.method == Method.facet, found.facet, found.footprint)
    for i in np.flatnonzero(found.is_case & (found.method == Method.samples)):
        known = raised_by(terrain, found.raised[i])
        drawn_again = sampled(item(found.pose, i), errors(drawn.scale[i]), known, i, samples, pixels[i])
        radius[i] = drawn_again.circular_error(0.9).value
    return np.stack([found.method, found.away <= radius], axis=1)[found.is_case]


def coverage(targets: int, samples: int, fresh: int) -> Table:
    """Coverage of the stated circle, for classes of synthetic terrain."""
    columns = [Column("terrain"), Column("cases"), Column("truth within CE90", "%"), Column("from", "%")]
    columns += [Column("to", "%"), Column("by the facet", "%"), Column("by the footprint", "%")]
    columns += [Column("by samples", "%"), Column("sent to samples", "%", "lower")]
    table = Table("Coverage of CE90 stated at the measured state", columns)
    table.notes.append("from, to: 95 % interval of a binomial share (Clopper and Pearson 1934); goal: 88 to 92 %")
    for number, name in enumerate(("smooth", "hilly", "mountainous")):
        dems, seed = made_up_of(name, fresh), fresh + 1000 + 10 * number
        parts = [covered(dem, -(-targets // len(dems)), samples, seed + k) for k, dem in enumerate(dems)]
        method, inside = np.concatenate(parts).T
        by_trust = [percent(inside[method == method]) for method in Method]
        _, low, high = (100.0 * x for x in share_of(np.flatnonzero(inside), inside.size))
        sent = percent(method == Method.samples)
        table.rows.append([name, inside.size, percent(inside), low, high, *by_trust, sent])
        print(table.rows[-1], file=sys.stderr, flush=True)
    return table


def main() -> None:
    """Run the study and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coverage", action="store_true", help="how often the truth lies within the stated circle")
    parser.add_argument("--steep", action="store_true", help="looks within 10 degrees of the nadir")
    parser.add_argument("--targets", type=int, help="looks at each terrain (60), or cases of each class (1000)")
    parser.add_argument("--samples", type=int, default=8192, help="of a look")
    parser.add_argument("--output", type=pathlib.Path, help="a PNG of the trade-off")
    parser.add_argument("--cluster", help="workers of Dask: local:2, tcp://host:port or a scheduler file")
    parser.add_argument("--folder", type=pathlib.Path, help="where finished terrains are kept, for a run that goes on")
    parser.add_argument("--fresh", type=int, default=0, help="a number: other synthetic terrain and looks than before")
    options = parser.parse_args()
    if options.coverage:
        tables = [coverage(options.targets or 1000, options.samples, options.fresh)]
    else:
        with connect(options.cluster) if options.cluster else contextlib.nullcontext() as client:
            how = {"executor": client, "folder": options.folder}
            tables = study(options.targets or 60, options.samples, options.output, options.fresh, options.steep, **how)
    for table in tables:
        print(table.markdown())


if __name__ == "__main__":
    main()
