"""`jaxgeo view`: images and map side by side in the browser, from this machine only."""

from __future__ import annotations

import dataclasses
import functools
import os
import pathlib
import sys
import threading
import webbrowser
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

import jaxgeo
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._archive_dem import messages
from jaxgeo.cli._common import Debug, UserError, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._locate_inputs import LocateInputs, read_inputs, states_errors
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions, Refraction
from jaxgeo.cli._locate_results import camera_outside_dem
from jaxgeo.cli._options import SEEN, OptionGroup, Probability
from jaxgeo.cli._oriented_images import check_is_folder, images_named
from jaxgeo.cli._results import AsJson, print_json
from jaxgeo.cli._screen import print_note, working

if TYPE_CHECKING:
    from jaxgeo.view import ViewImage, ViewServer

PORTS = range(1, 65536)
AWAKE = 3600.0  # s between looks at nothing, which let signals in


@dataclasses.dataclass(frozen=True, kw_only=True)
class PageOptions(OptionGroup):
    """The page and its server."""

    panel: ClassVar[str | None] = "Page"

    images: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--images",
            metavar="FOLDER",
            help="Images of the exposures, by their names (with a scene: its image), if the FILEs are not images.",
            rich_help_panel=SEEN,
        ),
    ] = None
    tiles: Annotated[
        str | None,
        typer.Option(
            "--tiles",
            metavar="URL",
            help="Web-map tiles in place of the relief, https://HOST/{z}/{x}/{y}.png: the browser then asks that host "
            "for the tiles in view. Default: none; nothing is asked for elsewhere.",
        ),
    ] = None
    port: Annotated[
        int | None, typer.Option("--port", metavar="PORT", help="Port on this machine (default: a free one).")
    ] = None
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address; open no browser.")] = False


def view_command(
    of_images: ObservationOptions,
    ground: GroundOptions,
    *,
    probability: Probability = 0.9,
    sigmas: Sigmas,
    refraction: Refraction = False,
    reading: ReadingOptions,
    page: PageOptions,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Show images and map side by side in the browser: click a pixel for its place, a place for its pixel, with CE90.

    Only this machine can open the address that is printed. Ctrl-C ends the command.
    """
    with report_errors(debug):
        options = LocateOptions(of_images, ground, reading, sigmas, refraction)
        _check(options, probability, page)
        with working("starting"):
            from jaxgeo.view import ViewServer
        try:
            server = ViewServer(port=page.port or 0, tiles=page.tiles)
        except OSError as error:
            raise UserError(
                f"--port {page.port}: {error.strerror or error}; give another port, or none for a free one."
            ) from error
        with server:
            try:
                _view(server, options, probability, page, as_json)
            except Exception as error:
                server.fail(" ".join(str(error).split()) or type(error).__name__)
                raise


def _check(options: LocateOptions, probability: float, page: PageOptions) -> None:
    """Raises `UserError` for wrong values."""
    options.check()
    _ = options.reading.arguments  # raises for wrong values
    if not 0.0 < probability < 1.0:
        raise UserError(f"--probability {probability:g}: must be between 0 and 1.")
    if page.port is not None and page.port not in PORTS:
        raise UserError(f"--port {page.port}: must be from 1 to 65535.")
    if page.images is not None and not (options.is_scene and page.images.exists()):
        check_is_folder(page.images)
    if page.tiles is not None:
        from jaxgeo.view import check_tiles

        try:
            check_tiles(page.tiles)
        except ValueError as error:
            raise UserError(f"--tiles {error}") from error


def _title(options: LocateOptions) -> str:
    """Title of the scene, or the names of the files."""
    from jaxgeo.io.scene import read_scene

    path = options.scene_file
    if options.is_scene and path is not None:
        return read_scene(path).title or path.name
    more = f" and {len(options.files) - 1} more" if len(options.files) > 1 else ""
    return f"{options.files[0].name}{more}"


def _view(server: ViewServer, options: LocateOptions, probability: float, page: PageOptions, as_json: bool) -> None:
    from jaxgeo._checks import enable_x64
    from jaxgeo.view import NoGround, ViewData

    compile_quickly(options.has_terrain_field)
    enable_x64()
    server.site.title, server.site.doing = _title(options), "reading the files"
    files: list[pathlib.Path | None] = []
    given = options.of_images
    has_marks = bool(given.pixels or given.detections or given.shots)

    def show_images(observed: jaxgeo.io.Observations, has_errors: bool) -> None:
        del has_errors
        from jaxgeo.view import images_of

        files.extend(_files_of(images_of(observed), options, page.images))
        server.show_images(observed, files, marks=has_marks)
        server.site.doing = "reading the elevation model"
        if not as_json:
            typer.echo(server.address)
            sys.stdout.flush()
        print_note("open the address in a browser on this machine; Ctrl-C ends the viewer.")
        if not page.no_browser:
            _open_browser(server.address)

    inputs = read_inputs(options, states_errors(options), None, show_images, whole=True)
    data = ViewData(inputs.observed, inputs.grounds, files, probability, inputs.has_errors)
    try:
        server.show(data, notes=_notes(inputs))
    except NoGround as error:
        why = camera_outside_dem(inputs)
        raise UserError(f"no image sees the ground: {why}." if why else f"{error}") from error
    if as_json:
        unread = [] if inputs.reasons is None else [reason for reason in inputs.reasons if reason is not None]
        content = {"address": server.address, "images": [one.name for one in data.images], "unread": unread}
        print_json("view", {"inputs": options.inputs | _asked(page), "assumed": inputs.assumed, **content})
        sys.stdout.flush()
    _wait()


def _wait() -> None:
    """Until the command is interrupted."""
    ended = threading.Event()
    while not ended.wait(AWAKE):
        pass


def _asked(page: PageOptions) -> dict[str, Any]:
    return {name: value for name, value in vars(page).items() if value not in (None, False)}


def _notes(inputs: LocateInputs) -> list[str]:
    """Assumptions, the source of the ground, and files that could not be read."""
    unread = [f"Not read: {reason}" for reason in inputs.reasons or () if reason is not None]
    return [*inputs.assumed, *messages(), *dict.fromkeys(unread)]


def _files_of(
    images: Sequence[ViewImage], options: LocateOptions, folder: pathlib.Path | None
) -> list[pathlib.Path | None]:
    """The image file of each exposure, None without one. Raises `UserError` if there is none in the folder."""
    from jaxgeo.io.acquisitions.several import files_of

    if folder is not None and not folder.is_dir():
        return [folder for _ in images]
    if folder is not None:
        return [*images_named(folder, [one.name for one in images], _source(options))]
    if options.is_scene:
        return [None for _ in images]
    each = [pathlib.Path(one) for one in files_of(options.files)[0]]
    by_name = {one.name: one for one in each} | {f"{one}": one for one in each}
    return [by_name.get(one.name) for one in images]


def _source(options: LocateOptions) -> str:
    """The files as named in messages."""
    first = options.files[0] if options.files else options.scene_file
    return f"{first}" if len(options.files) < 2 else f"{first} and {len(options.files) - 1} more"


def _open_browser(address: str) -> None:
    """Open the page, unless only a browser in this terminal could."""
    is_graphical = sys.platform in ("win32", "darwin") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    if is_graphical:
        threading.Thread(target=functools.partial(webbrowser.open, address), daemon=True).start()
