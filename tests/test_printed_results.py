"""Results as text: figures and statuses, not the fields of a record."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Fix, Geodetic, Status


def fix_of(codes: object) -> Fix:
    codes = np.asarray(codes, np.int8)
    lat, lon, height = (np.full(codes.shape, value) for value in (47.5, -11.25, 812.25))
    found = np.where(codes == Status.hit.code, 1500.0, np.nan)
    angles = [np.full(codes.shape, 0.5)] * 3
    position = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    return Fix(position, np.zeros((*codes.shape, 3)), found, *angles, status=codes)


def test_a_fix_prints_its_place_and_its_status() -> None:
    said = "47.5000000, -11.2500000 deg, 812.25 m above the ellipsoid, 1500.0 m away: hit"
    assert str(fix_of(Status.hit.code)) == said
    lost = str(fix_of(Status.ray_misses_terrain.code))
    assert lost == f"no fix: ray_misses_terrain: {Status.ray_misses_terrain.message}"
    hit, lost = Status.hit.code, Status.outside_image.code
    assert str(fix_of([hit, lost, hit])) == "3 fixes: 2 hit, 1 outside_image"
    assert str(fix_of([hit])) == "1 fix: 1 hit"


def test_traced_results_print_their_fields() -> None:
    seen = []
    jax.make_jaxpr(lambda fix: seen.append(f"{fix}"))(fix_of(Status.hit.code))
    assert seen[0].startswith("Fix(")


@pytest.mark.costly
def test_accuracies_print_their_radii() -> None:
    """The figures are those of the methods; a probability in percent is refused."""
    terrain = jaxgeo.ConstantHeight(300.0)
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1300.0, heading=30.0), np.zeros(0))
    errors = [jaxgeo.uncertainty.sources.Attitude.from_degrees(heading=0.5, pitch=0.2, roll=0.2)]
    linear = jaxgeo.propagate(sensor, shot, (100, 200), terrain, errors)
    assert str(linear).startswith(f"CE90 {float(linear.circular_error(0.9)):.4g} m, LE90 ")
    sampled = jaxgeo.sample(sensor, shot, (100, 200), terrain, errors, key=jax.random.key(0), count=1000)
    assert str(sampled).startswith(f"CE90 {sampled.quantile('CE', 0.9).value:.4g} m (")
    for figure in (linear.circular_error, linear.linear_error, linear.spherical_error, sampled.circular_error):
        with pytest.raises(ValueError, match=r"Write 90 % as 0\.9"):
            figure(90.0)
    with pytest.raises(ValueError, match=r"Write 90 % as 0\.9"):
        sampled.quantile("CE", 90.0)
