"""Mosaic of `jaxgeo adjust`: options, writing, and its summary."""

from __future__ import annotations

import dataclasses
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from jaxgeo._destination import check_no_input, check_place
from jaxgeo.cli._common import UserError, name_says
from jaxgeo.cli._inputs import numbers_in
from jaxgeo.cli._option_names import translate_cell_errors, translate_reach_errors
from jaxgeo.cli._options import WRITING, OptionGroup
from jaxgeo.cli._screen import print_note, progress_bar

if TYPE_CHECKING:
    from jaxgeo.io.reach import Reach
    from jaxgeo.terrain import AbstractTerrain
    from jaxgeo.ties import Correction, Views


@dataclasses.dataclass(frozen=True, kw_only=True)
class MosaicOptions(OptionGroup):
    """The mosaic and its cells."""

    panel: ClassVar[str | None] = WRITING

    mosaic: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--mosaic",
            metavar="FILE",
            help="Also write a mosaic of the images, rectified on --dem with the adjusted orientations (.tif).",
        ),
    ] = None
    resolution: Annotated[
        str | None,
        typer.Option(
            "--resolution",
            metavar="SIZE",
            help="Cell size of --mosaic in units of --crs, or of its UTM zone, or ACROSS,DOWN (default: the GSD).",
        ),
    ] = None

    def check_options(self, output: pathlib.Path) -> None:
        """Raises `UserError` for a size without a mosaic, wrong values, and a file that cannot be written.

        The folder `output` need not be there yet.
        """
        if self.mosaic is None:
            if self.resolution is not None:
                raise UserError("--resolution is for the cells of a mosaic; give --mosaic FILE too.")
            return
        for one in self._size or ():
            if not 0.0 < one < float("inf"):
                raise UserError(f"--resolution {self.resolution}: sizes must be positive and finite.")
        if self.mosaic.suffix.lower() not in (".tif", ".tiff"):
            raise UserError(f"--mosaic {self.mosaic}: {name_says(self.mosaic)}; use .tif.")
        if self.mosaic.parent.resolve() != output.resolve() or output.exists():
            check_place("--mosaic", self.mosaic)

    @property
    def _size(self) -> list[float] | None:
        if self.resolution is None:
            return None
        return numbers_in("--resolution", self.resolution, (1, 2), "one size, or ACROSS,DOWN")

    def check_no_input(self, read: Sequence[Any]) -> None:
        """Raises `UserError` for a mosaic that would overwrite an input."""
        if self.mosaic is not None:
            check_no_input("--mosaic", [self.mosaic], list(read))

    def check_cells(
        self, views: Views, paths: Sequence[pathlib.Path], terrain: AbstractTerrain, crs: str | None, reach: Reach
    ) -> None:
        """Raises `UserError` for cells that make the mosaic too large, and images that fit in none, before any image is
        matched; by the orientations of the navigation."""
        from jaxgeo.io.mosaic import check_mosaic

        if self.mosaic is None:
            return
        with translate_cell_errors(several=True), translate_reach_errors():
            check_mosaic(self.mosaic, paths, views.exposure, terrain, **self._cells(crs, reach))

    def _cells(self, crs: str | None, reach: Reach) -> dict[str, Any]:
        size = self._size
        return {
            "crs": crs,
            "resolution": None if size is None else size[0] if len(size) == 1 else (size[0], size[1]),
            "allow_remote": reach.remote,
            "allow_outside": reach.outside,
        }

    def write(
        self, found: Correction, paths: Sequence[pathlib.Path], terrain: AbstractTerrain, crs: str | None, reach: Reach
    ) -> dict[str, Any]:
        """Write the mosaic; content of --json. Images that see no ground are printed. Raises as `write_mosaic`."""
        from jaxgeo.io import exposures_of, write_mosaic
        from jaxgeo.observation import Exposure

        assert self.mosaic is not None
        row_of = {str(name): row for row, name in enumerate(found.views.name)}
        rows = [row_of[name] for name in found.names]
        air = [found.views.exposure[row].atmosphere for row in rows]
        name_of = {f"{paths[row]}": name for row, name in zip(rows, found.names, strict=True)}
        exposures = [
            Exposure(one.sensor, one.motion, None, given)
            for one, given in zip(exposures_of(found.adjustment), air, strict=True)
        ]
        with progress_bar() as bar, translate_cell_errors(several=True), translate_reach_errors():
            task = bar.add_task("rectifying", total=None)
            done = write_mosaic(
                self.mosaic,
                [paths[row] for row in rows],
                exposures,
                terrain,
                callback=lambda what, number, total: bar.update(
                    task, completed=number, total=total, description=f"{what} the mosaic"
                ),
                **self._cells(crs, reach),
            )
        for file, reason in done.left_out.items():
            print_note(f"not in the mosaic: {file}: {reason}")
        rows_, cols = done.raster.shape
        return {
            "file": done.path,
            "crs": ":".join(done.raster.crs.to_authority() or ()) or done.raster.crs.name,
            "transform": list(done.raster.transform[:6]),
            "rows": rows_,
            "columns": cols,
            "known": done.known,
            "cells_by_image": {name_of[file]: count for file, count in done.used.items()},
            "left_out": {name_of[file]: reason for file, reason in done.left_out.items()},
        }
