"""Rendering: synthetic camera images of an orthoimage draped over terrain."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Int8

from jaxgeo._accelerator import by_device, on_accelerator
from jaxgeo._arguments import check_terrain, checked_air, checked_exposure
from jaxgeo._checks import check_is
from jaxgeo._compile import MOST_ROWS, ROWS, batch_filter_jit, long_run_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo.earth import WGS84, Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.observation import Exposure, accepts_exposure
from jaxgeo.ortho.interpolation import AbstractInterpolation, Bilinear, Pixels, sampled
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Bracket
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.uncertainty.model_inputs import ModelInputs, located_each

CHUNK, CHUNK_ACCELERATOR = ROWS, 2**20  # rays per call: one size, compiled once
MANY = 4_000_000  # rays; a program that is optimised more repays its compiling from here on
BILINEAR = Bilinear()


class Rendered(NamedTuple):
    """A rendered image: values (bands, rows, cols), zero where unknown; mask of pixels whose rays all hit known
    cells of the orthoimage; and the `Status` of each pixel: that of its first ray without a hit, else `hit`."""

    values: Float[np.ndarray, "bands rows cols"]
    known: Bool[np.ndarray, "rows cols"]
    status: Int8[np.ndarray, "rows cols"]


class Met(NamedTuple):
    """First terrain hits of lines of sight: points in ECEF m, latitude and longitude in rad and height in m, the
    terrain cell, and the `Status` of each; a point on the equator where it is not `hit`."""

    p_ecef: Float[Any, "n 3"]
    lat: Float[Any, " n"]
    lon: Float[Any, " n"]
    height: Float[Any, " n"]
    cell: Int[Any, "n 2"]
    status: Int8[Any, " n"]


@accepts_exposure
def render(
    sensor: Sensor,
    shot: Shot | Trajectory,
    reference: Orthoimage,
    terrain: AbstractTerrain,
    *,
    supersampling: int = 1,
    interpolation: AbstractInterpolation = BILINEAR,
    time: ArrayLike | None = None,
    atmosphere: Atmosphere | None = None,
) -> Rendered:
    """Render the image (bands, rows, cols) of an orthoimage for a shot (or a trajectory and the image's `time`).

    The inverse of `rectify`, by ray tracing: each pixel's line of sight is intersected with the terrain (`locate`,
    first hit), and the orthoimage is sampled there. `terrain` is a `Dem` or a `ConstantHeight`. A pixel is the mean of
    `supersampling` x `supersampling` evenly spaced rays; choose it so that their ground spacing does not exceed the
    cells of the orthoimage. `known` flags pixels whose rays all hit a known part of it; elsewhere the value is zero.
    `status` is the reason if a line of sight fails, and `hit` outside the orthoimage. Illumination and atmospheric
    radiance are not modelled: brightness is that of the orthoimage.

    Raises `ValueError` for a camera without a size and a `supersampling` under 1, and as `locate` does.
    """
    check_is(reference, Orthoimage, "reference")
    check_is(interpolation, AbstractInterpolation, "interpolation")
    check_terrain(terrain, FIRST_HIT)
    sensor, motion, moment = checked_exposure(sensor, shot, time)
    rows, cols = _size_of(sensor)
    if supersampling < 1:
        raise ValueError(f"supersampling must be 1 ray a pixel along each axis or more; got {supersampling}.")
    inputs = ModelInputs(Exposure(sensor, motion, moment, checked_air(atmosphere)), terrain=terrain)
    total, seen, status = np.zeros(()), np.ones(rows * cols, bool), np.zeros(rows * cols, np.int8)
    pixels = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)
    for offset in _offsets(supersampling):
        value, is_known, code = seen_at(inputs, reference, pixels + offset[None, :], interpolation)
        total, seen = total + value, seen & is_known
        status = np.where(status == Status.hit, code, status)
    means = np.where(seen[None, :], total / supersampling**2, 0.0)
    return Rendered(means.reshape(-1, rows, cols), seen.reshape(rows, cols), status.reshape(rows, cols))


def seen_at(
    inputs: ModelInputs, reference: Orthoimage, uv: Float[np.ndarray, "n 2"], how: AbstractInterpolation = BILINEAR
) -> tuple[Float[np.ndarray, "bands n"], Bool[np.ndarray, " n"], Int8[np.ndarray, " n"]]:
    """(orthoimage values at the first terrain hits of pixels, zero if unknown; mask of known values; the `Status`).
    Pixels may lie outside the image where the camera still defines rays."""
    pixels = Pixels.of(jnp.asarray(reference.values), jnp.asarray(reference.known))
    if on_accelerator():  # where the fixes stay; all parts are sent before the first comes back
        parts: Any = [_seen_there(inputs, reference.grid, pixels, part, how) for part in _chunks(uv, _chunk())]
    else:
        found = met(inputs, uv)
        parts = [(*_sampled_on(reference.grid, pixels, part, how), part.status) for part in _chunks(found, _chunk())]
    values = (np.concatenate([np.asarray(x) for x in column], axis=-1) for column in zip(*parts, strict=True))
    value, is_known, status = (x[..., : len(uv)] for x in values)
    return value, is_known, status


def met(inputs: ModelInputs, uv: Float[np.ndarray, "n 2"]) -> Met:
    """First terrain hits of pixels; they may lie outside the image."""
    if len(uv) > MANY:
        parts = [_located_many(inputs, part) for part in _chunks(uv, _chunk())]
    else:
        filled, most = np.concatenate(_chunks(uv, _chunk())), by_device(MOST_ROWS, CHUNK_ACCELERATOR)
        parts = [located_each(inputs, filled[k : k + most]) for k in range(0, len(filled), most)]
    found = jax.tree.map(lambda *x: np.concatenate([np.asarray(part) for part in x])[: len(uv)], *parts)
    return _met_of(np, *found)


def _met_of(xp: Any, fix: Fix, bracket: Bracket) -> Met:
    hit, nowhere = fix.status == Status.hit, np.array([WGS84.a, 0.0, 0.0])
    lat, lon, height = (xp.where(hit, x, 0.0) for x in (fix.position.lat, fix.position.lon, fix.position.height))
    return Met(xp.where(hit[:, None], fix.ecef, nowhere), lat, lon, height, bracket.cell, fix.status)


def _chunk() -> int:
    return by_device(CHUNK, CHUNK_ACCELERATOR)


def _chunks(rows: Any, size: int) -> list[Any]:
    """Arrays with the same leading axis in parts of `size` rows; the last one is filled up, so that all fit one
    program."""
    count = len(jax.tree.leaves(rows)[0])
    if count == 0:
        return [jax.tree.map(lambda x: np.zeros((size, *x.shape[1:]), x.dtype), rows)]
    index = np.minimum(np.arange(-(-count // size) * size), count - 1).reshape(-1, size)
    return [jax.tree.map(lambda x, k=k: x[k], rows) for k in index]


# One program, which runs faster, and is worth its time to compile.
_located_many = long_run_filter_jit(located_each)


@long_run_filter_jit
def _seen_there(
    inputs: ModelInputs, grid: AbstractGrid, pixels: Pixels, uv: Float[Array, "n 2"], how: AbstractInterpolation
) -> tuple[Float[Array, "bands n"], Bool[Array, " n"], Int8[Array, " n"]]:
    """As `seen_at`, in one program."""
    found = _met_of(jnp, *located_each(inputs, uv))
    return *_sampled_on(grid, pixels, found, how), found.status


@batch_filter_jit
def _sampled_on(
    grid: AbstractGrid, pixels: Pixels, found: Met, how: AbstractInterpolation
) -> tuple[Float[Array, "bands n"], Bool[Array, " n"]]:
    """(values, mask of known values) of an orthoimage at points."""
    rowcol = jax.vmap(lambda p: grid.rowcol(WGS84.normal_and_height(p)[0]))(found.p_ecef)
    (rows, cols), row, col = pixels.shape, rowcol[:, 0], rowcol[:, 1]
    on = (row >= -0.5) & (row <= rows - 0.5) & (col >= -0.5) & (col <= cols - 0.5) & (found.status == Status.hit)
    bands, sound = sampled(pixels, (jnp.where(on, col, 0.0), jnp.where(on, row, 0.0)), how)
    return jnp.where((on & sound)[None, :], jnp.stack(bands), 0.0), on & sound


def _offsets(count: int) -> Float[np.ndarray, "rays 2"]:
    """Ray offsets within a pixel, (column, row) from its centre."""
    steps = (np.arange(count) + 0.5) / count - 0.5
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def _size_of(sensor: Sensor) -> tuple[int, int]:
    """(rows, cols) of a sensor's images."""
    height, width = (getattr(sensor.camera, side, None) for side in ("height", "width"))
    sizes: Any = height, width
    if None in sizes:
        raise ValueError(f"a {type(sensor.camera).__name__} has no width and height; nothing says how much to render.")
    return int(sizes[0]), int(sizes[1])
