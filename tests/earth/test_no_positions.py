"""What takes a position refuses anything else at once, by the name of the argument."""

from __future__ import annotations

import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.scenes import small_dem

import jaxgeo
from jaxgeo import adjust, earth, plot, sensor
from jaxgeo.coverage import transform
from jaxgeo.io import height_msl
from jaxgeo.terrain import HeightFunction, TangentGrid
from jaxgeo.uncertainty import accuracy_map, presets

PLACE = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=100.0)
HIGH = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1500.0)
DEM = small_dem(np.random.default_rng(0).uniform(50.0, 60.0, (17, 17)))
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=100, height=100)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
SHOT = jaxgeo.Shot(HIGH, SENSOR.gimbal.neutral_readings())
MAP = earth.TransverseMercator.gauss_krueger(0.19)
FRAME = adjust.LocalFrame(PLACE)
LEVEL = jaxgeo.ConstantHeight(3.0)
TAKERS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "to_ecef": ("position", jaxgeo.WGS84.to_ecef),
    "R_ecef_from_ned": ("position", earth.R_ecef_from_ned),
    "R_ecef_from_enu": ("position", earth.R_ecef_from_enu),
    "TangentGrid.centred": ("centre", lambda x: TangentGrid.centred(x, spacing=(30.0, 30.0), shape=(5, 5))),
    "Dem.rowcol_at": ("position", DEM.rowcol_at),
    "Dem.height_at": ("position", DEM.height_at),
    "Dem.normal_at": ("position", DEM.normal_at),
    "Dem.slope_at": ("position", DEM.slope_at),
    "ConstantHeight.height_at": ("position", LEVEL.height_at),
    "HeightFunction.height_at": (
        "position",
        lambda x: HeightFunction(lambda place: 0.0 * place.lat, lowest=-1.0, highest=1.0).height_at(x),
    ),
    "LocalFrame.from_geodetic": ("position", FRAME.from_geodetic),
    "LocalFrame.R_local_from_enu": ("position", FRAME.R_local_from_enu),
    "GroundPoints": ("position", lambda x: adjust.GroundPoints.from_geodetic(FRAME, ["a"], x)),
    "Pose.looking_at, the position": ("position", lambda x: jaxgeo.Pose.looking_at(position=x, point=PLACE)),
    "Pose.looking_at, the point": ("point", lambda x: jaxgeo.Pose.looking_at(position=HIGH.position, point=x)),
    "a pose": (
        "shot.pose.position",
        lambda x: jaxgeo.locate(
            SENSOR, jaxgeo.Shot(jaxgeo.Pose(x, 0.0, 0.0, 0.0), SHOT.gimbal_readings), [5.0, 5.0], LEVEL
        ),
    ),
    "project": ("point", lambda x: jaxgeo.project(SENSOR, SHOT, x)),
    "point_shot": ("point", lambda x: sensor.point_shot(SENSOR, HIGH, x)),
    "accuracy_map": ("ground", lambda x: accuracy_map(SENSOR, SHOT, DEM, presets.li_2023(), x)),
    "step_on_map": ("before", lambda x: transform.step_on_map(MAP, x, PLACE)),
    "plot.lonlat_deg": ("position", plot.lonlat_deg),
    "height_msl": ("position", height_msl),
}


MESSAGES = """
import json, jaxgeo
jaxgeo.enable_x64()
import test_no_positions as these
print(json.dumps({name: [these.refusal(take, x) for x in ((47.0, 11.0, 100.0), these.HIGH)]
    for name, (_, take) in these.TAKERS.items()}))
"""


def refusal(take: Callable[[Any], Any], given: Any) -> str | None:
    """What the caller reads."""
    try:
        take(given)
    except TypeError as error:
        return str(error)
    return None


@pytest.fixture(scope="module")
def refusals() -> dict[str, list[str]]:
    """The messages for a tuple and for a pose, without the checker of types, which is on in tests and not for users."""
    folder = pathlib.Path(__file__).parent
    path = os.pathsep.join([str(folder), str(folder.parent), str(pathlib.Path(jaxgeo.__file__).parents[1])])
    env = {**os.environ, "PYTHONPATH": path}
    ran = subprocess.run([sys.executable, "-c", MESSAGES], check=False, capture_output=True, text=True, env=env)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


@pytest.mark.costly
@pytest.mark.parametrize("name", TAKERS)
def test_only_a_position_is_taken_for_one(name: str, refusals: dict[str, list[str]]) -> None:
    argument, of_tuple, of_pose = TAKERS[name][0], *refusals[name]
    assert of_tuple == (
        f"{argument} must be a jaxgeo Geodetic; got tuple. "
        "Make one with jaxgeo.Geodetic.from_degrees(lat=, lon=, height=)."
    )
    assert of_pose == f"{argument} must be a jaxgeo Geodetic; got Pose. Give {argument}.position."


@pytest.mark.parametrize("name", [name for name in TAKERS if name not in ("HeightFunction.height_at", "accuracy_map")])
def test_a_position_is_taken(name: str) -> None:
    """As the others are refused for what they are only."""
    _, take = TAKERS[name]
    several = jnp.ones(1) if name == "GroundPoints" else jnp.ones(())
    found = take(jaxgeo.Geodetic(lat=0.82 * several, lon=0.19 * several, height=900.0 * several))
    assert jax.tree.leaves(found)
