"""`jaxgeo study`: what papers print, made again."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable
from typing import Annotated, Any

import typer

from jaxgeo.cli._commands import Commands
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, check_writable, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._examples import examples_of
from jaxgeo.cli._inputs import DemReading, keep_inputs, read_terrain
from jaxgeo.cli._option_names import reach_as_typed
from jaxgeo.cli._options import (
    AllowOutside,
    AllowRemote,
    AssumeWgs84,
    DemBand,
    DemBounds,
    HeightUnit,
    Nodata,
    VerticalDatum,
)
from jaxgeo.cli._results import AsJson, asked, print_json
from jaxgeo.cli._screen import tell, working

WIDE = 150  # characters of a line in a file
POSITION_SIGMA, ATTITUDE_SIGMA = 50.0, 0.5  # m and deg, of a real image's navigation where nobody says it

studies = typer.Typer(cls=Commands, help="What papers print, made again.", no_args_is_help=True)

Folder = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--output", "-o", metavar="FOLDER", help="Folder for tables (CSV, Markdown) and pictures; none if left out."
    ),
]


@studies.command("li2020", epilog=examples_of("li2020"))
def li2020_command(
    output: Folder = None,
    seed: Annotated[int, typer.Option(help="Of errors of the gimbal's control and of fractal ground.")] = 0,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """The overlap analysis of Li et al. (2020) beside ours: attitude, compensation, strips in flight, timing,
    and what errors of the gimbal's control and relief of the ground do.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    inputs = asked(locals())
    with report_errors(debug):
        _check_seed(seed)
        _begin(output)
        from jaxgeo.studies import li2020

        _show(li2020, lambda: li2020.run(seed=seed), output, inputs if as_json else None)


