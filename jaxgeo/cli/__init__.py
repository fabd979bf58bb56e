"""The command line.

`jaxgeo inspect` for what a file tells; `jaxgeo locate` for pixels and tables of shots; `jaxgeo footprint`, `point`,
`overlap` and `plan` for where a camera will look, and when; `jaxgeo rectify` for images on a map, `register` for their
pose from a map; `jaxgeo demo` for a first look; `jaxgeo study` for what papers print.
"""

from __future__ import annotations

import typer

from jaxgeo.cli.demo import demo_command
from jaxgeo.cli.footprint import footprint_command
from jaxgeo.cli.inspect import inspect_command
from jaxgeo.cli.locate import locate_command
from jaxgeo.cli.overlap import overlap_command
from jaxgeo.cli.plan import plan_command
from jaxgeo.cli.point import point_command
from jaxgeo.cli.rectify import rectify_command
from jaxgeo.cli.register import register_command
from jaxgeo.cli.study import studies

app = typer.Typer(
    help="Where is what this pixel sees? Geolocation of aerial images on real terrain.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("inspect")(inspect_command)
app.command("locate")(locate_command)
app.command("footprint")(footprint_command)
app.command("point")(point_command)
app.command("overlap")(overlap_command)
app.command("plan")(plan_command)
app.command("rectify")(rectify_command)
app.command("register")(register_command)
app.command("demo")(demo_command)
app.add_typer(studies, name="study")


def main() -> None:
    """Entry point of the command `jaxgeo`."""
    app()
