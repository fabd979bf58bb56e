"""Simulated scene: a textured map over real terrain, an oblique image of it, and a navigation with errors."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load on first use

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.io import example_dem
from jaxgeo.observation import Exposure
from jaxgeo.ortho import Orthoimage
from jaxgeo.ortho.rendering import met
from jaxgeo.register import TieErrors
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.status import Status
from jaxgeo.studies.scenes import fractal_posts
from jaxgeo.terrain import AbstractTerrain, ConstantHeight, Dem, TangentGrid
from jaxgeo.terrain.grid import AbstractGrid, surface_point
from jaxgeo.uncertainty import ErrorModel, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

WIDTH, HEIGHT, FOCAL = 2400, 1500, 8540.0  # px: 16 by 10 deg
STRIDE = 5  # px between ray-traced lines of sight; points between are interpolated
JUMP = 4.0  # times the median map distance of neighbouring lines of sight: a ridge hides the points between
OFF_NADIR, AZIMUTH, ABOVE = 65.0, 20.0, 5000.0  # deg, deg, m over the ground
TARGET = (36.300, -84.250)  # deg: hills of Tennessee
CELLS, CELL = (960, 960), 10.0  # map, m
FINE_CELLS, FINE_CELL = (1980, 1620), 3.0  # map for large blocks, m
SIGMA_POSITION, SIGMA_ATTITUDE = 50.0, 0.5  # m, deg: the second row of the paper's table
SIGMA_TERRAIN = 5.0  # m, elevation model error: white noise smoothed by a Gaussian of ALIKE
ALIKE = 200.0  # m
LEAST_MATCH = 0.5  # m: lower bound of a tie's standard deviation


class Sight(NamedTuple):
    """Ground points of lines of sight every `STRIDE` px, starting 3 px outside the image: `p_ecef` (rows, cols, 3)
    in m, NaN without ground."""

    p_ecef: np.ndarray

    def places(self, grid: AbstractGrid) -> np.ndarray:
        """Grid coordinates (rows, cols, 2): the (row, col) of a grid."""
        shape = self.p_ecef.shape[:2]
        flat = self.p_ecef.reshape(-1, 3)
        known = np.isfinite(flat[:, 0])
        found = np.asarray(_rowcol(grid, jnp.asarray(np.where(known[:, None], flat, [WGS84.a, 0.0, 0.0]))))
        return np.where(known[:, None], found, np.nan).reshape(*shape, 2)


class Imaged(NamedTuple):
    """An image, a map and a terrain, with the navigation. `image` is (rows, cols), `known` its valid pixels; `given`
    is the shot from the navigation, `terrain` the elevation model. `true` and `ground` are the true shot and ground,
    `clear` (bands, rows, cols) the image before degradation, `sight` the true ground points of its pixels: None if
    unknown."""

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
    sight: Sight | None = None


class World(NamedTuple):
    """The true ground, a map of it, and an elevation model with errors."""

    ground: Dem
    reference: Orthoimage
    terrain: Dem


def camera(pixels: int = WIDTH) -> Sensor:
    """The camera of the simulated scene, with `pixels` columns over the same field of view."""
    scale = pixels / WIDTH
    made = FrameCamera.from_pixels(focal_px=FOCAL * scale, width=pixels, height=round(HEIGHT * scale))
    return Sensor(made, Gimbal.fixed(), Mount.nadir())


def navigation(
    position: float = SIGMA_POSITION, attitude_deg: float = SIGMA_ATTITUDE, sharing: Any = None
) -> ErrorModel:
    """Error model with three independent errors of the position, m, and three of the attitude, deg."""
    options: dict[str, Any] = {} if sharing is None else {"sharing": sharing}
    return ErrorModel(
        (
            sources.Position.from_ned(north=position, east=position, down=position, **options),
            sources.Attitude.from_degrees(heading=attitude_deg, pitch=attitude_deg, roll=attitude_deg, **options),
        )
    )


def map_errors() -> TieErrors:
    """Errors of the map, and of the elevation model of `erring`: their covariance is Gaussian, of length 2 `ALIKE`."""
    field = sources.TerrainField.of_variograms(gaussian=[(SIGMA_TERRAIN, 2.0 * ALIKE)])
    return TieErrors(registration=LEAST_MATCH, terrain_field=field)


def world(seed: int = 0) -> World:
    """The packaged elevation model, taken as the true ground, with a synthetic map over it."""
    ground = example_dem()
    return World(ground, textured(ground, target_on(ground), CELLS, CELL), erring(ground, seed))


def erring(ground: Dem, seed: int) -> Dem:
    """The ground with height errors of standard deviation `SIGMA_TERRAIN` and correlation length `ALIKE` m."""
    posts = np.asarray(ground.posts, np.float64)
    spacing = float(np.mean(np.asarray(ground.grid.cell_size())))
    error = scipy.ndimage.gaussian_filter(np.random.default_rng([seed, 1]).normal(size=posts.shape), ALIKE / spacing)
    return Dem.from_array(posts + SIGMA_TERRAIN * error / np.std(error), ground.grid)


def made(seed: int = 0) -> Imaged:
    """A simulated image of the synthetic world, and a navigation with errors drawn from `seed`."""
    there = world(seed)
    true = looking_at(target_on(there.ground), off_nadir=OFF_NADIR, azimuth=AZIMUTH, above=ABOVE)
    given = disturbed(true, np.random.default_rng(seed), metres=SIGMA_POSITION, degrees=SIGMA_ATTITUDE)
    return taken(there, camera(), true, given, seed)


def in_fine_cells(im: Imaged, seed: int) -> Imaged:
    """The same shot over a map with nearly pixel-sized cells. Raises `ValueError` if the image is not simulated."""
    if im.true is None or im.ground is None or im.sight is None:
        raise ValueError("only an image that was made can be made again.")
    fine = textured(im.ground, target_on(im.ground), FINE_CELLS, FINE_CELL, seed)
    there = World(im.ground, fine, erring(im.ground, seed))
    return taken(there, im.sensor, im.true, im.given, seed, im.sight)


def shows(im: Imaged, reference: Orthoimage) -> Imaged:
    """The same shot over another map. Raises `ValueError` if the image is not simulated."""
    if im.sight is None:
        raise ValueError("only an image that was made can be made again.")
    clear, known = shown(im.sight, reference, im.sensor)
    return im._replace(reference=reference, clear=clear, known=known)


def taken(there: World, sensor: Sensor, true: Shot, given: Shot, seed: int, sight: Sight | None = None) -> Imaged:
    """The image of a shot, with other illumination than the map and with noise; `given` is the navigation's shot.

    `sight` is the precomputed `Sight` of the shot over this ground, if available.
    """
    sight = sight_of(sensor, true, there.ground) if sight is None else sight
    clear, known = shown(sight, there.reference, sensor)
    of_map = known, there.reference, there.terrain, navigation(), map_errors()
    return Imaged(sensor, given, spoilt(clear, seed)[0], *of_map, true, there.ground, clear, sight)


def sight_of(sensor: Sensor, shot: Shot, ground: AbstractTerrain) -> Sight:
    """The `Sight` of a shot: first ground intersections of its lines of sight."""
    rows, cols = (np.arange(n // STRIDE + 2) * float(STRIDE) - 3.0 for n in _size(sensor))
    uv = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    return Sight(points_seen(sensor, shot, ground, uv).reshape(len(rows), len(cols), 3))


def points_seen(sensor: Sensor, shot: Shot, ground: AbstractTerrain, uv: np.ndarray) -> np.ndarray:
    """Points (n, 3) in ECEF, m, of the first ground that pixels (n, 2) see; NaN without ground."""
    found = met(ModelInputs(Exposure(sensor, shot, jnp.asarray(0.0)), terrain=ground), np.asarray(uv, float))
    return np.where((np.asarray(found.status) == Status.hit)[:, None], np.asarray(found.p_ecef), np.nan)


def between(lattice: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Values at pixels (n, 2), interpolated from those (rows, cols, k) of a `Sight`."""
    at = (np.asarray(uv)[:, ::-1].T + 3.0) / STRIDE
    return np.stack([scipy.ndimage.map_coordinates(band, at, order=1) for band in np.moveaxis(lattice, -1, 0)], axis=-1)


def shown(sight: Sight, reference: Orthoimage, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """(image (1, rows, cols) of a map along lines of sight, its valid mask)."""
    places = sight.places(reference.grid)
    far = [np.linalg.norm(np.diff(places, axis=axis, append=np.nan), axis=-1) for axis in (0, 1)]
    torn = np.any([x > JUMP * np.nanmedian(x) for x in far], axis=0) | np.isnan(places[..., 0])
    rows, cols = _size(sensor)
    at = np.stack(np.meshgrid(*((np.arange(n) + 3.0) / STRIDE for n in (rows, cols)), indexing="ij"))
    torn_here = scipy.ndimage.maximum_filter(torn, 3)[tuple(np.rint(at).astype(int))]
    row, col = (scipy.ndimage.map_coordinates(np.nan_to_num(places[..., k]), at, order=1) for k in range(2))
    inside = (row >= 0) & (col >= 0) & (row <= reference.shape[0] - 1) & (col <= reference.shape[1] - 1)
    known = inside & ~torn_here
    values = scipy.ndimage.map_coordinates(np.asarray(reference.values)[0], [row, col], order=1, mode="nearest")
    return np.where(known, values, 0.0)[None], known


def _size(sensor: Sensor) -> tuple[int, int]:
    camera: Any = sensor.camera
    return camera.height, camera.width


def seen_again(im: Imaged, seed: int, noise: float = 0.1) -> Imaged:
    """The same shot with other illumination and noise, and an elevation model with other errors.

    Raises `ValueError` if the image is not simulated.
    """
    if im.clear is None or im.ground is None:
        raise ValueError("only an image that was made can be made again.")
    return im._replace(image=spoilt(im.clear, seed, noise=noise)[0], terrain=erring(im.ground, seed))


def target_on(terrain: Dem, north: float = 0.0) -> Geodetic:
    """The target of the camera on the ground, `north` m to the north of `TARGET`."""
    lat = TARGET[0] + np.rad2deg(north / 6.36e6)
    place = Geodetic.from_degrees(lat=lat, lon=TARGET[1], height=0.0)
    return Geodetic(lat=place.lat, lon=place.lon, height=jnp.asarray(terrain.height_at(place)))


def looking_at(target: Geodetic, *, off_nadir: float, azimuth: float, above: float) -> Shot:
    """Shot from `above` m over a target, so that a nadir camera that is pitched up looks at it; angles in deg.

    Assumes a flat Earth, so the image centre misses the target by some metres.
    """
    away, towards = above * np.tan(np.deg2rad(off_nadir)), np.deg2rad(azimuth)
    ned = jnp.asarray([-away * np.cos(towards), -away * np.sin(towards), -above])
    ecef = WGS84.to_ecef(target) + R_ecef_from_ned(target) @ ned
    return Shot(Pose(WGS84.to_geodetic(ecef), towards, np.deg2rad(off_nadir), 0.0))


def disturbed(shot: Shot, rng: np.random.Generator, *, metres: float, degrees: float) -> Shot:
    """The shot with errors of these standard deviations along north, east, down and of heading, pitch, roll."""
    return moved(shot, metres * rng.normal(size=3), np.deg2rad(degrees) * rng.normal(size=3))


def moved(shot: Shot, ned: np.ndarray, angles: np.ndarray) -> Shot:
    """The shot moved by m to the north, east and down, with rad added to its heading, pitch and roll."""
    pose = shot.pose
    ecef = WGS84.to_ecef(pose.position) + R_ecef_from_ned(pose.position) @ jnp.asarray(ned)
    turned = (pose.heading + angles[0], pose.pitch + angles[1], pose.roll + angles[2])
    return Shot(Pose(WGS84.to_geodetic(ecef), *turned), shot.gimbal_readings)


def spoilt(image: np.ndarray, seed: int, *, depth: float = 0.35, blur: float = 0.8, noise: float = 0.1) -> np.ndarray:
    """A degraded image (bands, rows, cols) with other illumination, contrast and sharpness: another day and camera.

    Darkened by up to `depth` of the brightness, varying slowly and towards the corners; smoothed by a Gaussian of
    `blur` px; with reduced contrast, and white noise of `noise` times its standard deviation.
    """
    rng, (rows, cols) = np.random.default_rng([seed, 3]), image.shape[1:]
    slow = fractal_posts(128, spacing=1.0, rms_slope=0.1, exponent=5.0, seed=int(rng.integers(2**31)))
    slow = scipy.ndimage.zoom(slow / slow.max(), (rows / 128, cols / 128), order=1)
    down, across = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    dark = image * (1.0 - depth * slow)[None] * (1.0 - 0.5 * depth * (down**2 + across**2))[None]
    soft = scipy.ndimage.gaussian_filter(dark, (0.0, blur, blur))
    flat = 0.7 * soft + 0.2 * np.mean(soft)
    return flat + noise * np.std(flat) * rng.normal(size=flat.shape)


def repeated(reference: Orthoimage, period: int, share: float) -> Orthoimage:
    """A map with a texture that repeats every `period` cells down and across, as orchards and streets do; the
    pattern has `share` of its variance."""
    values = np.asarray(reference.values, float)[0]
    down, across = (np.arange(n) % period for n in values.shape)
    tile = scipy.ndimage.gaussian_filter(np.random.default_rng(7).normal(size=(period, period)), 1.5, mode="wrap")
    pattern = tile[down[:, None], across[None, :]] / np.std(tile)
    mixed = np.sqrt(share) * pattern + np.sqrt(1.0 - share) * (values - np.mean(values)) / np.std(values)
    return Orthoimage.of(np.mean(values) + np.std(values) * mixed, reference.grid)


def textured(
    terrain: AbstractTerrain, centre: Geodetic, shape: tuple[int, int], cell: float, seed: int = 0
) -> Orthoimage:
    """A map of a terrain around a position, cells of `cell` m: its shading, and fields and woods unrelated to it."""
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
    """Heights of a terrain at the cells of a grid, m; outside a DEM those of its edge."""
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


@eqx.filter_jit
def _rowcol(grid: AbstractGrid, points: Any) -> Any:
    return jax.vmap(lambda p: grid.rowcol(WGS84.normal_and_height(p)[0]))(points)
