"""A camera below the terrain is reported with its height and that of the ground, both above the ellipsoid."""

from __future__ import annotations

import numpy as np
import pytest
from support.scenes import flat, small_dem

import jaxgeo
from jaxgeo import ConstantHeight
from jaxgeo.uncertainty import sources

SENSOR = jaxgeo.Sensor(
    jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000),
    jaxgeo.Gimbal.fixed(),
    jaxgeo.Mount.nadir(),
)
SHOT = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=62.5))
MIDDLE = np.array([1999.5, 1499.5])
SAID = (
    r"camera_below_terrain: .*; check the vertical datum of its height\. "
    r"The camera is at 62\.5 m, the ground at 100\.0 m above the ellipsoid, 37\.5 m higher\."
)
GROUNDS = {"level": ConstantHeight(100.0), "a DEM": small_dem(flat(100.0))}


@pytest.mark.costly
@pytest.mark.parametrize("name", GROUNDS)
def test_a_fix_that_is_asked_to_raise_tells_both_heights(name: str) -> None:
    with pytest.raises(ValueError, match=SAID):
        jaxgeo.locate(SENSOR, SHOT, MIDDLE, GROUNDS[name], throw=True)
    p_ecef = jaxgeo.WGS84.to_ecef(SHOT.pose.position)
    down = -jaxgeo.WGS84.normal_and_height(p_ecef)[0]
    with pytest.raises(ValueError, match=SAID):
        jaxgeo.intersect(jaxgeo.Ray(p_ecef, down), GROUNDS[name], throw=True)


@pytest.mark.costly
def test_accuracy_tells_them_too() -> None:
    errors = sources.Position.from_ned(north=1.0, east=1.0, down=1.0)
    with pytest.raises(ValueError, match=f"there is no fix: {SAID}"):
        jaxgeo.accuracy(SENSOR, SHOT, MIDDLE, GROUNDS["level"], errors)
