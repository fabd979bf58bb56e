"""Inputs of `jaxgeo register`: error sources, pixels, checks and output folder."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import pathlib
import shutil
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, NamedTuple

import typer

from jaxgeo._destination import check_no_input
from jaxgeo._interruption import undone_if_stopped
from jaxgeo._partial import hidden_name, left_over
from jaxgeo.cli._common import UserError, check_writable
from jaxgeo.cli._errors import (
    DEM_SIGMA,
    attitude_errors,
    checked_sigma,
    gimbal_errors,
    interior_errors,
    position_errors,
)
from jaxgeo.cli._inputs import check_on_image, numbers_in
from jaxgeo.cli._options import OptionGroup

FILES = ("scene.toml", "ties.geojson", "ortho.tif", "report.json", "registration.png")
OLD = ".old"
DEM_CORRELATION = 500.0  # m, default correlation length of height errors
LEAST_BLOCK = 32  # cells per side; smaller blocks match too many places
PICTURED = 1024  # cells per side of the figure, at most
TILE = 256  # as in registration, to reuse compiled programs


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sigmas(OptionGroup):
    """Standard deviations as typed; None if not given."""

    position: Annotated[
        str | None,
        typer.Option(
            "--position-sigma",
            metavar="SIGMA",
            help="Position standard deviation, m, or NORTH,EAST,DOWN (default: of the image or scene).",
        ),
    ] = None
    attitude: Annotated[
        str | None,
        typer.Option(
            "--attitude-sigma",
            metavar="SIGMA",
            help="Attitude standard deviation, deg, or HEADING,PITCH,ROLL (default: of the image or scene).",
        ),
    ] = None
    gimbal: Annotated[
        str | None,
        typer.Option(
            "--gimbal-sigma",
            metavar="SIGMA",
            help="Gimbal reading standard deviation, deg, or one per axis (default: of the image or scene, or exact).",
        ),
    ] = None
    focal: Annotated[
        str | None,
        typer.Option(
            "--focal-sigma", metavar="SIGMA", help="Also estimate the focal length, with prior sigma 5px, 0.1mm."
        ),
    ] = None
    principal: Annotated[
        str | None,
        typer.Option(
            "--principal-sigma",
            metavar="SIGMA",
            help="Also estimate the principal point, with prior sigma 5px, 0.1mm, or COLUMN,ROWpx.",
        ),
    ] = None
    reference: Annotated[
        float | None,
        typer.Option(
            "--reference-sigma",
            help="Position sigma of the whole reference, m (default: one cell). It cannot be estimated "
            "from one image: the value is your guarantee.",
        ),
    ] = None
    registration: Annotated[
        float,
        typer.Option(
            "--registration-sigma", help="Minimum sigma of a match besides its own, m; increased by residuals."
        ),
    ] = 0.0
    dem: Annotated[float | None, typer.Option("--dem-sigma", help="DEM height standard deviation, m (default 5).")] = (
        None
    )
    dem_correlation: Annotated[
        float | None,
        typer.Option("--dem-correlation", help="Correlation length of DEM errors, m (default 500; 0: uncorrelated)."),
    ] = None


class Errors(NamedTuple):
    """Error sources of the navigation, tie errors, the local part of the DEM height sigma in m, and assumptions."""

    sources: tuple[Any, ...]
    tie_errors: Any
    terrain: float
    assumed: list[str]


def errors_of(sigmas: Sigmas, scene: Any, where: pathlib.Path, cell: float, pitch: float | None = None) -> Errors:
    """Error sources from options, and from the scene for what they leave out.

    `where` is the file of the pose, `cell` the cell size of the reference in m, `pitch` the pixel pitch. Raises
    `UserError`.
    """
    from jaxgeo.register import TieErrors
    from jaxgeo.uncertainty import sources

    stated = () if scene.errors is None else scene.errors.sources
    of = lambda *kinds: [one for one in stated if isinstance(one, kinds)]  # noqa: E731
    position = of(sources.Position) if sigmas.position is None else [position_errors(sigmas.position)]
    attitude = of(sources.Attitude) if sigmas.attitude is None else [attitude_errors(sigmas.attitude)]
    gimbal = of(sources.GimbalAngles)
    if sigmas.gimbal is not None:
        gimbal = [gimbal_errors(sigmas.gimbal, scene.sensor.gimbal, where)]
    for name, found in (("position", position), ("attitude", attitude or gimbal)):
        if not found:
            raise UserError(f"--{name}-sigma is missing, and {where} states none.")
    found: list[Any] = [*position, *attitude, *gimbal]
    if sigmas.focal is not None or sigmas.principal is not None:
        lens = interior_errors(sigmas.focal, sigmas.principal, where, pitch)
        if lens is None:
            raise UserError("--focal-sigma and --principal-sigma are zero: leave out what is exact.")
        found.append(lens)
    assumed = []
    if sigmas.reference is None:
        assumed.append(f"reference position sigma: {cell:.3g} m, one cell (--reference-sigma)")
    if sigmas.dem is None:
        assumed.append(f"DEM height sigma: {DEM_SIGMA:g} m (--dem-sigma)")
    if sigmas.dem_correlation is None and sigmas.dem != 0.0:
        assumed.append(f"correlation length of DEM errors: {DEM_CORRELATION:g} m (--dem-correlation)")
    shift = checked_sigma("--reference-sigma", cell if sigmas.reference is None else sigmas.reference)
    terrain = checked_sigma("--dem-sigma", DEM_SIGMA if sigmas.dem is None else sigmas.dem)
    registration = checked_sigma("--registration-sigma", sigmas.registration)
    length = DEM_CORRELATION if sigmas.dem_correlation is None else sigmas.dem_correlation
    length = checked_sigma("--dem-correlation", length, "a distance")
    half = terrain / math.sqrt(2.0)  # half the variance is common to all heights, half correlated over the length
    if half > 0.0:
        found.append(sources.TerrainHeight.from_metres(half))
    ties = TieErrors(registration=registration, shift=shift)
    if half > 0.0 and length > 0.0:
        field = sources.TerrainField.of_variograms(gaussian=[(half, length)])
        ties = TieErrors(registration=registration, shift=shift, terrain_field=field)
    elif half > 0.0:
        ties = TieErrors(registration=registration, terrain=half, shift=shift)
    return Errors(tuple(found), ties, half, assumed)


def pixels_in(texts: list[str], camera: Any) -> list[list[float]]:
    """Pixels from the command line; the image centre if none. Raises `UserError` for one outside the image."""
    found = [numbers_in("--pixel", text, (2,), "COLUMN,ROW, e.g. --pixel 100,200") for text in texts]
    for text, uv in zip(texts, found, strict=True):
        check_on_image(text, uv, camera)
    return found or [[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]]


def check_search(block: int, probability: float) -> None:
    """Raises `UserError` for search options with which no match could be found."""
    if block < LEAST_BLOCK:
        raise UserError(f"--block {block}: must be at least {LEAST_BLOCK} cells; smaller blocks match too many places.")
    if not 0.5 < probability < 1.0:
        raise UserError(
            f"--probability {probability:g}: must be between 0.5 and 1; with less, most shifts would be outside the "
            f"search window."
        )


def check_folder(folder: pathlib.Path, inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Raises `ValueError` if a result would overwrite an input, `UserError` if the folder cannot be written to; it need
    not exist."""
    results = [folder / name for name in FILES]
    check_no_input("--output", results, inputs)
    check_writable(folder)
    for path in results:
        if path.is_dir():
            raise UserError(f"--output {folder}: {path} is a folder, but a file is to be written there; name another.")