@studies.command("li2023", epilog=examples_of("li2023"))
def li2023_command(
    output: Folder = None,
    samples: Annotated[int, typer.Option(help="Samples for each row of a table.")] = 50_000,
    seed: Annotated[int, typer.Option(help="Of all that is random: samples, terrains, places, rays.")] = 0,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """The error analysis of Li et al. (2023) beside ours: pointing, targets, RMS and CEP, searches over many terrains.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    inputs = asked(locals())
    with report_errors(debug):
        _check_seed(seed)
        _begin(output)
        from jaxgeo.studies import li2023

        _show(li2023, lambda: li2023.run(samples=samples, seed=seed), output, inputs if as_json else None)


@studies.command("xue2019", epilog=examples_of("xue2019"))
def xue2019_command(
    output: Folder = None,
    size: Annotated[
        float, typer.Option(help="Side of the area, m; the paper's is 5000, with some 1600 images.")
    ] = 1000.0,
    trials: Annotated[int, typer.Option(help="Smaller blocks with other noise, to test the standard deviations.")] = 0,
    seed: Annotated[int, typer.Option(help="Of the noise.")] = 0,
    plane_limit: Annotated[
        float | None, typer.Option(help="Largest error in plan of a standard for maps at 1:500, m; 0.3 if left out.")
    ] = None,
    height_limit: Annotated[float | None, typer.Option(help="The same in height, m; 0.4 if left out.")] = None,
    limit_source: Annotated[
        str | None, typer.Option(help="The standard that says so; given with either limit.")
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """The block of Xue et al. (2019), simulated: direct georeferencing, free net, self-calibration, boresight.

    Takes minutes, most of them to compile. Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and
    with --output the exit code is 1.
    """
    inputs = asked(locals())
    with report_errors(debug):
        _check_seed(seed)
        _begin(output)
        from jaxgeo.studies import xue2019

        limits = _limits(plane_limit, height_limit, limit_source)
        _show(
            xue2019, lambda: xue2019.run(seed, size, trials=trials, limits=limits), output, inputs if as_json else None
        )


@studies.command("gu2017", epilog=examples_of("gu2017"))
def gu2017_command(
    output: Folder = None,
    seed: Annotated[int, typer.Option(help="Of the noise.")] = 0,
    image: Annotated[
        pathlib.Path | None, typer.Option(help="A real image, with --reference, --dem and --scene; else one is made.")
    ] = None,
    reference: Annotated[pathlib.Path | None, typer.Option(help="Orthoimage of the same ground.")] = None,
    dem: Annotated[
        list[str] | None,
        typer.Option(help="Elevation model: a file, or a URL with --allow-remote; repeat it for tiles."),
    ] = None,
    scene: Annotated[
        pathlib.Path | None, typer.Option(help="Scene file (TOML): camera, gimbal, mount and pose.")
    ] = None,
    vertical_datum: VerticalDatum = None,
    nodata: Nodata = None,
    height_unit: HeightUnit = None,
    dem_band: DemBand = None,
    dem_bounds: DemBounds = None,
    assume_wgs84: AssumeWgs84 = None,
    allow_remote: AllowRemote = None,
    allow_outside: AllowOutside = None,
    position_sigma: Annotated[
        float | None, typer.Option(help="How the position of a real image errs, m; 50 if left out.")
    ] = None,
    attitude_sigma: Annotated[float | None, typer.Option(help="How its attitude errs, deg; 0.5 if left out.")] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """The registration of Gu and Qiao (2017): its table, an image end to end, blocks and ties, searches, frames.

    Takes minutes, most of them to compile. Without a real image one is made over the package's own elevation model.
    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    inputs = asked(locals())
    with report_errors(debug):
        files = {"--image": image, "--reference": reference, "--dem": dem or None, "--scene": scene}
        missing = [name for name, value in files.items() if value is None]
        if missing and len(missing) < len(files):
            raise UserError(f"a real image needs {', '.join(missing)} as well; leave all four out, and one is made.")
        _check_seed(seed)
        sigmas = _sigmas(position_sigma, attitude_sigma, is_given=image is not None)
        reading = DemReading(nodata, height_unit, dem_band, dem_bounds, assume_wgs84, allow_remote, allow_outside)
        if not dem:
            reading.check_goes_with_dem()
        keep_inputs("--output", output, [image, reference, scene], (dem or [], vertical_datum, reading))
        _begin(output, runs_long=True)
        from jaxgeo.studies import gu2017

        given = None
        if image is not None and reference is not None and scene is not None:
            terrain = read_terrain(dem or [], vertical_datum, reading)
            with reach_as_typed():
                given = gu2017.read(image, reference, scene, terrain, sigmas, reading.reach)
        _show(gu2017, lambda: gu2017.run(seed, given), output, inputs if as_json else None)


@studies.command("all", epilog=examples_of("all"))
def all_command(
    output: Folder = None,
    seed: Annotated[int, typer.Option(help="Of all that is random.")] = 0,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """All four studies: every numbered equation, table and figure as printed, as obtained, and the verdict.

    With --output a page index.html of verdicts, tables and pictures, and a folder of each study. Takes minutes. Without
    jinja2 and matplotlib (pip install 'jaxgeo\\[report]') there is no page, and with --output the exit code is 1.
    """
    inputs = asked(locals())
    with report_errors(debug):
        _check_seed(seed)
        if output is not None:
            check_writable(output)
        from jaxgeo.cli._studies_apart import found_apart
        from jaxgeo.studies.all_studies import write_verdicts
        from jaxgeo.studies.claims import claims_sheet

        if output is not None:
            output.mkdir(parents=True, exist_ok=True)
        found = found_apart(seed, output)
        verdicts, console = claims_sheet([claim for one in found for claim in one.claims]), _console()
        if as_json:
            print_json("study all", {"inputs": inputs, "tables": [_content(verdicts)]})
        else:
            console.print(verdicts.to_rich(console.width))
        if output is None:
            return
        write_verdicts(found, output)
        missing = next((one.missing for one in found if one.missing), "")
        try:
            from jaxgeo.studies.page import write_page  # only who wants a page needs jinja2

            write_page(output / "index.html", found)
        except ImportError as error:
            missing = missing or str(error)
        if missing:
            tell(f"there are no pictures or no page ({missing}); pip install 'jaxgeo[report]'")
            raise typer.Exit(NO_ANSWER) from None
        if not as_json:
            console.print(f"page, tables and pictures: {output / 'index.html'}", highlight=False, soft_wrap=True)


def _limits(plane: float | None, height: float | None, source: str | None) -> Any:
    """The limits for maps at 1:500 that were given, or the usual ones. Raises `UserError`."""
    from jaxgeo.studies.xue2019.limits import HILLS_AT_1_500, Limits

    if (plane is None and height is None) != (source is None):
        raise UserError("--plane-limit and --height-limit go with --limit-source, the standard that states them.")
    for option, value in (("--plane-limit", plane), ("--height-limit", height)):
        if value is not None and not 0.0 < value < math.inf:
            raise UserError(f"{option} {value:g}: it is a length in m, above zero and finite.")
    if source is None:
        return HILLS_AT_1_500
    if not source.strip():
        raise UserError("--limit-source is empty; name the standard, its year and clause.")
    usual = HILLS_AT_1_500
    return Limits(usual.plane if plane is None else plane, usual.height if height is None else height, source)


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise UserError(f"--seed {seed}: it is a whole number, 0 or more.")


def _sigmas(position: float | None, attitude: float | None, *, is_given: bool) -> tuple[float, float]:
    """Standard deviations of the navigation of a real image, m and deg. Raises `UserError`."""
    for option, value in (("--position-sigma", position), ("--attitude-sigma", attitude)):
        if value is None:
            continue
        if not is_given:
            raise UserError(f"{option} {value:g} is of a real image: give --image, --reference, --dem and --scene too.")
        if not 0.0 < value < math.inf:
            raise UserError(f"{option} {value:g}: a registration needs a standard deviation above zero, and finite.")
    return POSITION_SIGMA if position is None else position, ATTITUDE_SIGMA if attitude is None else attitude


def _begin(folder: pathlib.Path | None, *, runs_long: bool = False) -> None:
    """Check the folder before the work."""
    from jaxgeo._checks import enable_x64

    if folder is not None:
        check_writable(folder)
    compile_quickly(runs_long=runs_long)
    enable_x64()


def _show(study: Any, run: Callable[[], Any], folder: pathlib.Path | None, inputs: dict[str, Any] | None) -> None:
    """Tables on the screen, or as JSON with `inputs`; and with pictures into a folder."""
    console = _console()
    with working("compiling and computing"):
        report = run()
    sheets = study.sheets_of(report)
    if inputs is None:
        for sheet in sheets:
            console.print(sheet.to_rich(console.width))
    else:
        name = study.__name__.rpartition(".")[2]
        print_json(f"study {name}", {"inputs": inputs, "tables": [_content(sheet) for sheet in sheets]})
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    study.write_tables(report, folder)
    try:
        study.write_pictures(report, folder)
    except ImportError as error:
        tell(f"there are no pictures, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(NO_ANSWER) from None
    if inputs is None:
        console.print(f"tables and pictures: {folder}", highlight=False, soft_wrap=True)


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=WIDE)  # a file has room for all of a table


def _content(sheet: Any) -> dict[str, Any]:
    """A table with all digits."""
    rows = [dict(zip(sheet.columns, row, strict=True)) for row in sheet.rows]
    return {"name": sheet.name, "title": sheet.title, "rows": rows, "note": sheet.note}
