"""Styles for QGIS: the table layer_styles of a GeoPackage, and a .qml beside GeoJSON; only where asked for.

Held against: the columns of layer_styles that QGIS reads (QgsOgrProvider, "Styles" of its user guide), the requirement
of the GeoPackage standard that a table of attributes is in gpkg_contents, and GDAL, which reads the layers as before.
"""

from __future__ import annotations

import contextlib
import pathlib
import sqlite3
from xml.etree import ElementTree as ET

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.io import write_fixes
from jaxgeo.io._features import Feature
from jaxgeo.io._geopackage import one_layer
from tests.support.made_fixes import LEVEL, made

COLUMNS = ["id", "f_table_catalog", "f_table_schema", "f_table_name", "f_geometry_column", "styleName", "styleQML",
           "styleSLD", "useAsDefault", "description", "owner", "ui", "update_time"]  # fmt: skip


def write(path: pathlib.Path, style: bool = False) -> None:
    write_fixes(path, made(), cov_enu=np.stack([LEVEL] * 3), style=style)


def check_style(text: str) -> None:
    """Each rule draws a symbol that is there, of a kind for its geometry."""
    root = ET.fromstring(text.split("\n", 1)[1])  # after the document type
    assert root.tag == "qgis"
    symbols = {one.get("name"): one for one in root.iter("symbol")}
    rules = list(root.iter("rule"))
    assert len(rules) == len(symbols) == 3
    for rule in rules:
        kind = {"Point": "marker", "Polygon": "fill"}[(rule.get("filter") or "").split("'")[1]]
        assert symbols[rule.get("symbol")].get("type") == kind
    hit = next(rule for rule in rules if "\"status\" = 'hit'" in (rule.get("filter") or ""))
    assert hit.get("label") == "fix"


def test_a_geopackage_has_the_style_of_each_layer(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "fixes.gpkg"
    write(path, style=True)
    with contextlib.closing(sqlite3.connect(path)) as base:
        assert [row[1] for row in base.execute("PRAGMA table_info(layer_styles)")] == COLUMNS
        rows = base.execute(
            "SELECT f_table_name, f_geometry_column, useAsDefault, styleQML FROM layer_styles"
        ).fetchall()
        contents = dict(base.execute("SELECT table_name, data_type FROM gpkg_contents"))
        assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert [row[:3] for row in rows] == [("fixes", "geom", 1), ("ellipses", "geom", 1)]
    assert contents == {"fixes": "features", "ellipses": "features", "layer_styles": "attributes"}
    check_style(rows[0][3])
    plain = tmp_path / "plain.gpkg"
    write(plain)
    for layer in ("fixes", "ellipses"):
        one, other = (pyogrio.read_info(each, layer=layer) for each in (path, plain))
        assert (one["features"], one["fields"].tolist()) == (other["features"], other["fields"].tolist())
    assert "layer_styles" not in pyogrio.list_layers(plain)[:, 0]


def test_a_geopackage_of_one_layer_is_styled_too(tmp_path: pathlib.Path) -> None:
    """As that of footprints."""
    feature = Feature(shapely.box(8.0, 47.0, 8.1, 47.1), {"status": "hit"})
    content = one_layer("a.gpkg", "GPKG", "footprints", [feature], ["status"], pyproj.CRS(4326), style=True)
    path = tmp_path / "a.gpkg"
    path.write_bytes(content)
    with contextlib.closing(sqlite3.connect(path)) as base:
        assert base.execute("SELECT f_table_name FROM layer_styles").fetchall() == [("footprints",)]
    assert pyogrio.read_info(path, layer="footprints")["features"] == 1


@pytest.mark.costly
def test_geojson_has_its_style_beside_it(tmp_path: pathlib.Path) -> None:
    write(tmp_path / "fixes.geojson", style=True)
    check_style((tmp_path / "fixes.qml").read_text(encoding="utf-8"))
    write(tmp_path / "plain.geojson")
    assert not (tmp_path / "plain.qml").exists()


def test_other_files_have_none(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match=r"fixes\.kml: only \.gpkg, \.geojson, \.json have a style for QGIS"):
        write(tmp_path / "fixes.kml", style=True)
    assert not list(tmp_path.iterdir())
    for line in (["-o", str(tmp_path / "fixes.csv")], []):
        refused = CliRunner().invoke(app, ["locate", "a.jpg", "--ground", "1", "--style", *line])
        assert refused.exit_code == 2
        assert "--style needs --output FILE (.gpkg, .geojson, .json)" in refused.stderr
