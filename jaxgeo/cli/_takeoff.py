"""`--takeoff-height dem`: the height of the elevation model under the first exposure."""

from __future__ import annotations

import dataclasses
import math
import pathlib
from collections.abc import Sequence

import numpy as np

from jaxgeo._checks import enable_x64
from jaxgeo.cli._acquisitions import TAKEOFF_ON_DEM, ReadingOptions, reading_files
from jaxgeo.cli._archive_dem import is_archive
from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import read_terrain
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._screen import print_note

BESIDE = 2e-3  # deg of latitude: ground that is read around the first exposure, about 200 m


def known_takeoff(
    reading: ReadingOptions,
    files: Sequence[pathlib.Path],
    scene: pathlib.Path | None,
    dem: Sequence[str],
    of_dem: DemOptions,
) -> ReadingOptions:
    """The reading options with a number for `--takeoff-height dem`, which is printed on stderr.

    It is the height in m above the ellipsoid of the elevation model under the earliest exposure. Raises `UserError`
    without an elevation model, beside --camera-datum, and where the model has no height; and as the readers.
    """
    if reading.takeoff_height != TAKEOFF_ON_DEM:
        return reading
    if not dem:
        raise UserError(
            "--takeoff-height dem is the height of the elevation model under the first exposure; give --dem."
        )
    if reading.height_datum is not None:
        raise UserError("--takeoff-height dem is above the ellipsoid already; leave --camera-datum out.")
    enable_x64()
    name, lat, lon = _first_exposure(dataclasses.replace(reading, takeoff_height="0"), list(files), scene)
    height = _height_under(list(dem), of_dem, lat, lon)
    if not math.isfinite(height):
        raise UserError(
            f"--takeoff-height dem: the elevation model has no height under the first exposure, {name}, at {lat:.6f} "
            f"deg north, {lon:.6f} deg east; give the height of the take-off in m."
        )
    print_note(f"assumed: The take-off is at {height:.2f} m above the ellipsoid, as the ground under {name}.")
    return dataclasses.replace(reading, takeoff_height=f"{height:.3f}")


def _first_exposure(
    reading: ReadingOptions, files: list[pathlib.Path], scene: pathlib.Path | None
) -> tuple[str, float, float]:
    """(name, latitude and longitude in deg) of the earliest exposure, of those at one time the first."""
    from jaxgeo.io import read_observations

    with reading_files(files) as progress:
        observed = read_observations(files, scene=scene, progress=progress, **reading.known_arguments)
    found: list[tuple[float, int, float, float]] = []
    for batch in observed.batches:
        times = np.broadcast_to(np.asarray(batch.shots.time, float), (len(batch.rows),))
        place = batch.shots.pose.position
        lat, lon = (np.broadcast_to(np.rad2deg(np.asarray(x)), times.shape) for x in (place.lat, place.lon))
        found += zip(times.tolist(), np.asarray(batch.rows).tolist(), lat.tolist(), lon.tolist(), strict=True)
    _, row, lat, lon = min(found)
    return str(observed.columns[row].get("name", observed.source)), lat, lon


def _height_under(dem: list[str], of_dem: DemOptions, lat: float, lon: float) -> float:
    """The height in m above the ellipsoid of an elevation model at a place; NaN beside it and in voids."""
    from jaxgeo.earth import Geodetic

    if is_archive(dem):
        across = BESIDE / max(math.cos(math.radians(lat)), 0.01)
        edges = f"{lon - across:.8f},{lat - BESIDE:.8f},{lon + across:.8f},{lat + BESIDE:.8f}"
        of_dem = dataclasses.replace(of_dem, dem_bounds=edges)
    return float(read_terrain(dem, of_dem).height_at(Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)))
