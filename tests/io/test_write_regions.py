"""Regions and probability maps as files: read back by other libraries they are where they were, and sum to the share.

Held against: shapely and the standard library (GeoJSON, KML), GDAL (GeoPackage, GeoTIFF).
"""

from __future__ import annotations

import json
import math
import pathlib
import re
import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pyproj
import pytest
import rasterio
import shapely
from pyogrio import raw

from jaxgeo.io import write_probability_map, write_region
from tests.support.clouds import cloud, normal, two_hills

KML = {"k": "http://www.opengis.net/kml/2.2"}


@pytest.fixture(scope="module")
def found():
    return cloud(two_hills(5000, seed=1), lost=250).probability_map()


@pytest.fixture(scope="module")
def region(found):
    return found.region(0.9)


def test_geojson_holds_the_region_and_its_pieces(region, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "region.geojson"
    write_region(path, region, attributes=[{"name": "target 3"}])
    whole, *pieces = json.loads(path.read_text(encoding="utf-8"))["features"]
    assert len(pieces) == len(region.modes) == 2
    shape = shapely.geometry.shape(whole["geometry"])
    assert shape.symmetric_difference(region.polygon).area < 1e-6 * shape.area
    assert all(part.exterior.is_ccw for part in shape.geoms)
    row = whole["properties"]
    assert row["kind"] == "highest-density region of samples, no ellipse"
    assert (row["probability"], row["confidence"], row["pieces"], row["name"]) == (0.9, 0.95, 2, "target 3")
    assert row["area_m2"] == pytest.approx(region.area)
    assert row["share_without_ground"] == pytest.approx(250 / 5250)
    assert row["words"] == region.words
    assert row["share_low"] < row["share"] < row["share_high"]
    for piece, mode in zip(pieces, region.modes, strict=True):
        one = piece["properties"]
        assert one["kind"] == "piece of a highest-density region of samples, no ellipse"
        assert (one["share"], one["share_low"], one["share_high"]) == pytest.approx(tuple(mode.share))
        assert one["words"] == mode.words
        assert (one["distance_m"], one["azimuth_deg"]) == pytest.approx((mode.distance, math.degrees(mode.azimuth)))
        assert shapely.geometry.shape(piece["geometry"]).area == pytest.approx(mode.polygon.area, rel=1e-6)


def test_geopackage_is_in_the_crs_that_was_asked_for(found, region, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "regions.gpkg"
    write_region(path, [region, found.region(0.5)], crs="EPSG:25832")
    meta, _, shapes, _ = raw.read(path)
    crs = pyproj.CRS(meta["crs"])
    assert crs.to_epsg() == 25832
    assert len(shapes) == 2 + len(region.modes) + len(found.region(0.5).modes)
    to_map = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    expected = shapely.transform(region.polygon, lambda at: np.stack(to_map.transform(*at.T), axis=-1))
    assert shapely.from_wkb(shapes[0]).symmetric_difference(expected).area < 1e-6 * expected.area
    assert expected.area == pytest.approx(region.area, rel=2e-3)  # UTM's scale and the height


def test_kml_names_pieces_by_their_words(region, tmp_path: pathlib.Path) -> None:
    write_region(tmp_path / "region.kml", region)
    write_region(tmp_path / "region.kmz", region)
    text = (tmp_path / "region.kml").read_bytes()
    with zipfile.ZipFile(tmp_path / "region.kmz") as archive:
        assert archive.read("doc.kml") == text
    root = ET.fromstring(text)
    names = [one.text for one in root.findall(".//k:Placemark/k:name", KML)]
    assert names == ["Region, 90 %", *(mode.words for mode in region.modes)]
    assert b"no ellipse" in text
    rings = root.findall(".//k:Placemark[1]//k:outerBoundaryIs//k:coordinates", KML)
    assert len(rings) >= 2
    numbers = np.array([[float(x) for x in at.split(",")] for at in (rings[0].text or "").split()])
    assert shapely.box(*region.polygon.bounds).buffer(1e-8).covers(shapely.MultiPoint(numbers[:, :2]))


def test_a_region_across_the_date_line_is_cut_there(tmp_path: pathlib.Path) -> None:
    across = cloud(normal(2000, [[100.0, 0.0], [0.0, 100.0]], seed=3), place=(10.0, 180.0, 0.0)).region(0.9)
    write_region(tmp_path / "region.geojson", across)
    (feature,) = json.loads((tmp_path / "region.geojson").read_text(encoding="utf-8"))["features"]
    shape = shapely.geometry.shape(feature["geometry"])
    assert len(shape.geoms) == 2
    assert (shape.bounds[0], shape.bounds[2]) == (-180.0, 180.0)
    assert shape.area == pytest.approx(across.polygon.area, rel=1e-6)


@pytest.mark.parametrize(
    "name, how, words",
    [
        ("region.shp", {}, "end in .geojson, .json, .gpkg, .kml, .kmz"),
        ("region.kml", {"crs": "EPSG:25832"}, "KML has longitudes and latitudes"),
        ("region.gpkg", {"crs": "EPSG:1"}, "PROJ does not know"),
        ("region.gpkg", {"attributes": []}, "one mapping for each of 1 regions; got 0"),
        ("region.gpkg", {"attributes": [{"kind": "hill"}]}, "'kind' is one that the file has by itself"),
    ],
)
def test_region_files_that_cannot_be_written_are_refused(region, tmp_path, name: str, how, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        write_region(tmp_path / name, region, **how)
    assert not list(tmp_path.iterdir())


def test_other_objects_are_refused(region, found, tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match="one or more; got none"):
        write_region(tmp_path / "region.gpkg", [])
    with pytest.raises(TypeError, match=r"Sampled\.region"):
        write_region(tmp_path / "region.gpkg", [region.polygon])
    with pytest.raises(TypeError, match=r"Sampled\.probability_map"):
        write_probability_map(tmp_path / "map.tif", region)
    with pytest.raises(ValueError, match="name a coarser resolution"):
        write_probability_map(tmp_path / "map.tif", found, resolution=0.01)


@pytest.mark.parametrize("how", [{}, {"crs": "EPSG:4326", "resolution": 4e-5}], ids=["usual", "coarse"])
def test_probability_map_sums_to_the_share_found_and_its_levels_are_regions(found, tmp_path, how) -> None:
    path = tmp_path / "map.tif"
    raster = write_probability_map(path, found, **how)
    with rasterio.open(path) as data:
        assert data.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        probability, held = data.read(masked=True)
        assert data.shape == raster.shape
        assert math.isnan(data.nodata)
        assert data.descriptions == ("probability", "probability of the smallest region that holds the cell")
        assert float(data.tags()["SUM"]) == pytest.approx(found.found)
        assert data.tags()["SAMPLES"] == "5250"
        to_lonlat = pyproj.Transformer.from_crs(data.crs.to_wkt(), "EPSG:4326", always_xy=True)
        row, col = np.nonzero(held.filled(1.0) <= 0.9)
        lon, lat = to_lonlat.transform(*rasterio.transform.xy(data.transform, row, col))
        area = len(row) * abs(data.transform.a * data.transform.e)
    assert found.found == pytest.approx(5000 / 5250)
    assert probability.sum() == pytest.approx(found.found, rel=1e-5)
    region = found.region(0.9)
    inside = np.mean(shapely.contains_xy(region.polygon, lon, lat))
    assert inside > (0.97 if not how else 0.9)
    if not how:
        assert area == pytest.approx(region.area, rel=0.04)
        assert raster.crs.to_epsg() == 32632


def test_a_map_of_another_kind_of_file_appears_only_when_asked_for(found, tmp_path: pathlib.Path) -> None:
    write_probability_map(tmp_path / "plain.tif", found, cog=False)
    with rasterio.open(tmp_path / "plain.tif") as data:
        assert "LAYOUT" not in data.tags(ns="IMAGE_STRUCTURE")
        assert np.nansum(data.read(1)) == pytest.approx(found.found, rel=1e-5)
