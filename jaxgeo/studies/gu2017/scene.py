"""A made scene: a map with a texture over real terrain, an oblique image of it, and a navigation that errs."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are asked for

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.io import example_dem
from jaxgeo.register import Orthoimage, TieErrors
from jaxgeo.register.render import render
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.studies.scenes import fractal_posts
from jaxgeo.terrain import AbstractTerrain, ConstantHeight, Dem, TangentGrid
from jaxgeo.terrain.grid import AbstractGrid, surface_point
from jaxgeo.uncertainty import ErrorModel, sources

WIDTH, HEIGHT, FOCAL = 480, 300, 1708.0  # px: 16 by 10 deg
OFF_NADIR, AZIMUTH, ABOVE = 65.0, 20.0, 5000.0  # deg, deg, m over the ground
TARGET = (36.300, -84.250)  # deg: hills of Tennessee
CELLS, CELL = (960, 960), 10.0  # of the map, m
SIGMA_POSITION, SIGMA_ATTITUDE = 50.0, 0.5  # m, deg: the second row of the paper's table
SIGMA_TERRAIN = 5.0  # m, of the elevation model, alike over
ALIKE = 200.0  # m
LEAST_MATCH = 0.5  # m: no tie is taken as better than that


class Imaged(NamedTuple):
    """An image, a map and a terrain, and what the navigation says. `image` is (rows, cols), `known` where it shows
    anything; `given` is the shot of the navigation, `terrain` the elevation model. `true` and `ground` are the shot and
    the ground that there were, `clear` (bands, rows, cols) the image before it was spoilt: None where not known."""

    sensor: Sensor
    given: Shot
    image: np.ndarray
    known: np.ndarray
    reference: Orthoimage
    terrain: AbstractTerrain
    errors: ErrorModel
    tie_errors: TieErrors
    true: Shot | None = None
    ground: Dem | None = None
    clear: np.ndarray | None = None


class World(NamedTuple):
    """The ground that there is, a map of it, and an elevation model that errs."""

    ground: Dem
    reference: Orthoimage
    terrain: Dem


def camera(pixels: int = WIDTH) -> Sensor:
    """The camera of the made scene, of so many columns over the same field of view."""
    scale = pixels / WIDTH
    made = FrameCamera.from_pixels(focal_px=FOCAL * scale, width=pixels, height=round(HEIGHT * scale))
    return Sensor(made, Gimbal.fixed(), Mount.nadir())


def navigation(
    position: float = SIGMA_POSITION, attitude_deg: float = SIGMA_ATTITUDE, sharing: Any = None
) -> ErrorModel:
    """Three independent errors of the position, m, and three of the attitude, deg."""
    options: dict[str, Any] = {} if sharing is None else {"sharing": sharing}
    return ErrorModel(
        (
            sources.Position.from_ned(north=position, east=position, down=position, **options),
            sources.Attitude.from_degrees(heading=attitude_deg, pitch=attitude_deg, roll=attitude_deg, **options),
        )
    )


def world(seed: int = 0) -> World:
    """The package's own elevation model, taken as what the ground is, with a made map over it."""
    ground = example_dem()
    return World(ground, textured(ground, target_on(ground), CELLS, CELL), erring(ground, seed))


def erring(ground: Dem, seed: int) -> Dem:
    """Ground with errors of its heights, of standard deviation `SIGMA_TERRAIN` and alike over `ALIKE` m."""
    posts = np.asarray(ground.posts, np.float64)
    spacing = float(np.mean(np.asarray(ground.grid.cell_size())))
    error = scipy.ndimage.gaussian_filter(np.random.default_rng([seed, 1]).normal(size=posts.shape), ALIKE / spacing)
    return Dem.from_array(posts + SIGMA_TERRAIN * error / np.std(error), ground.grid)


def made(seed: int = 0) -> Imaged:
    """An image of the made world, and a navigation that errs by a draw of the `seed`."""
    there = world(seed)
    true = looking_at(target_on(there.ground), off_nadir=OFF_NADIR, azimuth=AZIMUTH, above=ABOVE)
    given = disturbed(true, np.random.default_rng(seed), metres=SIGMA_POSITION, degrees=SIGMA_ATTITUDE)
    return taken(there, camera(), true, given, seed)


def taken(there: World, sensor: Sensor, true: Shot, given: Shot, seed: int) -> Imaged:
    """The image of a shot, of other light than the map, with noise; `given` is what the navigation says."""
    seen = render(sensor, true, there.reference, there.ground)
    errors = TieErrors(registration=LEAST_MATCH, terrain=SIGMA_TERRAIN)
    known, reference, terrain = seen.known, there.reference, there.terrain
    clear = np.asarray(seen.values)
    image = spoilt(clear, seed)[0]
    return Imaged(sensor, given, image, known, reference, terrain, navigation(), errors, true, there.ground, clear)


def seen_again(im: Imaged, seed: int) -> Imaged:
    """The same shot in other light, with other noise, and an elevation model that errs otherwise.

    Raises `ValueError` for an image that was not made.
    """
    if im.clear is None or im.ground is None:
        raise ValueError("only an image that was made can be made again.")
    return im._replace(image=spoilt(im.clear, seed)[0], terrain=erring(im.ground, seed))


