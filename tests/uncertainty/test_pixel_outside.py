"""A pixel outside the image has no fix in any function of an observation, whatever transforms the function.

Expected from `jaxgeo.locate`: `outside_image`, without a position. Its other pixels keep what they have alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Geodetic, Status, uncertainty
from jaxgeo.uncertainty import Looks, sources
from tests.support import looks

CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
SHOT = jaxgeo.Shot(
    jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0),
    SENSOR.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0),
)
GROUND = ConstantHeight(600.0)
ERRORS = jaxgeo.ErrorModel(
    (
        sources.GimbalAngles.from_degrees(yaw=1.0, pitch=0.5, roll=0.5),
        sources.Position.from_ned(north=3.0, east=3.0, down=5.0),
    )
)
BESIDE, WITHIN = np.array([4050.0, 1500.0]), np.array([1999.5, 1499.5])
PIXELS = np.array([BESIDE, WITHIN, [200.0, -3.0]])
CODES = [Status.outside_image, Status.hit, Status.outside_image]


def _samples(uv: Any) -> tuple[Any, Any]:
    found = uncertainty.error_samples(SENSOR, SHOT, uv, GROUND, ERRORS, jax.random.key(0), jnp.arange(3))
    return found.status[..., 0], found.errors_enu


def _moments(function: Any) -> Callable[[Any], tuple[Any, Any]]:
    def call(uv: Any) -> tuple[Any, Any]:
        found = function(SENSOR, SHOT, uv, GROUND, ERRORS)
        return found.status, (found.mean_enu, found.cov_enu)

    return call


def _propagation(uv: Any, **options: Any) -> tuple[Any, Any]:
    found = uncertainty.propagate(SENSOR, SHOT, uv, GROUND, ERRORS, **options)
    return found.fix.status, (found.fix.ecef, found.jacobian, found.cov_enu, found.bias_enu)


SCENE = (SENSOR, SHOT, GROUND, ERRORS)
LEVEL = (looks.level_sensor(), looks.level_shot(), looks.LEVEL, looks.level_errors())  # programs of other tests


def _accuracy(uv: Any, scene: tuple[Any, ...] = SCENE, **options: Any) -> tuple[Any, Any]:
    found = jaxgeo.accuracy(*scene[:2], uv, *scene[2:], sampling=None, **options)
    figures = found.circular, found.linear, found.spherical, found.cov_enu, found.bias_enu
    return found.fix.status, (found.fix.ecef, found.fix.position.lat, *figures)


def _gauss_helmert(uv: Any) -> tuple[Any, Any]:
    errors = (*ERRORS.sources, sources.TerrainHeight.from_metres(2.0))
    status = jaxgeo.locate(SENSOR, SHOT, uv, GROUND).status
    return status, uncertainty.gauss_helmert(SENSOR, SHOT, uv, GROUND, errors)


ONE: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "propagate": _propagation,
    "propagate over the footprint": lambda uv: _propagation(uv, slope=uncertainty.Footprint()),
    "accuracy": _accuracy,
    "sigma_points": _moments(uncertainty.sigma_points),
    "second_order": _moments(uncertainty.second_order),
    "error_samples": _samples,
    "gauss_helmert": _gauss_helmert,
}
# The first is a second case of one function; the second one is in `test_accuracy`, with its derivative.
LATER = ("propagate over the footprint", "accuracy")
MANY: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "accuracy of pixels": lambda uv: _accuracy(uv, LEVEL, block=4),
    "accuracy by in_axes": lambda uv: _accuracy(uv, in_axes=(None, None, 0, None, None)),
}


def _check(status: Any, figures: Any) -> None:
    np.testing.assert_array_equal(status, CODES)
    for figure in jax.tree.leaves(figures):
        assert np.isnan(np.asarray(figure)[[0, 2]]).all()
        assert np.isfinite(np.asarray(figure)[1]).all()


@pytest.mark.costly
@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.slow) if one in LATER else one for one in ONE])
def test_one_traced_pixel_outside_has_no_figures(name: str) -> None:
    _check(*jax.jit(jax.vmap(ONE[name]))(jnp.asarray(PIXELS)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["propagate"])
def test_nor_has_it_under_a_vmap_alone_and_under_a_jit_alone(name: str) -> None:
    _check(*jax.vmap(ONE[name])(jnp.asarray(PIXELS)))
    alone = jax.jit(ONE[name])
    _check(*jax.tree.map(lambda *leaves: np.stack(leaves), *[alone(jnp.asarray(uv)) for uv in PIXELS]))


@pytest.mark.costly
@pytest.mark.parametrize("name", ["accuracy of pixels", pytest.param("accuracy by in_axes", marks=pytest.mark.slow)])
def test_of_many_pixels_each_outside_has_no_figures(name: str) -> None:
    """The first of them, too, whose arguments are checked as those of one alone."""
    _check(*MANY[name](PIXELS))


@pytest.mark.slow
@pytest.mark.parametrize("name", MANY)
def test_nor_has_one_of_many_that_are_traced(name: str) -> None:
    _check(*jax.jit(MANY[name])(jnp.asarray(PIXELS)))


@pytest.mark.slow  # for what is compiled anyway it is in `test_track`
@pytest.mark.parametrize("on_terrain", [True, False])
def test_a_look_beside_the_image_is_left_out_of_a_track(on_terrain: bool) -> None:
    point = Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)
    places = [Geodetic.from_degrees(lat=46.97, lon=lon, height=2600.0) for lon in (10.98, 10.99, 11.01, 11.02)]
    fixed = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
    shots = [jaxgeo.Shot(jaxgeo.Pose.looking_at(position=p, point=point), time=k) for k, p in enumerate(places)]
    errors = sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1)
    target = uncertainty.AtRest() if on_terrain else uncertainty.AtRest(on_terrain=False)
    uvs = np.array([BESIDE, WITHIN, WITHIN, [-1.0, 9.0]])
    found = uncertainty.track(Looks(fixed, shots, uvs), GROUND if on_terrain else None, errors, target=target)
    np.testing.assert_array_equal(found.status, [Status.outside_image, Status.hit, Status.hit, Status.outside_image])
    kept = uncertainty.track(Looks(fixed, shots[1:3], uvs[1:3]), GROUND if on_terrain else None, errors, target=target)
    np.testing.assert_allclose(found.batch.cov_enu, kept.batch.cov_enu, rtol=1e-9)


RAISING = {
    "propagate": uncertainty.propagate,
    "accuracy": jaxgeo.accuracy,
    "sample": jaxgeo.sample,
    "compare": uncertainty.compare,
    "sigma_points": uncertainty.sigma_points,
    "second_order": uncertainty.second_order,
    "sobol_indices": uncertainty.sobol_indices,
    "gauss_helmert": uncertainty.gauss_helmert,
    "check_accuracy": jaxgeo.uncertainty.check_accuracy,
}


@pytest.mark.parametrize("name", RAISING)
def test_one_known_pixel_outside_is_refused_at_once(name: str) -> None:
    with pytest.raises(ValueError, match="outside_image: the pixel uv = "):
        RAISING[name](SENSOR, SHOT, BESIDE, GROUND, ERRORS)
