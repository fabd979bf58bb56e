"""Records that are printed as a line in deg and m; while they are traced, or without numbers, as their fields."""

from __future__ import annotations

import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Dem, FrameCamera, Geodetic, Pose, Shot
from jaxgeo.coverage import FlightNoise, LinearGaps, Strip
from jaxgeo.io import example_dem
from jaxgeo.sensor.conventions import li_2020_sensor
from jaxgeo.terrain import TangentGrid

POSE = Pose.from_degrees(lat=36.318, lon=-84.105, height=5469.0, heading=160.0, pitch=-0.5)
SENSOR = li_2020_sensor(focal_length=1.0, pixel_pitch=2e-5, along_flight=1536, across_flight=1536, mirror=False)
PAIR, NONE = jnp.array([0.01, 0.25]), jnp.zeros(8)
GAPS = LinearGaps(NONE, jnp.zeros((1, 8, 8)), jnp.asarray(0.7), PAIR, NONE[:1], FlightNoise.from_degrees())


def test_a_pose() -> None:
    said = "lat 36.3180000, lon -84.1050000 deg, height 5469.00 m, heading 160.000, pitch -0.500, roll 0.000 deg)"
    assert repr(POSE) == f"Pose({said}"
    two = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf + 0.01]), POSE)
    assert repr(two).startswith("Pose(2 poses, lat 36.3180000 to 36.8909578, lon -84.1050000 to -83.5320422 deg")


def test_a_camera() -> None:
    camera = FrameCamera.from_metric(focal_length=0.05, pixel_pitch=4e-6, width=6000, height=4000)
    said = "6000 x 4000 pixels, focal length 12500.0 pixels, field of view 26.99 x 18.18 deg without distortion, "
    assert repr(camera) == f"FrameCamera({said}NoDistortion)"
    two = jax.tree.map(lambda leaf: jnp.stack([leaf, 2.0 * leaf]), camera)
    assert "(2 cameras, 6000 x 4000 pixels, focal length 12500.0 to 25000.0 pixels, field of view 13.69 to" in repr(two)


def test_a_dem() -> None:
    middle = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    grid = TangentGrid.centred(middle, spacing=(30.0, 0.5), shape=(3, 5))
    posts = np.full((3, 5), 600.0)
    posts[0, 0], posts[1, 1] = np.nan, 612.34
    said = "3 x 5 posts 30.0 x 0.500 m apart, heights 600.0 to 612.3 m above the ellipsoid, with voids, centre "
    assert repr(Dem.from_array(posts, grid)) == f"Dem({said}47.000000, 11.000000 deg)"
    assert re.fullmatch(r"Dem\(\d+ x \d+ posts .* no voids, centre 36\.\d+, -84\.\d+ deg\)", repr(example_dem()))


def test_a_strip_and_its_gaps() -> None:
    shot = Shot(POSE, SENSOR.gimbal.readings_from_degrees(outer=65.0, inner=0.0))
    numbers = map(jnp.asarray, (170.0, math.radians(160.0), 0.15, 100.0, 300.0))
    strip = Strip(SENSOR, shot, ConstantHeight(300.0), *numbers, None, 6, "rows", 3)  # pyright: ignore[reportCallIssue]
    assert re.fullmatch(
        r"Strip\(6 images 85\.\d m apart, at 170\.0 m/s, course 160\.000 deg, overlap 15\.0 % at the near end, flight "
        r"along rows\)",
        repr(strip),
    )
    assert repr(GAPS) == "LinearGaps(probability of a gap 0.3 in 2 pairs, largest at pair 1: 0.25)"


@pytest.mark.parametrize("record", [POSE, SENSOR.camera, example_dem(), GAPS], ids=lambda one: type(one).__name__)
def test_without_numbers_they_are_printed_as_their_fields(record: jaxgeo.Pose) -> None:
    """Traced, of shapes alone, filtered, and as a tree of flags; nothing is raised, and pytrees are as before."""
    name = type(record).__name__
    traced: list[str] = []
    arrays, other = eqx.partition(record, eqx.is_array)
    jax.make_jaxpr(lambda given: traced.append(repr(eqx.combine(given, other))))(arrays)
    empty, flags = eqx.filter(record, lambda _: False), jax.tree.map(lambda _: True, record)
    shapes = jax.eval_shape(lambda given: given, arrays)
    for said in (*traced, repr(empty), repr(flags), repr(shapes)):
        assert said.startswith(f"{name}(")
        assert " deg" not in said
    assert jax.tree.structure(jax.tree.map(np.asarray, record)) == jax.tree.structure(record)


def test_inside_a_trace_known_records_are_printed_as_outside() -> None:
    said: list[str] = []
    terrain = example_dem()
    jax.make_jaxpr(lambda x: (said.append(repr(terrain)), x)[1])(1.0)
    assert said == [repr(terrain)]
