"""Translation of Python keyword names in messages to command-line options."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterator
from typing import Any

from jaxgeo._refusals import is_refusal
from jaxgeo.cli._common import UserError

# Options of `read_observations` whose command-line name differs by more than dashes.
OTHER_NAMES = {"height_datum": "camera-datum", "vertical_datum": "dem-datum", "crs": "source-crs",
               "gimbal_deg": "gimbal", "velocities": "no-velocities", "exposures": "exposure",
               "pixels": "pixel", "times": "time", "part": "reconstruction"}  # fmt: skip
# Reader options available on the command line; the others are Python only.
READING = (
    "height_datum", "takeoff_height", "image_size", "upright", "keep_damaged", "stream", "velocities", "crs", "camera",
    "gimbal_deg", "positions", "errors", "interior", "times", "part",
)  # fmt: skip
OBSERVED = ("scene", "shots", "exposures", "pixels")  # other options of `read_observations`
# Reader options whose value is a flag on the command line.
FLAGS = {
    "jaxgeo.io.read_dem": "--dem",
    "velocities=False": "--no-velocities",
    "keep_damaged=True": "--keep-damaged",
    "upright=True": "--upright",
}
_VALUE = r'"[^"]*"|\((?:"|[-+.\d])[^()]*\)'  # a Python string, or a tuple
_OPTION = re.compile(rf"\b({'|'.join(('vertical_datum', *OBSERVED, *READING))})=(?:({_VALUE})|(?:\.\.\.)?\s?)")


def typed(name: str) -> str:
    """Command-line name of a reader option."""
    return "--" + OTHER_NAMES.get(name, name.replace("_", "-"))


def as_typed(text: str) -> str:
    """A sentence with reader options replaced by command-line options."""

    def replaced(found: re.Match[str]) -> str:
        option = typed(found[1])
        if found[2]:
            inside = found[2][1:-1]
            value = inside.replace(" ", "").replace('"', "") if found[2].startswith("(") else shlex.quote(inside)
            return f"{option} {value}"
        follows = text[found.end() : found.end() + 1]
        return option + ("" if follows in ":,;." else " ")

    for said, flag in FLAGS.items():
        text = text.replace(said, flag)
    return _OPTION.sub(replaced, text)


def gap_as_typed(text: str) -> str:
    """A message about a gap in a flight, which no option allows, with what can be done on the command line."""
    text = re.sub(r"longest_gap is ([^ ]+ s)\.", r"the longest allowed is \1 (ten times the median).", text)
    return text.replace(
        "Make one trajectory of what is before and one of what is behind, or allow the gap.",
        "Give what is before the gap and what is behind it one after the other, each as a file or folder of its own.",
    )


def reason_of(error: Exception) -> str:
    """Reason why a file cannot be read, with command-line options."""
    from jaxgeo.io.acquisitions.detect import WrongOption

    if isinstance(error, WrongOption):
        options = [typed(name) for name in error.takes if name in READING]
        takes = f"it takes {', '.join(options)}" if options else "leave it out"
        remedy = "" if error.name != "camera" else " Its camera is that of --scene SCENE.toml."
        return f"{error.path} ({error.kind}) takes no {typed(error.name)}; {takes}.{remedy}"
    return as_typed("\n".join(" ".join(line.split()) for line in str(error).splitlines())) or type(error).__name__


def reason_not_read(unread: Any) -> str:
    """Reason why one of many files could not be read, including internal errors."""
    if is_refusal(unread.error):
        return " ".join(reason_of(unread.error).split())
    name, reason = type(unread.error).__name__, " ".join(str(unread.error).split())
    return (
        f"{unread.path}: internal error: unexpected {name}{f' ({reason})' if reason else ''}; run jaxgeo inspect "
        f"{unread.path} --debug for the traceback, and report it."
    )


_OF_DEM = {
    "nodata": "nodata",
    "height_unit": "height-unit",
    "band": "dem-band",
    "bounds": "dem-bounds",
    "vertical_datum": "dem-datum",
    "mirror": "mirror",
    "proxy": "proxy",
}
_DEM_LIST = re.compile(r"\bnodata=\[([^\]]*)\]")
_DEM_TUPLE = re.compile(r"\bbounds=\(([-\d., ]*)\)")
_DEM_OPTION = re.compile(rf"\b({'|'.join(_OF_DEM)})=(\.\.\.)?\s?")
REACH = (("allow_remote=True", "--allow-remote"), ("allow_outside=True", "--allow-outside"))
_DEM_WORDS = (
    ("assume_wgs84=True", "--assume-wgs84"),
    *REACH,
    ("offline=True", "--offline"),
    ("bounds=(west, south, east, north)", "--dem-bounds WEST,SOUTH,EAST,NORTH"),
    ("as vertical_datum", "with --dem-datum"),
    ("Leave vertical_datum out", "Leave --dem-datum out"),
)


def dem_as_typed(text: str) -> str:
    """A sentence with options of `read_dem` replaced by command-line options."""

    def typed(found: re.Match[str]) -> str:
        follows = text[found.end() : found.end() + 1]
        return f"--{_OF_DEM[found[1]]}" + ("" if follows in ",:;." or not follows else " ")

    text = _DEM_LIST.sub(lambda found: " ".join(f"--nodata {one.strip()}" for one in found[1].split(",")), text)
    text = _DEM_TUPLE.sub(lambda found: f"--dem-bounds {found[1].replace(' ', '')}", text)
    for word, option in _DEM_WORDS:
        text = text.replace(word, option)
    return _DEM_OPTION.sub(typed, text)


@contextlib.contextmanager
def translate_dem_errors() -> Iterator[None]:
    """Raise `read_dem` errors as `UserError` with command-line options."""
    try:
        yield
    except (ValueError, ImportError) as error:
        raise UserError(dem_as_typed(str(error))) from error


@contextlib.contextmanager
def translate_reach_errors() -> Iterator[None]:
    """Raise remote- or outside-access errors of images as `UserError` with command-line options."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        if not is_refusal(error) or not any(word in text for word, _ in REACH):
            raise
        for word, option in REACH:
            text = text.replace(word, option)
        raise UserError(text) from error


@contextlib.contextmanager
def translate_reader_errors() -> Iterator[None]:
    """Raise reader errors as `UserError` with command-line options."""
    try:
        yield
    except (ValueError, ImportError) as error:
        if not is_refusal(error):
            raise
        raise UserError(reason_of(error)) from error


_CELLS = re.compile(r"\b(crs|bounds|resolution|like|bands)=(?:\.\.\.)?")


@contextlib.contextmanager
def translate_cell_errors(*, several: bool = False) -> Iterator[None]:
    """Raise errors about the cells of a raster as `UserError` with command-line options; `several` images have no
    bounds."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        if not is_refusal(error) or not (_CELLS.search(text) or "resolution must be" in text):
            raise
        if several:
            text = text.replace(", or a part with bounds=", "")
        text = _CELLS.sub(lambda found: "--band" if found[1] == "bands" else f"--{found[1]}", text)
        raise UserError(re.sub(r"(^|: )resolution must be", r"\1--resolution must be", text)) from error
