"""Fixes as a dataset of GeoParquet files: parts of one schema, written apart, in any order, by any process."""

from __future__ import annotations

import dataclasses
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxgeo._destination import destination
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io._fix_columns import figures_of, no_figures, plain
from jaxgeo.io._fix_formats import as_parquet
from jaxgeo.io._map_crs import flat_map_crs, map_crs
from jaxgeo.io.fix_files import _extent, _table_of, check_fix_file
from jaxgeo.io.geoid import degrees_of
from jaxgeo.uncertainty import Accuracy

TEXTS = ("status", "status_text", "accuracy_method", "accuracy_text", "mgrs", "vertical_datum", "kind")
OF_ATTRIBUTES = {bool: "bool", int: "int64", float: "double", str: "string"}

Attributes = Sequence[Mapping[str, Any]]


@dataclasses.dataclass(frozen=True)
class FixParts:
    """What all parts of a dataset of fixes have in common: CRS, heights, and types of the columns.

    - `crs`, `heights`, `mgrs`, `ellipses`: as in `write_fixes`; `area`, (west, south, east, north) in deg, selects the
      transformation to the CRS.
    - `probability`: that of the accuracy, or None without.
    - `attributes`: the Arrow type of each attribute.
    - `is_above_takeoff`: as in `write_fixes`.
    """

    crs: Any
    heights: Any
    mgrs: bool
    ellipses: bool
    probability: float | None
    area: tuple[float, float, float, float] | None
    attributes: Mapping[str, str]
    is_above_takeoff: bool = False

    @classmethod
    def of(
        cls,
        near: Geodetic,
        attributes: Attributes,
        *,
        crs: Any = "EPSG:4326",
        heights: Any = None,
        mgrs: bool = False,
        ellipses: bool = True,
        probability: float | None = None,
        is_above_takeoff: bool = False,
    ) -> FixParts:
        """The parts of fixes of n exposures at the positions `near`, with an attribute of each by name.

        Raises as `write_fixes`.
        """
        how: dict[str, Any] = {"mgrs": mgrs, "probability": probability, "is_above_takeoff": is_above_takeoff}
        check_fix_file("fixes.parquet", crs, heights, near, attributes=attributes, **how)
        lat, lon, _ = degrees_of(near)
        kinds = {name: {type(plain(row[name])) for row in attributes} - {type(None)} for name in attributes[0]}
        types = {name: _type_of(found) for name, found in kinds.items()}
        drawn = ellipses and probability is not None
        return cls(crs, heights, mgrs, drawn, probability, _extent(lon, lat), types, is_above_takeoff)

    def write(
        self,
        path: pathlib.Path,
        fixes: Fix,
        accuracy: Accuracy | None,
        index: np.ndarray,
        attributes: Attributes,
        reasons: Sequence[str | None] | None,
    ) -> None:
        """Write a part with n fixes, of the numbers `index` (n,) in the whole. The file appears only when complete.

        Raises as `write_fixes`.
        """
        chart_of = flat_map_crs if self.is_above_takeoff else map_crs
        chart, count = chart_of(f"{path}", self.crs, self.heights, self.area), len(index)
        figures = None
        if self.probability is not None:
            figures = figures_of(f"{path}", fixes, accuracy, None, None, self.probability)
            figures = no_figures(count, self.probability) if figures is None else figures
        how: dict[str, Any] = {"mgrs": self.mgrs, "reasons": reasons, "ellipses": self.ellipses}
        how |= {"is_above_takeoff": self.is_above_takeoff}
        table = _table_of(path, chart, fixes, figures, attributes, **how)
        for row, number in zip(table.rows, index.tolist(), strict=True):
            row["index"] = number
        names = [*table.rows[0], *(["kind"] if self.ellipses else [])]
        types = {name: self.attributes.get(name, "string" if name in TEXTS else "double") for name in names}
        types |= {"index": "int64"}
        with destination("fixes", path, binary=True) as stream:
            stream.write(as_parquet(table, types))


def _type_of(kinds: set[type]) -> str:
    """The Arrow type of values of some types; a text where all are unknown."""
    return next((name for kind, name in reversed(OF_ATTRIBUTES.items()) if kind in kinds), "string")


def write_summary(folder: pathlib.Path, parts: Sequence[str]) -> None:
    """Write `_metadata` and `_common_metadata` of a dataset, with which readers need not open each part."""
    from pyarrow import parquet

    each = []
    for name in parts:
        found = parquet.read_metadata(folder / name)
        found.set_file_path(name)
        each.append(found)
    schema = parquet.read_schema(folder / parts[0])
    parquet.write_metadata(schema, folder / "_common_metadata")
    parquet.write_metadata(schema, folder / "_metadata", metadata_collector=each)
