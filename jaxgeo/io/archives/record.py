"""Record of fetched ground: its files, its source, and what was assumed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

from jaxgeo.io.archives.catalogue import Archive
from jaxgeo.io.archives.sight import REACH
from jaxgeo.io.dem import read_dem
from jaxgeo.io.files import DemFiles, open_dem
from jaxgeo.io.vertical import VerticalDatum
from jaxgeo.io.windows import Bounds
from jaxgeo.terrain.dem import Dem


@dataclasses.dataclass(frozen=True)
class FetchedDem:
    """Parts of an archive's tiles on this machine, and how to read them."""

    archive: Archive
    files: tuple[str, ...]
    bounds: Bounds
    """(west, south, east, north) in deg of the ground that was asked for."""
    vertical_datum: VerticalDatum
    """As for `read_dem`; None if the files state it."""
    tiles: tuple[str, ...]
    """Names of the tiles of which parts are used."""
    sea: tuple[str, ...]
    """Names of the tiles that the archive lacks over the sea, whose height is zero by its rule."""
    gaps: tuple[str, ...]
    """Names of the tiles that the archive lacks elsewhere: there is no ground."""
    fetched: int
    """Bytes that were fetched now, as kept."""
    cached: int
    """Bytes that were in the cache already."""
    cut: int
    """Number of lines of sight that were not followed to the ground, because it is too far away."""
    stated: VerticalDatum = None
    """The datum that the caller states for the heights, as for `read_dem`."""

    def read(self, **options: Any) -> Dem:
        """The ground within `bounds` as a `Dem`; options of `read_dem`."""
        return read_dem(list(self.files), **self._options({"bounds": self.bounds} | options))

    def open(self, **options: Any) -> DemFiles:
        """The parts as a DEM on disk; options of `open_dem`."""
        return open_dem(list(self.files), **self._options(options))

    def _options(self, given: dict[str, Any]) -> dict[str, Any]:
        return {"vertical_datum": self.vertical_datum} | {k: v for k, v in given.items() if v is not None}

    @property
    def datum(self) -> str:
        """The vertical datum of the heights, in words."""
        names = {
            "EPSG:3855": "EGM2008 (EPSG:3855)",
            "EPSG:5773": "EGM96 (EPSG:5773)",
            "EPSG:5703": "NAVD88 (EPSG:5703)",
        }
        own = self.archive.datum
        said = "as its files state" if own is None else names.get(own, own)
        if self.stated is None or self.stated == own:
            return said
        is_number = isinstance(self.stated, float | int)
        taken = f"{self.stated:g} m" if is_number else names.get(f"{self.stated}", f"{self.stated}")
        return taken if own is None else f"{said}, taken as above {taken}"

    def messages(self) -> list[str]:
        """Sentences on the source, its licence, and what was assumed."""
        many = f"{len(self.files)} part{'s' if len(self.files) != 1 else ''} of {listed(self.tiles)}"
        said = [
            f"{self.archive.title}: {many}, {self.fetched / 1e6:.3g} MB fetched, {self.cached / 1e6:.3g} MB from the "
            f"cache; heights above {self.datum}. Licence: {self.archive.licence}."
        ]
        if self.archive.attribution:
            said.append(f"attribution: {self.archive.attribution}")
        if self.sea:
            said.append(
                f"no tile {listed(self.sea)} in the archive: sea, at height zero above {self.datum} by the rule of "
                f"the archive."
            )
        if self.gaps:
            said.append(f"no tile {listed(self.gaps)} in the archive: the elevation model ends there.")
        if self.cut:
            said.append(
                f"lines of sight that do not come down to the ground within {REACH / 1000.0:.0f} km, or rise: "
                f"{self.cut}; the elevation model ends there."
            )
        return said

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "archive": self.archive.name, "title": self.archive.title, "datum": self.archive.datum,
            "licence": self.archive.licence, "attribution": self.archive.attribution, "tiles": list(self.tiles),
            "sea_at_height_zero": list(self.sea), "no_ground": list(self.gaps), "bounds_deg": list(self.bounds),
            "files": list(self.files), "bytes_fetched": self.fetched, "bytes_cached": self.cached,
            "lines_of_sight_cut": self.cut,
        }  # fmt: skip


def listed(names: Iterable[str]) -> str:
    """The first names of a list, and how many more there are."""
    each = list(names)
    return ", ".join(each[:4]) + (f" and {len(each) - 4} more" if len(each) > 4 else "")
