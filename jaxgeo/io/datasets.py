"""Accuracy maps and error samples as xarray datasets with CF dimensions, coordinates, units and CRS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.io.map_raster import MapRaster
from jaxgeo.status import Status
from jaxgeo.uncertainty import NO_FIX, AccuracyMap, Method
from jaxgeo.uncertainty.sampled import Sampled

if TYPE_CHECKING:
    import xarray

CONVENTIONS = "CF-1.11"
AXES = ["east", "north", "up"]


def accuracy_map_dataset(found: AccuracyMap, raster: MapRaster | None = None) -> xarray.Dataset:
    """An accuracy map as a dataset: `circular_error`, `linear_error`, `spherical_error` in m, with method and status.

    NaN where unknown, infinite where too many samples fail, as in `AccuracyMap`. `trust` (the method) and `status` are
    codes with CF flag attributes; `failed` is a share, `u` and `v` the pixel in px.
    `latitude`, `longitude` (deg, WGS 84) and `height` (m above its ellipsoid) are coordinates. With the `raster` of the
    map the dimensions are those of the CRS, with cell centres as coordinates, and `crs` is the grid mapping; without
    it they are `place`, or `row` and `col`. Raises `ValueError` for a raster of another shape, or a rotated one;
    `ImportError` without xarray.
    """
    check_is(found, AccuracyMap, "found")
    xr = _xarray()
    dims, coords, mapping = _dimensions(found.shape, raster)
    lat, lon, height = (np.asarray(x) for x in found.position.to_degrees())
    u, v = np.moveaxis(np.asarray(found.uv), -1, 0)
    percent = f"with a probability of {found.probability:g}"
    codes = [(NO_FIX, "no_fix"), *((int(one), one.name) for one in Method)]
    data: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
        "circular_error": (
            np.asarray(found.circular),
            _attrs(f"horizontal radius that holds the truth {percent}", "m"),
        ),
        "linear_error": (np.asarray(found.linear), _attrs(f"height that holds the truth {percent}", "m")),
        "spherical_error": (np.asarray(found.spherical), _attrs(f"radius that holds the truth {percent}", "m")),
        "failed": (np.asarray(found.failed), _attrs("share of the samples without a fix", "1")),
        "trust": (np.asarray(found.method, np.int8), _flags("method that the figures are from", codes)),
        "status": (np.asarray(found.status, np.int8), _statuses()),
        "u": (u, _attrs("column of the pixel that sees the place", "pixel")),
        "v": (v, _attrs("row of the pixel that sees the place", "pixel")),
    }
    variables = {name: (dims, values, attributes | mapping) for name, (values, attributes) in data.items()}
    places = {"latitude": (dims, lat, _latitude()), "longitude": (dims, lon, _longitude())}
    places["height"] = (dims, height, _height())
    attributes = {"Conventions": CONVENTIONS, "probability": found.probability, "samples": found.count}
    return xr.Dataset(variables, coords=coords | places, attrs=attributes)


def samples_dataset(sampled: Sampled) -> xarray.Dataset:
    """Error samples of a fix as a dataset: `error` (sample, axis) in m, NaN without a fix, and `status`.

    Axes are east, north, up at the fix, whose `latitude`, `longitude` (deg, WGS 84) and `height` (m above its
    ellipsoid) are coordinates; errors are relative to `centre`. `mean` in m and `covariance` in m² are those of the
    samples with a fix. Raises `ValueError` if the samples were not kept; `ImportError` without xarray.
    """
    check_is(sampled, Sampled, "sampled")
    if sampled.errors_enu is None or sampled.codes is None:
        raise ValueError("the samples themselves were not kept: sample(..., keep=True) returns them.")
    xr = _xarray()
    lat, lon, height = (float(x) for x in sampled.fix.position.to_degrees())
    variables = {
        "error": (("sample", "axis"), sampled.errors_enu, _attrs("error of the fix about its centre", "m")),
        "status": ("sample", np.asarray(sampled.codes, np.int8), _statuses()),
        "mean": ("axis", sampled.mean_enu, _attrs("mean of the samples with a fix, from the fix", "m")),
        "covariance": (("axis", "other_axis"), sampled.cov_enu, _attrs("covariance of the samples with a fix", "m2")),
        "centre": ("axis", sampled.centre_enu, _attrs("what errors are counted from, from the fix", "m")),
    }
    coords = {"axis": AXES, "other_axis": AXES, "sample": sampled.numbers}
    coords |= {
        "latitude": ((), lat, _latitude()),
        "longitude": ((), lon, _longitude()),
        "height": ((), height, _height()),
    }
    attributes = {"Conventions": CONVENTIONS, "samples": sampled.count, "samples_with_a_fix": sampled.found}
    return xr.Dataset(variables, coords=coords, attrs=attributes)


def _dimensions(
    shape: tuple[int, ...], raster: MapRaster | None
) -> tuple[tuple[str, ...], dict[str, Any], dict[str, str]]:
    """Dimension names, their coordinates, and the grid-mapping attribute of variables."""
    if raster is None:
        usual = {0: (), 1: ("place",), 2: ("row", "col")}
        return usual.get(len(shape), tuple(f"axis_{k}" for k in range(len(shape)))), {}, {}
    if tuple(raster.shape) != tuple(shape):
        raise ValueError(f"the raster has {raster.shape} cells (rows, cols), but the map of accuracy {shape}.")
    across, turned, west, sheared, down, north = raster.transform[:6]
    if turned or sheared:
        raise ValueError("the raster is turned against its CRS, so that its rows and columns have no coordinates.")
    x, y = west + across * (np.arange(shape[1]) + 0.5), north + down * (np.arange(shape[0]) + 0.5)
    names = ("lat", "lon") if raster.crs.is_geographic else ("y", "x")
    kinds = (
        ("latitude", "longitude")
        if raster.crs.is_geographic
        else ("projection_y_coordinate", "projection_x_coordinate")
    )
    units = _units(raster)
    coords: dict[str, Any] = {
        name: (name, values, {"standard_name": kind, "units": unit, "axis": axis})
        for name, values, kind, unit, axis in zip(names, (y, x), kinds, units, "YX", strict=True)
    }
    coords["crs"] = ((), np.int32(0), {key: value for key, value in raster.crs.to_cf().items() if value is not None})
    return names, coords, {"grid_mapping": "crs"}


def _units(raster: MapRaster) -> tuple[str, str]:
    """CF units of y and x; PROJ's names where CF has none."""
    unit = raster.crs.axis_info[0].unit_name
    if unit == "degree":
        return "degrees_north", "degrees_east"
    unit = {"metre": "m"}.get(unit, unit)
    return unit, unit


def _attrs(words: str, units: str) -> dict[str, Any]:
    return {"long_name": words, "units": units}


def _statuses() -> dict[str, Any]:
    return _flags("what became of the line of sight", [(int(one), one.name) for one in Status])


def _flags(words: str, codes: list[tuple[int, str]]) -> dict[str, Any]:
    values, names = zip(*codes, strict=True)
    return {"long_name": words, "flag_values": np.array(values, np.int8), "flag_meanings": " ".join(names)}


def _latitude() -> dict[str, Any]:
    return {"standard_name": "latitude", "units": "degrees_north"}


def _longitude() -> dict[str, Any]:
    return {"standard_name": "longitude", "units": "degrees_east"}


def _height() -> dict[str, Any]:
    return {"standard_name": "height_above_reference_ellipsoid", "units": "m"}


def _xarray() -> Any:
    try:
        import xarray
    except ImportError as error:
        raise ImportError("datasets need the library xarray: pip install 'jaxgeo[xarray]'.") from error
    return xarray
