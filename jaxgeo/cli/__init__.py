"""The command line: `jaxgeo locate` for pixels and tables of shots, `jaxgeo demo` for a first look, `jaxgeo study`."""

from __future__ import annotations

import typer

from jaxgeo.cli.demo import demo_command
from jaxgeo.cli.locate import locate_command
from jaxgeo.cli.study import studies

app = typer.Typer(
    help="Where is what this pixel sees? Geolocation of aerial images on real terrain.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("locate")(locate_command)
app.command("demo")(demo_command)
app.add_typer(studies, name="study")


def main() -> None:
    """Entry point of the command `jaxgeo`."""
    app()
