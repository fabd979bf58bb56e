"""Options shared by several commands, and groups of options as records."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pathlib
from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_type_hints

import typer
from typer.models import OptionInfo

import jaxgeo
from jaxgeo.cli._screen import set_quiet

if TYPE_CHECKING:
    import jaxgeo.io.reach

SEEN, SURE = "Inputs", "Accuracy"  # help panels of commands with many options
READING, WRITING = "Reading the FILE", "Output"
OF_DEM = "Reading the elevation model"


@dataclasses.dataclass(frozen=True)
class OptionGroup:
    """Base class of dataclasses of options: each field is annotated with a `typer.Option` that has a name.

    `panel` is the help panel of options that name none; fields named in `first` precede inherited ones.
    """

    panel: ClassVar[str | None] = None
    first: ClassVar[tuple[str, ...]] = ()


Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print errors only on stderr: no assumptions, progress and counts.")
]


def expand_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with each parameter that is an `OptionGroup` replaced by a parameter per field, and with --quiet.

    Typer reads options from the signature of a function and knows no groups. The parameters are named GROUP_FIELD, so
    that fields of two groups may share a name; a group is passed to the command as a record.
    """
    hints = get_type_hints(command, include_extras=True)
    signature = inspect.signature(command)
    groups = {name: hints[name] for name in signature.parameters if inspect.isclass(hints[name])}
    groups = {name: kind for name, kind in groups.items() if issubclass(kind, OptionGroup)}

    def expanded() -> Iterator[inspect.Parameter]:
        for name, parameter in signature.parameters.items():
            if name in groups:
                yield from _parameters_of(name, groups[name])
            else:
                yield parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[name])
        yield inspect.Parameter("quiet", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Quiet)

    def run(**given: Any) -> None:
        set_quiet(given.pop("quiet"))
        for name, kind in groups.items():
            fields = {field.name: given.pop(f"{name}_{field.name}") for field in dataclasses.fields(kind)}
            given[name] = kind(**fields)
        command(**given)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    setattr(run, "__signature__", signature.replace(parameters=list(expanded())))  # noqa: B010
    return run


def _parameters_of(group: str, kind: type[OptionGroup]) -> Iterator[inspect.Parameter]:
    """A parameter per field of a group, with its help panel."""
    hints = get_type_hints(kind, include_extras=True)
    for field in sorted(dataclasses.fields(kind), key=lambda field: field.name not in kind.first):
        (option,) = hints[field.name].__metadata__
        option = copy.copy(option)
        if isinstance(option, OptionInfo):  # not an argument
            option.rich_help_panel = option.rich_help_panel or kind.panel
        default = inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default
        yield inspect.Parameter(
            f"{group}_{field.name}",
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[hints[field.name].__origin__, option],
        )


SceneOfFiles = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--scene",
        metavar="FILE",
        help="Scene file (TOML): camera, gimbal, mount and pose; also for FILEs without a camera.",
    ),
]
ExposureFiles = Annotated[
    list[pathlib.Path] | None,
    typer.Argument(
        metavar="FILE",
        help="Drone images or folders, KLV, SBET, table, reconstruction; or a scene.",
        show_default=False,
    ),
]
ExposureNames = Annotated[
    list[str] | None,
    typer.Option("--exposure", metavar="NAME", help="Exposure name (repeatable; default: all)."),
]
DemFiles = Annotated[
    list[str],
    typer.Option(
        "--dem",
        metavar="FILE",
        help="Elevation model: a file, an archive (copernicus, copernicus-90, srtm, 3dep: fetched as needed), or a URL "
        "with --allow-remote; repeatable for tiles.",
    ),
]
NavigationFile = Annotated[
    pathlib.Path | None,
    typer.Option("--navigation", metavar="FILE", help="CSV with a navigation record per row."),
]
Probability = Annotated[
    float,
    typer.Option("--probability", metavar="SHARE", help="Confidence level of CE/LE/SE.", rich_help_panel=SURE),
]
_BAND = "Height band of --dem, from 1 (default 1)."


@dataclasses.dataclass(frozen=True, kw_only=True)
class DemOptions(OptionGroup):
    """How the files of --dem are read."""

    panel: ClassVar[str | None] = OF_DEM

    vertical_datum: Annotated[
        str | None,
        typer.Option(
            "--dem-datum",
            metavar="DATUM",
            help='Vertical datum of the DEM: "EPSG:5773", "ellipsoid", an undulation in m, a geoid grid.',
            rich_help_panel="Options",
        ),
    ] = None
    nodata: Annotated[
        list[float] | None,
        typer.Option(
            "--nodata",
            metavar="VALUE",
            help="Stored value that marks voids of --dem, besides its nodata tag (repeatable).",
        ),
    ] = None
    height_unit: Annotated[
        str | None,
        typer.Option(
            "--height-unit",
            metavar="UNIT",
            help='Height unit of --dem, overrides the file: "m", "ft", "us-ft", "dm", "cm".',
        ),
    ] = None
    dem_band: Annotated[int | None, typer.Option("--dem-band", "--band", help=_BAND)] = None
    dem_bounds: Annotated[
        str | None,
        typer.Option("--dem-bounds", metavar="EDGES", help="Extent of --dem to read: WEST,SOUTH,EAST,NORTH in deg."),
    ] = None
    assume_wgs84: Annotated[
        bool | None,
        typer.Option("--assume-wgs84", help="Assume that the geographic coordinates of --dem are WGS 84."),
    ] = None
    allow_remote: Annotated[
        bool | None,
        typer.Option("--allow-remote", help="Allow rasters at URLs and other GDAL data sources (/vsi..., a WMS)."),
    ] = None
    allow_outside: Annotated[
        bool | None,
        typer.Option("--allow-outside", help="Allow rasters (a VRT) to read files outside their own folder."),
    ] = None

    mirror: Annotated[
        str | None,
        typer.Option(
            "--mirror",
            metavar="ADDRESS",
            help="Archive of --dem at another address or in a folder; NAME=ADDRESS for several, proj=ADDRESS for "
            "geoid grids.",
        ),
    ] = None
    proxy: Annotated[
        str | None,
        typer.Option("--proxy", metavar="ADDRESS", help="Proxy to the archive of --dem (default: HTTPS_PROXY)."),
    ] = None
    offline: Annotated[
        bool | None,
        typer.Option("--offline", help="Use only those parts of the archive of --dem that are on this machine."),
    ] = None

    @property
    def of_files(self) -> dict[str, Any]:
        """The given options that need --dem, by name."""
        names = [field.name for field in dataclasses.fields(DemOptions) if field.name != "vertical_datum"]
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def reach(self) -> jaxgeo.io.reach.Reach:
        """Places that raster reading may access."""
        from jaxgeo.io.reach import Reach

        return Reach(bool(self.allow_remote), bool(self.allow_outside))


@dataclasses.dataclass(frozen=True, kw_only=True)
class DemOptionsBesideBand(DemOptions):
    """For commands in which --band selects an image band."""

    dem_band: Annotated[int | None, typer.Option("--dem-band", help=_BAND)] = None


class Axis(StrEnum):
    """An axis of the image."""

    columns = "columns"
    rows = "rows"


class Compared(StrEnum):
    """What of two images is compared."""

    grey = "grey"
    orientation = "orientation"


Measure = Annotated[
    Compared,
    typer.Option(
        "--measure",
        help="Compare grey values, or the orientation of their gradients: for unlike sensors, bands, seasons.",
    ),
]
Along = Annotated[Axis | None, typer.Option("--along", help="Image axis along track (default: detected).")]
