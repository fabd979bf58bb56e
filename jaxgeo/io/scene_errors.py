"""Error model from the table [errors] of a scene file."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from jaxgeo.io._schema import ErrorsTable, StatedTable
from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty import sources
from jaxgeo.uncertainty.datasheet import Stated, circular_error, linear_error, plus_minus, rms, spherical_error
from jaxgeo.uncertainty.distributions import (
    AbstractDistribution,
    Arcsine,
    Empirical,
    Laplace,
    Mixture,
    StudentT,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from jaxgeo.uncertainty.model import ErrorModel

Given = float | list[float] | StatedTable
AMOUNTS = ("sigma", "plus_minus", "rms", "ce", "le", "se")
PLAIN: dict[str, type[AbstractDistribution]] = {
    "uniform": Uniform,
    "triangular": Triangular,
    "arcsine": Arcsine,
    "laplace": Laplace,
}
NAMES = ("normal", *PLAIN, "student-t", "outliers", "mixture", "truncated-normal", "empirical")
OPTIONS = {
    "sigmas": ("plus_minus",),
    "coverage": ("plus_minus",),
    "probability": ("ce", "le", "se", "raster"),
    "axes": ("rms",),
    "scale": ("raster",),
}
KEYS = {  # of a distribution: those that it needs, all of one of the tuples
    "student-t": (("df",),),
    "outliers": (("share", "times"),),
    "mixture": (("parts",),),
    "truncated-normal": (("low",), ("high",), ("low", "high")),
    "empirical": (("residuals",), ("probabilities", "values")),
}
WITH_SIGMA = ("mixture", "empirical")  # distributions with a standard deviation of their own
UNLIMITED = ("laplace", "student-t", "outliers", "mixture", "truncated-normal", "empirical")


def model_of_table(table: ErrorsTable, gimbal: Gimbal, folder: pathlib.Path = pathlib.Path()) -> ErrorModel:
    """The error model of a table; paths in it are relative to `folder`.

    Raises `ValueError` if it does not match the gimbal, and as `read_height_sigmas` for a raster.
    """
    found: list[Any] = []
    if table.position_m is not None:
        north, east, down = _each(table.position_m, 3, "position_m", axes=("ce", "ce", "le"))
        found.append(sources.Position.from_ned(north=north, east=east, down=down))
    if table.attitude_deg is not None:
        heading, pitch, roll = _each(table.attitude_deg, 3, "attitude_deg")
        found.append(sources.Attitude.from_degrees(heading=heading, pitch=pitch, roll=roll))
    if table.gimbal_deg is not None:
        found.append(_of_axes(sources.GimbalAngles, "gimbal_deg", table.gimbal_deg, gimbal))
    if table.gimbal_mounting_deg is not None:
        found.append(_of_axes(sources.GimbalMounting, "gimbal_mounting_deg", table.gimbal_mounting_deg, gimbal))
    if table.boresight_deg is not None:
        found.append(_boresight(table.boresight_deg, gimbal))
    if table.lever_body_m is not None:
        forward, right, down = _each(table.lever_body_m, 3, "lever_body_m")
        found.append(sources.LeverArm.from_metres(forward=forward, right=right, down=down))
    return ErrorModel((*found, *_of_image(table), *_of_ground(table, folder)))


def _of_image(table: ErrorsTable) -> list[Any]:
    found: list[Any] = []
    if table.focal_px is not None or table.principal_px is not None:
        column, row = _each(0.0 if table.principal_px is None else table.principal_px, 2, "principal_px")
        (focal,) = _each(0.0 if table.focal_px is None else table.focal_px, 1, "focal_px")
        found.append(sources.InteriorOrientation.from_pixels(focal=focal, principal_column=column, principal_row=row))
    if table.pixel_px is not None:
        column, row = _each(table.pixel_px, 2, "pixel_px")
        found.append(sources.PixelMeasurement.from_pixels(column=column, row=row))
    return found


def _of_ground(table: ErrorsTable, folder: pathlib.Path) -> list[Any]:
    if table.terrain_m is None:
        return []
    if isinstance(table.terrain_m, StatedTable) and table.terrain_m.raster is not None:
        return [_of_raster(table, table.terrain_m, folder)]
    (height,) = _each(table.terrain_m, 1, "terrain_m", axes=("le",))
    if table.terrain_correlation_m is None:
        return [sources.TerrainHeight.from_metres(height)]
    sigma, shape = height if isinstance(height, Stated) else (height, None)
    variogram = (sigma, table.terrain_correlation_m)
    return [sources.TerrainField.of_variograms(gaussian=[variogram], distribution=shape)]


def _of_raster(table: ErrorsTable, stated: StatedTable, folder: pathlib.Path) -> sources.TerrainHeightRaster:
    """Terrain heights whose standard deviations are in a raster."""
    from jaxgeo.io.height_sigmas import read_height_sigmas  # which imports rasterio

    key = "[errors] terrain_m"
    if table.terrain_correlation_m is not None:
        raise ValueError(f"{key}: a raster has no terrain_correlation_m; leave one of them out.")
    amounts = [name for name in AMOUNTS if getattr(stated, name) is not None]
    if amounts:
        raise ValueError(f"{key}: a raster states the standard deviation at each place; leave out {amounts[0]}.")
    assert stated.raster is not None
    path = folder / stated.raster
    try:
        _check_options(stated, ["raster"])
        return read_height_sigmas(
            path, scale=stated.scale or 1.0, probability=stated.probability, distribution=_distribution(stated)
        )
    except FileNotFoundError:
        raise ValueError(f"{key}: raster = {stated.raster!r}: there is no such file ({path}).") from None
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error


def _of_axes(kind: Any, key: str, given: Given, gimbal: Gimbal) -> Any:
    if not gimbal.names:
        raise ValueError(f"[errors] {key}: the gimbal is fixed, so its readings have no error.")
    return kind.from_degrees(**dict(zip(gimbal.names, _each(given, len(gimbal.names), key), strict=True)))


def _boresight(given: Given, gimbal: Gimbal) -> Any:
    if gimbal.reference == "level":
        raise ValueError(
            "[errors] boresight_deg: this gimbal reports its angles against the level, so that how its base is mounted "
            "does not matter; give gimbal_mounting_deg."
        )
    heading, pitch, roll = _each(given, 3, "boresight_deg")
    return sources.Boresight.from_degrees(heading=heading, pitch=pitch, roll=roll)


def _each(given: Given, count: int, key: str, axes: Sequence[str] = ()) -> Sequence[float | Stated]:
    """One standard deviation, or what is stated of it, per axis; `axes` are the radii that a table may state of each.

    Raises `ValueError` for a wrong number, and for tables that do not say one thing.
    """
    if isinstance(given, StatedTable):
        try:
            return _stated(given, count, key, axes)
        except ValueError as error:
            reason = str(error).replace("kind=", "distribution = ").removeprefix(f"[errors] {key}: ")
            raise ValueError(f"[errors] {key}: {reason}") from error
    return _numbers(given, count, key)


def _numbers(given: float | list[float], count: int, key: str) -> list[float]:
    values = [given] * count if isinstance(given, float | int) else list(given)
    if len(values) != count:
        raise ValueError(f"[errors] {key} = {given!r}: expected {count} numbers, one for each reading, or one for all.")
    return [float(value) for value in values]


def _stated(table: StatedTable, count: int, key: str, axes: Sequence[str]) -> list[Stated]:
    """What a table states of each axis."""
    if table.raster is not None:
        raise ValueError("a raster of standard deviations is one of terrain_m.")
    amounts = [name for name in AMOUNTS if getattr(table, name) is not None]
    if not amounts and table.distribution in WITH_SIGMA:
        amounts = ["sigma"]
    radii = [name for name in amounts if name in ("ce", "le", "se")]
    if len(amounts) != 1 and not (radii == amounts == ["ce", "le"]):
        known = ", ".join(AMOUNTS[:3]) + (", ce and le, or se" if len(axes) == 3 else ", or le" if axes else "")
        raise ValueError(f"give one of {known}; got {', '.join(amounts) or 'none of them'}.")
    _check_options(table, amounts)
    if radii:
        return _of_radii(table, radii, axes)
    if table.rms is not None:
        return [rms(table.rms, axes=table.axes)] * count
    if table.plus_minus is not None:
        shape = table.distribution
        if shape in UNLIMITED:
            raise ValueError(f'plus_minus goes with distribution = "normal" or one with limits; got {shape!r}.')
        options: Any = {"kind": shape, "sigmas": table.sigmas, "coverage": table.coverage}
        return [plus_minus(value, **options) for value in _numbers(table.plus_minus, count, f"{key}.plus_minus")]
    shape = _distribution(table)
    if table.sigma is None:
        return [Stated(_own_sigma(shape), shape)] * count
    return [Stated(value, shape) for value in _numbers(table.sigma, count, f"{key}.sigma")]


def _check_options(table: StatedTable, amounts: list[str]) -> None:
    """Raise `ValueError` for keys that go with others."""
    for name, with_ in OPTIONS.items():
        if getattr(table, name) is not None and not any(amount in with_ for amount in amounts):
            raise ValueError(f"{name} goes with {', '.join(with_)}.")
    if table.distribution not in (None, "normal") and not {"sigma", "plus_minus", "raster"} & set(amounts):
        raise ValueError("distribution goes with sigma or plus_minus; rms, ce, le and se are of normal errors.")
    for shape, ways in KEYS.items():
        names = list(dict.fromkeys(name for way in ways for name in way))
        given = tuple(name for name in names if getattr(table, name) is not None)
        if table.distribution != shape and given:
            raise ValueError(f'distribution = "{shape}" alone has {given[0]}.')
        if table.distribution == shape and given not in ways:
            wanted = " or ".join(" and ".join(way) for way in ways if shape != "truncated-normal" or len(way) == 1)
            raise ValueError(f'distribution = "{shape}" needs {wanted}; got {", ".join(given) or "none of them"}.')


def _of_radii(table: StatedTable, radii: list[str], axes: Sequence[str]) -> list[Stated]:
    if radii == ["se"] and len(axes) == 3:
        return [spherical_error(table.se, probability=table.probability)] * 3
    if set(radii) != set(axes):
        wanted = "le" if axes else "sigma, plus_minus or rms"
        if len(axes) == 3:
            wanted = "ce and le (horizontal and vertical), or se"
        raise ValueError(f"give {wanted} of these errors; got {' and '.join(radii)}.")
    of = {
        "ce": lambda: circular_error(table.ce, probability=table.probability),
        "le": lambda: linear_error(table.le, probability=table.probability),
    }
    return [of[name]() for name in axes]


def _own_sigma(shape: AbstractDistribution | None) -> float:
    """Standard deviation of a distribution of `WITH_SIGMA`, in the unit of its values."""
    assert isinstance(shape, Empirical | Mixture)
    return float(shape.standard_deviation)


def _distribution(table: StatedTable) -> AbstractDistribution | None:
    shape = _shape(table)
    if shape is not None:
        shape.check("distribution")
    return shape


def _shape(table: StatedTable) -> AbstractDistribution | None:
    """The distribution of a table that has the keys of its kind."""
    name, share, times = table.distribution, table.share, table.times
    if name is None or name == "normal":
        return None
    if name == "truncated-normal":
        return TruncatedNormal(
            -math.inf if table.low is None else table.low, math.inf if table.high is None else table.high
        )
    if name == "empirical":
        if table.residuals is not None:
            return Empirical.of_residuals(table.residuals)
        return Empirical(jnp.asarray(table.probabilities), jnp.asarray(table.values))
    if table.parts is not None:
        columns = ([getattr(part, key) for part in table.parts] for key in ("share", "sigma", "mean"))
        return Mixture(*(jnp.asarray(column, jnp.float64) for column in columns))
    if name == "student-t":
        if table.df is not None and table.df <= 2.0:
            raise ValueError(f"df must be above 2, for there to be the standard deviation sigma; got {table.df:g}.")
        return StudentT(table.df)
    if share is not None and times is not None:  # `_check_options`: those of outliers
        return Mixture.of_outliers(share=share, times=times)
    if name not in PLAIN:
        raise ValueError(f"distribution must be one of {', '.join(NAMES)}; got {name!r}.")
    return PLAIN[name]()
