"""Options for the cells of a raster on a map: CRS, bounds and cell size."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, ClassVar

import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import numbers_in
from jaxgeo.cli._options import WRITING, OptionGroup


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapCells(OptionGroup):
    """Where the cells of a raster are."""

    panel: ClassVar[str | None] = WRITING

    crs: Annotated[
        str | None,
        typer.Option("--crs", metavar="CRS", help='CRS of the file: "EPSG:32616", ... (default: UTM zone).'),
    ] = None
    bounds: Annotated[
        str | None,
        typer.Option(
            "--bounds", metavar="EDGES", help="WEST,SOUTH,EAST,NORTH in units of --crs (default: the visible ground)."
        ),
    ] = None
    resolution: Annotated[
        str | None,
        typer.Option(
            "--resolution", metavar="SIZE", help="Cell size in units of --crs, or ACROSS,DOWN (default: the GSD)."
        ),
    ] = None

    @property
    def placed(self) -> dict[str, Any]:
        """The arguments `crs`, `bounds` and `resolution` of a raster. Raises `UserError`."""
        edges, size = None, None
        if self.bounds is not None:
            edges = tuple(numbers_in("--bounds", self.bounds, (4,), "WEST,SOUTH,EAST,NORTH"))
            if self.crs is None:
                raise UserError(f"--bounds {self.bounds}: give the CRS of the bounds with --crs.")
        if self.resolution is not None:
            sizes = tuple(numbers_in("--resolution", self.resolution, (1, 2), "one size, or ACROSS,DOWN"))
            size = sizes[0] if len(sizes) == 1 else sizes
        return {"crs": self.crs, "bounds": edges, "resolution": size}
