"""Index of rasters in a folder: STAC items, their collection, and a VRT mosaic."""

from __future__ import annotations

import json
import math
import os
import pathlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from jaxgeo._parallel import Work
from jaxgeo._partial import partial_file
from jaxgeo.cluster.parts import Parts, PartsFailed, Run
from jaxgeo.io.map_raster import MapRaster, outline_of, raster_with
from jaxgeo.io.vrt_writer import Bands, MosaicFile, write_vrt

COLLECTION, ITEMS, MOSAIC = "collection.json", "items.json", "mosaic"
STATUS, CELLS, KNOWN = "jaxgeo:status", "jaxgeo:cells_by_status", "jaxgeo:cells_with_accuracy"  # properties of items
# A time that is not known lies between these; STAC has no word for it, and some readers no earlier time.
EARLIEST, LATEST = (datetime(year, 1, 1, tzinfo=UTC) for year in (1900, 2100))
EXTENSIONS = (
    "https://stac-extensions.github.io/projection/v1.1.0/schema.json",
    "https://stac-extensions.github.io/raster/v1.1.0/schema.json",
)
STAC_VERSION = "1.1.0"
COG = "image/tiff; application=geotiff; profile=cloud-optimized"
TIFF = "image/tiff; application=geotiff"


def write_item(
    path: pathlib.Path,
    assets: Mapping[str, tuple[str, Bands]],
    raster: MapRaster | None,
    properties: Mapping[str, Any],
    taken: datetime | None,
    *,
    cog: bool,
) -> None:
    """Write the STAC item of files in its folder: `assets` are (file, bands) by key, `raster` the cells of all.

    Without a raster the item has no place. The file appears only when complete.
    """
    geometry, box, own = None, None, {}
    if raster is not None:
        geometry, box = outline_of(f"{path}", raster)
        code = raster.crs.to_epsg()
        own = {"proj:epsg": code} if code else {"proj:epsg": None, "proj:wkt2": raster.crs.to_wkt()}
        own |= {"proj:shape": list(raster.shape), "proj:transform": [*map(float, raster.transform[:6]), 0.0, 0.0, 1.0]}
    span = {} if taken is not None else {"start_datetime": _as_time(EARLIEST), "end_datetime": _as_time(LATEST)}
    when = {**span, "datetime": None if taken is None else _as_time(taken)}
    files = {
        key: {
            "href": f"./{file}",
            "type": COG if cog else TIFF,
            "raster:bands": [_band(bands, number) for number in range(bands.count)],
            "roles": ["data"],
        }
        for key, (file, bands) in assets.items()
    }
    item = {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": list(EXTENSIONS) if raster is not None else [],
        "id": path.stem,
        "geometry": geometry,
        **({} if box is None else {"bbox": list(box)}),
        "properties": {**own, **properties, **when},
        "links": [_link(relation, COLLECTION, "application/json") for relation in ("root", "parent", "collection")],
        "assets": files,
        "collection": path.parent.name,
    }
    write_json(path, item)


def _as_time(when: datetime) -> str:
    return when.astimezone(UTC).isoformat().replace("+00:00", "Z")


def _link(relation: str, name: str, kind: str) -> dict[str, str]:
    return {"rel": relation, "href": f"./{name}", "type": kind}


def _band(bands: Bands, number: int) -> dict[str, Any]:
    nodata = None if bands.nodata is None else "nan" if np.isnan(bands.nodata) else bands.nodata
    told = {"data_type": bands.dtype, "nodata": nodata}
    told |= {"description": bands.names[number]} if bands.names else {}
    told |= {"unit": bands.units[number]} if bands.units and bands.units[number] else {}
    return {name: value for name, value in told.items() if value is not None}


