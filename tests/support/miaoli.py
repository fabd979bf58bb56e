"""Four oblique drone frames of a village, with their surface model; occlusions differ between frames."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.io import read_dem, read_opensfm
from jaxgeo.io.images import read_image
from jaxgeo.sensor import Gimbal, Mount, Sensor, Shot
from jaxgeo.terrain import Dem
from jaxgeo.terrain.grid import AbstractGrid

FRAMES = ("100_0005_0018", "100_0005_0136", "100_0005_0140", "100_0005_0142")
UNDULATION = 19.6  # m, of EGM96: cameras and surface come from one reconstruction, so both have the same heights
GRID = "EPSG:32651"
FINER = 0.25  # surface model cells per image cell


@dataclass(frozen=True)
class Village:
    """Frames of a drone's camera, 60 deg below horizontal from about 180 m above the ground, each with its shot."""

    folder: pathlib.Path
    sensor: Sensor
    shots: dict[str, Shot]
    terrain: Dem

    @classmethod
    def of(cls, folder: pathlib.Path) -> Village:
        """Read from the folder of real data."""
        root = folder / "odm_miaoli"
        path = root / "opensfm" / "reconstruction.json"
        found = read_opensfm(path, height_datum=UNDULATION, crs=GRID)
        poses, names = found.poses(), [str(name) for name in found.names]
        shots = {
            frame: Shot(jax.tree.map(lambda x, row=names.index(frame): jnp.asarray(x)[row], poses)) for frame in FRAMES
        }
        terrain = read_dem(root / "dsm.tif", vertical_datum=UNDULATION)
        (camera,) = {name: found.cameras[name] for name in found.camera}.values()
        return cls(root, Sensor(camera, Gimbal.fixed(), Mount.nadir()), shots, terrain)

    def image(self, frame: str) -> np.ndarray:
        """Image (3, 912, 1368) in uint8."""
        return read_image(self.folder / "images" / f"{frame}.tif")[0]

    def grid(self) -> AbstractGrid:
        """Grid with cells of 0.2 m over the surface model."""
        return self.terrain.grid.coarser(FINER)
