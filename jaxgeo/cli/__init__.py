"""The command line.

`jaxgeo inspect` for what a file tells; `jaxgeo locate` for pixels and tables of shots, `report` for a page about them;
`jaxgeo footprint`, `point`, `overlap` and `plan` for where a camera will look, and when; `jaxgeo rectify` for images on
a map, `register` for their pose from a map; `jaxgeo demo` for a first look; `jaxgeo study` for what papers print.

All speak alike: results on stdout, messages and progress on stderr; `--json` prints one object (`_results.py`), `-o`
writes a file that appears when it is whole; exit codes are those of `_common.py`.
"""

from __future__ import annotations

import _thread
import io
import os
import signal
import sys
import threading
from typing import Annotated, Any

import typer

from jaxgeo._destination import UNWRITABLE
from jaxgeo.cli._commands import Commands
from jaxgeo.cli._common import INTERRUPTED
from jaxgeo.cli._examples import examples_of
from jaxgeo.cli._results import version
from jaxgeo.cli.demo import demo_command
from jaxgeo.cli.footprint import footprint_command
from jaxgeo.cli.inspect import inspect_command
from jaxgeo.cli.locate import locate_command
from jaxgeo.cli.overlap import overlap_command
from jaxgeo.cli.plan import plan_command
from jaxgeo.cli.point import point_command
from jaxgeo.cli.rectify import rectify_command
from jaxgeo.cli.register import register_command
from jaxgeo.cli.report import report_command
from jaxgeo.cli.study import studies

AGAIN = 0.02  # s after which a wish to stop is told once more

EPILOG = """[bold]Exit codes[/bold]
    0  done
    1  done, but without an answer: no fix, not registered, no picture
    2  a mistake of yours, told in one line
   70  a fault of jaxgeo's; --debug shows where
  130  interrupted

Results go to stdout, messages and progress to stderr. --json prints one JSON object.
Help on a command, with examples: [bold]jaxgeo locate --help[/bold]"""

app = typer.Typer(
    name="jaxgeo",
    cls=Commands,
    help="Where is what this pixel sees, and how sure can I be? Geolocation of aerial images on real terrain.",
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
        bool, typer.Option("--version", help="Show the version and leave.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Where is what this pixel sees, and how sure can I be? Geolocation of aerial images on real terrain."""


def _add(name: str, command: Any) -> None:
    app.command(name, epilog=examples_of(name))(command)


_add("inspect", inspect_command)
_add("locate", locate_command)
_add("report", report_command)
_add("footprint", footprint_command)
_add("point", point_command)
_add("overlap", overlap_command)
_add("plan", plan_command)
_add("rectify", rectify_command)
_add("register", register_command)
_add("demo", demo_command)
app.add_typer(studies, name="study")


def _heed_signals() -> None:
    """A wish to stop ends a command in order, also where a callback of the compiler's would swallow it."""
    usual = sys.unraisablehook

    def heed(what: Any) -> None:
        if what.exc_type is not None and issubclass(what.exc_type, KeyboardInterrupt):
            threading.Timer(AGAIN, _thread.interrupt_main).start()  # where it is not swallowed
        else:
            usual(what)

    sys.unraisablehook = heed
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.default_int_handler)


def main() -> None:
    """Entry point of the command `jaxgeo`."""
    _heed_signals()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=UNWRITABLE)  # a name that the screen cannot show is no reason to stop
    try:
        app()
    except SystemExit as end:
        if end.code == INTERRUPTED:  # XLA's threads are still compiling, and would crash on an orderly way out
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        raise
