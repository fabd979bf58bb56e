"""Height metadata (unit, scale, voids, vertical CRS) inherited by a VRT from its sources, with consistency checks.

`gdalbuildvrt` drops units and vertical CRS, and GDAL copies stored values without the source's scale: a mosaic in
feet would be read in metres.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pyproj
from pyproj.crs import CompoundCRS

from jaxgeo.io.errors import DemError
from jaxgeo.io.height_units import alike, stated_unit, unit_of_crs, unit_shown
from jaxgeo.io.vertical import horizontal_part, vertical_part
from jaxgeo.io.vrt import NAME_TILES, VrtBand, VrtSource, holes

if TYPE_CHECKING:
    from jaxgeo.io.tiles import Tile


@dataclasses.dataclass(frozen=True)
class _Facts:
    """Metadata of the values that a VRT takes from a file."""

    path: str
    unit: float | str | None
    by_crs: float | None
    vertical: pyproj.CRS | None
    scale: tuple[float, float]
    is_rescaled: bool = False


def inherit(tile: Tile, vrt: VrtBand, headers: list[Tile]) -> Tile:
    """The header of a VRT completed with its sources' metadata; `headers` are in the order of `vrt.sources`.

    Raises `DemError` if sources differ from each other or from the VRT, or if voids would become heights.
    """
    pairs = list(zip(vrt.sources, headers, strict=True))
    for source, header in pairs:
        _check_type(tile, source, header)
    verticals = {id(header.crs): vertical_part(header.crs, unnamed=True) for header in headers}
    sources = [_facts(tile, source, header, verticals[id(header.crs)]) for source, header in pairs]
    own = _Facts(
        tile.path, stated_unit(tile), unit_of_crs(tile.crs), vertical_part(tile.crs), (tile.scale, tile.offset)
    )
    unit, crs = _unit(tile, own, sources), _crs(tile, own, sources)
    scale, offset = _scale(vrt, own, sources)
    marks = _voids(tile, vrt, pairs)
    fields = {header.datum_field for header in headers}
    datum_field = fields.pop() if len(fields) == 1 else None
    return dataclasses.replace(
        tile, unit=unit, crs=crs, scale=scale, offset=offset, marks=marks, datum_field=datum_field
    )


def _check_type(tile: Tile, source: VrtSource, header: Tile) -> None:
    """Raises `DemError` if a VRT with an integer dtype would round the heights of a source."""
    is_rounded = tile.dtype.kind != "f" and not np.can_cast(header.dtype, tile.dtype, "safe")
    is_rounded |= tile.dtype.kind != "f" and any(number % 1.0 for number in source.scaling or ())
    if is_rounded:
        raise DemError(
            f"{tile.path}: it holds heights as {tile.dtype} and rounds those of its source {source.file}. {NAME_TILES}."
        )


def _facts(tile: Tile, source: VrtSource, header: Tile, vertical: pyproj.CRS | None) -> _Facts:
    own = (header.scale, header.offset)
    facts = _Facts(header.path, stated_unit(header), unit_of_crs(header.crs), vertical, own)
    if source.scaling is None:
        return facts
    if source.nodata is None:
        raise DemError(
            f"{tile.path}: it scales its source {source.file} by {source.scaling[0]:g} without NODATA, so that voids "
            f"become heights. {NAME_TILES}, or write the VRT anew with <NODATA> in that source."
        )
    if all(math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-12) for a, b in zip(source.scaling, own, strict=True)):
        return dataclasses.replace(facts, scale=(1.0, 0.0))
    if own != (1.0, 0.0):
        raise DemError(
            f"{tile.path}: it scales its source {source.file} by {source.scaling[0]:g}, and that file states a scale "
            f"of {own[0]:g} itself. {NAME_TILES}."
        )
    return dataclasses.replace(facts, is_rescaled=True)


def _unit(tile: Tile, own: _Facts, sources: list[_Facts]) -> str | None:
    """The unit of a VRT's band: its own, else that of all its sources."""
    rescaled = next((source for source in sources if source.is_rescaled), None)
    if rescaled is not None and own.unit is None:
        raise DemError(
            f"{tile.path}: it scales its source {rescaled.path}, and nothing states the unit of the result. "
            f"{NAME_TILES}, or write <UnitType> into the VRT's band."
        )
    others = [source for source in sources if not source.is_rescaled]
    if own.unit is not None:
        wrong = next((s for s in others if s.unit is not None and not alike(s.unit, own.unit)), None)
        if wrong is not None:
            raise _at_odds(tile, wrong, f"states heights in {unit_shown(own.unit)}", f"in {unit_shown(wrong.unit)}")
        return tile.unit
    metres = 1.0 if tile.is_geographic or tile.map_unit == 1.0 else None
    stated = {id(s): s.unit if s.unit is not None else metres for s in others}
    odd = next((s for s in others if not alike(stated[id(s)], stated[id(others[0])])), None)
    if odd is not None:
        first = others[0]
        shown = [f"{s.path} states {unit_shown(s.unit)}" for s in (first, odd)]
        raise DemError(
            f"{tile.path}: its sources differ in the unit of their heights: {shown[0]}, {shown[1]}. Convert them to "
            f"one unit first (gdal_calc), or read those of one unit at a time."
        )
    return _word(others, stated) if others else None


