"""Elevation models of open archives for --dem NAME: fetched for the lines of sight of a command."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from jaxgeo.cli._common import UserError
from jaxgeo.cli._option_names import translate_dem_errors
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._screen import print_note, working

if TYPE_CHECKING:
    from jaxgeo.io.archives import FetchedDem, View

Look = Callable[[], "View"]
_fetched: list[FetchedDem] = []


def forget() -> None:
    """Begin a new run."""
    _fetched.clear()


def told() -> dict[str, Any]:
    """What was fetched in this run, as part of the JSON object of the command."""
    return {"elevation_model": _fetched[-1].to_dict()} if _fetched else {}


def messages() -> list[str]:
    """Source, licence and attribution of what was fetched in this run."""
    return [f"Elevation model: {message}" for message in _fetched[-1].messages()] if _fetched else []


def is_archive(dem: list[str]) -> bool:
    """Whether --dem names an archive. Raises `UserError` if it names files too, or a word that is neither."""
    if not any(any(mark in one for mark in "{:") or one.isidentifier() or "-" in one for one in dem):
        return False
    from jaxgeo.io.archives.catalogue import ARCHIVES, is_archive

    named = [one for one in dem if is_archive(one)]
    wrong = next((one for one in dem if one not in named and _is_word(one) and not os.path.exists(one)), None)
    if wrong is not None:
        near = difflib.get_close_matches(wrong.lower(), ARCHIVES, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise UserError(
            f"--dem {wrong}: neither a file nor an archive; the archives are {', '.join(ARCHIVES)} (jaxgeo dem lists "
            f"them).{hint}"
        )
    if named and len(dem) > 1:
        other = next(one for one in dem if one != named[0])
        raise UserError(f"--dem {named[0]} is an archive, and {other} another elevation model; give one of them.")
    return bool(named)


def _is_word(name: str) -> bool:
    """Whether a name has neither folders nor an ending, as archives have."""
    return re.fullmatch(r"[\w-]+", name) is not None


def fetch(name: str, options: DemOptions, look: Look | None) -> FetchedDem:
    """The parts of an archive that a command needs; prints where they come from. Raises `UserError`."""
    from jaxgeo.cli._inputs import bounds_in, datum
    from jaxgeo.io.archives import fetch_dem
    from jaxgeo.io.archives.errors import NotAtHand

    if (options.dem_band or 1) != 1:
        raise UserError(f"--dem-band {options.dem_band}: the tiles of archives have one band; leave it out.")
    edges = bounds_in(options)
    if edges is None and look is None:
        raise UserError(f"--dem {name}: say for which ground, with --dem-bounds WEST,SOUTH,EAST,NORTH in deg.")
    view = look() if edges is None and look is not None else None
    try:
        with working("fetching the elevation model"), translate_dem_errors():
            found = fetch_dem(
                name,
                bounds=edges,
                rays=view,
                vertical_datum=datum(options.vertical_datum),
                mirror=options.mirror,
                proxy=options.proxy,
                offline=options.offline,
            )
    except UserError as error:
        if not isinstance(error.__cause__, NotAtHand) or not hasattr(options, "level"):
            raise
        raise UserError(f"{error} Without an elevation model: --ground HEIGHT, level ground, in m.") from error
    for message in found.messages():
        print_note(f"elevation model: {message}")
    _fetched.append(found)
    return found
