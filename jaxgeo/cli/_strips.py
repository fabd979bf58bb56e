"""Strips of `jaxgeo overlap` and `jaxgeo plan`: forward and side overlap, and the spacing for a wanted side overlap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgeo.cli._common import UserError
from jaxgeo.cli._exposures import GivenExposure
from jaxgeo.cli._screen import is_quiet, print_note, progress_bar, stderr, track

if TYPE_CHECKING:
    from jaxgeo.coverage import SideOverlap

COLUMN = "strip"  # of a table of shots
COLUMNS = {
    "kind": ("overlap", ""),
    "strip": ("strip", ""),
    "next_strip": ("next", ""),
    "images": ("images", "d"),
    "least": ("least", ".4f"),
    "mean": ("mean", ".4f"),
    "spacing_m": ("spacing, m", ".1f"),
    "before": ("least at", ""),
    "after": ("and", ""),
    "lat_deg": ("lat, deg", ".6f"),
    "lon_deg": ("lon, deg", ".6f"),
}
CAPTION = (
    "forward: along the strip, a share of an image's length; side: across, a share of the wider strip, negative "
    "for a gap; least at: images, and for side overlap the place; spacing: between the middles of both strips"
)
DECIMALS = {"least": 6, "mean": 6, "spacing_m": 3, "lat_deg": 8, "lon_deg": 8}
NEEDED = "parallel to 30 deg, with a length of the flight in common"
NO_NEIGHBOURS = f"no strips lie side by side ({NEEDED}), so there is no side overlap"
NO_NEIGHBOUR = f"no other strip lies beside it ({NEEDED}), so it has no side overlap"
Strips = dict[int | str, list[GivenExposure]]


def strips_of(images: Sequence[GivenExposure]) -> Strips:
    """The images of each strip in order of flight: by the names in the column `strip` of a table of shots, else by
    their courses, numbered from 1.

    Raises `UserError` for fewer than two strips, a strip of a single image, rows without a name, and a strip whose
    shots do not lie on a line.
    """
    strips = _named_strips(images) if any(COLUMN in one.cells for one in images) else _strips_by_course(images)
    if len(strips) < 2:
        raise UserError(
            f"--strips: the course of the {len(images)} images is that of one strip; side overlap needs two or more. "
            f'Name them in a column "{COLUMN}" of --shots FILE, or leave --strips out.'
        )
    alone = next((name for name, own in strips.items() if len(own) < 2), None)
    if alone is not None:
        raise UserError(f"--strips: strip {alone} has one image; a strip needs two or more to have a course.")
    if any(COLUMN in one.cells for one in images):
        return {name: _along_course(name, own) for name, own in strips.items()}
    return strips


def _named_strips(images: Sequence[GivenExposure]) -> Strips:
    strips: Strips = {}
    for row, one in enumerate(images, 1):
        name = f"{'' if one.cells.get(COLUMN) is None else one.cells[COLUMN]}".strip()
        if name.lower() in ("", "nan"):
            raise UserError(
                f'--strips: data row {row} of --shots FILE (shot {one.name}) has nothing in the column "{COLUMN}". '
                f"Name its strip, remove the row, or leave the column out to tell strips apart by their courses."
            )
        strips.setdefault(name, []).append(one)
    return strips


def _strips_by_course(images: Sequence[GivenExposure]) -> Strips:
    from jaxgeo.coverage import split_strips

    found = split_strips([one.shot for one in images])
    outside = len(images) - sum(len(own) for own in found)
    if outside:
        print_note(f"strips: {outside} of {len(images)} images are in a turn between strips, and left out.")
    return {number: [images[k] for k in own.tolist()] for number, own in enumerate(found, 1)}


def _along_course(name: int | str, own: list[GivenExposure]) -> list[GivenExposure]:
    """The images of a strip in order of flight. Raises `UserError` if they do not lie on a line."""
    from jaxgeo.coverage._strip_order import NotOnLine, strip_order

    try:
        order = strip_order([one.shot for one in own])
    except NotOnLine as error:
        raise UserError(
            f"--strips: the shots of strip {name} do not lie on a line: {own[error.index].name} is {error.off:.0f} m "
            f'off that of its neighbours. Correct its name in the column "{COLUMN}", or give it a strip per line.'
        ) from error
    if order != sorted(order):
        print_note(f"strip {name}: its shots are not in order of flight, and are put in order along their line.")
    return [own[k] for k in order]


def forward_row(number: int | str, rows: Sequence[dict[str, Any]], means: Sequence[float]) -> dict[str, Any]:
    """The forward overlap of a strip from the rows of its pairs, and the mean of each."""
    known = [row for row in rows if row["least"] is not None]
    worst = min(known, key=lambda row: row["least"]) if known else None
    known_means = [mean for mean in means if np.isfinite(mean)]
    return {
        "kind": "forward",
        "strip": number,
        "next_strip": None,
        "images": len(rows) + 1,
        "least": None if worst is None else worst["least"],
        "mean": float(np.mean(known_means)) if known_means else None,
        "spacing_m": None,
        "before": None if worst is None else worst["before"],
        "after": None if worst is None else worst["after"],
        "lat_deg": None,
        "lon_deg": None,
    }


def side_rows(strips: Strips, terrain: Any) -> tuple[list[dict[str, Any]], dict[int | str, str]]:
    """(rows of neighbouring strips, why others have none, by strip, which is printed on stderr)."""
    from jaxgeo.coverage import SeesNoGround, local_projection, neighbouring_strips, side_overlap, strip_outline

    first = next(iter(strips.values()))[0]
    projection = local_projection(first.shot)
    outlines, unknown = {}, {}
    for number, own in track(list(strips.items()), "computing outlines of strips"):
        try:
            outlines[number] = strip_outline(
                [one.sensor for one in own],
                [one.shot for one in own],
                terrain,
                atmosphere=first.atmosphere,
                projection=projection,
            )
        except SeesNoGround as error:
            unknown[number] = _named(error, own)
            print_note(f"strip {number}: its side overlap is unknown: {unknown[number]}")
    numbers = list(outlines)
    rows = []
    for left, right in neighbouring_strips(list(outlines.values())):
        one, other = numbers[left], numbers[right]
        found = side_overlap(outlines[one], outlines[other])
        rows.append(_side_row((one, other), strips, found))
        if found.without_image:
            share = 100.0 * found.without_image
            print_note(
                f"strips {one} and {other}: {share:.3g} % of their common length has no image of one of them, because "
                f"of a gap along the flight."
            )
    return rows, unknown or _without_neighbour(strips, rows)


def _without_neighbour(strips: Strips, rows: Sequence[dict[str, Any]]) -> dict[int | str, str]:
    """Why strips with an outline are in none of the rows of neighbouring strips, which is printed on stderr."""
    if not rows:
        print_note(f"{NO_NEIGHBOURS}.")
        return dict.fromkeys(strips, NO_NEIGHBOURS)
    beside = {row[one] for row in rows for one in ("strip", "next_strip")}
    alone: dict[int | str, str] = dict.fromkeys((name for name in strips if name not in beside), NO_NEIGHBOUR)
    for name, why in alone.items():
        print_note(f"strip {name}: {why}.")
    return alone


def _named(error: ValueError, own: Sequence[GivenExposure]) -> str:
    """The message of an image that sees no ground, with its name for its index."""
    index, _, said = f"{error}".removeprefix("image ").partition(" of the strip: ")
    return f"{own[int(index)].name}: {said}"


def _side_row(pair: tuple[int | str, int | str], strips: Strips, found: SideOverlap) -> dict[str, Any]:
    where = found.where_least
    lat, lon = np.rad2deg(found.places[where]).tolist()
    before, after = found.images[where].tolist()
    return {
        "kind": "side",
        "strip": pair[0],
        "next_strip": pair[1],
        "images": None,
        "least": found.least,
        "mean": found.mean,
        "spacing_m": found.spacing,
        "before": strips[pair[0]][before].name,
        "after": strips[pair[1]][after].name,
        "lat_deg": lat,
        "lon_deg": (lon + 180.0) % 360.0 - 180.0,
    }


def spacings(sensor: Any, shots: Sequence[Any], terrain: Any, wanted: float, air: Any) -> list[dict[str, Any]]:
    """For each strip of planned shots the spacing in m to the next one on its left and right, printed on stderr.

    A value is None where an image of the next strip sees no ground, or no spacing is small enough, as a note says.
    """
    from jaxgeo.coverage import split_strips

    strips = split_strips(shots)
    found = []
    with progress_bar() as bar:
        task = bar.add_task("computing the strip spacing", total=None)
        for number, own in enumerate(strips, 1):
            row: dict[str, Any] = {"strip": number, "first": int(own[0]), "last": int(own[-1])}
            for side in ("left", "right"):
                say = f"computing the strip spacing, strip {number} of {len(strips)}, {side}"
                bar.update(task, description=say)
                row |= _spacing(sensor, [shots[k] for k in own], terrain, wanted, side, air, number)
            found.append(row)
    for row in found:
        _print_spacing(row, wanted, len(found))
    return found


def _spacing(
    sensor: Any, shots: Sequence[Any], terrain: Any, wanted: float, side: Any, air: Any, number: int
) -> dict[str, Any]:
    from jaxgeo.coverage import strip_spacing

    names = [f"{side}_{what}" for what in ("m", "least", "mean")]
    try:
        one = strip_spacing(sensor, shots, terrain, wanted, side=side, atmosphere=air)
    except ValueError as error:  # of that side only
        print_note(f"strip {number}: the spacing on its {side} is unknown: {error}")
        return dict.fromkeys(names)
    return dict(zip(names, (one.spacing, one.overlap.least, one.overlap.mean), strict=True))


def _print_spacing(row: dict[str, Any], wanted: float, count: int) -> None:
    sides = [
        f"{row[f'{side}_m']:.1f} m to the {side} (mean overlap {row[f'{side}_mean']:.4f})"
        for side in ("left", "right")
        if row[f"{side}_m"] is not None
    ]
    if sides and not is_quiet():
        of = f", exposures {row['first']} to {row['last']}" if count > 1 else ""
        text = f"next strip for a side overlap of {wanted:g} at least{of}: {', '.join(sides)}"
        stderr().print(text, highlight=False, soft_wrap=True)


Overlaps = Callable[[Sequence[GivenExposure], list[float]], list[dict[str, Any]]]


def strip_rows(
    strips: Strips, terrain: Any, overlaps: Overlaps
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], dict[int | str, str]]:
    """(rows of strips and of their sides; pairs of images in strips, with its name; strips without a side)."""
    pairs, forward = [], []
    for number, own in strips.items():
        means: list[float] = []
        rows = overlaps(own, means)
        pairs += [{"strip": number, **row} for row in rows]
        forward.append(forward_row(number, rows, means))
    sides, unknown = side_rows(strips, terrain)
    return [*forward, *sides], pairs, unknown


def as_cells(row: dict[str, Any]) -> dict[str, Any]:
    """A row as cells of a CSV file."""
    texts = {name: None if row[name] is None else f"{row[name]:.{places}f}" for name, places in DECIMALS.items()}
    return {**row, **texts}
