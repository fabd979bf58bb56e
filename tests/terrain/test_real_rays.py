"""Rays over Mont Ventoux with two independent answers: a dense march with bisection, and another program."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Dem, Geodetic, Ray, Status
from jaxgeo.earth import WGS84


@pytest.fixture(scope="module")
def ventoux(jaxgeo_test_data):
    """The rays, their published hits in ECEF, and which of them meet a cell that touches a void."""
    entries = json.loads((jaxgeo_test_data / "rays" / "ventoux_rays.json").read_text())["rays"]
    sensor, hit, other = (np.array([e[name] for e in entries]) for name in ("sensor", "hit", "independent_hit"))
    rays = Ray(_ecef(sensor), jnp.array([e["dir_ecef"] for e in entries]))
    return rays, _ecef(hit), _ecef(other), np.array([e["hit_cell_has_void"] for e in entries])


def _ecef(lon_lat_height):
    lon, lat, height = lon_lat_height.T
    return jax.jit(jax.vmap(WGS84.to_ecef))(Geodetic.from_degrees(lat=lat, lon=lon, height=height))


@pytest.fixture(scope="module")
def original(jaxgeo_test_data):
    """The file the rays were made for, with a ceiling for its voids: the ground there is no higher than 1500 m."""
    return jaxgeo.io.read_dem(jaxgeo_test_data / "dem" / "N44E005.hgt", vertical_datum="EPSG:5773", void_ceiling=1500.0)


intersect = jax.jit(jax.vmap(jaxgeo.intersect, in_axes=(0, None)))


@pytest.mark.costly
def test_the_published_hits_are_met_to_two_millimetres(ventoux, original):
    """One ray passes a void far below the highest post on its way, so that by default it has no answer."""
    rays, hit, other, touches_void = ventoux
    fix = intersect(rays, original)
    away = np.linalg.norm(fix.ecef - hit, axis=1)[~touches_void]
    apart = np.linalg.norm(fix.ecef - other, axis=1)[~touches_void]
    print(f"{away.size} rays, largest distance {away.max():.1e} m, to the other program's {apart.max():.1e} m")
    assert np.all(fix.ok)
    assert away.max() < 2e-3

    cautious = intersect(rays, Dem.from_array(original.posts, original.grid, void=original.void))
    over_void = np.asarray(cautious.status) == Status.hits_void
    assert over_void.sum() == 1
    assert np.linalg.norm(cautious.ecef - hit, axis=1)[~touches_void & ~over_void].max() < 2e-3


@pytest.mark.slow
def test_another_file_of_the_same_ground_differs_by_its_resampling(ventoux, original, jaxgeo_test_data):
    """The UTM file was resampled to 90 m from the same heights: its bilinear surface is another one.

    Hits differ by what the two surfaces differ in height there, times the tangent of incidence; the map is exact.
    """
    rays, _, _, touches_void = ventoux
    resampled = jaxgeo.io.read_dem(
        jaxgeo_test_data / "dem" / "N44E005_UTM.tif", vertical_datum="EPSG:5773", void_ceiling=1500.0
    )
    first, second = intersect(rays, original), intersect(rays, resampled)
    seen = np.asarray(second.ok) & ~touches_void
    surface = jax.jit(jax.vmap(Dem.height_at, in_axes=(None, 0)))(original, second.position)
    higher = np.abs(surface - second.position.height)
    away = np.linalg.norm(first.ecef - second.ecef, axis=1)
    print(
        f"{seen.sum()} rays; distance median {np.median(away[seen]):.2f} m, largest {away[seen].max():.2f} m; "
        f"surfaces differ by {np.median(higher[seen]):.2f} m (median)"
    )
    assert seen.sum() >= 20
    assert np.median(away[seen]) < 5.0
    steepness = np.abs(1.0 / np.cos(second.incidence_surface)) / np.cos(second.slope)
    explained = higher * np.maximum(steepness, 1.0)
    assert np.mean(away[seen] < 3.0 * explained[seen] + 0.01) > 0.9
