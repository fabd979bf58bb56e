"""`jaxgeo study`: reproduction of published results."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable
from typing import Annotated, Any

import typer

from jaxgeo._refusals import is_refusal
from jaxgeo.cli._cluster import ClusterOptions
from jaxgeo.cli._commands import Commands
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, check_writable, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._examples import examples_of
from jaxgeo.cli._inputs import check_goes_with_dem, check_no_overwrite, read_terrain
from jaxgeo.cli._option_names import translate_reach_errors
from jaxgeo.cli._options import DemOptions, expand_groups
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import print_message, print_written
from jaxgeo.cli._study_time import MACHINE, MEASURED, minutes_of, study_progress

WIDE = 150  # characters per line in a file
SIDE = 1000.0  # m, of the area of Xue et al. (2019) by default
PLACES = "places"  # folder of what workers have evaluated
POSITION_SIGMA, ATTITUDE_SIGMA = 50.0, 0.5  # m and deg, defaults for the navigation of a real image

studies = typer.Typer(
    cls=Commands,
    help=f"Reproduce published results; each takes minutes of processor time, of which most is compilation: "
    f"{', '.join(f'{name} {minutes_of(name)}' for name in MEASURED)} on {MACHINE}.",
    no_args_is_help=True,
)

Folder = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FOLDER",
        help="Folder for tables (CSV, Markdown) and figures; then only the verdicts are printed. Default: all tables "
        "are printed.",
    ),
]


@studies.command("li2020", epilog=examples_of("li2020"))
@expand_groups
def li2020_command(
    output: Folder = None,
    seed: Annotated[int, typer.Option(help="Random seed of the gimbal control errors and the fractal terrain.")] = 0,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Overlap analysis of Li et al. (2020) compared with ours: attitude, compensation, strips, timing,
    and effects of gimbal control errors and terrain relief.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no figures, and with --output the exit code is 1.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        _check_seed(seed)
        _begin(output)
        from jaxgeo.studies import li2020

        _show(li2020, lambda: li2020.run(seed=seed), output, inputs if as_json else None, True)


@studies.command("li2023", epilog=examples_of("li2023"))
@expand_groups
def li2023_command(
    output: Folder = None,
    samples: Annotated[int, typer.Option(help="Samples per table row.")] = 50_000,
    seed: Annotated[int, typer.Option(help="Random seed of samples, terrains, places and rays.")] = 0,
    many: ClusterOptions = ClusterOptions(),
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Error analysis of Li et al. (2023) compared with ours: pointing, targets, RMS and CEP, terrain searches.

    With --cluster, workers evaluate the places of RMS and CEP; with --output they are kept, and an interrupted run goes
    on where it stopped.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no figures, and with --output the exit code is 1.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        _check_seed(seed)
        many.check()
        _begin(output)
        from jaxgeo.studies import li2023
        from jaxgeo.studies.li2023.report import SAMPLES

        def run() -> Any:
            if many.cluster is None:
                return li2023.run(samples=samples, seed=seed)
            kept = None if output is None else output / PLACES
            if kept is not None:
                kept.mkdir(parents=True, exist_ok=True)
            with many.connected() as client:
                try:
                    return li2023.run(samples=samples, seed=seed, executor=client, folder=kept)
                except ValueError as error:
                    if not is_refusal(error) or "another sweep" not in str(error):
                        raise
                    raise UserError(
                        f"--output {output}: {kept} holds a run with other --samples or --seed, or by another version; "
                        f"name another folder, or remove it."
                    ) from error

        is_usual = many.cluster is None and samples == SAMPLES
        _show(li2023, run, output, inputs if as_json else None, is_usual)


@studies.command("xue2019", epilog=examples_of("xue2019"))
@expand_groups
def xue2019_command(
    output: Folder = None,
    size: Annotated[float, typer.Option(help="Side of the area, m; 5000 in the paper, with about 1600 images.")] = SIDE,
    trials: Annotated[int, typer.Option(help="Smaller blocks with other noise, to test the standard deviations.")] = 0,
    seed: Annotated[int, typer.Option(help="Random seed of the noise.")] = 0,
    plane_limit: Annotated[
        float | None, typer.Option(help="Largest horizontal error of a 1:500 mapping standard, m (default 0.3).")
    ] = None,
    height_limit: Annotated[
        float | None, typer.Option(help="Largest vertical error of the standard, m (default 0.4).")
    ] = None,
    limit_source: Annotated[
        str | None, typer.Option(help="The standard that states them; needed with either limit.")
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Simulated block of Xue et al. (2019): direct georeferencing, free network, self-calibration, boresight.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no figures, and with --output the exit code is 1.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        _check_seed(seed)
        _begin(output)
        from jaxgeo.studies import xue2019

        limits = _limits(plane_limit, height_limit, limit_source)
        is_usual = size == SIDE and not trials
        run = lambda: xue2019.run(seed, size, trials=trials, limits=limits)  # noqa: E731
        _show(xue2019, run, output, inputs if as_json else None, is_usual)


@studies.command("gu2017", epilog=examples_of("gu2017"))
@expand_groups
def gu2017_command(
    output: Folder = None,
    seed: Annotated[int, typer.Option(help="Random seed of the noise.")] = 0,
    image: Annotated[
        pathlib.Path | None,
        typer.Option(help="A real image, with --reference, --dem and --scene (default: simulated)."),
    ] = None,
    reference: Annotated[pathlib.Path | None, typer.Option(help="Orthoimage of the same area.")] = None,
    dem: Annotated[
        list[str] | None,
        typer.Option(help="Elevation model: a file, or a URL with --allow-remote; repeatable for tiles."),
    ] = None,
    scene: Annotated[
        pathlib.Path | None, typer.Option(help="Scene file (TOML): camera, gimbal, mount and pose.")
    ] = None,
    reading: DemOptions = DemOptions(),
    position_sigma: Annotated[
        float | None, typer.Option(help="Position standard deviation of a real image, m (default 50).")
    ] = None,
    attitude_sigma: Annotated[
        float | None, typer.Option(help="Attitude standard deviation of a real image, deg (default 0.5).")
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Registration of Gu and Qiao (2017): its table, an image end to end, blocks and ties, searches, frames.

    Without a real image, one is simulated over the packaged elevation model.
    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no figures, and with --output the exit code is 1.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        files = {"--image": image, "--reference": reference, "--dem": dem or None, "--scene": scene}
        missing = [name for name, value in files.items() if value is None]
        if missing and len(missing) < len(files):
            raise UserError(f"a real image needs {', '.join(missing)} as well; leave out all four to simulate one.")
        _check_seed(seed)
        sigmas = _sigmas(position_sigma, attitude_sigma, is_given=image is not None)
        if not dem:
            check_goes_with_dem(reading)
        check_no_overwrite("--output", output, [image, reference, scene], dem, reading)
        _begin(output)
        from jaxgeo.studies import gu2017

        given = None
        if image is not None and reference is not None and scene is not None:
            terrain = read_terrain(dem or [], reading, padded=False)  # sheets have its own posts
            with translate_reach_errors():
                given = gu2017.read(image, reference, scene, terrain, sigmas, reading.reach)
        _show(gu2017, lambda: gu2017.run(seed, given), output, inputs if as_json else None, given is None)


@studies.command("all", epilog=examples_of("all"))
@expand_groups
def all_command(
    output: Folder = None,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """All four studies: every numbered equation, table and figure as published, as obtained, and the verdict.

    With --output, writes index.html with verdicts, tables and figures, and a folder per study. Takes minutes. Without
    jinja2 and matplotlib (pip install 'jaxgeo\\[report]') there is no page, and with --output the exit code is 1.
    """
    inputs = given_options(locals())
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
            from jaxgeo.studies.page import write_page  # needs jinja2, only for the page

            write_page(output / "index.html", found)
        except ImportError as error:
            missing = missing or str(error)
        if missing:
            print_message(f"no figures or no page ({missing}); pip install 'jaxgeo[report]'")
            raise typer.Exit(NO_ANSWER) from None
        print_written(output / "index.html")


def _limits(plane: float | None, height: float | None, source: str | None) -> Any:
    """The given limits for 1:500 maps, or the default ones. Raises `UserError`."""
    from jaxgeo.studies.xue2019.limits import HILLS_AT_1_500, Limits

    if (plane is None and height is None) != (source is None):
        raise UserError("--plane-limit and --height-limit need --limit-source, the standard that states them.")
    for option, value in (("--plane-limit", plane), ("--height-limit", height)):
        if value is not None and not 0.0 < value < math.inf:
            raise UserError(f"{option} {value:g}: must be a length in m, above zero and finite.")
    if source is None:
        return HILLS_AT_1_500
    if not source.strip():
        raise UserError("--limit-source is empty; name the standard, its year and clause.")
    usual = HILLS_AT_1_500
    return Limits(usual.plane if plane is None else plane, usual.height if height is None else height, source)


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise UserError(f"--seed {seed}: must be a whole number, 0 or more.")


def _sigmas(position: float | None, attitude: float | None, *, is_given: bool) -> tuple[float, float]:
    """Standard deviations of the navigation of a real image, m and deg. Raises `UserError`."""
    for option, value in (("--position-sigma", position), ("--attitude-sigma", attitude)):
        if value is None:
            continue
        if not is_given:
            raise UserError(f"{option} {value:g} applies to a real image: give --image, --reference, --dem, --scene.")
        if not 0.0 < value < math.inf:
            raise UserError(f"{option} {value:g}: must be a standard deviation above zero, and finite.")
    return POSITION_SIGMA if position is None else position, ATTITUDE_SIGMA if attitude is None else attitude


def _begin(folder: pathlib.Path | None) -> None:
    """Check the output folder and set up JAX."""
    from jaxgeo._checks import enable_x64

    if folder is not None:
        check_writable(folder)
    compile_quickly()
    enable_x64()


def _show(
    study: Any, run: Callable[[], Any], folder: pathlib.Path | None, inputs: dict[str, Any] | None, is_usual: bool
) -> None:
    """Print the tables, or JSON with `inputs`; with a folder, write tables and figures to it and print the verdicts
    only. `is_usual`: whether the options that the time depends on are the default ones."""
    console, name = _console(), study.__name__.rpartition(".")[2]
    with study_progress(name, is_usual=is_usual):
        report = run()
    sheets = study.sheets_of(report)
    if inputs is None:
        for sheet in sheets if folder is None else sheets[-1:]:  # the last is that of the verdicts
            console.print(sheet.to_rich(console.width))
    else:
        print_json(f"study {name}", {"inputs": inputs, "tables": [_content(sheet) for sheet in sheets]})
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    study.write_tables(report, folder)
    try:
        study.write_pictures(report, folder)
    except ImportError as error:
        print_message(f"no figures: matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(NO_ANSWER) from None
    print_written(folder)


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=WIDE)  # wide tables fit in a file


def _content(sheet: Any) -> dict[str, Any]:
    """A table as JSON content, full precision."""
    rows = [dict(zip(sheet.columns, row, strict=True)) for row in sheet.rows]
    return {"name": sheet.name, "title": sheet.title, "rows": rows, "note": sheet.note}
