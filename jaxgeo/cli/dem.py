"""`jaxgeo dem`: elevation models of open archives."""

from __future__ import annotations

import dataclasses
import math
import pathlib
import re
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from jaxgeo._destination import check_place
from jaxgeo._text_numbers import number_in
from jaxgeo.cli._acquisitions import ReadingOptions, print_unread, reading_files
from jaxgeo.cli._archive_dem import fetch
from jaxgeo.cli._common import Debug, UserError, name_says, report_errors
from jaxgeo.cli._console import Console
from jaxgeo.cli._inputs import check_no_overwrite
from jaxgeo.cli._option_names import translate_dem_errors
from jaxgeo.cli._options import DemOptions, OptionGroup
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import print_message, print_note, working

if TYPE_CHECKING:
    from jaxgeo.io.archives import View

RADIUS = 5000.0  # m
ENDINGS = (".tif", ".tiff")
METRES_PER_DEGREE = 111_000.0
_PLACE = re.compile(r"-(\d[\d.]*),(-?\d[\d.]*)")


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundOptions(OptionGroup):
    """The ground for which an elevation model is fetched."""

    panel: ClassVar[str | None] = "The ground"

    place: Annotated[
        str | None, typer.Argument(metavar="LAT,LON", help="Place in deg, e.g. 36.31,-84.25.", show_default=False)
    ] = None
    files: Annotated[
        list[pathlib.Path] | None,
        typer.Option(
            "--for", metavar="FILE", help="Images, telemetry or a scene, whose ground is fetched (repeatable)."
        ),
    ] = None
    scene: Annotated[
        pathlib.Path | None,
        typer.Option("--scene", metavar="FILE", help="Scene file (TOML) for a --for FILE without a camera."),
    ] = None
    radius: Annotated[
        float | None, typer.Option("--radius", metavar="METRES", help="Distance around LAT,LON, m (default 5000).")
    ] = None
    bounds: Annotated[
        str | None, typer.Option("--bounds", metavar="EDGES", help="Extent instead: WEST,SOUTH,EAST,NORTH in deg.")
    ] = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class SourceOptions(OptionGroup):
    """The archive, and how it is reached."""

    panel: ClassVar[str | None] = "The archive"

    archive: Annotated[
        str,
        typer.Option(
            "--archive",
            metavar="NAME",
            help="copernicus, copernicus-90, srtm, skadi, 3dep; an address with fields such as "
            "https://HOST/{S}{W}.tif; or stac:ADDRESS of a collection.",
        ),
    ] = "copernicus"
    vertical_datum: Annotated[
        str | None,
        typer.Option(
            "--dem-datum",
            metavar="DATUM",
            help="Vertical datum of the tiles, if neither the archive nor the files state it.",
        ),
    ] = None
    mirror: Annotated[
        str | None,
        typer.Option(
            "--mirror",
            metavar="ADDRESS",
            help="The archive at another address or in a folder; NAME=ADDRESS for several, proj=ADDRESS for geoid "
            "grids.",
        ),
    ] = None
    proxy: Annotated[
        str | None,
        typer.Option("--proxy", metavar="ADDRESS", help="Proxy (default: HTTPS_PROXY)."),
    ] = None
    offline: Annotated[bool, typer.Option("--offline", help="Use only what is on this machine.")] = False
    geoid: Annotated[
        str | None,
        typer.Option(
            "--geoid", metavar="DATUM", help="Install PROJ's geoid grid of a datum for use offline: EPSG:3855, ..."
        ),
    ] = None
    clear: Annotated[bool, typer.Option("--clear-cache", help="Remove all parts of archives on this machine.")] = False


def dem_command(
    ground: GroundOptions,
    source: SourceOptions,
    reading: ReadingOptions,
    output: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="GeoTIFF to write, heights above the WGS 84 ellipsoid (.tif); default: only fetch.",
        ),
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Fetch the elevation model of a place, of images or of an extent from an open archive; without any, list them.

    The parts stay on this machine: --dem NAME of the other commands then needs no network.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        asked = [name for name in ("place", "files", "bounds") if getattr(ground, name)]
        _check(ground, source, asked, output)
        content: dict[str, Any] = {}
        if source.clear:
            content |= _clear()
        if source.geoid is not None:
            content |= _install(source)
        if asked:
            content |= _fetch(ground, source, reading, output)
        elif not content:
            content |= _list(as_json)
        content |= _cache()
        if as_json:
            print_json("dem", {"inputs": inputs, **content})


def as_place(word: str) -> str:
    """A place in the southern hemisphere, which starts like an option, with a letter instead of its sign."""
    found = _PLACE.fullmatch(word)
    return word if found is None else f"{found[1]}S,{found[2]}"


def _check(ground: GroundOptions, source: SourceOptions, asked: list[str], output: pathlib.Path | None) -> None:
    if len(asked) > 1:
        raise UserError("give one of LAT,LON, --for FILE and --bounds EDGES.")
    if ground.radius is not None and not ground.place:
        raise UserError(f"--radius {ground.radius:g} applies to LAT,LON; leave it out.")
    if ground.radius is not None and not 0.0 < ground.radius <= 200_000.0:
        raise UserError(f"--radius {ground.radius:g}: must be above 0 m, and at most 200000 m.")
    if ground.scene is not None and not ground.files:
        raise UserError(f"--scene {ground.scene} applies to --for FILE; a scene alone is --for {ground.scene}.")
    if output is not None:
        if not asked:
            raise UserError(f"--output {output}: say for which ground: LAT,LON, --for FILE or --bounds EDGES.")
        if output.suffix.lower() not in ENDINGS:
            raise UserError(f"--output {output}: {name_says(output)}; use .tif.")
        check_place("--output", output)
        check_no_overwrite("--output", output, [*(ground.files or []), ground.scene])


