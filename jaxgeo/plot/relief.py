"""Shaded relief images and height grids of a terrain in a geographic box, for pages."""

from __future__ import annotations

import base64
import io
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image, features

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.plot.maps import relief_colours
from jaxgeo.terrain import Dem

ACROSS = 1100  # pixels of an image, west to east
OF_HEIGHTS = 128  # columns of the height grid
QUALITY = 82
FINEST, FEWEST = 1.5, 48  # pixels per terrain cell, at most; pixels west to east, at least
PART = 1 << 17  # points at a time


class Box(NamedTuple):
    """A geographic bounding box, deg; longitudes exceed 180 if it crosses the date line."""

    west: float
    south: float
    east: float
    north: float

    @property
    def centre(self) -> tuple[float, float]:
        """(longitude, latitude) in deg."""
        return 0.5 * (self.west + self.east), 0.5 * (self.south + self.north)

    @property
    def sides(self) -> tuple[float, float]:
        """Lengths in m, west to east (at the centre latitude) and south to north."""
        east, north = metres_per_degree(self.centre[1])
        return east * (self.east - self.west), north * (self.north - self.south)

    def grown(self, share: float, least: float = 0.0) -> Box:
        """The box enlarged on every side by a share of its size, each side at least `least` m."""
        (lon, lat), (across, up) = self.centre, self.sides
        east, north = metres_per_degree(lat)
        half_across, half_up = (0.5 * max((1.0 + 2.0 * share) * side, least) for side in (across, up))
        south, top = max(lat - half_up / north, -90.0), min(lat + half_up / north, 90.0)
        return Box(lon - half_across / east, south, lon + half_across / east, top)

    def squared(self) -> Box:
        """The smallest square with the same centre that contains the box."""
        (lon, lat), (east, north) = self.centre, metres_per_degree(self.centre[1])
        half = 0.5 * max(self.sides)
        return Box(lon - half / east, max(lat - half / north, -90.0), lon + half / east, min(lat + half / north, 90.0))


class Relief(NamedTuple):
    """A relief image of a box: its data URL, and its height range."""

    box: Box
    url: str
    between: tuple[float, float]


class Heights(NamedTuple):
    """Heights above WGS 84 in m over a box, (rows, cols) from north-west, NaN where unknown."""

    box: Box
    values: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """Content for the page script: 32-bit floats as base64 text."""
        rows, cols = self.values.shape
        data = base64.b64encode(np.ascontiguousarray(self.values, "<f4").tobytes()).decode("ascii")
        return {"box": list(self.box), "rows": rows, "cols": cols, "data": data}


def metres_per_degree(lat_deg: float) -> tuple[float, float]:
    """Metres per degree (of longitude, of latitude) on the ellipsoid."""
    lat = jnp.deg2rad(jnp.asarray(lat_deg, jnp.float64))
    east = float(WGS84.prime_vertical_radius(lat) * jnp.maximum(jnp.cos(lat), 1e-6))
    return np.deg2rad(east), np.deg2rad(float(WGS84.meridian_radius(lat)))


def relief_of(dem: Dem, box: Box, *, across: int = ACROSS, between: tuple[float, float] | None = None) -> Relief | None:
    """The relief of a terrain in a box; None if no height is known. Points outside the terrain are transparent."""
    found = relief_pixels(dem, box, across=across, between=between)
    return None if found is None else Relief(box, _as_url(found[0]), found[1])


def relief_pixels(
    dem: Dem, box: Box, *, across: int = ACROSS, between: tuple[float, float] | None = None
) -> tuple[np.ndarray, tuple[float, float]] | None:
    """(colours (rows, cols, 4) from 0 to 1, height range) of `relief_of`."""
    wide, high = box.sides
    cell = float(np.min(np.asarray(dem.grid.cell_size())))
    cols = min(across, max(round(FINEST * wide / cell), FEWEST))  # finer images would show facets as steps
    rows = max(round(cols * high / wide), 2)
    finer = 2 if cell < 0.7 * wide / cols else 1  # antialiasing
    heights = sampled(dem, _of_centres(box, rows * finer, cols * finer), rows * finer, cols * finer)
    heights = heights.reshape(rows, finer, cols, finer).mean(axis=(1, 3))
    if np.isfinite(heights).sum() < 4:
        return None
    if between is None:
        between = float(np.nanpercentile(heights, 1.0)), float(np.nanpercentile(heights, 99.5))
    north, east = np.meshgrid(np.linspace(high, 0.0, rows), np.linspace(0.0, wide, cols), indexing="ij")
    with np.errstate(invalid="ignore"):
        colours = relief_colours(heights, east, north, between=between)
    return colours, between


def _of_centres(box: Box, rows: int, cols: int) -> Box:
    """The box spanned by the centres of the outer pixels."""
    half = 0.5 * (box.east - box.west) / cols, 0.5 * (box.north - box.south) / rows
    return Box(box.west + half[0], box.south + half[1], box.east - half[0], box.north - half[1])


def heights_of(dem: Dem, box: Box, across: int = OF_HEIGHTS) -> Heights:
    """Height grid of a terrain in a box."""
    wide, high = box.sides
    return Heights(box, sampled(dem, box, max(round(across * high / wide), 2), across))


def sampled(dem: Dem, box: Box, rows: int, cols: int) -> np.ndarray:
    """Surface heights (rows, cols) in m, north to south and west to east, NaN where unknown."""
    lat, lon = np.meshgrid(
        np.linspace(box.north, box.south, rows), np.linspace(box.west, box.east, cols), indexing="ij"
    )
    lat, lon = np.deg2rad(lat.ravel()), np.deg2rad(lon.ravel())
    parts = []
    for first in range(0, lat.size, PART):
        index = np.minimum(np.arange(first, first + PART), lat.size - 1)
        parts.append(np.asarray(_surface(dem, jnp.asarray(lat[index]), jnp.asarray(lon[index]))))
    return np.concatenate(parts)[: rows * cols].reshape(rows, cols)


@eqx.filter_jit
def _surface(dem: Dem, lat: jax.Array, lon: jax.Array) -> jax.Array:
    return jax.vmap(lambda a, b: dem.height_at(Geodetic(lat=a, lon=b, height=jnp.zeros(()))))(lat, lon)


def _as_url(colours: np.ndarray) -> str:
    """An image as a data URL."""
    content, kind = encoded(colours)
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def encoded(colours: np.ndarray) -> tuple[bytes, str]:
    """(content, media type) of an image file of colours (rows, cols, 4) from 0 to 1."""
    image = Image.fromarray(np.round(255.0 * colours).astype(np.uint8), "RGBA")
    buffer, kind = io.BytesIO(), "webp" if features.check("webp") else "png"
    image.save(buffer, kind.upper(), **({"quality": QUALITY, "method": 4} if kind == "webp" else {"optimize": True}))
    return buffer.getvalue(), f"image/{kind}"
