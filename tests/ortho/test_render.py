"""Rendered images show, pixel by pixel, the places that `project` puts there; and rectifying undoes rendering."""

from __future__ import annotations

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import fractal_posts

from jaxgeo import (
    ConstantHeight,
    Dem,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Sensor,
    Shot,
    Status,
    _accelerator,
    project,
)
from jaxgeo.earth import WGS84
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.ortho.rectification import rectify
from jaxgeo.ortho.rendering import render
from jaxgeo.sensor import AbstractCamera
from jaxgeo.studies.gu2017.scene import looking_at
from jaxgeo.terrain import TangentGrid
from jaxgeo.terrain.grid import surface_point

CENTRE = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
ROWS, COLS = 72, 96
CELLS = (96, 96)  # of 25 m
GRID = TangentGrid.centred(CENTRE, spacing=(25.0, 25.0), shape=CELLS)
ROW, COL = np.meshgrid(np.arange(96.0), np.arange(96.0), indexing="ij")
PLACES = np.stack([ROW, COL, np.sin(ROW / 14.0) + np.cos(COL / 17.0)])  # where a place lies, and a smooth texture
POSTS = 100.0 + fractal_posts(65, spacing=40.0, relief=400.0, exponent=2.8, seed=3)
DEM = Dem.from_array(POSTS, TangentGrid.centred(CENTRE, spacing=(40.0, 40.0), shape=POSTS.shape))


def sensor(left: float = 0.0, up: float = 0.0) -> Sensor:
    """A camera whose image lies so many pixels further left and up."""
    principal = 0.5 * (COLS - 1) - left, 0.5 * (ROWS - 1) - up
    camera = FrameCamera.from_pixels(focal_px=220.0, principal_px=principal, width=COLS, height=ROWS)
    return Sensor(camera, Gimbal.fixed(), Mount.nadir())


def shot(off_nadir: float = 70.0) -> Shot:
    return looking_at(CENTRE, off_nadir=off_nadir, azimuth=20.0, above=900.0)


@jax.jit
def _projected(sensor: Sensor, shot: Shot, rowcol, dem: Dem):
    """Pixels of places of the map on a terrain, and their statuses, hidden ones told."""

    def one(place):
        position = WGS84.to_geodetic(surface_point(GRID.normal(place)))
        height = dem.height_at(position)
        found = project(sensor, shot, Geodetic(lat=position.lat, lon=position.lon, height=height), terrain=dem)
        return found.uv, found.status

    return jax.vmap(one)(rowcol)


@pytest.mark.slow
def test_each_pixel_shows_the_nearest_place_that_is_imaged_there() -> None:
    # The map's values are its own rows and columns, so that a pixel tells what it shows.
    seen = render(sensor(), shot(), Orthoimage.of(PLACES, GRID), DEM)
    assert seen.known.mean() > 0.4
    np.testing.assert_array_equal(seen.values[:, ~seen.known], 0.0)
    shown = np.zeros((ROWS * COLS, 2)) + 48.0
    known = seen.known.ravel()
    shown[known] = seen.values[:2].reshape(2, -1).T[known]
    uv, status = (np.asarray(x) for x in _projected(sensor(), shot(), jnp.asarray(shown), DEM))
    pixels = np.stack(np.meshgrid(np.arange(COLS), np.arange(ROWS)), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(uv[known], pixels[known], rtol=0, atol=1e-5)  # px
    inside = known & (np.abs(pixels - [COLS / 2, ROWS / 2]) < [COLS / 2 - 1, ROWS / 2 - 1]).all(axis=1)
    assert np.mean(status[inside] == Status.hit) > 0.99  # none is hidden; at a ridge rounding decides


@pytest.mark.slow
def test_more_rays_are_the_mean_of_images_a_part_of_a_pixel_apart() -> None:
    reference = Orthoimage.of(PLACES, GRID)
    coarse = render(sensor(), shot(), reference, DEM, supersampling=2)
    parts = [render(sensor(left, up), shot(), reference, DEM) for left in (-0.25, 0.25) for up in (-0.25, 0.25)]
    known = np.all([part.known for part in parts], axis=0)
    inside = np.s_[1:-1, 1:-1]  # rays of pixels at the rim leave the image
    np.testing.assert_array_equal(coarse.known[inside], known[inside])
    means = np.where(known, np.mean([part.values for part in parts], axis=0), 0.0)
    np.testing.assert_allclose(coarse.values[:, *inside], means[:, *inside], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_an_image_by_the_program_of_an_accelerator_is_that_of_a_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled for a CPU, and in parts, the last of which is padded."""
    given = sensor(), shot(), Orthoimage.of(PLACES, GRID), DEM
    usual = render(*given)
    monkeypatch.setattr(_accelerator, "on_accelerator", lambda *_: True)
    monkeypatch.setattr(sys.modules["jaxgeo.ortho.rendering"], "on_accelerator", lambda *_: True)
    monkeypatch.setattr(sys.modules["jaxgeo.ortho.rendering"], "CHUNK_ACCELERATOR", 4000)
    found = render(*given)
    assert usual.known.any()
    assert not usual.known.all()
    np.testing.assert_array_equal(found.status, usual.status)
    np.testing.assert_array_equal(found.known, usual.known)
    np.testing.assert_allclose(found.values, usual.values, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_rectifying_undoes_rendering() -> None:
    reference = Orthoimage.of(PLACES, GRID)
    seen = render(sensor(), shot(), reference, DEM)
    back = rectify(sensor(), shot(), seen.values, DEM, GRID, CELLS, known=seen.known).orthoimage
    known = np.asarray(back.known)
    assert known.mean() > 0.05
    error = np.abs(np.asarray(back.values)[2] - PLACES[2])[known]
    assert np.median(error) < 0.03  # of values between -2 and 2; pixels are larger than cells along the look
    assert np.quantile(error, 0.9) < 0.2  # at ridges near and far ground are mixed
    all_of_it = rectify(sensor(), shot(), seen.values, DEM, GRID, CELLS, mask_hidden=False).orthoimage.known
    assert np.asarray(all_of_it).sum() > known.sum()


@pytest.mark.slow
def test_what_is_not_seen_says_why() -> None:
    up = render(sensor(), shot(100.0), Orthoimage.of(PLACES, GRID), DEM)
    assert not up.known.any()
    assert not np.any(up.status == Status.hit)
    beside = Orthoimage.of(PLACES, GRID.window(500.0, 0.0))
    missed = render(sensor(), shot(), beside, DEM)
    assert not missed.known.any()
    assert np.any(missed.status == Status.hit)  # there is ground, but nothing on the map
    holes = np.where(COL[None] > 48.0, np.nan, PLACES)
    half = render(sensor(), shot(), Orthoimage.of(holes, GRID), DEM)
    assert 0.2 < half.known.mean() < 0.8


class _Endless(AbstractCamera):
    """A camera without edges."""

    def ray(self, uv):
        raise NotImplementedError

    def project(self, p_camera):
        raise NotImplementedError

    def time_of(self, uv):
        raise NotImplementedError


@pytest.mark.parametrize(
    "view, options, message",
    [
        (sensor(), {"supersampling": 0}, "supersampling must be 1"),
        (Sensor(_Endless(), Gimbal.fixed(), Mount.nadir()), {}, "no width and height"),
        (sensor(), {"time": 1.0}, "time goes with a Trajectory"),
    ],
)
def test_mistakes_are_named(view: Sensor, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        render(view, shot(), Orthoimage.of(PLACES, GRID), ConstantHeight(100.0), **options)
