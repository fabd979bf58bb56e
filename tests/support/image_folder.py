"""A folder of rendered drone images with tags that err, an elevation model, and the poses that rendered them."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from rasterio.transform import Affine

from jaxgeo import Exposure, Geodetic
from jaxgeo.earth import WGS84
from jaxgeo.io import read_dem, read_observations
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.terrain import TangentGrid
from support.drone_image_files import packet, write_image
from support.fractal import fractal_posts
from support.rasters import write

LAT, LON, ABOVE, APART = 47.0, 11.0, 160.0, 40.0  # deg, m above the ground, m between images
SIZE, FOCAL = (256, 192), 240.0  # px
POSTS, SPACING, RELIEF = 256, 5.0, 30.0  # of the elevation model, m
SHAPE, CELL = (900, 900), 0.6  # of the texture on the ground
METRES, DEGREES = (2.0, 2.0, 3.0), (0.6, 0.4, 0.4)  # errors in the tags: north, east, up; yaw, pitch, roll
FOCAL_LENGTH, WIDTH, HEIGHT = 0x920A, 0xA002, 0xA003  # tags of EXIF


@dataclass(frozen=True)
class ImageFolder:
    """The folder of images, the elevation model, the map that they show, the names of the images, and their true
    exposures."""

    images: pathlib.Path
    dem: pathlib.Path
    map: pathlib.Path
    names: list[str]
    true: list[Exposure]

    @property
    def arguments(self) -> list[str]:
        """Arguments of a command that reads it."""
        return [f"{self.images}", "--camera-datum", "ellipsoid", "--dem", f"{self.dem}"]


def written(
    folder: pathlib.Path,
    name: str,
    pose: np.ndarray,
    grey: np.ndarray | None = None,
    focal: float = FOCAL,
    moment: str | None = None,
    size: tuple[int, int] = SIZE,
) -> None:
    """An image with the tags of its pose (deg, m), of a camera with that focal length and (width, height), exposed at a
    moment in UTC."""
    lat, lon, height, yaw, pitch, roll = pose
    tags = {
        "drone-dji:AbsoluteAltitude": f"{height:+.4f}",
        "drone-dji:GpsLatitude": f"{lat:+.10f}",
        "drone-dji:GpsLongitude": f"{lon:+.10f}",
        "drone-dji:GimbalYawDegree": f"{yaw:+.6f}",
        "drone-dji:GimbalPitchDegree": f"{pitch:+.6f}",
        "drone-dji:GimbalRollDegree": f"{roll:+.6f}",
        "drone-dji:CalibratedFocalLength": f"{focal}",
        "drone-dji:CalibratedOpticalCenterX": f"{(size[0] - 1) / 2}",
        "drone-dji:CalibratedOpticalCenterY": f"{(size[1] - 1) / 2}",
    }
    tags |= {} if moment is None else {"drone-dji:UTCAtExposure": moment}
    exif = {FOCAL_LENGTH: 8.8, WIDTH: size[0], HEIGHT: size[1]}
    write_image(folder / name, packet(tags), make="DJI", exif=exif, size=size, grey=grey)


def texture_of(seed: int) -> Orthoimage:
    """Grey values of the ground."""
    rng = np.random.default_rng(seed)
    grid = TangentGrid.centred(Geodetic.from_degrees(lat=LAT, lon=LON, height=0.0), spacing=(CELL, CELL), shape=SHAPE)
    parts = [scipy.ndimage.gaussian_filter(rng.normal(size=SHAPE), width) for width in (1.0, 2.5, 6.0)]
    return Orthoimage.of(128.0 + 22.0 * sum(one / np.std(one) for one in parts), grid)


def hills(root: pathlib.Path, seed: int) -> pathlib.Path:
    """File of an elevation model."""
    posts = 500.0 + fractal_posts(POSTS, spacing=SPACING, relief=RELIEF, exponent=4.0, seed=seed + 1)
    step = np.array([SPACING / 76_060.0, SPACING / 111_180.0])  # deg of longitude and latitude at 47 deg
    corner = np.array([LON, LAT]) + 0.5 * POSTS * step * [-1.0, 1.0]
    affine = Affine(step[0], 0.0, corner[0], 0.0, -step[1], corner[1])
    return write(root / "dem.tif", posts.astype(np.float32), affine=affine)


def write_folder(root: pathlib.Path, count: int = 4, seed: int = 0) -> ImageFolder:
    """Images of a strip to the north over hills; the last one shows noise."""
    rng = np.random.default_rng(seed)
    dem = hills(root, seed)
    terrain = read_dem(dem, vertical_datum="ellipsoid")
    names = [f"image_{k}.jpg" for k in range(count)]
    poses = np.array(
        [
            [LAT + (k - 0.5 * (count - 1)) * APART / 111_180.0, LON + 8e-5 * (k % 2), 515.0 + ABOVE + 3.0 * (k % 2),
             6.0 * k, -80.0 - 3.0 * (k % 2), 0.0]
            for k in range(count)
        ]
    )  # fmt: skip
    for name, pose in zip(names, poses, strict=True):
        written(made(root / "true"), name, pose)
    observed = read_observations([root / "true"], height_datum="ellipsoid")
    true = [observed.at(row)[0].exposure for row in range(count)]
    texture = texture_of(seed)
    images = made(root / "images")
    for k, (name, pose, exposure) in enumerate(zip(names, poses, true, strict=True)):
        seen = render(exposure.sensor, exposure.motion, texture, terrain)
        assert seen.known.all(), name
        grey = seen.values[0] + 2.0 * rng.normal(size=SIZE[::-1])
        if k == count - 1:
            grey = 128.0 + 30.0 * rng.normal(size=SIZE[::-1])
        north, east, up = METRES * rng.normal(size=3)
        off = np.array([north / 111_180.0, east / 76_060.0, up, *(DEGREES * rng.normal(size=3))])
        written(images, name, pose + off, np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    return ImageFolder(images, dem, _map(root / "map.tif", texture), names, true)


def _map(path: pathlib.Path, texture: Orthoimage) -> pathlib.Path:
    """The texture in latitudes and longitudes."""
    rows, cols = 0.9 * np.array(SHAPE)
    step = CELL / np.array([76_060.0, 111_180.0])
    corner = np.array([LON - 0.5 * cols * step[0], LAT + 0.5 * rows * step[1]])
    lon = corner[0] + step[0] * (np.arange(int(cols)) + 0.5)
    lat = corner[1] - step[1] * (np.arange(int(rows)) + 0.5)
    lat, lon = (np.deg2rad(x) for x in np.meshgrid(lat, lon, indexing="ij"))
    place = Geodetic(lat=jnp.asarray(lat.ravel()), lon=jnp.asarray(lon.ravel()), height=jnp.zeros(lat.size))
    at = jax.vmap(lambda one: texture.grid.rowcol(WGS84.normal_and_height(WGS84.to_ecef(one))[0]))(place)
    values = scipy.ndimage.map_coordinates(np.asarray(texture.values[0], float), np.asarray(at).T, order=1)
    affine = Affine(step[0], 0.0, corner[0], 0.0, -step[1], corner[1])
    return write(path, values.reshape(lat.shape).astype(np.float32), affine=affine)


def made(folder: pathlib.Path) -> pathlib.Path:
    """The folder, which exists then."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder
