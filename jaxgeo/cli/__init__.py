"""The command line `jaxgeo`.

`inspect` shows the content of a file; `locate` geolocates pixels and tables of shots, `report` writes a page on them;
`view` shows images and map in the browser; `accuracy-map` maps the accuracy of all places on an image; `validate`
compares stated errors with check points; `footprint`, `point`, `overlap` and `plan` are for coverage and mission
planning; `rectify` orthorectifies images, `register` estimates their orientation from a map, `adjust` by
tie points among them; `dem` fetches elevation
models; `scene` writes a scene file of an exposure; `demo` is an example; `doctor` checks the installation; `study`
reproduces published results.

All commands share one interface: results on stdout, messages and progress on stderr; `--json` prints one object
(`_results.py`), `-o` writes a file atomically; exit codes are those of `_common.py`.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from jaxgeo import _command
from jaxgeo._destination import UNWRITABLE
from jaxgeo._interruption import run
from jaxgeo.cli._commands import Commands
from jaxgeo.cli._examples import examples_of
from jaxgeo.cli._options import expand_groups
from jaxgeo.cli._results import version
from jaxgeo.cli.accuracy_map import accuracy_map_command
from jaxgeo.cli.adjust import adjust_command
from jaxgeo.cli.dem import dem_command
from jaxgeo.cli.demo import demo_command
from jaxgeo.cli.doctor import doctor_command
from jaxgeo.cli.footprint import footprint_command
from jaxgeo.cli.inspect import inspect_command
from jaxgeo.cli.locate import locate_command
from jaxgeo.cli.overlap import overlap_command
from jaxgeo.cli.plan import plan_command
from jaxgeo.cli.point import point_command
from jaxgeo.cli.rectify import rectify_command
from jaxgeo.cli.register import register_command
from jaxgeo.cli.report import report_command
from jaxgeo.cli.scene import scene_command
from jaxgeo.cli.study import studies
from jaxgeo.cli.validate import validate_command
from jaxgeo.cli.view import view_command

EPILOG = """[bold]Exit codes[/bold]
    0  done
    1  done, but without a result: no fix, not registered, no figure
    2  usage or input error, reported in one line
   70  internal error; --debug shows the traceback
  130  interrupted
  143  terminated

Results go to stdout, messages and progress to stderr. --json prints one JSON object.
Help on a command, with examples: [bold]jaxgeo locate --help[/bold]"""

app = typer.Typer(
    name="jaxgeo",
    cls=Commands,
    help="Geolocation of aerial images on real terrain: ground coordinates of pixels and their accuracy.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _show_version(is_asked: bool) -> bool:
    if is_asked:
        typer.echo(f"jaxgeo {version()}")
        raise typer.Exit
    return is_asked


@app.callback()
def of_all(
    show_version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Geolocation of aerial images on real terrain: ground coordinates of pixels and their accuracy."""


def _add(name: str, command: Callable[..., None]) -> None:
    app.command(name, epilog=examples_of(name))(expand_groups(command))


_add("inspect", inspect_command)
_add("locate", locate_command)
_add("report", report_command)
_add("view", view_command)
_add("accuracy-map", accuracy_map_command)
_add("validate", validate_command)
_add("footprint", footprint_command)
_add("point", point_command)
_add("overlap", overlap_command)
_add("plan", plan_command)
_add("rectify", rectify_command)
_add("register", register_command)
_add("adjust", adjust_command)
_add("dem", dem_command)
_add("scene", scene_command)
_add("demo", demo_command)
_add("doctor", doctor_command)
app.add_typer(studies, name="study")


def main() -> None:
    """Entry point of the command `jaxgeo`; ends the process."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=UNWRITABLE)  # a name the terminal cannot encode must not fail
    _command.collect_again()
    run(app)