@contextlib.contextmanager
def new_results(folder: pathlib.Path) -> Iterator[None]:
    """Replace the results of an earlier registration once all new ones are written; on failure restore them."""
    for one in left_over(folder, OLD):
        _put_back(one, folder)
    aside = hidden_name(folder / FILES[0], OLD)
    aside.mkdir()
    with undone_if_stopped(lambda: _put_back(aside, folder)):
        _move(folder, aside)
        try:
            yield
        except BaseException:
            _put_back(aside, folder)
            raise
    shutil.rmtree(aside, ignore_errors=True)


def _put_back(aside: pathlib.Path, folder: pathlib.Path) -> None:
    if aside.exists():
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        _move(aside, folder)
        aside.rmdir()


def _move(source: pathlib.Path, target: pathlib.Path) -> None:
    """Move existing results from one folder to another."""
    for name in FILES:
        with contextlib.suppress(FileNotFoundError):
            (source / name).replace(target / name)


class Seen(NamedTuple):
    """The part of a reference an image covers: first (row, col), and shape (rows, cols) in cells."""

    corner: tuple[int, int]
    shape: tuple[int, int]


def seen_part(sensor: Any, shot: Any, terrain: Any, atmosphere: Any, reference: Any) -> Seen | None:
    """The part of a reference an image covers; None without overlap."""
    from jaxgeo.observation import Exposure
    from jaxgeo.register.prediction import window_of
    from jaxgeo.uncertainty.model_inputs import ModelInputs

    look = ModelInputs(Exposure(sensor, shot, 0.0, atmosphere), terrain=terrain)
    window = window_of(look, reference.grid, reference.shape)
    if window is None:
        return None
    return Seen(window[:2], (window[2] - window[0], window[3] - window[1]))


