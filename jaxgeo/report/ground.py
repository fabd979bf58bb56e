"""The ground of a map: pictures of its relief, each a part of the page, and its heights for the pointer."""

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

ACROSS = 1100  # pixels of a picture from west to east
OF_HEIGHTS = 128  # places of the grid of heights from west to east
QUALITY = 82
FINEST, FEWEST = 1.5, 48  # pixels of a picture to a cell of the terrain, and from west to east
PART = 1 << 17  # places at a time


class Box(NamedTuple):
    """A part of the Earth between meridians and parallels, deg; longitudes go on beyond 180 where it crosses that."""

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
        """Lengths in m from west to east, in the middle, and from south to north."""
        east, north = metres_per_degree(self.centre[1])
        return east * (self.east - self.west), north * (self.north - self.south)

    def grown(self, share: float, least: float = 0.0) -> Box:
        """Larger on every side by a share of its own, and no side shorter than `least` m."""
        (lon, lat), (across, up) = self.centre, self.sides
        east, north = metres_per_degree(lat)
        half_across, half_up = (0.5 * max((1.0 + 2.0 * share) * side, least) for side in (across, up))
        south, top = max(lat - half_up / north, -90.0), min(lat + half_up / north, 90.0)
        return Box(lon - half_across / east, south, lon + half_across / east, top)

    def squared(self) -> Box:
        """The least square about the same middle that holds it, so that charts of any shape are filled."""
        (lon, lat), (east, north) = self.centre, metres_per_degree(self.centre[1])
        half = 0.5 * max(self.sides)
        return Box(lon - half / east, max(lat - half / north, -90.0), lon + half / east, min(lat + half / north, 90.0))


class Relief(NamedTuple):
    """A picture of the ground in a box: its address, which holds all of it, and the heights between which it goes."""

    box: Box
    url: str
    between: tuple[float, float]


class Heights(NamedTuple):
    """Heights above WGS 84 in m over a box, (rows, cols) from north-west, NaN where they are not known."""

    box: Box
    values: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """For the script of the page: 32-bit floats as text."""
        rows, cols = self.values.shape
        data = base64.b64encode(np.ascontiguousarray(self.values, "<f4").tobytes()).decode("ascii")
        return {"box": list(self.box), "rows": rows, "cols": cols, "data": data}


def metres_per_degree(lat_deg: float) -> tuple[float, float]:
    """(of longitude, of latitude) on the ellipsoid."""
    lat = jnp.deg2rad(jnp.asarray(lat_deg, jnp.float64))
    east = float(WGS84.prime_vertical_radius(lat) * jnp.maximum(jnp.cos(lat), 1e-6))
    return np.deg2rad(east), np.deg2rad(float(WGS84.meridian_radius(lat)))


def relief_of(dem: Dem, box: Box, *, across: int = ACROSS, between: tuple[float, float] | None = None) -> Relief | None:
    """The relief of a terrain in a box; None where none of it is known. Places beside the terrain are transparent."""
    wide, high = box.sides
    cell = float(np.min(np.asarray(dem.grid.cell_size())))
    cols = min(across, max(round(FINEST * wide / cell), FEWEST))  # finer, facets would look like steps
    rows = max(round(cols * high / wide), 2)
    finer = 2 if cell < 0.7 * wide / cols else 1  # smooths what is too fine
    heights = sampled(dem, _of_centres(box, rows * finer, cols * finer), rows * finer, cols * finer)
    heights = heights.reshape(rows, finer, cols, finer).mean(axis=(1, 3))
    if np.isfinite(heights).sum() < 4:
        return None
    if between is None:
        between = float(np.nanpercentile(heights, 1.0)), float(np.nanpercentile(heights, 99.5))
    north, east = np.meshgrid(np.linspace(high, 0.0, rows), np.linspace(0.0, wide, cols), indexing="ij")
    with np.errstate(invalid="ignore"):
        colours = relief_colours(heights, east, north, between=between)
    return Relief(box, _as_url(colours), between)


def _of_centres(box: Box, rows: int, cols: int) -> Box:
    """From the middles of the outer pixels to those across."""
    half = 0.5 * (box.east - box.west) / cols, 0.5 * (box.north - box.south) / rows
    return Box(box.west + half[0], box.south + half[1], box.east - half[0], box.north - half[1])


def heights_of(dem: Dem, box: Box, across: int = OF_HEIGHTS) -> Heights:
    """Heights of a terrain in a box."""
    wide, high = box.sides
    return Heights(box, sampled(dem, box, max(round(across * high / wide), 2), across))


def sampled(dem: Dem, box: Box, rows: int, cols: int) -> np.ndarray:
    """Heights (rows, cols) in m of the surface, from north to south and west to east, NaN where it is not known."""
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
    """A picture as an address that holds it."""
    image = Image.fromarray(np.round(255.0 * colours).astype(np.uint8), "RGBA")
    buffer, kind = io.BytesIO(), "webp" if features.check("webp") else "png"
    image.save(buffer, kind.upper(), **({"quality": QUALITY, "method": 4} if kind == "webp" else {"optimize": True}))
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
