"""Linear propagation: derivatives against differences, another route to the covariance, and what each source moves."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, FirstHit, Pose, Shot
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.uncertainty import ErrorModel, Footprint, Level, gauss_helmert, propagate, sample, sources
from jaxgeo.uncertainty.linear import AXES, derivatives
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.slopes import AbstractSlope, Surface
from tests.support import looks

SEARCH = FirstHit()


@eqx.filter_jit
def _misses(look: ModelInputs, aim, model: ErrorModel, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(lambda error: model.fix_offset(look, aim, error, SEARCH))(errors)


@pytest.fixture(scope="module")
def scene():
    return looks.sensor(), looks.shot(), looks.UV, looks.dem()


@pytest.fixture(scope="module")
def whole(scene):
    return propagate(*scene, looks.all_sources(), atmosphere=looks.AIR)


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["shot", "trajectory"])
def test_jacobian_is_that_of_the_miss_itself(scene, whole, motion: str) -> None:
    """Column by column against central differences of the whole map, search included."""
    sensor, shot, uv, dem = scene
    where, time = (shot, None) if motion == "shot" else (looks.trajectory(), 0.0)
    model = looks.all_sources() if motion == "shot" else looks.few_sources()
    result = whole if motion == "shot" else propagate(sensor, where, uv, dem, model, time=time, atmosphere=looks.AIR)
    look = ModelInputs.of(sensor, where, uv, dem, time=time, atmosphere=looks.AIR)
    step = looks.steps(model)
    errors = jnp.concatenate([jnp.diag(step), -jnp.diag(step)])
    misses, statuses = _misses(look, result.nominal, result.model, errors)
    assert np.all(np.asarray(statuses) == 0)
    differences = np.asarray(misses[: model.size] - misses[model.size :]).T / (2.0 * np.asarray(step))
    moved_per_sigma = np.sqrt(np.diagonal(np.asarray(result.cov_error)))
    jacobian = np.asarray(result.jacobian)
    np.testing.assert_allclose(jacobian * moved_per_sigma, differences * moved_per_sigma, atol=2e-4)  # m
    idle = [axis for axis, column in zip(model.axes, result.jacobian.T, strict=True) if not np.any(column)]
    assert all("node" in axis for axis in idle)  # of a field along the approach only those about the fix count


@pytest.mark.slow
def test_gauss_helmert_gives_the_same_covariance() -> None:
    """Through `project` and not through `locate`. From 15 km, so that the nanometre of an ECEF position is nothing."""
    plain = jaxgeo.FrameCamera.from_pixels(focal_px=9000.0, width=1600, height=1200)
    sensor = jaxgeo.Sensor(plain, jaxgeo.Gimbal.two_axis(), looks.sensor().mount)
    shot = Shot(Pose.from_degrees(lat=29.0, lon=89.0, height=15_409.0, heading=-102.0), jnp.array([1.2, 0.01]))
    scene = (sensor, shot, looks.UV, ConstantHeight(3850.0), looks.few_sources())
    direct = propagate(*scene).cov_enu
    np.testing.assert_allclose(gauss_helmert(*scene), direct, rtol=0.0, atol=1e-12 * np.abs(direct).max())


@pytest.mark.slow
def test_gauss_helmert_on_a_facet(scene) -> None:
    """The slope of a bilinear facet of 30 m changes by 3e-11 within the nanometre of an ECEF position."""
    direct = propagate(*scene, looks.few_sources()).cov_enu
    other = gauss_helmert(*scene, looks.few_sources())
    np.testing.assert_allclose(other, direct, rtol=0.0, atol=2e-10 * np.abs(direct).max())


@pytest.mark.slow
def test_covariance_is_the_same_in_ecef(whole) -> None:
    R = np.asarray(whole.nominal.R_ecef_from_enu)
    np.testing.assert_allclose(np.trace(whole.cov_ecef), np.trace(whole.cov_enu), rtol=1e-12)
    np.testing.assert_allclose(R.T @ whole.cov_ecef @ R, whole.cov_enu, atol=1e-9)


@pytest.mark.costly
def test_a_look_straight_down_at_a_plane() -> None:
    """Every figure by hand: position moves the fix as it is, height not at all, a pixel by height over focal length."""
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=2000.0, width=801, height=601)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    shot = Shot(Pose.from_degrees(lat=10.0, lon=20.0, height=1100.0))
    model = ErrorModel(
        (
            sources.Position.from_ned(north=3.0, east=2.0, down=1.0),
            sources.PixelMeasurement.from_pixels(column=2.0, row=4.0),
            sources.TerrainHeight.from_metres(5.0),
        )
    )
    result = propagate(sensor, shot, camera.principal_px, ConstantHeight(100.0), model)
    # The level surface bends away by some 1e-7 of the height flown.
    expected = np.diag([2.0**2 + (2.0 * 0.5) ** 2, 3.0**2 + (4.0 * 0.5) ** 2, 5.0**2])
    np.testing.assert_allclose(result.cov_enu, expected, atol=5e-3)


def test_terrain_height_moves_the_hit_by_the_tangent_of_the_incidence() -> None:
    sensor = jaxgeo.Sensor(looks.sensor().camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
    shot = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=5000.0), jnp.deg2rad(jnp.array([60.0, 0.0])))
    ground = ConstantHeight(200.0)
    result = propagate(sensor, shot, looks.UV, ground, ErrorModel((sources.TerrainHeight.from_metres(2.0),)))
    aside = math.sqrt(float(np.trace(result.cov_enu[:2, :2])))
    assert aside == pytest.approx(2.0 * math.tan(float(result.fix.incidence_ellipsoid)), abs=1e-6)
    assert float(result.cov_enu[2, 2]) == pytest.approx(4.0, abs=1e-6)
    up = np.asarray(R_ecef_from_enu(result.fix.position))[:, 2]  # the same variance along the vertical in ECEF
    assert float(up @ np.asarray(result.cov_ecef) @ up) == pytest.approx(4.0, abs=1e-6)


class _Rough(AbstractSlope):
    """A level plane 2 m above the fix, about which the ground deviates by 3 m."""

    def surface(self, terrain, nominal, facet, spread) -> Surface:  # pyright: ignore
        del terrain, nominal, facet, spread
        return Surface(jnp.array([0.0, 0.0, 1.0]), *(jnp.asarray(x) for x in (2.0, 3.0, 1.0)))


def test_rough_ground_adds_the_variance_of_its_heights_along_the_line_of_sight() -> None:
    """By hand: a height h above the plane moves the fix by h upwards, and by h times tan(incidence) back."""
    sensor = jaxgeo.Sensor(looks.sensor().camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
    shot = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=5000.0), jnp.deg2rad(jnp.array([60.0, 0.0])))
    scene = (sensor, shot, looks.UV, ConstantHeight(200.0), ErrorModel((sources.TerrainHeight.from_metres(1.0),)))
    rough = propagate(*scene, slope=_Rough())
    tan = math.tan(float(rough.fix.incidence_ellipsoid))
    assert float(rough.cov_enu[2, 2]) == pytest.approx(1.0 + 3.0**2, rel=1e-9)
    assert float(np.trace(rough.cov_enu[:2, :2])) == pytest.approx((1.0 + 3.0**2) * tan**2, rel=1e-6)
    assert float(rough.bias_enu[2]) == pytest.approx(2.0, rel=1e-9)
    assert math.hypot(*np.asarray(rough.bias_enu[:2])) == pytest.approx(2.0 * tan, rel=1e-6)


@pytest.mark.slow
def test_on_level_ground_every_slope_is_the_same(scene) -> None:
    sensor, shot, uv, dem = scene
    level = dem.with_posts(jnp.full(dem.posts.shape, 130.0))
    facet = propagate(sensor, shot, uv, level, looks.few_sources())
    other = propagate(sensor, shot, uv, level, looks.few_sources(), slope=Footprint())
    np.testing.assert_allclose(other.cov_enu, facet.cov_enu, atol=2e-3 * np.abs(facet.cov_enu).max())
    assert float(other.surface.roughness) < 0.01  # m: the surface of one height bends away from its tangent plane


@pytest.mark.slow
def test_level_ground_is_what_a_constant_height_gives(scene) -> None:
    sensor, shot, uv, dem = scene
    result = propagate(sensor, shot, uv, dem, looks.few_sources(), slope=Level())
    plane = ConstantHeight(float(result.fix.position.height))
    other = propagate(sensor, shot, uv, plane, looks.few_sources())
    np.testing.assert_allclose(result.cov_enu, other.cov_enu, atol=1e-3 * np.abs(other.cov_enu).max())


@pytest.mark.slow
def test_footprint_within_a_cell_is_the_facet(scene) -> None:
    """Errors a hundred times smaller keep the ellipse within the cell, whose slope the regression then finds."""
    sensor, shot, uv, dem = scene
    small = jax.tree.map(lambda x: 0.003 * x, looks.few_sources())
    facet = propagate(sensor, shot, uv, dem, small)
    footprint = propagate(sensor, shot, uv, dem, small, slope=Footprint())
    np.testing.assert_allclose(footprint.cov_enu, facet.cov_enu, atol=2e-2 * np.abs(facet.cov_enu).max())


@pytest.mark.slow
def test_propagation_runs_under_vmap_and_tells_of_misses(scene) -> None:
    sensor, shot, _, dem = scene
    pixels = jnp.array([looks.UV, (-5000.0, 300.0), (math.nan, 3.0)])
    result = jax.vmap(lambda uv: propagate(sensor, shot, uv, dem, looks.few_sources()))(pixels)
    single = propagate(sensor, shot, looks.UV, dem, looks.few_sources())
    np.testing.assert_allclose(result.cov_enu[0], single.cov_enu, atol=1e-9)
    assert [int(code) != 0 for code in result.fix.status] == [False, True, True]
    assert np.all(np.isnan(result.cov_enu[1:]))
    assert np.isnan(jax.vmap(lambda one: one.circular_error(0.9))(result)[1])


@pytest.mark.slow
def test_circular_error_is_differentiable_in_a_sigma(scene) -> None:
    sensor, shot, uv, dem = scene

    def ce90(heading: jax.Array) -> jax.Array:
        model = ErrorModel((sources.Attitude(jnp.stack([heading, 5e-4, 5e-4])), *looks.few_sources().sources[1:]))
        return propagate(sensor, shot, uv, dem, model).circular_error(0.9)

    ce90 = jax.jit(ce90)
    slope, step = jax.grad(ce90)(1e-3), 1e-6
    assert float(slope) == pytest.approx(float(ce90(1e-3 + step) - ce90(1e-3 - step)) / (2.0 * step), rel=1e-5)


@eqx.filter_jit
def _swept(inputs: ModelInputs, nominal, model: ErrorModel):
    return model.at(inputs, nominal).sweep(inputs, nominal)


@pytest.mark.parametrize(
    "scene",
    ["level", pytest.param("all in air", marks=pytest.mark.slow), pytest.param("trajectory", marks=pytest.mark.slow)],
)
def test_derivatives_by_way_of_the_line_of_sight_are_those_through_the_whole_model(scene: str) -> None:
    """Of every source; the axes of zeros that models share programs by stay zero."""
    model = looks.all_sources() if scene == "all in air" else looks.few_sources()
    where, time = (looks.trajectory(), 0.0) if scene == "trajectory" else (looks.shot(), None)
    ground = ConstantHeight(120.0) if scene == "level" else looks.dem()
    air = looks.AIR if scene == "all in air" else None
    inputs = ModelInputs.of(looks.sensor(), where, looks.UV, ground, time=time, atmosphere=air)
    nominal = inputs.nominal_fix(SEARCH)
    whole = _swept(inputs, nominal, model)
    errors = derivatives(inputs, nominal, model)
    assert errors.shared.cov_error.shape[0] % AXES == 0
    by_way = jax.jit(lambda shared: shared.sweep(inputs.terrain, nominal))(errors.shared)
    for name, one, other in zip(whole._fields, by_way, whole, strict=True):
        np.testing.assert_allclose(
            one[..., : model.size], other, rtol=1e-9, atol=1e-9 * np.abs(other).max(), err_msg=name
        )
        assert not np.any(one[..., model.size :])
    np.testing.assert_array_equal(errors.shared.cov_error[: model.size, : model.size], errors.cov_error)
    assert np.trace(errors.shared.cov_error) == pytest.approx(np.trace(errors.cov_error))


def test_another_model_compiles_only_how_its_errors_move_the_exposure() -> None:
    scene = looks.sensor(), looks.shot(), looks.UV, ConstantHeight(120.0)
    position, attitude, *_, pixel = looks.few_sources().sources
    propagate(*scene, (position,))
    traced: list[str] = []

    def on(name: str, _: float, **about: object) -> None:
        if name.endswith("jaxpr_trace_duration"):
            traced.append(str(about.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(on)
    try:
        propagate(*scene, (position, attitude, pixel))
    finally:
        jax.monitoring.unregister_event_duration_listener(on)
    assert "_moves" in traced
    assert not {"_nominal_sightline", "met_by", "nominal_fix_of", "_of_line", "_over"} & set(traced)


@pytest.mark.parametrize("question", [jaxgeo.propagate, jaxgeo.accuracy, jaxgeo.compare, sample])
def test_a_pixel_outside_the_image_has_no_accuracy(question: Any) -> None:
    """As it has no fix by `locate`: nothing is compiled, and the size of the image is named."""
    scene = (looks.level_sensor(), looks.level_shot(), (-100.0, 0.0), looks.LEVEL, looks.level_errors())
    with pytest.raises(ValueError, match=r"uv = \(-100, 0\) lies outside the image of \d+ columns x \d+ rows"):
        question(*scene)
