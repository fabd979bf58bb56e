"""Grids: both ways are inverses, steps are metres, derivatives are true, at the pole and the date line too."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pyproj import Geod, Transformer

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.earth.projection import TransverseMercator
from jaxgeo.terrain.grid import (
    AbstractGrid,
    FittedGrid,
    GeographicGrid,
    TangentGrid,
    TransverseMercatorGrid,
    surface_point,
)

SHAPE = (301, 201)


def geographic(lon: float, lat: float) -> GeographicGrid:
    return GeographicGrid.from_affine((1 / 1200, 0, lon, 0, -1 / 1200, lat), SHAPE)


def tangent(lat: float, lon: float, heading: float = 0.0) -> TangentGrid:
    centre = Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    return TangentGrid.centred(centre, spacing=(30.0, 20.0), shape=SHAPE, heading=heading)


def fitted() -> FittedGrid:
    """A smooth warp of the tangent plane; its inverse polynomial is only approximate, as after a fit."""
    plain = tangent(46.0, 11.0)
    coefficients = np.zeros((4, 4, 2))
    coefficients[0, 1, 0], coefficients[1, 0, 1] = -1.0, 1.0
    inverse = coefficients[..., ::-1].copy()
    inverse[1, 0], inverse[0, 1] = (0.0, -1.0), (1.0, 0.0)
    coefficients[2, 1], coefficients[1, 1] = (1e-6, -2e-6), (3e-6, 1e-6)
    half = jnp.array([1e-3, 1e-3])
    return FittedGrid(
        plain.rowcol0,
        plain.R_enu_from_ecef,
        half,
        jnp.array([200.0, 300.0]),
        jnp.asarray(coefficients),
        jnp.asarray(inverse),
    )


GRIDS = {
    "geographic": lambda: geographic(5.0, 45.0),
    "geographic across the date line": lambda: geographic(179.95, -16.0),
    "geographic from 0 to 360": lambda: geographic(359.95, 10.0),
    "geographic sheared": lambda: GeographicGrid.from_affine((1e-3, 2e-4, 5.0, -3e-4, -1e-3, 45.0), SHAPE),
    "utm": lambda: TransverseMercatorGrid.from_affine(
        TransverseMercator.utm(31), (30.0, 0, 657596.0, 0, -30.0, 4987377.0), SHAPE
    ),
    "utm rotated, date line": lambda: TransverseMercatorGrid.from_affine(
        TransverseMercator.utm(1, north=False), (20.0, 5.0, 177000.0, 5.0, -20.0, 8230000.0), SHAPE
    ),
    "tangent": lambda: tangent(36.0, -84.0, heading=0.4),
    "tangent at the pole": lambda: tangent(90.0, 0.0),
    "tangent on the date line": lambda: tangent(-16.0, 180.0),
    "fitted": fitted,
}
PLACES = jnp.array([[0.0, 0.0], [300.0, 200.0], [150.0, 100.0], [0.3, 199.7], [-20.0, 230.0], [149.9, 100.1]])


@pytest.fixture(params=GRIDS, scope="module")
def grid(request: pytest.FixtureRequest) -> AbstractGrid:
    return GRIDS[request.param]()


cell_sizes = jax.jit(lambda grid: grid.cell_size())
normals_at = jax.jit(jax.vmap(lambda grid, rowcol: grid.normal(rowcol), in_axes=(None, 0)))


@jax.jit
def along(grid: AbstractGrid, normal, t):
    """(row, col) on the way from a normal along an axis, with its first and second derivative."""

    def value(t):
        n = normal + t * jnp.array([0.3, -0.5, 0.8])
        return grid.rowcol(n / jnp.linalg.norm(n))

    return value(t), jax.jacfwd(value)(t), jax.jacfwd(jax.jacfwd(value))(t)


@jax.jit
def there_and_back(grid: AbstractGrid, rowcol):
    normal = jax.vmap(grid.normal)(rowcol)
    return normal, jax.vmap(grid.rowcol)(normal)


def test_both_ways_are_inverses(grid: AbstractGrid) -> None:
    normal, back = there_and_back(grid, PLACES)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(back, PLACES, rtol=0, atol=1e-9)  # cells


@pytest.mark.costly
def test_cell_size_is_the_distance_between_neighbours(grid: AbstractGrid) -> None:
    centre = jnp.asarray(grid.rowcol0)
    around = centre[None] + jnp.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
    p = np.asarray(jax.vmap(surface_point)(normals_at(grid, around)))
    steps = [np.linalg.norm(p[1] - p[0]), np.linalg.norm(p[3] - p[2])]
    np.testing.assert_allclose(cell_sizes(grid), steps, rtol=1e-6)


@pytest.mark.costly
def test_derivatives_equal_differences(grid: AbstractGrid) -> None:
    normal, h = normals_at(grid, jnp.array([[100.2, 50.7]]))[0], 1e-5
    _, first, second = along(grid, normal, 0.0)
    value_after, first_after, _ = along(grid, normal, h)
    value_before, first_before, _ = along(grid, normal, -h)
    scale = np.abs(first).max()
    np.testing.assert_allclose(first, (value_after - value_before) / (2 * h), rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(second, (first_after - first_before) / (2 * h), rtol=0, atol=1e-4 * scale)


def test_a_window_is_the_same_ground(grid: AbstractGrid) -> None:
    window = grid.window(10.0, 20.0)
    here, there = jnp.array([[5.0, 7.0]]), jnp.array([[15.0, 27.0]])
    np.testing.assert_allclose(normals_at(window, here), normals_at(grid, there), rtol=0, atol=1e-15)


def test_utm_posts_are_where_proj_says() -> None:
    grid = GRIDS["utm"]()
    lon, lat = Transformer.from_crs(32631, 4326, always_xy=True).transform(657596.0 + 30 * 7.25, 4987377.0 - 30 * 3.5)
    expected = Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    p = surface_point(grid.normal(jnp.array([3.5, 7.25])))
    np.testing.assert_allclose(p, WGS84.to_ecef(expected), rtol=0, atol=1e-6)  # m


@pytest.mark.parametrize("lon", [-180.0, 180.0, 540.0])
def test_longitudes_may_be_off_by_whole_turns(lon: float) -> None:
    reference = geographic(-180.05, 12.0)
    shifted = geographic(lon - 0.05, 12.0)
    normal = reference.normal(jnp.array([11.0, 22.0]))
    np.testing.assert_allclose(shifted.rowcol(normal), [11.0, 22.0], rtol=0, atol=1e-9)


def test_tangent_rows_go_south_and_columns_east() -> None:
    grid = tangent(36.0, -84.0)
    normals = jax.vmap(grid.normal)(jnp.array([[150.0, 100.0], [151.0, 100.0], [150.0, 101.0]]))
    lat, lon = np.degrees(np.arcsin(normals[:, 2])), np.degrees(np.arctan2(normals[:, 1], normals[:, 0]))
    geod = Geod(ellps="WGS84")
    azimuth, _, distance = geod.inv([lon[0]] * 2, [lat[0]] * 2, lon[1:], lat[1:])
    np.testing.assert_allclose(np.mod(azimuth, 360), [180.0, 90.0], rtol=0, atol=1e-3)
    np.testing.assert_allclose(distance, [30.0, 20.0], rtol=0, atol=1e-6)


def test_tangent_heading_turns_the_grid_clockwise() -> None:
    grid = tangent(0.0, 0.0, heading=math.radians(90.0))
    normals = jax.vmap(grid.normal)(jnp.array([[151.0, 100.0], [150.0, 101.0]]))
    assert normals[0, 1] < -1e-6  # rows went south, now west
    assert normals[1, 2] < -1e-6  # columns went east, now south


def test_fitted_goes_on_without_folding_far_outside() -> None:
    grid = fitted()
    plane = jnp.stack([jnp.linspace(-0.5, 0.5, 201), jnp.zeros(201)], axis=1)
    normals = jnp.concatenate([plane, jnp.ones((201, 1))], axis=1) @ grid.R_enu_from_ecef
    cols = jax.vmap(grid.rowcol)(normals / jnp.linalg.norm(normals, axis=1, keepdims=True))[:, 1]
    assert np.all(np.diff(cols) > 0.0)


def test_the_far_side_of_the_earth_is_outside() -> None:
    grid = tangent(10.0, 20.0)
    rowcol = grid.rowcol(-grid.normal(jnp.array([100.0, 50.0])))
    assert np.all(np.isfinite(rowcol))
    far = Geodetic.from_degrees(lat=-11.0, lon=-155.0, height=0.0)
    normal, _ = WGS84.normal_and_height(WGS84.to_ecef(far))
    assert np.abs(grid.rowcol(normal) - jnp.array([150.0, 100.0])).max() > 1000.0


def test_another_grid_of_the_same_kind_does_not_recompile() -> None:
    calls = []

    @jax.jit
    def rowcol(grid, normal):
        calls.append(1)
        return grid.rowcol(normal)

    for lon in (3.0, 9.0):
        grid = TransverseMercatorGrid.from_affine(
            TransverseMercator.gauss_krueger(math.radians(lon)), (30.0, 0, 500000.0 + lon, 0, -30.0, 5e6), SHAPE
        )
        rowcol(grid, grid.normal(jnp.array([1.0, 2.0])))
    assert len(calls) == 1
