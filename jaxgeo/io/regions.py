"""Highest-density regions as GeoJSON, GeoPackage and KML, and probability maps as GeoTIFFs."""

from __future__ import annotations

import importlib.metadata
import math
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyproj
import shapely
from rasterio.transform import Affine
from scipy import ndimage

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.io._attributes import attribute_rows
from jaxgeo.io._features import Feature
from jaxgeo.io._geopackage import check_vector_driver, one_layer
from jaxgeo.io._kml import Placemark, as_file, kml
from jaxgeo.io._outlines import within_a_turn
from jaxgeo.io.footprints import DRIVERS, IN_KML, checked_map
from jaxgeo.io.map_raster import (
    MOST_CELLS,
    MapRaster,
    Spacing,
    bounds_of,
    checked_crs,
    checked_resolution,
    checked_target,
    in_unit,
    map_of,
    usual_crs,
)
from jaxgeo.io.mapping import FileMap
from jaxgeo.io.ortho_writer import OrthoWriter
from jaxgeo.uncertainty import Mode, ProbabilityMap, Region

KIND = "highest-density region of samples, no ellipse"
PIECE = "piece of a highest-density region of samples, no ellipse"
POINTS = 2**20  # places that are looked up at a time
ABOUT = "Each region is the smallest area that holds the truth with its probability, from samples; it is no ellipse."


