"""What heights are above, before files are read: the take-off on the elevation model, and datums that nobody states."""

from __future__ import annotations

import dataclasses
import math
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import typer

from jaxgeo._checks import enable_x64
from jaxgeo._text_numbers import number_in
from jaxgeo.cli._acquisitions import TAKEOFF_ON_DEM, KnownHeights, ReadingOptions, reading_files
from jaxgeo.cli._archive_dem import is_archive
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._inputs import bounds_in, check_goes_with_dem, open_terrain, read_terrain
from jaxgeo.cli._options import READING, DemOptions
from jaxgeo.cli._takeoff_sigma import FirstExposure, doubt_of, takeoff_sigma
from jaxgeo.earth import Geodetic
from jaxgeo.uncertainty.sources import Position

if TYPE_CHECKING:
    from jaxgeo.cli._locate_options import GroundOptions
    from jaxgeo.io import Observations

UNSTATED = "does not state the vertical datum of its heights"  # of a `VerticalDatumError`
BESIDE = 2e-3  # deg of latitude: ground that is read around the first exposure, about 200 m


@dataclasses.dataclass(frozen=True, kw_only=True)
class TakeoffOptions(DemOptions):
    """The elevation model of `--takeoff-height dem`, for commands that need no other ground."""

    first: ClassVar[tuple[str, ...]] = ("dem",)

    dem: Annotated[
        list[str] | None,
        typer.Option(
            "--dem",
            metavar="FILE",
            help="Elevation model for --takeoff-height dem: a file, an archive (copernicus, ...), or a URL with "
            "--allow-remote; repeatable for tiles.",
            rich_help_panel=READING,
        ),
    ] = None

    def known(
        self, reading: ReadingOptions, files: Sequence[pathlib.Path], scene: pathlib.Path | None = None
    ) -> ReadingOptions:
        """As `with_known_heights`. Raises `UserError`, also for an elevation model without such a take-off."""
        if reading.takeoff_height == TAKEOFF_ON_DEM:
            return with_known_heights(reading, files, scene, self.dem or [], self)
        if self.dem:
            raise UserError("--dem is for --takeoff-height dem here; give that too, or leave --dem out.")
        check_goes_with_dem(self)
        if self.vertical_datum is not None:
            raise UserError(f"--dem-datum {self.vertical_datum} applies to --dem; leave it out.")
        return reading


def with_known_heights(
    reading: ReadingOptions,
    files: Sequence[pathlib.Path],
    scene: pathlib.Path | None,
    dem: Sequence[str],
    of_dem: DemOptions,
    sigmas: Sigmas | None = None,
) -> ReadingOptions:
    """The reading options with a number for `--takeoff-height dem`, which is printed on stderr.

    It is the height in m above the ellipsoid of the elevation model under the earliest exposure. Its standard deviation
    is that of `takeoff_sigma`, with `sigmas` as typed. Raises `UserError` without an elevation model, beside
    --camera-datum, and where the model has no height; one for both, if neither the files nor the elevation model state
    what their heights are above; and as the readers.
    """
    if reading.takeoff_height != TAKEOFF_ON_DEM:
        _refuse_both(reading, list(files), scene, list(dem), of_dem)
        return reading
    if not dem:
        raise UserError(
            "--takeoff-height dem is the height of the elevation model under the first exposure; give --dem."
        )
    if reading.height_datum is not None:
        raise UserError("--takeoff-height dem is above the ellipsoid already; leave --camera-datum out.")
    enable_x64()
    # of the whole file: a flight has one take-off, whichever moments are asked for
    whole = dataclasses.replace(reading, takeoff_height="0", times=[])
    first = _first_exposure(whole, list(files), scene)
    name, lat, lon = first[:3]
    terrain = _terrain_at(list(dem), of_dem, lat, lon)
    height = float(terrain.height_at(Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)))
    if not math.isfinite(height):
        raise UserError(
            f"--takeoff-height dem: the elevation model has no height under the first exposure, {name}, at {lat:.6f} "
            f"deg north, {lon:.6f} deg east; give the height of the take-off in m."
        )
    sigmas = Sigmas() if sigmas is None else sigmas
    sigma = takeoff_sigma(terrain, first, sigmas)
    found = f"The take-off is at {height:.2f} m above the ellipsoid, as the ground under {name}. {sigma.words}"
    doubt = doubt_of(sigma, first, sigmas)
    print_assumed([found] if doubt is None else [found, doubt])
    known: dict[str, Any] = {field.name: getattr(reading, field.name) for field in dataclasses.fields(ReadingOptions)}
    known |= {"takeoff_height": f"{height:.3f}", "takeoff_sigma": sigma.total}
    return KnownHeights(**known)


def takeoff_instead(reading: ReadingOptions, ground: GroundOptions) -> str | None:
    """The options by which heights above the take-off replace the altitudes of files, with those to leave out; None if
    they do so already."""
    given = [f"--camera-datum {reading.height_datum}"] if reading.height_datum is not None else []
    if isinstance(reading, KnownHeights) or (reading.takeoff_height is not None and not ground.dem):
        return None
    given += [f"--takeoff-height {reading.takeoff_height}"] if reading.takeoff_height is not None else []
    if ground.dem:
        typed = f"--takeoff-height {TAKEOFF_ON_DEM}"
    elif number_in(ground.level or "") is None:
        return None
    else:
        datum = "" if ground.vertical_datum is None else f" --camera-datum {ground.vertical_datum}"
        typed = f"--takeoff-height {ground.level}{datum}"
    return typed + (f" in place of {' and '.join(given)}" if given else "")


