"""Registration of images to a map for `jaxgeo adjust --reference`."""

from __future__ import annotations

import dataclasses
import math
import pathlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import checked_sigma
from jaxgeo.cli._option_names import translate_reach_errors
from jaxgeo.cli._options import Compared, OptionGroup
from jaxgeo.cli._register_inputs import DEM_CORRELATION
from jaxgeo.cli._screen import print_note, progress_bar

if TYPE_CHECKING:
    from jaxgeo.io.reach import Reach
    from jaxgeo.ties import MapControl, Views


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapOptions(OptionGroup):
    """The map, its error, and the images that are registered to it."""

    reference: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--reference",
            metavar="FILE",
            help="Orthoimage of the same area: images are registered to it too, and ties carry it to the others.",
        ),
    ] = None
    reference_sigma: Annotated[
        float | None,
        typer.Option(
            "--reference-sigma",
            metavar="METRES",
            help="Position sigma of the whole reference, m (default: one cell). Images do not show it.",
        ),
    ] = None
    register: Annotated[
        list[str] | None,
        typer.Option(
            "--register", metavar="IMAGE", help="Image to register to --reference (repeatable; default: all)."
        ),
    ] = None

    def check(self) -> None:
        """Raises `UserError` for options that need --reference, and a wrong sigma."""
        if self.reference is None:
            for name, value in (("--reference-sigma", self.reference_sigma), ("--register", self.register)):
                if value:
                    raise UserError(f"{name} is for images that are registered; give --reference FILE too.")
        elif self.reference_sigma is not None:
            checked_sigma("--reference-sigma", self.reference_sigma)


@dataclasses.dataclass(frozen=True)
class OnMap:
    """The control by a map, None if no image is registered, with the outcome of each image by name, and assumptions."""

    control: MapControl | None
    outcomes: dict[str, str]
    assumed: list[str]


def rows_to_register(views: Views, given: MapOptions) -> list[int]:
    """Rows of the images to register. Raises `UserError` for a name that is not there."""
    names = [str(name) for name in views.name]
    if not given.register:
        return list(range(len(names)))
    for name in given.register:
        if name not in names:
            some = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
            raise UserError(f"--register {name}: there is no such image; there are {some}.")
    return [row for row, name in enumerate(names) if name in given.register]


def on_map(
    views: Views,
    rows: list[int],
    read: Callable[[int], tuple[Any, Any]],
    errors: list[Any],
    terrain: Any,
    dem_sigma: float,
    given: MapOptions,
    reach: Reach,
    measure: Compared = Compared.grey,
) -> OnMap:
    """Registrations of images by `rows`, whose values and masks `read` gives.

    Half the variance of the terrain's height is common to all images, half correlated over 500 m, as in
    `jaxgeo register`.
    """
    from jaxgeo.io import read_orthoimage_and_report
    from jaxgeo.register import TieErrors, register_image
    from jaxgeo.ties import MapControl
    from jaxgeo.uncertainty import ErrorModel, sources

    assert given.reference is not None
    with translate_reach_errors():
        reference, _ = read_orthoimage_and_report(
            given.reference, allow_remote=reach.remote, allow_outside=reach.outside
        )
    shift, assumed = given.reference_sigma, []
    if shift is None:
        shift = reference.ground_sampling
        assumed.append(f"reference position sigma: {shift:.3g} m, one cell (--reference-sigma)")
    half = dem_sigma / math.sqrt(2.0)
    field = sources.TerrainField.of_variograms(gaussian=[(half, DEM_CORRELATION)])
    tie_errors = TieErrors(shift=shift, terrain_field=field)
    ground = sources.TerrainHeight.from_metres(half)
    of_ground = sources.TerrainHeight, sources.TerrainField, sources.TerrainHeightRaster
    registered, outcomes = {}, {}
    with progress_bar() as bar:
        for row in bar.track(rows, description="registering to the map"):
            name, exposure = str(views.name[row]), views.exposure[row]
            stated = getattr(errors[row], "sources", errors[row])
            model = ErrorModel((*(one for one in stated if not isinstance(one, of_ground)), ground))
            image, known = read(row)
            try:
                found = register_image(
                    exposure, image, reference, terrain, model, tie_errors, known=known, measure=measure.value
                )
            except ValueError as error:
                raise UserError(f"{name}: registration to {given.reference} failed: {error}") from error
            outcomes[name] = found.outcome.name
            if found.accepted:
                registered[name] = found
            else:
                print_note(f"not registered: {name}: {found.outcome.message}")
    return OnMap(MapControl.of(views, registered, terrain) if registered else None, outcomes, assumed)
