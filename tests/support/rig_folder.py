"""A folder of rendered images of a drone with a wide and an infrared camera on its gimbal, whose tags err together."""

from __future__ import annotations

import pathlib

import numpy as np

from jaxgeo import Exposure
from jaxgeo.io import read_dem, read_observations
from jaxgeo.ortho import render
from support.image_folder import (
    ABOVE,
    APART,
    DEGREES,
    FOCAL,
    LAT,
    LON,
    METRES,
    SIZE,
    ImageFolder,
    hills,
    made,
    texture_of,
    written,
)

INFRARED, SMALLER = 200.0, (208, 160)  # px: its focal length, width and height
OFF = np.array([0.0, 0.0, 0.0, 0.5, 1.0, 0.0])  # deg: yaw and pitch of the infrared camera against the stated angles


def write_rig_folder(root: pathlib.Path, shots: int = 3, seed: int = 0) -> ImageFolder:
    """Images DJI_0000_W.jpg, DJI_0000_T.jpg and so on of a strip to the north over hills, a second between shots."""
    rng = np.random.default_rng(seed)
    dem = hills(root, seed)
    terrain = read_dem(dem, vertical_datum="ellipsoid")
    texture, names, true = texture_of(seed), [], []
    for k in range(shots):
        pose = np.array([LAT + (k - 0.5 * (shots - 1)) * APART / 111_180.0, LON, 515.0 + ABOVE, 6.0 * k, -80.0, 0.0])
        north, east, up = METRES * rng.normal(size=3)
        off = np.array([north / 111_180.0, east / 76_060.0, up, *(DEGREES * rng.normal(size=3))])
        for letter, focal, size in (("W", FOCAL, SIZE), ("T", INFRARED, SMALLER)):
            name, moment = f"DJI_{k:04d}_{letter}.jpg", f"2024-05-10T10:20:{30 + k}.000"
            written(made(root / "true"), name, pose + (size == SMALLER) * OFF, None, focal, moment, size)
            exposure = read_observations([root / "true" / name], height_datum="ellipsoid").at(0)[0].exposure
            seen = render(exposure.sensor, exposure.motion, texture, terrain)
            grey = seen.values[0] + 2.0 * rng.normal(size=size[::-1])
            shown = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
            written(made(root / "images"), name, pose + off, shown, focal, moment, size)
            names.append(name)
            true.append(exposure)
    assert all(isinstance(one, Exposure) for one in true)
    return ImageFolder(root / "images", dem, root / "none.tif", names, true)
