"""Options and readers of image, telemetry and navigation files, and messages on files that cannot be read."""

from __future__ import annotations

import contextlib
import dataclasses
import pathlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

import jaxgeo
from jaxgeo._text_numbers import number_in
from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import as_datum, numbers_in
from jaxgeo.cli._option_names import as_typed, reason_not_read, translate_reader_errors
from jaxgeo.cli._options import READING, OptionGroup
from jaxgeo.cli._screen import print_message, print_note, progress_bar, working

if TYPE_CHECKING:
    import jaxgeo.io.acquisitions

MOST_REASONS = 10  # unread files whose reasons are printed
TAKEOFF_ON_DEM = "dem"  # --takeoff-height dem, see `jaxgeo.cli._known_heights`


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReadingOptions(OptionGroup):
    """How files of exposures are read."""

    panel: ClassVar[str | None] = READING

    height_datum: Annotated[
        str | None,
        typer.Option(
            "--camera-datum",
            metavar="DATUM",
            help='Vertical datum of the camera heights in the file: "ellipsoid", "EPSG:5773", or an undulation in m.',
        ),
    ] = None
    takeoff_height: Annotated[
        str | None,
        typer.Option(
            "--takeoff-height",
            metavar="HEIGHT",
            help="Drone images, logs: height of the take-off point, m above the ellipsoid or --camera-datum, to which "
            "the heights above it are added; dem: that of --dem under the first exposure.",
        ),
    ] = None
    crs: Annotated[
        str | None,
        typer.Option(
            "--source-crs",
            metavar="CRS",
            help='CRS of the file\'s positions, if they are projected: "EPSG:32651", or a .prj file (default: '
            "the .prj beside a table). COLMAP, MicMac, Pix4D: also "
            '"EPSG:4978" or "enu:LAT,LON,HEIGHT".',
        ),
    ] = None
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            metavar="CAMERA",
            help="Camera: focal=8.8mm,pitch=2.41um, focal=3666px or film=24mm (35 mm equivalent), for logs and videos "
            "with size=5472x3648; a camera or scene file (.toml), Pix4D's .cam, OpenSfM's .json, or the NAME of a "
            "camera in the file (drone images: in the camera table).",
        ),
    ] = None
    gimbal: Annotated[
        str | None,
        typer.Option(
            "--gimbal",
            metavar="ANGLES",
            help="Drone images: YAW,PITCH,ROLL of the camera, deg from true north and the horizon; replaces the "
            "tags. aircraft,PITCH,ROLL takes the yaw from the aircraft heading.",
        ),
    ] = None
    image_size: Annotated[
        str | None,
        typer.Option("--image-size", metavar="SIZE", help="Telemetry: WIDTH,HEIGHT of the video, pixels."),
    ] = None
    upright: Annotated[
        bool, typer.Option("--upright", help="Telemetry: the image is stabilised level with the horizon.")
    ] = False
    keep_damaged: Annotated[
        bool, typer.Option("--keep-damaged", help="Telemetry: also use packets with a wrong checksum.")
    ] = False
    stream: Annotated[
        int | None,
        typer.Option("--stream", metavar="NUMBER", help="Telemetry: number of the data stream in a transport stream."),
    ] = None
    errors: Annotated[
        pathlib.Path | None, typer.Option("--errors", metavar="FILE", help="SBET: accuracy file (smrmsg).")
    ] = None
    no_velocities: Annotated[bool, typer.Option("--no-velocities", help="SBET: ignore the velocities.")] = False
    interior: Annotated[
        pathlib.Path | None,
        typer.Option("--interior", metavar="FILE", help="Orthority: interior parameter file (.yaml)."),
    ] = None
    part: Annotated[
        int | None,
        typer.Option(
            "--reconstruction",
            metavar="NUMBER",
            min=0,
            help="OpenSfM: which of several reconstructions in a file, from 0.",
        ),
    ] = None
    positions: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--positions",
            metavar="FILE",
            help="Drone images: file of refined positions (geo.txt, Timestamp.MRK, RTKLIB's .pos, shots.geojson, a "
            "table).",
        ),
    ] = None

    times: Annotated[
        list[str] | None,
        typer.Option(
            "--time",
            metavar="TIME",
            help="Videos, logs: exposures at HH:MM:SS or s after the start of the file, or at a UTC time "
            "(2024-05-10T10:20:31Z); interpolated; repeatable.",
        ),
    ] = None

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of `read_acquisitions`. Raises `UserError`."""
        names = ("crs", "camera", "errors", "interior", "part", "positions")
        how: dict[str, Any] = {name: getattr(self, name) for name in names}
        if self.takeoff_height is not None:
            how["takeoff_height"] = _takeoff(self.takeoff_height)
        how |= {"times": self.times or None}
        how |= {"velocities": False if self.no_velocities else None}
        how |= {"upright": self.upright or None, "keep_damaged": self.keep_damaged or None, "stream": self.stream}
        if self.height_datum is not None:
            how["height_datum"] = as_datum(self.height_datum)
        if self.gimbal is not None:
            form = "YAW,PITCH,ROLL, three angles in deg, or aircraft,PITCH,ROLL"
            by_aircraft = self.gimbal.strip().startswith("aircraft,")
            text = self.gimbal.replace("aircraft,", "0,", 1) if by_aircraft else self.gimbal
            angles = numbers_in("--gimbal", text, (3,), form)
            how["gimbal_deg"] = ["aircraft", *angles[1:]] if by_aircraft else angles
        if self.image_size is not None:
            size = numbers_in("--image-size", self.image_size, (2,), "WIDTH,HEIGHT, two whole numbers")
            if any(one != int(one) or one < 1 for one in size):
                raise UserError(f"--image-size {self.image_size!r}: expected WIDTH,HEIGHT, two whole numbers.")
            how["image_size"] = int(size[0]), int(size[1])
        if self.crs is not None and self.crs.lower().endswith(".prj"):
            how["crs"], _ = _of_prj(self.crs)
        return {name: value for name, value in how.items() if value is not None}

    @property
    def is_above_takeoff(self) -> bool:
        """Whether the take-off is the level of reference: at 0 m above no datum that is named."""
        return self.height_datum is None and number_in(self.takeoff_height or "") == 0.0

    @property
    def known_arguments(self) -> dict[str, Any]:
        """`arguments` for a reader. Raises `UserError` for a take-off on an elevation model, which no reader has."""
        if self.takeoff_height == TAKEOFF_ON_DEM:
            raise UserError("--takeoff-height dem is for commands with --dem; give the height of the take-off in m.")
        arguments = self.arguments
        if self.crs is not None and arguments["crs"] != self.crs:
            print_note(f"--source-crs {self.crs}: {_of_prj(self.crs)[1]}.")
        return arguments


@dataclasses.dataclass(frozen=True, kw_only=True)
class KnownHeights(ReadingOptions):
    """Reading options with the take-off on the elevation model as a number, and its standard deviation in m."""

    takeoff_sigma: float = 0.0

    @property
    def is_above_takeoff(self) -> bool:
        return False  # the height of the take-off is known, also where it is 0 m

    @property
    def arguments(self) -> dict[str, Any]:
        return super().arguments | {"takeoff_sigma": self.takeoff_sigma}


def _of_prj(path: str) -> tuple[str, str]:
    """(the CRS of a .prj file as text, its name). Raises `UserError`."""
    from jaxgeo.io._prj import name_of, read_prj, text_of
    from jaxgeo.io.errors import TableError

    try:
        found = read_prj(path)
    except FileNotFoundError as error:
        raise UserError(f"--source-crs {path}: there is no such file.") from error
    except TableError as error:
        raise UserError(f"--source-crs {as_typed(f'{error}')}") from error
    return text_of(found), name_of(found)


def _takeoff(text: str) -> float | str:
    height = number_in(text)
    if height is None and text != TAKEOFF_ON_DEM:
        raise UserError(f"--takeoff-height {text!r}: expected a height in m, or {TAKEOFF_ON_DEM}.")
    return text if height is None else height


@contextlib.contextmanager
def reading_files(files: Sequence[pathlib.Path]) -> Iterator[Callable[[int, int], None]]:
    """Show progress on stderr, and raise errors of the readers as `UserError` with command-line options.

    Yields a function to call with the number of files read and the total.
    """
    if len(files) == 1 and not files[0].is_dir():
        with working(f"reading {files[0].name}"), translate_reader_errors():
            yield lambda count, total: None
        return
    with progress_bar() as bar, translate_reader_errors():
        task = bar.add_task("reading", total=None)
        yield lambda count, total: bar.update(task, completed=count, total=total)


def print_unread(unread: Iterable[jaxgeo.io.acquisitions.Unread]) -> None:
    """Print the unread files and their reasons on stderr, at most `MOST_REASONS`."""
    each = list(unread)
    for one in each[:MOST_REASONS]:
        print_message(f"not read: {reason_not_read(one)}")
    if len(each) > MOST_REASONS:
        print_message(f"not read: {len(each) - MOST_REASONS} more files; --json lists all reasons.")