def _fetch(
    ground: GroundOptions, source: SourceOptions, reading: ReadingOptions, output: pathlib.Path | None
) -> dict[str, Any]:
    from jaxgeo._checks import enable_x64
    from jaxgeo.cli._compiler import compile_quickly

    enable_x64()
    options = DemOptions(
        vertical_datum=source.vertical_datum,
        dem_bounds=ground.bounds or (_around(ground) if ground.place else None),
        mirror=source.mirror,
        proxy=source.proxy,
        offline=source.offline or None,
    )
    if ground.files:
        compile_quickly()
    found = fetch(source.archive, options, lambda: _view(ground, reading))
    west, south, east, north = found.bounds
    said = (
        f"{source.archive}: {south:.4f} to {north:.4f} deg north, {west:.4f} to {east:.4f} deg east, heights above "
        f"{found.datum}"
    )
    told: dict[str, Any] = {}
    if output is not None:
        from jaxgeo.io.archives import write_dem

        with working("writing the elevation model"), translate_dem_errors():
            rows, cols = write_dem(output, found)
        where = said.rpartition(", heights")[0]
        said = f"written: {output}: {rows} x {cols} posts, {where}, heights above the WGS 84 ellipsoid"
        told = {"output": f"{output}", "shape": [rows, cols]}
    print_note(said)
    return told


def _around(ground: GroundOptions) -> str:
    """Edges around the place, as for --dem-bounds."""
    lat, lon = _lat_lon(str(ground.place))
    radius = RADIUS if ground.radius is None else ground.radius
    down = radius / METRES_PER_DEGREE
    across = min(down / max(math.cos(math.radians(lat)), 1e-3), 179.0)
    south, north = max(lat - down, -90.0), min(lat + down, 90.0)
    west, east = ((edge + 180.0) % 360.0 - 180.0 for edge in (lon - across, lon + across))
    return f"{west:.9f},{south:.9f},{east:.9f},{north:.9f}"


def _lat_lon(text: str) -> tuple[float, float]:
    parts = [_degrees(part, letters) for part, letters in zip(text.split(","), ("NS", "EW"), strict=False)]
    if len(parts) != 2 or text.count(",") != 1 or None in parts:
        raise UserError(f"{text!r}: expected LAT,LON in deg, e.g. 36.31,-84.25 or 36.31N,84.25W.")
    lat, lon = (float(part) for part in parts if part is not None)
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        raise UserError(f"{text!r}: expected LAT,LON in deg, latitudes from -90 to 90; is it LON,LAT?")
    return lat, lon


def _degrees(text: str, letters: str) -> float | None:
    text = text.strip().upper()
    sign = -1.0 if text.endswith(letters[1]) else 1.0
    number = number_in(text.rstrip(letters))
    return None if number is None else sign * number


def _view(ground: GroundOptions, reading: ReadingOptions) -> View:
    from jaxgeo.io import read_observations
    from jaxgeo.io.archives import view_of

    files = ground.files or []
    with reading_files(files) as progress:
        observed = read_observations(files, scene=ground.scene, progress=progress, **reading.known_arguments)
    print_unread(observed.unread.values())
    return view_of(observed, whole=True)


def _install(source: SourceOptions) -> dict[str, Any]:
    from jaxgeo.io.archives import fetch_geoid

    if source.offline:
        raise UserError("--geoid needs the network; leave --offline out.")
    assert source.geoid is not None
    with working("fetching the geoid grid"), translate_dem_errors():
        files = fetch_geoid(source.geoid, mirror=source.mirror, proxy=source.proxy)
    done = ", ".join(map(str, files)) if files else "PROJ has what it needs already"
    print_message(f"--geoid {source.geoid}: {done}")
    return {"geoid": [str(file) for file in files]}


def _clear() -> dict[str, Any]:
    from jaxgeo.io.archives import DemCache

    with translate_dem_errors():
        cache = DemCache()
        size = cache.clear()
    print_message(f"{cache.folder}: {size / 1e6:.3g} MB removed")
    return {"removed_bytes": size}


def _cache() -> dict[str, Any]:
    from jaxgeo.io.archives import DemCache

    with translate_dem_errors():
        cache = DemCache()
    print_message(
        f"cache: {cache.folder}, {cache.size() / 1e6:.3g} of at most {cache.largest / 1e6:.4g} MB (JAXGEO_DEM_CACHE, "
        f"JAXGEO_DEM_CACHE_SIZE)"
    )
    return {"cache": {"folder": str(cache.folder), "bytes": cache.size(), "largest_bytes": cache.largest}}


def _list(as_json: bool) -> dict[str, Any]:
    from jaxgeo.io.archives import ARCHIVES

    rows = [
        {"name": one.name, "title": one.title, "datum": one.datum, "licence": one.licence, "address": one.base}
        for one in ARCHIVES.values()
    ]
    if not as_json:
        for row in rows:
            said = f"{row['name']:<14} {row['title']}; heights above {row['datum']}"
            Console().print(said, highlight=False, markup=False, soft_wrap=True)
            Console().print(f"{'':<15}licence: {row['licence']}", highlight=False, markup=False, soft_wrap=True)
    return {"archives": rows}
