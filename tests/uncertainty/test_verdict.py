"""What is told of a fix without samples: where it agrees with them, and when it asks for them."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Geodetic, Pose, Shot
from jaxgeo.studies.scenes import tangent_dem
from jaxgeo.terrain import FirstHit
from jaxgeo.uncertainty import (
    ErrorModel,
    Method,
    Sampling,
    accuracy,
    compare,
    propagate,
    sample,
    second_order,
    sigma_points,
    sources,
)
from jaxgeo.uncertainty.model import checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from tests.support import looks

pytestmark = pytest.mark.costly

CENTRE = Geodetic.from_degrees(lat=46.0, lon=8.0, height=0.0)
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=20_000.0, width=401, height=401)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
UV = (200.0, 200.0)
KEY = jax.random.key(0)
SIZE, SPACING = 129, 30.0
MODEL = ErrorModel(
    (
        sources.Attitude.from_degrees(heading=0.03, pitch=0.03, roll=0.03),
        sources.Position.from_ned(north=2.0, east=2.0, down=3.0),
        sources.TerrainHeight.from_metres(3.0),
    )
)


def ground(kind: str) -> np.ndarray:
    """Heights in m: a plain, a plain with a crest across the look, or a sawtooth of rows far shorter than an error."""
    row = np.arange(SIZE)[:, None] * np.ones((1, SIZE))
    heights = {
        "plain": 100.0 + 0.0 * row,
        "crest": 100.0 + 120.0 * np.exp(-(((row - SIZE // 2) / 4.0) ** 2)),
        "sawtooth": 100.0 + 6.0 * (row % 2),
    }
    return heights[kind]


def shot_at(rows_ahead: float) -> Shot:
    """From 12 km to the south, 2.5 km up, looking north at a place so many rows north of the middle."""
    camera = Geodetic.from_degrees(lat=46.0 - math.degrees(12_000.0 / 6.367e6), lon=8.0, height=2600.0)
    north = math.degrees(rows_ahead * SPACING / 6.367e6)
    point = Geodetic.from_degrees(lat=46.0 + north, lon=8.0, height=100.0)
    return Shot(Pose.looking_at(position=camera, point=point))


@pytest.fixture(scope="module")
def dem():
    return tangent_dem(ground("plain"), SPACING, CENTRE)


# The crest, 240 m wide and 120 m high, hides some 450 m behind it. Rows go south: looking north is towards row 0.
CASES = [
    ("plain", 0.0, Method.facet),
    ("sawtooth", 0.4, Method.footprint),
    ("crest", 18.6, Method.samples),
]


@pytest.mark.slow
@pytest.mark.parametrize("kind, rows_ahead, expected", CASES)
def test_the_method_fits_the_ground(dem, kind: str, rows_ahead: float, expected: Method) -> None:
    scene = (SENSOR, shot_at(rows_ahead), UV, dem.with_posts(ground(kind)), MODEL)
    result = accuracy(*scene, sampling=Sampling(count=4096, key=KEY))
    drawn = sample(*scene, key=jax.random.key(9), count=4096)
    assert Method(int(result.method)) is expected, str(result)
    truth = drawn.circular_error(0.9)
    assert 0.93 * truth.low <= result.circular <= 1.07 * truth.high, (str(result), truth)
    assert (result.sampled is not None) == (expected is Method.samples)
    assert f"CE90 {result.circular:.4g} m" in str(result)
    assert result.because in str(result)


@pytest.mark.slow
def test_a_crest_is_seen_to_make_lines_of_sight_jump(dem) -> None:
    scene = (SENSOR, shot_at(18.6), UV, dem.with_posts(ground("crest")), MODEL)
    diagnostics = accuracy(*scene, sampling=Sampling(count=4096, key=KEY)).diagnostics
    comparison = compare(*scene, sampling=Sampling(count=4096, key=KEY))
    assert 0.02 < float(diagnostics.jumps) < 0.98
    assert float(diagnostics.jumps) == pytest.approx(comparison.jumped, abs=0.03)
    assert comparison.valid == ()
    assert "jump" in comparison.verdict
    assert str(comparison).count("x") >= 4


@pytest.mark.slow
def test_on_a_plain_the_samples_bear_every_method_out(dem) -> None:
    scene = (SENSOR, shot_at(0.0), UV, dem, MODEL)
    comparison = compare(*scene, sampling=Sampling(count=4096, key=KEY), digits=1)
    assert {"linear, facet", "linear, footprint", "sigma points"} <= set(comparison.valid), str(comparison)
    assert comparison.jumped == comparison.failed == 0.0
    alone = sample(*scene, key=KEY, count=4096, keep=True)
    np.testing.assert_array_equal(comparison.sampled.errors_enu, alone.errors_enu)
    points = sigma_points(*scene)  # by a program of their own, those of the comparison by that of the samples
    row = next(row for row in comparison.rows if row.method == "sigma points")
    figures = (
        points.circular_error(0.5),
        points.circular_error(0.9),
        points.linear_error(0.9),
        points.spherical_error(0.9),
    )
    assert row.values == pytest.approx([float(figure) for figure in figures], rel=1e-8)


@pytest.mark.slow
def test_moments_to_second_order_are_those_of_the_hessian_of_the_intersection(dem) -> None:
    """From one Hessian on the line of sight by the implicit function theorem, and by differentiating the solution."""
    scene = (SENSOR, shot_at(0.0), UV, dem.with_posts(ground("crest")))
    inputs = ModelInputs.of(*scene)
    nominal = inputs.nominal_fix(FirstHit())
    model = checked_model(MODEL, inputs)

    @jax.jit
    def by_hessian(inputs, nominal, model):
        model = model.at(inputs, nominal)
        offset = lambda z: model.linear_offset(inputs, nominal, model.factor() @ z)  # noqa: E731
        zero = jnp.zeros(model.size)
        jacobian, hessian = jax.jacfwd(offset)(zero), jax.jacfwd(jax.jacfwd(offset))(zero)
        mean = 0.5 * jnp.trace(hessian, axis1=1, axis2=2)
        return mean, jacobian @ jacobian.T + 0.5 * jnp.einsum("iab,jba->ij", hessian, hessian)

    mean, cov = by_hessian(inputs, nominal, model)
    found = second_order(*scene, MODEL)
    np.testing.assert_allclose(found.mean_enu, mean, atol=1e-9 * float(jnp.abs(mean).max()))
    np.testing.assert_allclose(found.cov_enu, cov, atol=1e-9 * float(jnp.abs(cov).max()))


@pytest.mark.slow
def test_constant_height_needs_no_samples() -> None:
    result = accuracy(SENSOR, shot_at(0.0), UV, ConstantHeight(100.0), MODEL)
    assert Method(int(result.method)) is Method.facet
    linear = propagate(SENSOR, shot_at(0.0), UV, ConstantHeight(100.0), MODEL)
    assert result.circular == pytest.approx(float(linear.circular_error(0.9)), rel=1e-9)
    half = accuracy(SENSOR, shot_at(0.0), UV, ConstantHeight(100.0), MODEL, probability=0.5)
    assert half.circular < result.circular
    assert str(half).startswith("CE50")


def test_no_fix_is_said() -> None:
    up = Shot(Pose(CENTRE.__class__.from_degrees(lat=46.0, lon=8.0, height=3000.0), 0.0, 0.5, 0.0))
    with pytest.raises(ValueError, match="cannot estimate accuracy, there is no fix: rises_away"):
        accuracy(SENSOR, up, UV, ConstantHeight(100.0), MODEL)
    with pytest.raises(ValueError, match="between 0 and 1"):
        accuracy(SENSOR, up, UV, ConstantHeight(100.0), MODEL, probability=1.5)


@pytest.mark.slow
def test_samples_are_drawn_until_every_figure_is_decided() -> None:
    """100 000 samples leave LE90 over level ground undecided to two digits; parts are the samples of one call."""
    look = (looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL, looks.level_errors())
    few = compare(*look, sampling=Sampling(count=100_000))
    assert (few.sampled.count, "undecided" in few.rows[0].validity) == (100_000, True)
    found = compare(*look)
    assert found.sampled.count in (400_000, 1_600_000)
    assert not any("undecided" in row.validity for row in found.rows)
    whole = sample(*look, count=found.sampled.count, keep=True)
    np.testing.assert_array_equal(found.sampled.radii["LE"], whole.radii["LE"])
    assert found.beyond_gap.shape == (found.sampled.count,)
