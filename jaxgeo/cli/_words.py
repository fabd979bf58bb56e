"""Python's words for options, in those of the command line."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterator

from jaxgeo.cli._common import UserError

# Options of `read_acquisition` that have another name on the command line than with dashes for underscores.
OTHER_NAMES = {"crs": "source-crs", "gimbal_deg": "gimbal"}
_NAMES = "height_datum|vertical_datum|takeoff_height|image_size|upright|crs|camera|gimbal_deg|errors|interior|stream"
# Options of a reader with a value that is a flag of its own on the command line.
FLAGS = {"velocities=False": "--no-velocities", "keep_damaged=True": "--keep-damaged"}
_VALUE = r'"[^"]*"|\([-+.,\d\s]*\)'  # a text, or numbers, as Python has them
_OPTION = re.compile(rf"\b({_NAMES})=(?:({_VALUE})|(?:\.\.\.)?\s?)")


def as_typed(text: str) -> str:
    """A sentence that names options of a reader, with those of the command line."""

    def typed(found: re.Match[str]) -> str:
        option = "--" + OTHER_NAMES.get(found[1], found[1].replace("_", "-"))
        if found[2]:
            value = found[2][1:-1]
            return f"{option} {value.replace(' ', '') if found[2].startswith('(') else shlex.quote(value)}"
        follows = text[found.end() : found.end() + 1]
        return option + ("" if follows in ":,;." else " ")

    for said, flag in FLAGS.items():
        text = text.replace(said, flag)
    return _OPTION.sub(typed, text)


_OF_DEM = {
    "nodata": "nodata",
    "height_unit": "height-unit",
    "band": "dem-band",
    "bounds": "dem-bounds",
    "vertical_datum": "vertical-datum",
}
_DEM_LIST = re.compile(r"\bnodata=\[([^\]]*)\]")
_DEM_TUPLE = re.compile(r"\bbounds=\(([-\d., ]*)\)")
_DEM_OPTION = re.compile(rf"\b({'|'.join(_OF_DEM)})=(\.\.\.)?\s?")
_DEM_WORDS = (
    ("assume_wgs84=True", "--assume-wgs84"),
    (", name its folder with pyproj.datadir.append_data_dir(folder),", ","),
    ("as vertical_datum", "with --vertical-datum"),
    ("Leave vertical_datum out", "Leave --vertical-datum out"),
)


def dem_as_typed(text: str) -> str:
    """A sentence that names options of `read_dem`, with those of the command line."""

    def typed(found: re.Match[str]) -> str:
        follows = text[found.end() : found.end() + 1]
        return f"--{_OF_DEM[found[1]]}" + ("" if follows in ",:;." or not follows else " ")

    text = _DEM_LIST.sub(lambda found: " ".join(f"--nodata {one.strip()}" for one in found[1].split(",")), text)
    text = _DEM_TUPLE.sub(lambda found: f"--dem-bounds {found[1].replace(' ', '')}", text)
    for word, option in _DEM_WORDS:
        text = text.replace(word, option)
    return _DEM_OPTION.sub(typed, text)


@contextlib.contextmanager
def dem_words_as_typed() -> Iterator[None]:
    """What refuses an elevation model, with the options of the command line in place of Python's."""
    try:
        yield
    except (ValueError, ImportError) as error:
        raise UserError(dem_as_typed(str(error))) from error


@contextlib.contextmanager
def words_as_typed() -> Iterator[None]:
    """Readers' mistakes with the options of the command line in place of Python's."""
    try:
        yield
    except (ValueError, ImportError) as error:
        raise UserError(as_typed(str(error))) from error
