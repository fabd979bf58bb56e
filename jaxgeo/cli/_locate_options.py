"""Options of `jaxgeo locate` and `jaxgeo report`, and their values."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any, NamedTuple

import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._inputs import DemReading
from jaxgeo.cli._options import SEEN

Source = Annotated[
    list[pathlib.Path] | None,
    typer.Argument(
        metavar="FILE",
        help="Drone images or folders, KLV, SBET, table, reconstruction; or a scene.",
        show_default=False,
    ),
]
SceneOption = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--scene",
        metavar="FILE",
        help="Scene file (TOML): camera, gimbal, mount and pose; also for FILEs without a camera.",
        rich_help_panel=SEEN,
    ),
]
GroundDem = Annotated[
    list[str] | None,
    typer.Option(
        "--dem",
        metavar="FILE",
        help="Elevation model: a file, or a URL with --allow-remote; repeatable for tiles.",
        rich_help_panel=SEEN,
    ),
]
GroundDatum = Annotated[
    str | None,
    typer.Option(
        "--vertical-datum",
        metavar="DATUM",
        help='Vertical datum of the ground: "EPSG:5773", "ellipsoid", an undulation in m, a geoid grid.',
        rich_help_panel=SEEN,
    ),
]
Ground = Annotated[
    str | None,
    typer.Option(
        "--ground",
        metavar="HEIGHT",
        help="Level ground instead of --dem: height in m above the ellipsoid or --vertical-datum; or 'reported': the "
        "frame centre height in the telemetry.",
        rich_help_panel=SEEN,
    ),
]
Pixels = Annotated[
    list[str] | None,
    typer.Option(
        "--pixel",
        metavar="PIXEL",
        help="COLUMN,ROW of a pixel (repeatable; default: image centre).",
        rich_help_panel=SEEN,
    ),
]
Exposures = Annotated[
    list[str] | None,
    typer.Option(
        "--exposure",
        metavar="NAME",
        help="Exposure name (repeatable; default: all).",
        rich_help_panel=SEEN,
    ),
]
TableOfShots = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--shots",
        metavar="FILE",
        help="With --scene: CSV with a shot and a pixel per row.",
        rich_help_panel=SEEN,
    ),
]
Refraction = Annotated[
    bool,
    typer.Option("--refraction", help="Apply refraction (US Standard Atmosphere 1976).", rich_help_panel=SEEN),
]


class LocateOptions(NamedTuple):
    """Option values as typed."""

    files: list[pathlib.Path]
    scene: pathlib.Path | None
    shots: pathlib.Path | None
    pixels: list[str]
    exposures: list[str]
    dem: list[str]
    ground: str | None
    vertical_datum: str | None
    refraction: bool
    how: dict[str, Any]
    sigmas: Sigmas
    reading: DemReading = DemReading()

    @property
    def is_scene(self) -> bool:
        """Whether the exposures come from a scene file: by --scene, or as the only FILE."""
        return not self.files or (len(self.files) == 1 and is_scene_file(self.files[0]))

    @property
    def scene_file(self) -> pathlib.Path | None:
        """The scene file, from --scene or as FILE."""
        return self.files[0] if self.files and self.is_scene else self.scene

    @property
    def named(self) -> str:
        """The FILEs as named in messages."""
        more = f" and {len(self.files) - 1} more" if len(self.files) > 1 else ""
        return f"{self.files[0]}{more}" if self.files else f"{self.scene}"

    @property
    def samples_of_field(self) -> bool:
        """Whether ground height errors are spatially correlated, by an option or by the scene's [errors] table."""
        scenes = [path for path in (self.scene, self.scene_file) if path is not None and is_scene_file(path)]
        told = [path.read_text(encoding="utf-8", errors="replace") for path in scenes if path.is_file()]
        return self.sigmas.dem_correlation is not None or any("terrain_correlation_m" in text for text in told)


def is_scene_file(path: pathlib.Path) -> bool:
    """Whether a file name is that of a scene (.toml)."""
    return path.suffix.lower() == ".toml"


def check_asked(asked: LocateOptions) -> None:
    if not asked.files and asked.scene is None:
        raise UserError("give a FILE that jaxgeo inspect reads, or --scene SCENE.toml.")
    if len(asked.files) > 1:
        for path in filter(is_scene_file, asked.files):
            raise UserError(f"{path} is a scene file: give it alone, or as --scene {path} for files without a camera.")
    if asked.shots is not None:
        if asked.files:
            raise UserError(f"--shots {asked.shots}: use it with --scene, not with {asked.named}.")
        if asked.pixels:
            raise UserError("give either --pixel COLUMN,ROW (repeatable) or --shots FILE.")
    if bool(asked.dem) == (asked.ground is not None):
        raise UserError("give the ground: either --dem FILE, or --ground HEIGHT for level ground.")
    if not asked.dem:
        asked.reading.check_goes_with_dem()
    if asked.exposures and asked.is_scene:
        raise UserError("--exposure needs a FILE of exposures; a scene has only one.")
    if asked.sigmas.dem_correlation is not None and asked.ground is not None:
        raise UserError("--dem-correlation: level ground has one common height error; use it with --dem.")