def write_region(
    path: str | os.PathLike[str],
    regions: Region | Sequence[Region] | Any,
    *,
    crs: Any = "EPSG:4326",
    attributes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None = None,
) -> None:
    """Write highest-density regions to .geojson, .json, .gpkg, .kml or .kmz.

    `regions` is one or several (`Sampled.region`). Each is a multipolygon, followed by one for each of its pieces if
    there are several. The attribute `kind` is "highest-density region of samples, no ellipse", or "piece of a ...";
    others are `index` (position in `regions`), `probability`, `share` of the samples with its interval `share_low` to
    `share_high` at `confidence`, `area_m2`, `pieces`, `share_without_ground`, and from the fix to the mean of a
    piece's samples `distance_m`, `azimuth_deg`, `rise_m`; `words` says it in a sentence. Outer rings run anticlockwise;
    polygons are cut at the date line.

    - `crs`: anything pyproj takes; KML is always in WGS 84.
    - `attributes`: for each region numbers, texts or None by name, the same names for all.

    The file appears only when complete. Raises `TypeError` for other objects than regions, `ValueError` for a path that
    cannot be written to, no regions, a CRS that is unknown, unsuitable or does not cover them and attributes that do
    not match; `ImportError` for a .gpkg without the extra `gis`; `OSError` where writing fails.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() not in DRIVERS:
        raise ValueError(f"{target}: regions are written to files that end in {', '.join(DRIVERS)}.")
    driver = DRIVERS[target.suffix.lower()]
    check_vector_driver(driver)
    several = [regions] if isinstance(regions, Region) else list(regions)
    if not several:
        raise ValueError(f"{target}: regions must be one or more; got none.")
    for region in several:
        check_is(region, Region, "regions", "Make them with Sampled.region.")
    chart = checked_map(target, crs, driver)
    extra = _checked_attributes(target, attributes, several)
    with destination("regions", target, binary=True) as stream:
        features = []
        for index, region in enumerate(several):
            features.append(Feature(_on_map(target, chart, region.polygon), _row(index, region, None) | extra[index]))
            if len(region.modes) > 1:
                features += [
                    Feature(_on_map(target, chart, mode.polygon), _row(index, region, mode) | extra[index])
                    for mode in region.modes
                ]
        if driver in IN_KML:
            stream.write(as_file(_kml(features), driver))
        else:
            stream.write(one_layer(f"{target}", driver, "regions", features, list(features[0].attributes), chart.crs))


def _row(index: int, region: Region, mode: Mode | None) -> dict[str, Any]:
    """Attributes of a region, or of one of its pieces."""
    share = region.inside if mode is None else mode.share
    return {
        "index": index,
        "kind": KIND if mode is None else PIECE,
        "probability": region.probability,
        "share": share.value,
        "share_low": share.low,
        "share_high": share.high,
        "confidence": region.confidence,
        "area_m2": region.area if mode is None else mode.area,
        "pieces": len(region.modes) if mode is None else None,
        "share_without_ground": region.without_ground.value,
        "distance_m": None if mode is None else mode.distance,
        "azimuth_deg": None if mode is None else math.degrees(mode.azimuth),
        "rise_m": None if mode is None else mode.rise,
        "words": region.words if mode is None else mode.words,
    }


def _checked_attributes(target: pathlib.Path, attributes: Any, regions: Sequence[Region]) -> list[dict[str, Any]]:
    attributes = attribute_rows(f"{target}", attributes, len(regions), "regions")
    given: list[dict[str, Any]] = [{}] * len(regions) if attributes is None else [dict(one) for one in attributes]
    if len(given) != len(regions):
        raise ValueError(
            f"{target}: attributes must be one mapping for each of {len(regions)} regions; got {len(given)}."
        )
    taken = {*_row(0, regions[0], None), "fid", "geom", "geometry"}
    for one in given:
        if one.keys() != given[0].keys():
            raise ValueError(f"{target}: all regions need the same attributes; write None for what is unknown.")
        for name in one:
            if str(name).lower() in taken:
                raise ValueError(f"{target}: the attribute {name!r} is one that the file has by itself; rename it.")
    return given


def _on_map(target: pathlib.Path, chart: Any, polygon: Any) -> Any:
    """The multipolygon in a CRS, cut at its seam."""

    def place(lonlat: np.ndarray) -> np.ndarray:
        return np.stack(chart.way.transform(lonlat[:, 0], lonlat[:, 1])[:2], axis=-1)

    if chart.turn is not None:
        polygon = within_a_turn(polygon, 360.0)
    mapped = shapely.transform(polygon, place)
    if not np.isfinite(shapely.get_coordinates(mapped)).all():
        raise ValueError(f"{target}: a region lies outside what {chart.crs.name!r} maps; choose another crs.")
    return shapely.MultiPolygon(shapely.get_parts(shapely.orient_polygons(mapped)).tolist())


def _kml(features: Sequence[Feature]) -> bytes:
    marks: dict[str, list[Placemark]] = {"Regions": [], "Pieces": []}
    for geometry, row in features:
        is_piece = row["kind"] == PIECE
        name = row["words"] if is_piece else f"{row.get('name') or 'Region'}, {100.0 * row['probability']:g} %"
        marks["Pieces" if is_piece else "Regions"].append(Placemark(name, "area", row, geometry))
    return kml("Highest-density regions", ABOUT, {name: some for name, some in marks.items() if some})


def write_probability_map(
    path: str | os.PathLike[str],
    found: ProbabilityMap | Any,
    *,
    crs: Any = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    cog: bool = True,
) -> MapRaster:
    """Write a probability map (`Sampled.probability_map`) to a GeoTIFF, by default a cloud-optimised one.

    Bands (float32): the probability of each cell, which sums to the share of samples with a fix; and the probability of
    the smallest region that holds the cell, so that cells of at most 0.9 are the 90 % region. Cells without a
    probability are NaN, the nodata value. The tags state the kind, the sum, and the number of samples.

    - `crs`: anything pyproj takes; by default the UTM zone, or UPS, of the fix.
    - `resolution`: cell size, or (across, down), in the unit of that CRS; by default that of the map's cells, or
      coarser if samples lie far apart.

    Returns the raster. Raises `TypeError` for another object, `ValueError` for an unusable path, CRS or resolution, and
    for more than four million cells; `OSError` where writing fails.
    """
    target = checked_target(path, "a map of probabilities")
    check_is(found, ProbabilityMap, "found", "Make it with Sampled.probability_map.")
    raster = _raster(f"{target}", found, crs, resolution)
    probability = _resampled(f"{target}", found, raster)
    bands = np.stack([probability, _held(probability)]).astype(np.float32)
    tags = {
        "KIND": "probability of the truth in each cell, from samples",
        "SUM": f"{found.found:.9g}",
        "SAMPLES": f"{found.count}",
        "SOFTWARE": _software(),
    }
    names = ("probability", "probability of the smallest region that holds the cell")
    with OrthoWriter(target, raster, bands=2, dtype="float32", cog=cog, tags=tags, descriptions=names) as sink:
        sink.write(0, 0, bands, probability > 0.0)
    return raster


def _raster(name: str, found: ProbabilityMap, crs: Any, resolution: Any) -> MapRaster:
    lon, lat = found.lonlat_deg()
    flat = usual_crs(float((lon.mean() + 180.0) % 360.0 - 180.0), float(lat.mean())) if crs is None else crs
    flat = checked_crs(name, flat)
    west, south, east, north = edges = bounds_of(name, flat, (lon, lat))
    if resolution is None:
        size = math.sqrt(math.prod(found.cell_size))
        across, down = in_unit(Spacing(size, "size of a cell", MOST_CELLS, 2), flat, edges)
        coarser = 1.1 * math.sqrt((east - west) / across * ((north - south) / down) / MOST_CELLS)
        across, down = (x * max(1.0, coarser) for x in (across, down))
    else:
        across, down = checked_resolution(name, resolution)
    west, north = across * (math.floor(west / across) - 1), down * (math.ceil(north / down) + 1)
    cols, rows = math.ceil((east - west) / across) + 1, math.ceil((north - south) / down) + 1
    if rows * cols > MOST_CELLS:
        raise ValueError(f"{name}: the map would have {rows} x {cols} cells; name a coarser resolution=.")
    return MapRaster(flat, Affine(across, 0.0, west, 0.0, -down, north), (rows, cols))


def _resampled(name: str, found: ProbabilityMap, raster: MapRaster) -> np.ndarray:
    """Probability (rows, cols): the mean density at places within each cell, scaled to the same sum."""
    mapping = map_of(name, raster)
    metres = _cell_metres(mapping, raster)
    parts = min(max(2, math.ceil(2.0 * max(metres) / min(found.cell_size))), 16)
    inner = np.stack(np.meshgrid(*[(np.arange(parts) + 0.5) / parts - 0.5] * 2), axis=-1).reshape(-1, 2)
    cells = np.argwhere(_near(found, mapping, raster, 1 + math.ceil(max(found.cell_size) / min(metres))))
    probability = np.zeros(raster.shape)
    step = max(1, POINTS // len(inner))
    for first in range(0, len(cells), step):
        some = cells[first : first + step]
        row, col = (some[:, None] + inner).reshape(-1, 2).T
        density = found.density_at(*mapping.lonlat(row, col)).reshape(len(some), -1)
        probability[tuple(some.T)] = density.mean(axis=1)
    total = probability.sum()
    if not total > 0.0:
        raise ValueError(f"{name}: no cell has a probability; name a finer resolution= than {raster.transform.a:g}.")
    return probability * (found.found / total)


def _near(found: ProbabilityMap, mapping: FileMap, raster: MapRaster, reach: int) -> np.ndarray:
    """Whether a cell (rows, cols) is within `reach` cells of one with a probability."""
    place = np.stack(mapping.rowcol(*found.lonlat_deg()), axis=-1)
    place = np.round(place[np.isfinite(place).all(axis=1)]).astype(int)
    place = place[((place >= 0) & (place < raster.shape)).all(axis=1)]
    near = np.zeros(raster.shape, bool)
    near[tuple(place.T)] = True
    return ndimage.maximum_filter(near, 2 * reach + 1)


def _cell_metres(mapping: FileMap, raster: MapRaster) -> tuple[float, float]:
    """Size of a raster's cell in m, (down, across), at its centre."""
    row, col = (n / 2.0 for n in raster.shape)
    lon, lat = mapping.lonlat(np.array([row, row + 1.0, row]), np.array([col, col, col + 1.0]))
    geod = pyproj.Geod(ellps="WGS84")
    _, _, size = geod.inv([lon[0]] * 2, [lat[0]] * 2, lon[1:], lat[1:])
    return float(size[0]), float(size[1])


def _held(probability: np.ndarray) -> np.ndarray:
    """Sum of the probabilities of the cells that are at least as probable; NaN where there is none."""
    flat = probability.ravel()
    order = np.argsort(flat)[::-1]
    held = np.empty(len(flat))
    held[order] = np.cumsum(flat[order])
    return np.where(probability > 0.0, held.reshape(probability.shape), np.nan)


def _software() -> str:
    try:
        return f"jaxgeo {importlib.metadata.version('jaxgeo')}"
    except importlib.metadata.PackageNotFoundError:
        return "jaxgeo"
