"""Styles of fixes and outlines for QGIS: a .qml file, and the table layer_styles of a GeoPackage."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from xml.etree import ElementTree as ET

NAME = "jaxgeo"
DOCTYPE = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
POINT, AREA = "geometry_type($geometry) = 'Point'", "geometry_type($geometry) = 'Polygon'"
MARKER = {"name": "circle", "size": "2.4", "size_unit": "MM", "outline_color": "30,30,30,255", "outline_width": "0.2"}
OUTLINE = {"style": "no", "outline_width": "0.5", "outline_width_unit": "MM", "outline_style": "solid"}
RULES = (  # label, filter, kind of symbol, its layer, the properties of that
    ("fix", f"{POINT} AND \"status\" = 'hit'", "marker", "SimpleMarker", MARKER | {"color": "255,200,0,255"}),
    ("fix with a warning", f"{POINT} AND \"status\" <> 'hit'", "marker", "SimpleMarker",
     MARKER | {"color": "255,80,0,255"}),
    ("outline", AREA, "fill", "SimpleFill", OUTLINE | {"color": "255,200,0,60", "outline_color": "255,200,0,255"}),
)  # fmt: skip
# The table as QGIS creates it.
TABLE = """
CREATE TABLE layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256), f_table_schema TEXT(256),
    f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
    useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30),
    update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
)
"""


def qml() -> str:
    """A style of points by their status and of outlines without a fill, for layers of either."""
    root = ET.Element("qgis", version="3.16.0", styleCategories="Symbology")
    renderer = ET.SubElement(
        root, "renderer-v2", type="RuleRenderer", symbollevels="0", forceraster="0", enableorderby="0"
    )
    rules = ET.SubElement(renderer, "rules", key="root")
    symbols = ET.SubElement(renderer, "symbols")
    for k, (label, condition, kind, layer, properties) in enumerate(RULES):
        ET.SubElement(rules, "rule", key=f"rule{k}", symbol=f"{k}", label=label, filter=condition)
        symbol = ET.SubElement(symbols, "symbol", type=kind, name=f"{k}", alpha="1", clip_to_extent="1", force_rhr="0")
        drawn = ET.SubElement(symbol, "layer", {"class": layer, "enabled": "1", "locked": "0", "pass": "0"})
        for key, value in properties.items():
            ET.SubElement(drawn, "prop", k=key, v=value)
    ET.indent(root, " ")
    return DOCTYPE + ET.tostring(root, encoding="unicode") + "\n"


def add_layer_styles(base: sqlite3.Connection, layers: Iterable[str]) -> None:
    """Add the style to a GeoPackage as the default of its layers."""
    base.execute(TABLE)
    text = qml()
    for layer in layers:
        (column,) = base.execute(
            "SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?", (layer,)
        ).fetchone()
        base.execute(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, styleName, "
            "styleQML, styleSLD, useAsDefault, description, owner) VALUES ('', '', ?, ?, ?, ?, '', 1, ?, '')",
            (layer, column, NAME, text, "Points by status, outlines without a fill"),
        )
    base.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        "VALUES ('layer_styles', 'attributes', 'layer_styles', '', 0)"
    )
    base.commit()
