"""`jaxgeo rectify` of several images: a folder of orthophotos, in this process or on the workers of Dask."""

from __future__ import annotations

import pathlib
import time
from typing import Any

import typer

from jaxgeo.cli._cluster import PartsOptions, print_missing, report_failed_parts
from jaxgeo.cli._common import FAULT, NO_ANSWER, UserError
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._inputs import open_terrain
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._oriented_images import OrientedImages
from jaxgeo.cli._results import print_json
from jaxgeo.cli._screen import print_counts, print_message
from jaxgeo.status import Status

SHOWN = "Its orthophoto is written."
OF_ONE = {"bounds": "--bounds", "like": "--like"}  # options for one image


def rectify_several(
    given: OrientedImages,
    dem: list[str],
    ground: DemOptions,
    output: pathlib.Path,
    wishes: dict[str, Any],
    many: PartsOptions,
    inputs: dict[str, Any] | None,
) -> None:
    """Write a folder of orthophotos; prints the result, or JSON with `inputs`. Raises `UserError`."""
    from jaxgeo._checks import enable_x64
    from jaxgeo._refusals import is_refusal
    from jaxgeo.cluster import rectify_frames, statuses_of

    if given.scene is not None:
        raise UserError(f"--cluster is for several images; --scene {given.scene} has the pose of one. Leave one out.")
    for name, option in OF_ONE.items():
        if wishes.pop(name) is not None:
            raise UserError(f"{option} is for one image; of several, each has its own. Leave it out.")
    wishes.pop("cog")
    folder = many.check_folder(output)
    compile_quickly()
    enable_x64()
    observed, files = given.read()
    terrain = open_terrain(dem, ground)
    began = time.perf_counter()
    with many.connected() as client, report_failed_parts():
        run = rectify_frames(folder, files, observed, terrain, client=client, progress=many.shows_progress, **wishes)
    seconds, counts = time.perf_counter() - began, statuses_of(run)
    print_missing(run)
    if inputs is None:
        written = counts.get(Status.hit.name, 0)
        Console(soft_wrap=True).print(
            f"{folder}: {written} orthophotos of {len(observed)} images, mosaic.vrt, collection.json; {seconds:.1f} s",
            highlight=False,
            markup=False,
        )
    else:
        told = {"folder": f"{folder}", "parts": list(run.parts), "computed": run.computed, "images_by_status": counts}
        print_json("rectify", {"inputs": inputs, "assumed": list(observed.assumed), **told, "seconds": seconds})
    print_counts(counts, len(observed), "image", SHOWN)
    if any(not is_refusal(one.error) for one in observed.unread.values()):
        raise typer.Exit(FAULT)
    if Status.hit.name not in counts:
        print_message("no image has an orthophoto.")
        raise typer.Exit(NO_ANSWER)
