"""`jaxgeo accuracy-map`: accuracy of every place on the ground of an image, as GeoTIFF."""

from __future__ import annotations

import dataclasses
import pathlib
import time
from collections import Counter
from typing import Annotated, Any, ClassVar

import numpy as np
import typer

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._cluster import PartsOptions, print_missing, report_failed_parts
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._far_crs import note_far_crs
from jaxgeo.cli._locate_inputs import LocateInputs, read_inputs
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions, Refraction
from jaxgeo.cli._map_cells import MapCells
from jaxgeo.cli._option_names import translate_cell_errors
from jaxgeo.cli._options import SEEN, SURE, WRITING, OptionGroup, Probability
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import bars_on_stderr, print_counts, print_message, print_written
from jaxgeo.status import Status

SAMPLES = 2000  # of a cell


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImageOptions(OptionGroup):
    """The exposure of a map."""

    panel: ClassVar[str | None] = SEEN

    file: Annotated[
        pathlib.Path | None,
        typer.Argument(metavar="FILE", help="An image or other file that jaxgeo locate reads; or a scene."),
    ] = None
    scene: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--scene",
            metavar="FILE",
            help="Scene file (TOML): camera, gimbal, mount and pose; also for a FILE without a camera.",
        ),
    ] = None
    exposure: Annotated[
        str | None, typer.Option("--exposure", metavar="NAME", help="The exposure of a FILE of several.")
    ] = None

    @property
    def observed(self) -> ObservationOptions:
        """As the options of `jaxgeo locate`."""
        files = None if self.file is None else [self.file]
        return ObservationOptions(
            files=files, scene=self.scene, exposures=None if self.exposure is None else [self.exposure]
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapOptions(MapCells):
    """The cells of the map."""

    resolution: Annotated[
        str | None,
        typer.Option(
            "--resolution",
            metavar="SIZE",
            help="Cell size in units of --crs, or ACROSS,DOWN (default: the post spacing of --dem).",
        ),
    ] = None
    cog: Annotated[
        bool, typer.Option("--cog", help="Write a cloud-optimised GeoTIFF; with --cluster it always is.")
    ] = False


def accuracy_map_command(
    of_image: ImageOptions,
    *,
    output: Annotated[
        pathlib.Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="GeoTIFF to write (.tif), or FOLDER with --cluster.",
            rich_help_panel=WRITING,
        ),
    ],
    ground: GroundOptions,
    probability: Probability = 0.9,
    samples: Annotated[
        int,
        typer.Option(
            "--samples",
            metavar="COUNT",
            help="Samples of a cell where linear propagation does not hold; 0 for none.",
            rich_help_panel=SURE,
        ),
    ] = SAMPLES,
    sigmas: Sigmas,
    refraction: Refraction = False,
    reading: ReadingOptions,
    cells: MapOptions,
    many: PartsOptions,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Map of accuracy: CE and LE of every place on the ground of an image, as GeoTIFF.

    Bands: circular error and linear error in m, the method used, and the status. With --cluster the map is a
    folder of tiles with a mosaic (mosaic.vrt) and a STAC catalogue.
    """
    given = given_options(locals())
    with report_errors(debug):
        placed = cells.placed
        _ = reading.arguments  # raises for wrong values
        if not 0.0 < probability < 1.0:
            raise UserError(f"--probability {probability:g}: must be between 0 and 1.")
        if samples < 0:
            raise UserError(f"--samples {samples}: must be a number of samples, 0 or more.")
        many.check_parts(many.cluster is not None)
        options = LocateOptions(of_image.observed, ground, reading, sigmas, refraction)
        how = placed | {"probability": probability}
        began = time.perf_counter()
        told, assumed = _computed(options, output, how, samples, cells.cog, many)
        told |= {"seconds": time.perf_counter() - began}
        if as_json:
            print_json("accuracy-map", {"inputs": given | options.inputs, "assumed": assumed, **told})
        else:
            Console(soft_wrap=True).print(_summary(told, probability), highlight=False, markup=False)
        print_written(output)
        counts = told["cells_by_status"]
        print_counts(counts, sum(counts.values()), "cell", _of_seen(counts, told["cells_with_accuracy"], samples))
        if not told["cells_with_accuracy"]:
            print_message("no cell has an accuracy.")
            raise typer.Exit(NO_ANSWER)


def _of_seen(cells: dict[str, int], known: int, samples: int) -> str:
    """What the status `hit` of a cell means, and of how many of these cells the accuracy is unknown."""
    unknown = cells.get(Status.hit.name, 0) - known
    if unknown <= 0:
        return "The image shows it, and its accuracy is known."
    why = ", which need samples (--samples 0 draws none)" if samples == 0 else ""
    return f"The image shows it; the accuracy of {unknown} of them is unknown{why}."


def _summary(told: dict[str, Any], probability: float) -> str:
    """The result in a line."""
    total, parts = sum(told["cells_by_status"].values()), len(told.get("parts", ()))
    tiles = f" in {parts} tile{'s' if parts != 1 else ''}" if parts else ""
    line = f"{told.get('folder', told.get('file'))}: {total} cells{tiles}, {told['cells_with_accuracy']} with accuracy"
    if told.get("median_circular_m") is not None:
        line += f", CE{100.0 * probability:g} {told['median_circular_m']:.3g} m in the median"
    return f"{line}; {told['seconds']:.1f} s"


def _computed(
    options: LocateOptions, output: pathlib.Path, how: dict[str, Any], samples: int, cog: bool, many: PartsOptions
) -> tuple[dict[str, Any], list[str]]:
    """(figures of the map, assumptions); the map is written."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.io.map_raster import checked_target
    from jaxgeo.uncertainty import Sampling

    on_cluster = many.cluster is not None
    if on_cluster:
        many.check_folder(output)
    else:
        checked_target(output, "a map of accuracy")
    compile_quickly(options.has_terrain_field)
    enable_x64()
    inputs = read_inputs(options, True, None if on_cluster else output, on_disk=on_cluster, whole=True)
    row = _only_row(inputs)
    note_far_crs(how["crs"], inputs.observed.position)
    observation, errors = inputs.observed.at(row)
    exposure = observation.exposure
    terrain: Any = inputs.grounds if on_cluster and options.ground.level is None else inputs.grounds[0]
    view = exposure.sensor, exposure.motion, terrain, errors
    with bars_on_stderr() as is_shown, translate_cell_errors():
        how |= {"sampling": Sampling(count=samples, progress=is_shown and not on_cluster)}
        how |= {"atmosphere": exposure.atmosphere}
        if not on_cluster:
            from jaxgeo.io import write_accuracy_map

            found = write_accuracy_map(output, *view, cog=cog, **how)
            counts = Counter(Status(int(code)).name for code in np.asarray(found.status).ravel())
            figures = np.stack([np.asarray(found.circular), np.asarray(found.linear)])
            radii = figures[0][np.isfinite(figures).all(axis=0)]
            told = {"file": f"{output}", "cells_by_status": dict(counts), "cells_with_accuracy": radii.size}
            return told | {"median_circular_m": float(np.median(radii)) if radii.size else None}, inputs.assumed
        from jaxgeo.cluster import accuracy_map, statuses_of
        from jaxgeo.cluster.catalogue import KNOWN, read_json

        with many.connected() as client, report_failed_parts():
            run = accuracy_map(output, *view, client=client, progress=many.shows_progress, **how)
        print_missing(run)
        told = {"folder": f"{output}", "parts": list(run.parts), "computed": run.computed}
        items = [read_json((run.folder / name).with_suffix(".json"))["properties"] for name in run.parts]
        told |= {"cells_with_accuracy": sum(one[KNOWN] for one in items)}
        return told | {"cells_by_status": statuses_of(run)}, inputs.assumed


def _only_row(inputs: LocateInputs) -> int:
    """The row of the only exposure. Raises `UserError` for several."""
    observed = inputs.observed
    if len(observed) > 1:
        names = [str(row.get("name")) for row in observed.columns]
        shown = ", ".join(names[:5]) + (" and others" if len(names) > 5 else "")
        raise UserError(
            f"{observed.source}: a map is of one exposure; got {len(names)} ({shown}). Choose one with --exposure NAME."
        )
    return 0
