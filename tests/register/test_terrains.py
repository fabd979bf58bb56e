"""Registration takes heights from a grid, or one height: other terrain is refused before anything is computed."""

from __future__ import annotations

import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Geodetic, ortho, register
from jaxgeo.earth import Ellipsoid
from jaxgeo.register.ties import TiePoints
from jaxgeo.terrain import TangentGrid
from jaxgeo.uncertainty import ErrorModel, sources
from tests.support.terrains import tin_along

PLACE = Geodetic.from_degrees(lat=46.0, lon=8.0, height=0.0)
SENSOR = jaxgeo.Sensor(
    jaxgeo.FrameCamera.from_pixels(focal_px=900.0, width=64, height=64), jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir()
)
SHOT = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=46.0, lon=8.0, height=1500.0))
GRID = TangentGrid.centred(PLACE, spacing=(5.0, 5.0), shape=(64, 64))
IMAGE = np.zeros((64, 64), np.uint8)
ERRORS = ErrorModel((sources.Position.from_ned(north=3.0, east=3.0, down=3.0),))
TIES = TiePoints(
    np.array([[30.0, 30.0]]), Geodetic(lat=np.array([0.8]), lon=np.array([0.1]), height=np.zeros(1)), np.eye(2)[None]
)
DOORS = {
    "rectify": lambda terrain: ortho.rectify(SENSOR, SHOT, IMAGE, terrain, GRID, (64, 64)),
    "register": lambda terrain: register.register_image(
        SENSOR, SHOT, IMAGE, ortho.Orthoimage.of(IMAGE, GRID), terrain, ERRORS, register.TieErrors(1.0, 1.0)
    ),
    "update": lambda terrain: register.update_orientation(
        SENSOR, SHOT, TIES, terrain, ERRORS, register.TieErrors(1.0, 1.0)
    ),
}


@pytest.mark.parametrize("door", DOORS)
def test_terrain_without_a_grid_is_refused(door: str) -> None:
    triangles = tin_along(PLACE, np.array([-500.0, 0.0, 500.0]), np.array([100.0, 200.0, 100.0]))
    with pytest.raises(TypeError, match=r"a Tin does not have. Make one with jaxgeo.Dem.from_array"):
        DOORS[door](triangles)


@pytest.mark.parametrize("door", DOORS)
def test_a_sphere_is_refused(door: str) -> None:
    with pytest.raises(
        ValueError, match="must lie on WGS 84 here; got a ConstantHeight on an ellipsoid of a = 6371000"
    ):
        DOORS[door](ConstantHeight(0.0, Ellipsoid(a=6_371_000.0, f=0.0)))
