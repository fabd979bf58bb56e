"""Four aerial frames of a real flight for rectification: orientations, terrain, orthophotos for comparison."""

from __future__ import annotations

import json
import pathlib
from dataclasses import dataclass

import jax
import numpy as np

from jaxgeo.io import read_dem, read_orientations
from jaxgeo.io.images import read_image
from jaxgeo.io.orthoimages import read_orthoimage
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.terrain import Dem

FRAMES = ("05_0182", "05_0184", "06_0251", "06_0253")
UNDULATION = 28.3  # m: cameras and ground are both above EGM2008, which is level here to a few cm


@dataclass(frozen=True)
class Flight:
    """Frames of a DMC with 0.12 m of focal length, 5 km above the ground, each with its shot and three bands."""

    folder: pathlib.Path
    sensor: Sensor
    shots: dict[str, Shot]
    terrain: Dem

    @classmethod
    def of(cls, folder: pathlib.Path) -> Flight:
        """Read from the folder of real data."""
        root = folder / "ngi_block"
        crs = json.loads((root / "io" / "ngi_ext_param.geojson").read_text())["world_crs"]
        table = read_orientations(root / "io" / "ngi_xyz_opk.csv", height_datum=UNDULATION, crs=crs)
        camera = FrameCamera.from_metric(focal_length=0.120, pixel_pitch=144e-6, width=640, height=1152)
        rows = {frame: next(k for k, name in enumerate(table.names) if f"_{frame}_" in name) for frame in FRAMES}
        shots = {frame: Shot(jax.tree.map(lambda x, row=row: x[row], table.pose)) for frame, row in rows.items()}
        terrain = read_dem(root / "dem.tif", vertical_datum=UNDULATION)
        return cls(root, Sensor(camera, Gimbal.fixed(), Mount.nadir()), shots, terrain)

    def image(self, frame: str) -> np.ndarray:
        """Image (3, 1152, 640) in uint8."""
        return read_image(next((self.folder / "images").glob(f"*_{frame}_RGB.tif")))[0]

    def reference(self, number: int) -> Orthoimage:
        """Orthophoto 1 or 2, with 5 m cells."""
        return read_orthoimage(self.folder / "reference_ortho" / f"ngi_rgb_byte_{number}.tif")