def _word(others: list[_Facts], stated: dict[int, float | str | None]) -> str | None:
    """A unit as a band would state it; None if the inherited vertical CRS states it."""
    unit = stated[id(others[0])]
    if unit is None or all(s.unit is None for s in others):
        return None
    if all(s.by_crs is not None and alike(s.by_crs, unit) for s in others) and all(
        s.vertical is not None for s in others
    ):
        return None
    return unit if isinstance(unit, str) else unit_shown(unit)


def _crs(tile: Tile, own: _Facts, sources: list[_Facts]) -> pyproj.CRS:
    """The CRS of a VRT with the vertical part of its sources, if it has none itself."""
    stating = [source for source in sources if source.vertical is not None]
    if not stating:
        return tile.crs
    expected = own if own.vertical is not None else stating[0]
    for source in stating if own.vertical is not None else sources:
        if not _same(source.vertical, expected.vertical):
            raise _at_odds(
                tile, source, f"has heights above {_named(expected.vertical)}", f"above {_named(source.vertical)}",
                "it" if expected is own else expected.path,
            )  # fmt: skip
    if own.vertical is not None:
        return tile.crs
    flat, vertical = horizontal_part(tile.crs), stating[0].vertical
    if vertical.is_vertical:  # pyright: ignore[reportOptionalMemberAccess]
        return CompoundCRS(f"{flat.name} + {vertical.name}", components=[flat, vertical])  # pyright: ignore
    return flat.to_3d()


def _scale(vrt: VrtBand, own: _Facts, sources: list[_Facts]) -> tuple[float, float]:
    """(scale, offset) of a VRT's band: its own, else those of all its sources."""
    plain = (1.0, 0.0)
    expected = own.scale if vrt.states_scale else sources[0].scale
    allowed = (expected, plain) if vrt.states_scale else (expected,)
    wrong = next((source for source in sources if source.scale not in allowed), None)
    if wrong is not None:
        raise DemError(
            f"{own.path}: scale and offset of its heights are {expected} "
            f"{'in the VRT' if vrt.states_scale else f'in {sources[0].path}'} and {wrong.scale} in {wrong.path}. "
            f"{NAME_TILES}."
        )
    return expected


def _voids(tile: Tile, vrt: VrtBand, pairs: list[tuple[VrtSource, Tile]]) -> tuple[float, ...]:
    """Further void values: those of sources whose voids are copied unchanged."""
    if tile.nodata is None and not tile.has_mask:
        masked = next((s for s, h in pairs if s.nodata is not None or s.uses_mask or h.has_mask), None)
        if masked is not None or holes(vrt):
            where = "some posts are covered by no source" if masked is None else f"its source {masked.file} has voids"
            raise DemError(
                f"{tile.path}: {where} and the VRT has no nodata value, so that GDAL gives 0 there. {NAME_TILES}, or "
                f"write the VRT anew (gdalbuildvrt -vrtnodata -32768)."
            )
    marks: dict[float, str] = {}
    for source, header in pairs:
        if header.has_mask and not source.uses_mask and not tile.has_mask:
            raise DemError(f"{tile.path}: it leaves out the mask of its source {source.file}. {NAME_TILES}.")
        copied = header.nodata if source.nodata is None else None
        if copied is not None and not math.isnan(copied) and copied != tile.nodata:
            marks[copied] = header.path
    if len(marks) > 1:
        (a, one), (b, other), *_ = marks.items()
        raise DemError(
            f"{tile.path}: its sources mark voids by different values ({a:g} in {one}, {b:g} in {other}) and it passes "
            f"both on as heights. {NAME_TILES}."
        )
    return tuple(marks)


def _at_odds(tile: Tile, source: _Facts, ours: str, theirs: str, who: str = "it") -> DemError:
    return DemError(f"{tile.path}: {who} {ours}, its source {source.path} {theirs}. {NAME_TILES}.")


def _named(crs: pyproj.CRS | None) -> str:
    return "no stated datum" if crs is None else repr(crs.name)


def _same(a: pyproj.CRS | None, b: pyproj.CRS | None) -> bool:
    if a is None or b is None:
        return a is b
    return a is b or a.equals(b, ignore_axis_order=True) or (a.name == b.name and unit_of_crs(a) == unit_of_crs(b))
