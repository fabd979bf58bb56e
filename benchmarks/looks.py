"""Observations of synthetic and real terrain from all sides, and their accuracy, for the method selection study.

Real terrain is read from `dem/` in the folder JAXGEO_TEST_DATA; missing files are skipped.
"""

from __future__ import annotations

import os
import pathlib
import sys
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxgeo
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.studies.scenes import CENTRE, fractal_posts
from jaxgeo.terrain import Dem, TangentGrid
from jaxgeo.terrain.grid import surface_point
from jaxgeo.uncertainty import ErrorModel, Sampled, sample, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

jaxgeo.enable_x64()
DATA = os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data")
SIDE = 768  # posts: all terrain is cut or padded to it, to share one compilation
FIRST_HIT = jaxgeo.FirstHit()
PIXEL = np.array([1999.5, 1999.5])
CAMERA = jaxgeo.FrameCamera.from_metric(focal_length=0.3, pixel_pitch=5.5e-6, width=4000, height=4000)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
DOWNWARD = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())  # for depressions near 90 degrees

# The thresholds were set on synthetic terrain of seed 1 and slopes of 3, 10, 20 and 30 degrees, and on Jacksboro.
MADE_UP = {  # class: (RMS slope in degrees, seed)
    "smooth": [(4.0, 11), (5.0, 12)],
    "hilly": [(12.0, 13), (15.0, 14)],
    "mountainous": [(20.0, 15), (22.0, 16)],
    "rough": [(27.0, 17), (30.0, 18)],
}
REAL = {
    "Big Tujunga": "bigtujunga.tif",
    "Ventoux": "N44E005.hgt",
    "Rome": "Rome-30m-DEM.tif",
    "Exploradores": "exploradores_aster_AST_L1A_00303182012144228_Z.tif",
    "Chhota Shigri": "dem_chhota_shigri.tif",
}


def made_up(slope: float, seed: int) -> Dem:
    """Fractal terrain of an RMS slope in degrees."""
    posts = fractal_posts(SIDE, spacing=30.0, rms_slope=np.deg2rad(slope), seed=seed)
    return on_a_plane(posts + 500.0, (30.0, 30.0))


def on_a_plane(posts: np.ndarray, spacing: tuple[float, float], void: np.ndarray | None = None) -> Dem:
    """Posts on a grid in a tangent plane, cut at their first corner or padded to one size."""
    posts = np.asarray(posts, np.float32)[:SIDE, :SIDE]
    void = np.zeros(posts.shape, bool) if void is None else np.asarray(void)[:SIDE, :SIDE]
    margin = [(0, SIDE - side) for side in posts.shape]
    grid = TangentGrid.centred(CENTRE, spacing=spacing, shape=posts.shape)
    return Dem.from_array(
        np.pad(posts, margin, "edge"), grid, void=np.pad(void, margin, constant_values=True), extent=posts.shape
    )


def copied(dem: Dem) -> Dem:
    """The posts of a real terrain, with their own spacing and voids, on a tangent plane grid like all others."""
    down, right = (float(step) for step in dem.grid.cell_size())
    rows, cols = np.asarray(dem.extent)
    return on_a_plane(np.asarray(dem.posts)[:rows, :cols], (down, right), np.asarray(dem.void)[:rows, :cols])


def made_up_of(name: str, fresh: int = 0) -> list[Dem]:
    """Synthetic terrain of a class; a nonzero `fresh` gives new terrain."""
    return [made_up(slope, seed + fresh) for slope, seed in MADE_UP[name]]


def terrains(fresh: int = 0) -> dict[str, list[Dem]]:
    """All terrain by class; 'set on' is the packaged one, on which thresholds were set."""
    classes = {name: made_up_of(name, fresh) for name in MADE_UP}
    for name, file in REAL.items():
        path = pathlib.Path(DATA) / "dem" / file
        if path.exists():
            classes[name] = [copied(jaxgeo.io.read_dem(path, vertical_datum="EPSG:5773"))]
        else:
            print(f"{path} is not there: {name} is left out.", file=sys.stderr)
    return classes | {"Jacksboro (set on)": [copied(jaxgeo.io.example_dem())]}


class Cases(NamedTuple):
    """Poses from which the image centre sees a point, the scale of the errors, and another one of the attitude's."""

    pose: jaxgeo.Pose
    scale: np.ndarray
    attitude: np.ndarray