def has_no_datum(reading: ReadingOptions, ground: GroundOptions) -> bool:
    """Whether heights, those of level ground too, are above a take-off whose own height is unknown."""
    is_level = number_in(ground.level or "") is not None and ground.vertical_datum is None
    return reading.is_above_takeoff and is_level


def relative_heights(reading: ReadingOptions, ground: GroundOptions | None = None) -> list[str]:
    """A sentence on all heights if the take-off is the level of reference; over ground above a datum, a doubt."""
    from jaxgeo.io.acquisitions.sentences import DOUBT

    if not reading.is_above_takeoff:
        return []
    if ground is None or has_no_datum(reading, ground):
        return [
            "With --takeoff-height 0 all heights are above the take-off, and above no datum; if it is at 0 m above "
            "the ellipsoid, give --camera-datum ellipsoid too."
        ]
    known = "--ground" if ground.level is not None else "--dem"
    way = "its height as --takeoff-height" if ground.level is not None else "--takeoff-height dem, or its height"
    return [
        f"{DOUBT}With --takeoff-height 0 the take-off is at 0 m above the ellipsoid, as heights of {known} are above a "
        f"datum. Give {way}, unless it is there."
    ]


def refuse_relative_heights(reading: ReadingOptions, what: str) -> None:
    """Raise `UserError` if the take-off is the level of reference, for a result whose heights are above a datum."""
    if reading.is_above_takeoff:
        raise UserError(
            f"--takeoff-height {reading.takeoff_height}: heights are then above the take-off, and above no datum, but "
            f"those of {what} are above one. Give the height of the take-off above the WGS 84 ellipsoid, or above a "
            f"datum with --camera-datum too (of 0 m above the ellipsoid, --camera-datum ellipsoid); or "
            f"--takeoff-height {TAKEOFF_ON_DEM} with --dem."
        )


def _refuse_both(
    reading: ReadingOptions, files: list[pathlib.Path], scene: pathlib.Path | None, dem: list[str], of_dem: DemOptions
) -> None:
    """Raise one `UserError` if neither the files nor the elevation model state what their heights are above."""
    from jaxgeo.io.acquisitions import UnstatedDatum

    said = (reading.height_datum, reading.takeoff_height, of_dem.vertical_datum)
    if not files or not dem or any(one is not None for one in said) or is_archive(dem):
        return
    try:
        open_terrain(dem, dataclasses.replace(of_dem, dem_bounds=None))
        return
    except UserError as error:
        if UNSTATED not in f"{error}":
            return  # said when the ground is read
        of_ground = error
    try:
        enable_x64()
        _read(reading, files, scene)
    except UserError as error:
        causes = error.__cause__, getattr(error.__cause__, "__cause__", None)
        if any(isinstance(cause, UnstatedDatum) for cause in causes):
            raise UserError(f"{error} And of the elevation model: {of_ground}") from error


def _read(reading: ReadingOptions, files: list[pathlib.Path], scene: pathlib.Path | None) -> Observations:
    from jaxgeo.io import read_observations

    with reading_files(files) as progress:
        return read_observations(files, scene=scene, progress=progress, **reading.known_arguments)


def _first_exposure(reading: ReadingOptions, files: list[pathlib.Path], scene: pathlib.Path | None) -> FirstExposure:
    """The earliest exposure, of those at one time the first."""
    observed = _read(reading, files, scene)
    found: list[tuple[float, int, float, float]] = []
    for batch in observed.batches:
        times = np.broadcast_to(np.asarray(batch.shots.time, float), (len(batch.rows),))
        place = batch.shots.pose.position
        lat, lon = (np.broadcast_to(np.rad2deg(np.asarray(x)), times.shape) for x in (place.lat, place.lon))
        found += zip(times.tolist(), np.asarray(batch.rows).tolist(), lat.tolist(), lon.tolist(), strict=True)
    _, row, lat, lon = min(found)
    name = str(observed.columns[row].get("name", row))
    name = f"exposure {name} of {observed.source}" if name.isdigit() else name
    is_usual = any(kind is Position for kind, _ in observed.assumed_errors)
    return FirstExposure(name, lat, lon, observed.at(row)[1], is_usual)


def _is_within(bounds: tuple[float, float, float, float] | None, lat: float, lon: float) -> bool:
    """Whether a place in deg is within an extent (west, south, east, north), which may cross the date line."""
    if bounds is None:
        return False
    west, south, east, north = bounds
    return south < lat < north and 0.0 < (lon - west) % 360.0 < (east - west) % 360.0


def _terrain_at(dem: list[str], of_dem: DemOptions, lat: float, lon: float) -> Any:
    """The elevation model, of an archive the part around a place in deg."""
    if is_archive(dem) and not _is_within(bounds_in(of_dem), lat, lon):
        across = BESIDE / max(math.cos(math.radians(lat)), 0.01)
        edges = f"{lon - across:.8f},{lat - BESIDE:.8f},{lon + across:.8f},{lat + BESIDE:.8f}"
        of_dem = dataclasses.replace(of_dem, dem_bounds=edges)
    return read_terrain(dem, of_dem)
