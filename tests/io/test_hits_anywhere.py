"""First hits on written files, wherever they lie, against a dense march with PROJ and NumPy alone."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
from rasterio.transform import Affine
from support.fractal import ecef, normal_and_height
from support.rasters import hills, write

import jaxgeo

pytestmark = pytest.mark.costly

SIZE = 33
STEP = 200.0  # m between posts
PLACES = {
    # crs, x and y of the centre, cell in the file's unit, latitude and longitude there
    "geographic": ("EPSG:4326", (10.0, 45.0), (1 / 400, 1 / 550)),
    "geographic across the date line": ("EPSG:4326", (180.0, 45.0), (1 / 400, 1 / 550)),
    "geographic in 0..360": ("EPSG:4326", (250.0, -45.0), (1 / 400, 1 / 550)),
    "UTM": ("EPSG:32633", (500000.0, 5000000.0), (STEP, STEP)),
    "polar stereographic about the pole": ("EPSG:3413", (0.0, 0.0), (STEP, STEP)),
    "polar stereographic about the south pole": ("EPSG:3031", (150.0, -90.0), (STEP, STEP)),
    "equal-area": ("EPSG:3035", (4000000.0, 3000000.0), (STEP, STEP)),
}
SLOW = {place for place in PLACES if "geographic" not in place}  # which share a program; maps have others
POSTS = hills((SIZE, SIZE), seed=5) * 2.0


class March:
    """The written file in PROJ and NumPy: no part of jaxgeo."""

    def __init__(self, crs: str, affine: Affine) -> None:
        self.affine = affine
        self.to_map = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True, allow_ballpark=False)
        self.is_degrees = pyproj.CRS(crs).is_geographic

    def place(self) -> tuple[float, float]:
        """Longitude and latitude in deg of the middle post."""
        a, e, c, f = self.affine.a, self.affine.e, self.affine.c, self.affine.f
        x, y = c + a * SIZE / 2, f + e * SIZE / 2
        return self.to_map.transform(x, y, direction="INVERSE")

    def clearance(self, p: np.ndarray) -> np.ndarray:
        """Height above the bilinear surface, NaN beside it."""
        normal, height = normal_and_height(p)
        lon = np.degrees(np.arctan2(normal[:, 1], normal[:, 0]))
        lat = np.degrees(np.arctan2(normal[:, 2], np.hypot(normal[:, 0], normal[:, 1])))
        x, y = self.to_map.transform(lon, lat)
        a, e, c, f = self.affine.a, self.affine.e, self.affine.c, self.affine.f
        if self.is_degrees:
            middle = c + a * SIZE / 2
            x = x - 360.0 * np.round((x - middle) / 360.0)
        col, row = (x - c) / a - 0.5, (y - f) / e - 0.5
        inside = (row >= 0) & (row <= SIZE - 1) & (col >= 0) & (col <= SIZE - 1)
        i, j = (np.clip(np.floor(v), 0, SIZE - 2).astype(int) for v in (row, col))
        u, v = row - i, col - j
        z = POSTS
        surface = (
            z[i, j] * (1 - u) * (1 - v)
            + z[i, j + 1] * (1 - u) * v
            + z[i + 1, j] * u * (1 - v)
            + z[i + 1, j + 1] * u * v
        )
        return np.where(inside, height - surface, np.nan)

    def first_hit(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """Range in m of the first crossing on a march of 0.5 m, refined by bisection."""
        s = np.arange(0.0, 15_000.0, 0.5)
        value = self.clearance(origin + s[:, None] * direction)
        crossed = np.flatnonzero((value[:-1] > 0.0) & (value[1:] <= 0.0))
        low, high = s[crossed[0]], s[crossed[0] + 1]
        for _ in range(50):
            middle = 0.5 * (low + high)
            above = self.clearance(origin[None] + middle * direction)[0] > 0.0
            low, high = (middle, high) if above else (low, middle)
        return 0.5 * (low + high)


def rays_over(lon: float, lat: float) -> tuple[np.ndarray, np.ndarray]:
    """Six rays over the middle of the file, 30 to 80 degrees off nadir, and one from a valley upwards."""
    rng = np.random.default_rng(8)
    lat, lon = np.radians(lat), np.radians(lon)
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east, north, up = np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])
    centre = ecef(lat, lon, 0.0)
    azimuth, zenith = np.linspace(0.0, 5.5, 6), np.radians([30.0, 50.0, 65.0, 72.0, 77.0, 80.0])
    along = np.sin(azimuth)[:, None] * east + np.cos(azimuth)[:, None] * north
    direction = np.sin(zenith)[:, None] * along - np.cos(zenith)[:, None] * up
    target = (
        centre + rng.uniform(-800.0, 800.0, (6, 1)) * east + rng.uniform(-800.0, 800.0, (6, 1)) * north + 900.0 * up
    )
    reach = 1900.0 / np.cos(zenith)
    reach = np.minimum(reach, 2500.0)
    return target - reach[:, None] * direction, direction


intersect_all = jax.jit(jax.vmap(jaxgeo.intersect, in_axes=(0, None)))


@pytest.mark.parametrize("place", [pytest.param(p, marks=pytest.mark.slow) if p in SLOW else p for p in PLACES])
def test_the_first_hit_is_the_same_wherever_the_file_lies(tmp_path, place):
    crs, (x, y), (across, along) = PLACES[place]
    affine = Affine(across, 0.0, x - across * SIZE / 2, 0.0, -along, y + along * SIZE / 2)
    path = write(tmp_path / "posts.tif", POSTS, crs=crs, affine=affine)
    dem = jaxgeo.io.read_dem(path, vertical_datum="ellipsoid")
    march = March(crs, affine)
    origin, direction = rays_over(*march.place())
    fix = intersect_all(jaxgeo.Ray(jnp.asarray(origin), jnp.asarray(direction)), dem)
    expected = [march.first_hit(o, d) for o, d in zip(origin, direction, strict=True)]
    assert np.all(fix.found)
    np.testing.assert_allclose(
        fix.slant_range, expected, rtol=0, atol=1e-5 if "geographic" in place or place == "UTM" else 2e-3
    )