def cases(dem: Dem, count: int, seed: int, down: tuple[float, float] = (8.0, 60.0)) -> Cases:
    """Observations of points in the middle half of a terrain, from above its highest post; `down` is the range of
    depressions in degrees at the point, larger where the camera would be below that post."""
    rng = np.random.default_rng(seed)
    rows, cols = np.asarray(dem.extent)
    rowcol = rng.uniform(0.25, 0.75, (count, 2)) * (rows - 1, cols - 1)
    azimuth, depression = rng.uniform(0.0, 2.0 * np.pi, count), np.deg2rad(rng.uniform(*down, count))
    away = np.exp(rng.uniform(np.log(6e3), np.log(50e3), count))
    scale = np.exp(rng.uniform(np.log(0.15), np.log(3.0), count))
    poses = _poses(dem, *(jnp.asarray(x) for x in (rowcol, azimuth, depression, away)))
    return Cases(poses, scale, np.ones(count))


def steep_cases(dem: Dem, count: int, seed: int) -> Cases:
    """Observations by the `DOWNWARD` sensor, within 10 degrees of the nadir, of every other one within 1 degree, from
    0.4 to 50 km; errors of the attitude up to 20 times as large, so that many reach beyond the nadir."""
    rng = np.random.default_rng(seed)
    rows, cols = np.asarray(dem.extent)
    rowcol = rng.uniform(0.25, 0.75, (count, 2)) * (rows - 1, cols - 1)
    azimuth, off_nadir = rng.uniform(0.0, 2.0 * np.pi, count), np.deg2rad(rng.uniform(0.0, 10.0, count))
    off_nadir[::2] *= 0.1
    away, scale, attitude = (
        np.exp(rng.uniform(np.log(low), np.log(high), count)) for low, high in ((400.0, 50e3), (0.15, 3.0), (1.0, 20.0))
    )
    poses = _downward(dem, *(jnp.asarray(x) for x in (rowcol, azimuth, off_nadir, away)))
    return Cases(poses, scale, attitude)


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(None, 0, 0, 0, 0))
def _poses(dem: Dem, rowcol: Any, azimuth: Any, depression: Any, away: Any) -> jaxgeo.Pose:
    eye, point = _eye_and_point(dem, rowcol, azimuth, depression, away)
    eye = eqx.tree_at(lambda eye: eye.height, eye, jnp.maximum(eye.height, dem.ceiling + 300.0))
    return jaxgeo.Pose.looking_at(position=eye, point=jaxgeo.WGS84.to_geodetic(point))


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(None, 0, 0, 0, 0))
def _downward(dem: Dem, rowcol: Any, azimuth: Any, off_nadir: Any, away: Any) -> jaxgeo.Pose:
    eye, _ = _eye_and_point(dem, rowcol, azimuth, 0.5 * jnp.pi - off_nadir, away)
    return jaxgeo.Pose(eye, azimuth, off_nadir, jnp.zeros(()))


def _eye_and_point(dem: Dem, rowcol: Any, azimuth: Any, depression: Any, away: Any) -> tuple[Any, Any]:
    """(geodetic position of a camera, ECEF of the point of the terrain that it looks at)."""
    normal = dem.grid.normal(rowcol)
    level = jaxgeo.WGS84.to_geodetic(surface_point(normal))
    point = surface_point(normal) + dem.height_at(level) * normal
    flat = jnp.cos(depression)
    towards = jnp.stack([flat * jnp.sin(azimuth), flat * jnp.cos(azimuth), -jnp.sin(depression)])
    return jaxgeo.WGS84.to_geodetic(point - away * (R_ecef_from_enu(level) @ towards)), point


def errors(scale: Any, attitude: Any = 1.0) -> ErrorModel:
    """Attitude to 0.05 and 0.03 degrees, position to 2 and 3 m, terrain height to 4 m, all times a scale, and that of
    the attitude times another."""
    attitude = attitude * jnp.deg2rad(jnp.array([0.05, 0.03, 0.03]))
    parts = (attitude * scale, jnp.array([2.0, 2.0, 3.0]) * scale, jnp.array([4.0]) * scale)
    kinds = (sources.Attitude, sources.Position, sources.TerrainHeight)
    return ErrorModel(tuple(kind(sigma) for kind, sigma in zip(kinds, parts, strict=True)))


def look_from(pose: jaxgeo.Pose, terrain: Dem, pixel: Any = PIXEL, sensor: jaxgeo.Sensor = SENSOR) -> ModelInputs:
    return ModelInputs(jaxgeo.Exposure(sensor, jaxgeo.Shot(pose), jnp.asarray(0.0)), jnp.asarray(pixel), terrain)


def sampled(
    pose: jaxgeo.Pose,
    model: ErrorModel,
    terrain: Dem,
    seed: Any,
    count: int,
    pixel: Any = PIXEL,
    sensor: jaxgeo.Sensor = SENSOR,
) -> Sampled:
    key = jax.random.key(seed)
    return sample(sensor, jaxgeo.Shot(pose), pixel, terrain, model, key=key, count=count, figures=("CE",))


def item(tree: Any, index: Any) -> Any:
    return jax.tree.map(lambda x: x[index], tree)