def read_json(path: pathlib.Path) -> Any:
    """Content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def write_json(path: pathlib.Path, content: Any) -> None:
    """Write a JSON file that appears only when complete."""
    with partial_file(path) as partial:
        partial.write_text(json.dumps(content, ensure_ascii=False, indent=1), encoding="utf-8")
        os.replace(partial, path)


def compute_and_list(
    parts: Parts,
    given: Mapping[str, Any],
    work: Work,
    client: Any,
    progress: bool,
    finish: Callable[[Sequence[str]], object],
    count_of: Callable[[Any], int] = lambda _: 1,
) -> Run:
    """`Parts.compute` of missing parts; `finish`, which lists parts, is called with those that are whole even if others
    failed. Raises `PartsFailed`."""
    try:
        return parts.compute(given, work, client, progress, finish, count_of)
    except PartsFailed:
        finish([name for name in parts.names if (parts.folder / name).exists()])
        raise


def write_catalogue(folder: pathlib.Path, items: Sequence[str], description: str) -> list[Any]:
    """Write the collection of all items, by file name, and all of them as one feature collection; returns them."""
    each = [read_json(folder / name) for name in items]
    boxes = [one["bbox"] for one in each if one.get("bbox")]
    times = sorted(_times(each)) or [EARLIEST, LATEST]
    links = [_link("root", COLLECTION, "application/json")]
    collection = {
        "type": "Collection",
        "id": folder.name,
        "stac_version": STAC_VERSION,
        "description": description,
        "links": links + [_link("item", name, "application/geo+json") for name in items],
        "extent": {
            "spatial": {"bbox": [_around(boxes)]},
            "temporal": {"interval": [[_as_time(times[0]), _as_time(times[-1])]]},
        },
        "license": "other",
    }
    write_json(folder / ITEMS, {"type": "FeatureCollection", "features": each})
    write_json(folder / COLLECTION, collection)
    return each


def statuses_of(run: Run) -> dict[str, int]:
    """Count of each status by name of all frames of a run, or of all cells of an accuracy map, earlier ones too."""
    counts: Counter[str] = Counter()
    for path in (run.folder / name for name in run.parts):
        if path.suffix == ".parquet":
            from pyarrow import parquet

            counts.update(parquet.read_table(path, columns=["status"])["status"].to_pylist())
        else:
            told = read_json(path.with_suffix(".json"))["properties"]
            counts.update({told[STATUS]: 1} if STATUS in told else told[CELLS])
    return dict(counts)


def _times(items: Sequence[Any]) -> list[datetime]:
    """Known times of items."""
    found = [one["properties"].get("datetime") for one in items]
    return [datetime.fromisoformat(one) for one in found if one]


def _around(boxes: Sequence[Sequence[float]]) -> list[float]:
    """The box of boxes (west, south, east, north) in deg; of all the Earth without any, or where some cross 180 deg."""
    if not boxes or any(west > east for west, _, east, _ in boxes):
        return [
            -180.0,
            min([box[1] for box in boxes], default=-90.0),
            180.0,
            max([box[3] for box in boxes], default=90.0),
        ]
    west, south, east, north = np.array(boxes).T
    return [float(west.min()), float(south.min()), float(east.max()), float(north.max())]


def mosaic_file(item: Mapping[str, Any], asset: str, crs: Any) -> tuple[MosaicFile, Bands] | None:
    """The file of an asset, and its bands, as an item tells them; None for an item without it."""
    if asset not in item["assets"]:
        return None
    own, place = item["assets"][asset], item["properties"]
    first, each = own["raster:bands"][0], own["raster:bands"]
    nodata = first.get("nodata")
    nodata = math.nan if nodata == "nan" else nodata  # one NaN for all, which is equal to itself as a part of a key
    names, units = (tuple(one.get(key, "") for one in each) for key in ("description", "unit"))
    bands = Bands(len(each), first["data_type"], nodata, names if any(names) else (), units if any(units) else ())
    raster = raster_with(crs, place["proj:transform"][:6], place["proj:shape"])
    return MosaicFile(own["href"], raster), bands


def write_mosaics(
    folder: pathlib.Path,
    files: Sequence[tuple[MosaicFile, Bands]],
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write a VRT of all files: `mosaic.vrt`; those with other bands than the first go to `mosaic-2.vrt`, and so on."""
    kinds: dict[Bands, list[MosaicFile]] = {}
    for file, bands in files:
        kinds.setdefault(bands, []).append(file)
    for number, (bands, some) in enumerate(kinds.items(), 1):
        name = MOSAIC if number == 1 else f"{MOSAIC}-{number}"
        write_vrt(folder / f"{name}.vrt", some, bands, tags)
