"""`jaxgeo rectify` of several images: a folder of orthophotos, in this process or on the workers of Dask."""

from __future__ import annotations

import pathlib
import time
from typing import Any

import typer

from jaxgeo.cli._cluster import MOST_TOLD, PartsOptions, print_missing, report_failed_parts
from jaxgeo.cli._common import FAULT, NO_ANSWER, UserError
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._far_crs import note_far_crs
from jaxgeo.cli._inputs import open_terrain
from jaxgeo.cli._option_names import as_typed, translate_cell_errors
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._oriented_images import OrientedImages
from jaxgeo.cli._results import print_json
from jaxgeo.cli._screen import print_counts, print_message, print_written
from jaxgeo.status import Status

SHOWN = "Its orthophoto is written."
OF_ONE = {"bounds": "--bounds", "like": "--like"}  # options for one image


def _view(observed: Any) -> Any:
    from jaxgeo.io.archives import view_of

    return view_of(observed, whole=True)


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
    from jaxgeo.cluster.catalogue import COLLECTION, MOSAIC

    if given.scene is not None:
        raise UserError(f"--cluster is for several images; --scene {given.scene} has the pose of one. Leave one out.")
    for name, option in OF_ONE.items():
        if wishes.pop(name) is not None:
            raise UserError(f"{option} is for one image; of several, each has its own. Leave it out.")
    wishes.pop("cog")
    folder = many.check_folder(output)
    compile_quickly()
    enable_x64()
    observed, files = given.on(dem, ground).read()
    note_far_crs(wishes["crs"], observed.position)
    _check_bands(files, wishes["bands"])
    terrain = open_terrain(dem, ground, lambda: _view(observed))
    began = time.perf_counter()
    with many.connected() as client, report_failed_parts(), translate_cell_errors(several=True):
        run = rectify_frames(folder, files, observed, terrain, client=client, progress=many.shows_progress, **wishes)
    seconds, counts = time.perf_counter() - began, statuses_of(run)
    print_missing(run)
    print_written(folder)
    without = _without_orthophoto(run)
    for one in [one for one in without if one["row"] not in observed.unread][:MOST_TOLD]:
        print_message(f"{one['image']}: {one['reason']}")
    if inputs is None:
        written, total = counts.get(Status.hit.name, 0), len(observed)
        beside = [name for name in (f"{MOSAIC}.vrt", COLLECTION) if (folder / name).exists()]
        Console(soft_wrap=True).print(
            f"{folder}: {written} orthophoto{'s' if written != 1 else ''} of {total} image{'s' if total != 1 else ''}"
            f" (.tif, by the names of the images), {', '.join(beside)}; {seconds:.1f} s",
            highlight=False,
            markup=False,
        )
    else:
        told = {"folder": f"{folder}", "parts": list(run.parts), "computed": run.computed, "images_by_status": counts}
        told |= {"without_orthophoto": without}
        print_json(
            "rectify", {"inputs": inputs, "assumed": list(map(as_typed, observed.assumed)), **told, "seconds": seconds}
        )
    print_counts(counts, len(observed), "image", SHOWN)
    if any(not is_refusal(one.error) for one in observed.unread.values()):
        raise typer.Exit(FAULT)
    if Status.hit.name not in counts:
        print_message("no image has an orthophoto.")
        raise typer.Exit(NO_ANSWER)


def _check_bands(files: list[pathlib.Path], bands: list[int] | None) -> None:
    """Raises `UserError` for a band that the first image which can be opened does not have."""
    from jaxgeo.io.errors import ImageError
    from jaxgeo.io.images import opened

    for file in files if bands else []:
        try:
            with opened(f"{file}") as data:
                count = data.count
        except (ImageError, OSError):
            continue
        wrong = next((band for band in bands or () if not 1 <= band <= count), None)
        if wrong is not None:
            raise UserError(f"--band {wrong}: {file} has bands 1 to {count}.")
        return


def _without_orthophoto(run: Any) -> list[dict[str, Any]]:
    """Row, image, status and reason of each image without an orthophoto."""
    from jaxgeo.cluster.catalogue import STATUS, read_json
    from jaxgeo.cluster.orthophotos import IMAGE, REASON

    told = enumerate(read_json(run.folder / name)["properties"] for name in run.parts)
    return [
        {"row": row, "image": one[IMAGE], "status": one[STATUS], "reason": one[REASON]}
        for row, one in told
        if REASON in one
    ]
