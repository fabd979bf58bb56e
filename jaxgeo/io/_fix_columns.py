"""Output columns of a fix: coordinates, status and accuracy, with units in their names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.fix import Fix
from jaxgeo.io._attributes import attribute_rows
from jaxgeo.io.geoid import height_msl
from jaxgeo.io.tables import ABOVE_TAKEOFF, FIX_COLUMNS, fix_rows
from jaxgeo.status import Status
from jaxgeo.uncertainty import NO_FIX, Accuracy, AccuracyMap, Method
from jaxgeo.uncertainty.accuracy_record import reasons
from jaxgeo.uncertainty.metrics import circular_error, error_ellipse, linear_error, spherical_error
from jaxgeo.uncertainty.metrics.exact import check_probability, covariance

USUAL = 0.9
SAME = 0.01  # m: tolerance between a fix and the fix of its accuracy
FEWEST, MOST = 16, 512  # covariances per batch, powers of two: few compilations, 0.2 GB of memory
COV = [(0, 0, "ee"), (0, 1, "en"), (0, 2, "eu"), (1, 1, "nn"), (1, 2, "nu"), (2, 2, "uu")]
FIX_DECIMALS = {name: places for name, places in FIX_COLUMNS.items() if places is not None}
FIX_DECIMALS[ABOVE_TAKEOFF] = FIX_DECIMALS["fix_height_m"]


class Figures(NamedTuple):
    """Accuracy of n fixes: NaN where unknown.

    Radii in m that contain the true point with the `probability`, infinite where too many samples have no fix;
    covariance in m² and mean of the errors in m, east, north, up; semi-axes in m of the ellipse with that probability
    and the azimuth of the longer one in rad; the method, and the reason, as text.
    """

    probability: float
    circular: np.ndarray
    linear: np.ndarray
    spherical: np.ndarray
    cov_enu: np.ndarray
    bias_enu: np.ndarray
    axes: np.ndarray
    azimuth: np.ndarray
    method: list[str | None] | None
    because: list[str | None] | None


def figures_of(
    name: str, fixes: Fix, accuracy: Any, cov_enu: Any, bias_enu: Any, probability: float | None
) -> Figures | None:
    """The figures of a batch of n fixes, from an accuracy, covariances, or both; None without either.

    Raises `ValueError` for arguments that do not match these fixes, and invalid covariances or probabilities.
    """
    if accuracy is None and cov_enu is None:
        if bias_enu is not None:
            raise ValueError(f"{name}: bias_enu is the mean of errors whose cov_enu must be given too.")
        return None
    count = len(np.asarray(fixes.status))
    columns = _unknown(count, USUAL if probability is None else probability)
    if isinstance(accuracy, AccuracyMap):
        accuracy = accuracy.accuracy
    if isinstance(accuracy, Accuracy) and accuracy.shape:
        columns = _of_batch(name, fixes, accuracy, probability)
    elif accuracy is not None:
        columns = _of_each(name, fixes, accuracy, probability)
    level = float(check_probability(columns.probability))
    if cov_enu is not None:
        cov = _shaped(name, cov_enu, "cov_enu", (count, 3, 3))
        bias = np.zeros((count, 3)) if bias_enu is None else _shaped(name, bias_enu, "bias_enu", (count, 3))
        columns = columns._replace(cov_enu=cov, bias_enu=np.where(np.isnan(cov[:, :, 0]), np.nan, bias))
    elif bias_enu is not None:
        raise ValueError(f"{name}: bias_enu is the mean of errors whose cov_enu must be given too.")
    return _with_ellipses(name, columns._replace(probability=level), radii_too=accuracy is None)


def rows_of(
    fixes: Fix,
    figures: Figures | None,
    reasons: Sequence[str | None] | None = None,
    *,
    is_above_takeoff: bool = False,
) -> list[dict[str, Any]]:
    """A row for each fix: columns of `FIX_COLUMNS`, the status as a sentence, and the figures; None if unknown.

    Heights above mean sea level are above EGM96, which is bundled; `is_above_takeoff` as for `fix_rows`.
    `reasons` that are not None replace the sentence of the status.
    """
    rows = []
    msl = None if is_above_takeoff else height_msl(fixes)
    for i, own in enumerate(fix_rows(fixes, msl, is_above_takeoff=is_above_takeoff)):
        reason = None if reasons is None else reasons[i]
        row = {"index": i, **own, "status_text": Status[own["status"]].message if reason is None else reason}
        rows.append(row if figures is None else row | _figures_row(figures, i))
    return rows


def _figures_row(figures: Figures, i: int) -> dict[str, Any]:
    percent = f"{100.0 * figures.probability:.10g}".replace(".", "_")
    radii = {"ce": figures.circular, "le": figures.linear, "se": figures.spherical}
    row: dict[str, Any] = {"probability": figures.probability}
    row |= {f"{kind}{percent}_m": _number(values[i], 4) for kind, values in radii.items()}
    row |= {f"semi_{kind}_m": _number(figures.axes[i, k], 6) for k, kind in enumerate(("major", "minor"))}
    row["azimuth_deg"] = _number(np.rad2deg(figures.azimuth[i]), 6)
    row |= {f"bias_{axis}_m": _number(figures.bias_enu[i, k], 6) for k, axis in enumerate("enu")}
    row |= {f"cov_{axes}_m2": _significant(figures.cov_enu[i, j, k]) for j, k, axes in COV}
    words = {"accuracy_method": figures.method, "accuracy_text": figures.because}
    return row | {name: texts[i] for name, texts in words.items() if texts is not None}


def _number(value: Any, places: int) -> float | None:
    return None if math.isnan(value) else round(float(value), places)


def _significant(value: Any) -> float | None:
    return None if math.isnan(value) else float(f"{value:.12g}")


def no_figures(count: int, probability: float) -> Figures:
    """Unknown figures for n fixes, with all columns of an accuracy."""
    return _unknown(count, probability)._replace(method=[None] * count, because=[None] * count)


def _unknown(count: int, probability: float) -> Figures:
    circular, linear, spherical, azimuth = (np.full(count, np.nan) for _ in range(4))
    cov, bias, axes = (np.full((count, *shape), np.nan) for shape in ((3, 3), (3,), (2,)))
    return Figures(probability, circular, linear, spherical, cov, bias, axes, azimuth, None, None)


def _of_batch(name: str, fixes: Fix, accuracy: Accuracy, probability: float | None) -> Figures:
    """Figures of a batch; covariances where a propagation is valid."""
    count = len(np.asarray(fixes.status))
    if math.prod(accuracy.shape) != count:
        raise ValueError(f"{name}: accuracy is of a batch of the shape {accuracy.shape}, fixes of {count}.")
    flat = jax.tree.map(lambda leaf: np.reshape(leaf, (count, *np.shape(leaf)[len(accuracy.shape) :])), accuracy)
    _check_probability(name, level := accuracy.level(), probability)
    _check_same(name, np.linalg.norm(np.asarray(flat.fix.ecef) - np.asarray(fixes.ecef), axis=-1))
    figures = (flat.circular, flat.linear, flat.spherical, flat.cov_enu, flat.bias_enu)
    circular, linear, spherical, cov, bias = (np.array(x, np.float64) for x in figures)
    return _unknown(count, level)._replace(
        circular=circular,
        linear=linear,
        spherical=spherical,
        cov_enu=cov,
        bias_enu=bias,
        method=[None if code == NO_FIX else Method(code).words for code in flat.method.tolist()],
        because=reasons(flat),
    )


def _of_each(name: str, fixes: Fix, accuracy: Any, probability: float | None) -> Figures:
    """Figures of each fix, or None."""
    count = len(np.asarray(fixes.status))
    each: Sequence[Any] = [accuracy] if isinstance(accuracy, Accuracy) else accuracy
    if not isinstance(each, list | tuple) or len(each) != count:
        length = len(each) if isinstance(each, list | tuple) else type(each).__name__
        raise ValueError(f"{name}: accuracy must be a list with one, or None, for each of {count} fixes; got {length}.")
    columns, asked = _unknown(count, USUAL if probability is None else probability), probability
    method: list[str | None] = [None] * count
    because: list[str | None] = [None] * count
    far = np.full(count, np.nan)
    for i, one in enumerate(each):
        if one is None:
            continue
        check_is(one, Accuracy, f"accuracy[{i}]")
        asked = _check_probability(name, one.level(), asked)
        far[i] = np.linalg.norm(np.asarray(one.fix.ecef) - np.asarray(fixes.ecef)[i])
        columns.circular[i], columns.linear[i], columns.spherical[i] = one.circular, one.linear, one.spherical
        columns.cov_enu[i], columns.bias_enu[i] = np.asarray(one.cov_enu), np.asarray(one.bias_enu)
        method[i], because[i] = one.words, one.because
    _check_same(name, far)
    return columns._replace(probability=USUAL if asked is None else asked, method=method, because=because)


def _check_probability(name: str, own: float, asked: float | None) -> float:
    if asked is not None and abs(own - asked) > 1e-12:
        raise ValueError(
            f"{name}: accuracy has a probability of {own:g}, but {asked:g} is asked for; leave probability "
            f"out, or compute the accuracy with it."
        )
    return own


def _check_same(name: str, far: np.ndarray) -> None:
    """Raises if fixes are apart; `far` is NaN where nothing is compared."""
    other = np.flatnonzero(far > SAME)
    if other.size:
        i = other[0]
        raise ValueError(f"{name}: accuracy {i} is of another place than fix {i}, {far[i]:.3g} m off; give the same.")


def _shaped(name: str, given: Any, what: str, shape: tuple[int, ...]) -> np.ndarray:
    """An array of a given shape, with each entry entirely known or entirely NaN."""
    array = np.asarray(given, np.float64)
    if array.shape == shape[1:] and shape[0] == 1:
        array = array[None]
    if array.shape != shape:
        raise ValueError(f"{name}: {what} must have the shape {shape}; got {array.shape}.")
    rows = array.reshape(shape[0], -1)
    torn = np.flatnonzero(~np.isfinite(rows).all(axis=1) & ~np.isnan(rows).all(axis=1))
    if torn.size:
        raise ValueError(f"{name}: {what} of fix {torn[0]} must be finite, or NaN throughout; got {rows[torn[0]]}.")
    return array


def _with_ellipses(name: str, figures: Figures, *, radii_too: bool) -> Figures:
    """The ellipses of known covariances, and the radii from them unless given."""
    parts = figures.cov_enu.reshape(-1, 9), figures.bias_enu
    known = np.flatnonzero(np.isfinite(np.concatenate(parts, axis=1)).all(axis=1))
    if not known.size:
        return figures
    cov, bias = figures.cov_enu[known], figures.bias_enu[known]
    try:
        covariance(cov, 3)
    except ValueError as error:
        raise ValueError(f"{name}: {error} (cov_enu)") from error
    found = np.concatenate([_computed(*part, figures.probability, radii_too) for part in _parts(cov, bias)])
    spread = np.full((len(figures.azimuth), found.shape[1]), np.nan)
    spread[known] = found
    figures = figures._replace(axes=spread[:, :2], azimuth=spread[:, 2])
    if not radii_too:
        return figures
    circular, linear, spherical = spread[:, 3:].T
    return figures._replace(circular=circular, linear=linear, spherical=spherical)


def _parts(cov: np.ndarray, bias: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for start in range(0, len(cov), MOST):
        yield cov[start : start + MOST], bias[start : start + MOST]


def _computed(cov: np.ndarray, bias: np.ndarray, probability: float, radii_too: bool) -> np.ndarray:
    """Semi-axes, azimuth, and circular, linear, spherical error of covariances (n, 3, 3) and biases (n, 3)."""
    count = len(cov)
    more = max(FEWEST, 1 << (count - 1).bit_length()) - count
    cov, bias = (np.pad(x, [(0, more)] + [(0, 0)] * (x.ndim - 1), mode="edge") for x in (cov, bias))
    ellipse = error_ellipse(cov[:, :2, :2], probability)
    columns = [ellipse.major, ellipse.minor, ellipse.azimuth]
    if radii_too:
        columns.append(circular_error(cov[:, :2, :2], probability, bias[:, :2]))
        columns.append(linear_error(cov[:, 2, 2], probability, bias[:, 2]))
        columns.append(spherical_error(cov, probability, bias))
    return np.stack([np.asarray(x) for x in columns], axis=-1)[:count]


def checked_attributes(name: str, attributes: Any, count: int, taken: set[str]) -> list[dict[str, Any]]:
    """Validated caller attributes: texts, numbers and bools by name, the same names for all rows."""
    if attributes is None:
        return [{} for _ in range(count)]
    attributes = attribute_rows(name, attributes, count, "fixes")
    if not isinstance(attributes, list | tuple) or not all(isinstance(one, Mapping) for one in attributes):
        raise ValueError(
            f"{name}: attributes must be a list with a mapping for each fix, or one mapping of names to columns; got "
            f"{type(attributes).__name__}."
        )
    rows = [{str(key): plain(value) for key, value in one.items()} for one in attributes]
    if len(rows) != count:
        raise ValueError(f"{name}: attributes must be one mapping for each of {count} fixes; got {len(rows)}.")
    for i, row in enumerate(rows):
        different = sorted(row.keys() ^ rows[0].keys())
        if different:
            raise ValueError(
                f"{name}: the attributes of fixes 0 and {i} differ: {', '.join(different)} is in one of them only; "
                f"write None for what is unknown."
            )
    lower = [key.lower() for key in rows[0]] if rows else []
    for key in rows[0] if rows else ():
        if key.lower() in taken:
            raise ValueError(f"{name}: the attribute {key!r} is one that the file has by itself; rename it.")
        if lower.count(key.lower()) > 1:
            raise ValueError(f"{name}: the attribute {key!r} is there twice but for capitals; rename one.")
        _check_kind(name, key, [row[key] for row in rows])
    return rows


def plain(value: Any) -> Any:
    """A value of NumPy or JAX as one of Python."""
    return value.item() if isinstance(value, np.generic | np.ndarray | jax.Array) and np.ndim(value) == 0 else value


def _check_kind(name: str, key: str, values: Sequence[Any]) -> None:
    kinds = {type(value) for value in values if value is not None}
    if not any(kinds <= one for one in ({int, float}, {bool}, {str})):
        shown = ", ".join(sorted(kind.__name__ for kind in kinds))
        raise ValueError(f"{name}: the attribute {key!r} must be all numbers, all texts or all bools; got {shown}.")
    big = next((value for value in values if isinstance(value, int) and not -(2**63) <= value < 2**63), None)
    if big is not None:
        raise ValueError(f"{name}: the attribute {key!r} is a whole number of more than 64 bits: {big}; give a text.")