def target_on(terrain: Dem, north: float = 0.0) -> Geodetic:
    """What the camera looks at, so many m to the north of `TARGET`, on the ground."""
    lat = TARGET[0] + np.rad2deg(north / 6.36e6)
    place = Geodetic.from_degrees(lat=lat, lon=TARGET[1], height=0.0)
    return Geodetic(lat=place.lat, lon=place.lon, height=jnp.asarray(terrain.height_at(place)))


def looking_at(target: Geodetic, *, off_nadir: float, azimuth: float, above: float) -> Shot:
    """From `above` m over a target, so that a nadir camera that is pitched up looks at it; angles in deg.

    The Earth is taken as flat, so that the middle of the image misses the target by some metres.
    """
    away, towards = above * np.tan(np.deg2rad(off_nadir)), np.deg2rad(azimuth)
    ned = jnp.asarray([-away * np.cos(towards), -away * np.sin(towards), -above])
    ecef = WGS84.to_ecef(target) + R_ecef_from_ned(target) @ ned
    return Shot(Pose(WGS84.to_geodetic(ecef), towards, np.deg2rad(off_nadir), 0.0))


def disturbed(shot: Shot, rng: np.random.Generator, *, metres: float, degrees: float) -> Shot:
    """The shot with errors of such standard deviations along north, east, down and of heading, pitch, roll."""
    return moved(shot, metres * rng.normal(size=3), np.deg2rad(degrees) * rng.normal(size=3))


def moved(shot: Shot, ned: np.ndarray, angles: np.ndarray) -> Shot:
    """The shot moved by m to the north, east and down, with rad added to its heading, pitch and roll."""
    pose = shot.pose
    ecef = WGS84.to_ecef(pose.position) + R_ecef_from_ned(pose.position) @ jnp.asarray(ned)
    turned = (pose.heading + angles[0], pose.pitch + angles[1], pose.roll + angles[2])
    return Shot(Pose(WGS84.to_geodetic(ecef), *turned), shot.gimbal_readings)


def spoilt(image: np.ndarray, seed: int, *, depth: float = 0.35, blur: float = 0.8, noise: float = 0.1) -> np.ndarray:
    """An image (bands, rows, cols) of other light, contrast and sharpness: another day and another camera.

    Darkened by up to `depth` of the brightness, slowly from place to place and towards the corners; smoothed by a
    Gaussian of `blur` px; less of contrast; with white noise of `noise` times its standard deviation.
    """
    rng, (rows, cols) = np.random.default_rng([seed, 3]), image.shape[1:]
    slow = fractal_posts(128, spacing=1.0, rms_slope=0.1, exponent=5.0, seed=int(rng.integers(2**31)))
    slow = scipy.ndimage.zoom(slow / slow.max(), (rows / 128, cols / 128), order=1)
    down, across = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    dark = image * (1.0 - depth * slow)[None] * (1.0 - 0.5 * depth * (down**2 + across**2))[None]
    soft = scipy.ndimage.gaussian_filter(dark, (0.0, blur, blur))
    flat = 0.7 * soft + 0.2 * np.mean(soft)
    return flat + noise * np.std(flat) * rng.normal(size=flat.shape)


def textured(
    terrain: AbstractTerrain, centre: Geodetic, shape: tuple[int, int], cell: float, seed: int = 0
) -> Orthoimage:
    """A map of a terrain about a place, cells of `cell` m: its shading, and fields and woods that are none."""
    grid = TangentGrid.centred(centre, spacing=(cell, cell), shape=shape)
    down, across = np.gradient(heights_on(terrain, grid, shape), cell)
    sun = np.array([-0.5, 0.6, 0.6])  # east, north, up
    shade = (-across * sun[0] + down * sun[1] + sun[2]) / np.sqrt(1.0 + down**2 + across**2)
    size = max(shape) + max(shape) % 2
    part = np.s_[: shape[0], : shape[1]]
    fine = fractal_posts(size, spacing=cell, rms_slope=0.1, exponent=2.2, seed=seed)[part]
    plots = fractal_posts(size, spacing=cell, rms_slope=0.1, exponent=3.4, seed=seed + 1)[part]
    plots = np.floor(12.0 * plots / np.ptp(plots)) * 7.0 % 5.0
    values = 1.5 * fine / np.std(fine) + 0.5 * plots
    values = values + (shade / np.std(shade) if np.std(shade) > 0.0 else 0.0)
    return Orthoimage.of(100.0 + 30.0 * (values - np.mean(values)) / np.std(values), grid)


def heights_on(terrain: AbstractTerrain, grid: AbstractGrid, shape: tuple[int, int]) -> np.ndarray:
    """Heights of a terrain at the cells of a grid, m; beside a DEM those of its edge."""
    if isinstance(terrain, ConstantHeight):
        return np.full(shape, float(terrain.height))
    if not isinstance(terrain, Dem):
        raise TypeError(f"the heights of a {type(terrain).__name__} are not to be had; give a Dem or a ConstantHeight.")
    places = np.stack(np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij"), axis=-1).astype(float)
    row, col = np.asarray(_posts_of(terrain.grid, grid, jnp.asarray(places.reshape(-1, 2)))).T
    heights = scipy.ndimage.map_coordinates(np.asarray(terrain.posts), [row, col], order=1, mode="nearest")
    return heights.reshape(shape)


@eqx.filter_jit
def _posts_of(posts: AbstractGrid, cells: AbstractGrid, places: Any) -> Any:
    return jax.vmap(lambda place: posts.rowcol(WGS84.normal_and_height(surface_point(cells.normal(place)))[0]))(places)