def fixes_of(scene: Any, shot: Any, terrain: Any, errors: Errors, found: Any, pixels: list[list[float]]) -> list[Any]:
    """(pixel, fix from the navigation, fix after registration or None) of each pixel."""
    from jaxgeo.uncertainty import propagate
    from jaxgeo.uncertainty.sharing import PerMeasurement
    from jaxgeo.uncertainty.sources import TerrainHeight

    sigma = errors.terrain
    model = (*errors.sources, TerrainHeight.from_metres(sigma, sharing=PerMeasurement()))
    rows = []
    for uv in pixels:
        direct = propagate(scene.sensor, shot, uv, terrain, model, atmosphere=scene.atmosphere)
        rows.append((uv, direct, found.fix(uv, sigma) if found.accepted else None))
    return rows


def picture_of(
    found: Any, reference: Any, look: tuple[Any, Any, Any, Any], image: Any, errors: Errors, fix: Any
) -> Any:
    """The registration figure; None if image and reference do not overlap. Raises `ImportError` without matplotlib.

    `look` is (sensor, shot, terrain, atmosphere) as given, `image` is (grey values, mask of known pixels).
    """
    from jaxgeo.plot.registration_page import registration_figure
    from jaxgeo.register import Prior
    from jaxgeo.register.places import places_of_blocks
    from jaxgeo.uncertainty import ErrorModel

    sensor, shot, terrain, air = look
    part = seen_part(found.sensor, found.shot, terrain, air, reference)
    if part is None:
        return None
    shown = reference.window(*part.corner, part.shape)
    shown = shown.coarser(max(1, math.ceil(max(part.shape) / PICTURED)))
    before = _rectified(sensor, shot, terrain, air, image, shown)
    after = _rectified(found.sensor, found.shot, found.terrain, air, image, shown) if found.accepted else None
    _, direct, updated = fix
    return registration_figure(
        found,
        shown,
        places=places_of_blocks(found, atmosphere=air) if found.passes else None,
        before=before,
        after=after,
        direct=direct if bool(direct.fix.found) else None,
        updated=updated if updated is not None and bool(updated.fix.found) else None,
        covariance=Prior.of(ErrorModel(errors.sources), errors.tie_errors).covariance,
    )


def _rectified(sensor: Any, shot: Any, terrain: Any, air: Any, image: Any, shown: Any) -> Any:
    from jaxgeo.ortho import rectify

    grey, known = image
    done = rectify(sensor, shot, grey, terrain, shown.grid, shown.shape, known=known, atmosphere=air, tile=TILE)
    return done.orthoimage
