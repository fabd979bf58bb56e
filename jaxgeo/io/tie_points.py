"""Tie points between an image and a reference as GeoJSON, with the reason why each was used or rejected."""

from __future__ import annotations

import math
import os
import pathlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import pyproj
import shapely

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.io._features import Feature
from jaxgeo.io._geopackage import one_layer

PLACE = ("lat_deg", "lon_deg", "height_m")


@dataclass(frozen=True)
class TieRow:
    """A ground point and its pixel, for a file.

    Latitude and longitude in deg of WGS 84, ellipsoidal height in m if known; `column` and `row` in pixels of
    the image, pixel centres at integers; the `score` of the match, the standard deviation in m of its position on the
    ground; residuals in pixels (image minus prediction) and the weight after the update; whether it was `chosen`,
    else the `reason` as text. Unknown values are None or NaN.
    """

    lat_deg: float
    lon_deg: float
    column: float
    row: float
    height_m: float | None = None
    score: float | None = None
    sigma_m: float | None = None
    residual_column_px: float | None = None
    residual_row_px: float | None = None
    weight: float | None = None
    chosen: bool = True
    reason: str = ""


NAMES = [name for name in TieRow.__dataclass_fields__ if name not in PLACE]


def write_tie_points(path: str | os.PathLike[str], rows: Sequence[TieRow]) -> None:
    """Write tie points as RFC 7946 GeoJSON points: [lon, lat], or [lon, lat, height] if all have a height.

    Everything else is a property; NaN and infinities, which JSON lacks, are null. The file appears only when
    complete. Raises `ValueError` for a path that cannot be written to, no tie points, a position that is not finite or
    not on the Earth, and a rejected one without a reason.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() not in (".geojson", ".json"):
        raise ValueError(f"{target}: tie points are written as GeoJSON; name a file that ends in .geojson.")
    if not rows:
        raise ValueError(f"{target}: there are no tie points; there is nothing to write.")
    for index, one in enumerate(rows):
        _check(f"{target}: tie point {index}", one)
    with_height = all(one.height_m is not None and math.isfinite(one.height_m) for one in rows)
    crs = pyproj.CRS.from_epsg(4979 if with_height else 4326)
    features = [_feature(one, with_height) for one in rows]
    with destination("tie points", target, binary=True) as stream:
        stream.write(one_layer(f"{target}", "GeoJSON", "tie points", features, NAMES, crs))


def _check(where: str, one: TieRow) -> None:
    check_is(one, TieRow, where)
    if not (abs(one.lat_deg) <= 90.0 and abs(one.lon_deg) <= 360.0):
        raise ValueError(f"{where}: latitude {one.lat_deg!r}, longitude {one.lon_deg!r} deg are no place on the Earth.")
    if not one.chosen and not one.reason:
        raise ValueError(f"{where} was left out without a reason; say in words why.")


def _feature(one: TieRow, with_height: bool) -> Feature:
    lon = (one.lon_deg + 180.0) % 360.0 - 180.0
    place = shapely.Point(lon, one.lat_deg, *([one.height_m] if with_height else []))
    values = asdict(one)
    return Feature(place, {name: _plain(values[name]) for name in NAMES})


def _plain(value: Any) -> Any:
    """A value for JSON: None for a number that is not finite."""
    if isinstance(value, bool | str) or value is None:
        return value
    return float(value) if math.isfinite(value) else None
