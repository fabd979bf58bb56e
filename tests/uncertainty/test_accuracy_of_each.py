"""How sure many exposures' fixes are: each as `accuracy` says of it alone, whatever else is in the batch."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import ConstantHeight, Gimbal, Mount, Sensor, Shot
from jaxgeo.uncertainty import (
    NO_FIX,
    Accuracy,
    ErrorModel,
    Method,
    Sampling,
    accuracy,
    many_fixes,
    method_selection,
    sources,
)
from jaxgeo.uncertainty.profile import profile_of
from tests.support import looks
from tests.support.looks import UV, pose, sensor
from tests.support.scenes import rough, small_dem

MODEL = ErrorModel(
    (
        sources.Position.from_ned(north=1.5, east=1.5, down=3.0),
        sources.Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.02),
        sources.TerrainHeight.from_metres(2.0),
    )
)
DRAWN = Sampling(count=400)
OF_SHOTS = (None, 0, 0, None, None)
READINGS = jnp.deg2rad(jnp.array([[40.0, 2.0], [41.0, 1.0], [120.0, 0.0]]))  # the last looks at the sky


def batch() -> tuple[Shot, np.ndarray]:
    shots = [Shot(pose(), readings) for readings in READINGS]
    return jax.tree.map(lambda *leaves: jnp.stack(jnp.broadcast_arrays(*leaves)), *shots), np.tile(UV, (3, 1))


@pytest.fixture(scope="module")
def dem():
    return small_dem(rough())


@pytest.mark.slow
@pytest.mark.parametrize("block", [128, 2], ids=["at once", "in blocks"])
def test_each_is_as_sure_as_alone(dem, block: int) -> None:
    shots, uv = batch()
    found = accuracy(sensor(), shots, uv, dem, MODEL, in_axes=OF_SHOTS, sampling=DRAWN, block=block)
    for i in range(2):
        alone = accuracy(sensor(), jax.tree.map(lambda leaf, i=i: leaf[i], shots), UV, dem, MODEL, sampling=DRAWN)
        assert int(found.method[i]) == int(alone.method)
        assert found[i].because == alone.because
        for name in ("circular", "linear", "spherical"):
            np.testing.assert_allclose(getattr(found, name)[i], getattr(alone, name), rtol=1e-6)
        np.testing.assert_allclose(found.cov_enu[i], alone.cov_enu, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.failed[i], alone.failed, atol=1e-12)
    assert int(found.method[2]) == NO_FIX
    assert found[2].because is None
    assert str(found[2]).startswith("No fix: rises_away")
    assert np.isnan(found.circular[2])
    assert np.isnan(found.cov_enu[2]).all()


def over_level_ground(angles: list[float], heights: list[float], scale: float = 0.0) -> Accuracy:
    """Four exposures of the same look, each with angles (deg) of its own over ground (m) of its own; the other errors
    are those of `level_errors` of a scale."""
    others = looks.level_errors(scale).sources[1:]
    attitudes = (sources.Attitude.from_degrees(heading=one, pitch=one, roll=one) for one in angles)
    errors = looks.stacked(*(ErrorModel((attitude, *others)) for attitude in attitudes))
    ground = looks.stacked(*map(ConstantHeight, heights))
    sensors, shots = (looks.stacked(*[one] * 4) for one in (looks.level_sensor(), looks.level_shot()))
    uv = np.tile(looks.LEVEL_UV, (4, 1))
    return accuracy(sensors, shots, uv, ground, errors, in_axes=(0, 0, 0, 0, 0), sampling=None)


@pytest.fixture(scope="module")
def of_each() -> Accuracy:
    """Over level ground: one, twice the errors, higher ground, and errors so wide that they need samples."""
    return over_level_ground([0.1, 0.2, 0.1, 30.0], [100.0, 100.0, 1600.0, 100.0])


@pytest.mark.costly
def test_what_is_of_each_is_of_each(of_each: Accuracy) -> None:
    """Ground, errors and sensors of each: twice the errors, twice the deviations; higher ground, less of them."""
    np.testing.assert_allclose(of_each.cov_enu[1], 4.0 * np.asarray(of_each.cov_enu[0]), rtol=1e-6, atol=1e-6)
    first, twice, higher = np.asarray(of_each.circular[:3])
    assert twice == pytest.approx(2.0 * first, rel=1e-3)  # larger errors are less linear
    assert 0.4 * first < higher < 0.6 * first
    assert (np.asarray(of_each.method[:3]) == Method.facet).all()


@pytest.mark.costly
def test_samples_that_are_not_drawn_leave_no_figures(of_each: Accuracy) -> None:
    assert int(of_each.method[3]) == Method.samples
    assert np.isnan(of_each.circular[3])
    assert np.isnan(of_each.cov_enu[3]).all()


@pytest.mark.slow
def test_samples_over_terrain_that_are_not_drawn_leave_no_figures(dem) -> None:
    shots, uv = batch()
    wide = ErrorModel((sources.Attitude.from_degrees(heading=3.0, pitch=3.0, roll=3.0),))
    found = accuracy(sensor(), shots, uv, dem, wide, in_axes=OF_SHOTS, sampling=None)
    sampled = np.asarray(found.method) == Method.samples
    assert sampled.any()
    assert np.isnan(np.asarray(found.circular)[sampled]).all()
    assert np.isnan(np.asarray(found.cov_enu)[sampled]).all()


@pytest.mark.costly
def test_slopes_profile_and_radii_are_compiled_once_for_all_cameras_and_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """After those of one camera, exposures of another one, and of a source more, add their derivatives only."""
    traced = []

    def counted(*given):
        traced.append(given)
        return profile_of(*given)

    over_level_ground([0.1] * 4, [100.0] * 4)
    monkeypatch.setattr(method_selection, "profile_of", counted)
    ground, uv = looks.stacked(*[looks.LEVEL] * 4), np.tile(looks.LEVEL_UV, (4, 1))
    attitude = sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1)
    given = {"in_axes": (None, 0, 0, 0, None), "sampling": None}
    fixed = Sensor(looks.level_sensor().camera, Gimbal.fixed(), Mount.nadir())
    still = looks.stacked(*[Shot(looks.level_shot().pose)] * 4)
    one = accuracy(fixed, still, uv, ground, (attitude,), **given)
    two = accuracy(fixed, still, uv, ground, (attitude, attitude), **given)
    assert not traced
    np.testing.assert_allclose(two.cov_enu, 2.0 * np.asarray(one.cov_enu), rtol=1e-9, atol=1e-9)


@pytest.mark.costly
def test_figures_are_those_of_the_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the facet is made to differ from the terrain profile, those of the footprint, as on level ground."""

    def assessed() -> Accuracy:
        return over_level_ground([0.01, 0.02, 0.03, 0.01], [100.0] * 4, 0.1)

    level, examined = assessed(), many_fixes.examine_block

    def with_a_steep_facet(*given):
        found = examined(*given)
        return found._replace(cov_enu=found.cov_enu.at[:, 0].multiply(4.0))

    monkeypatch.setattr(many_fixes, "examine_block", with_a_steep_facet)
    found = assessed()
    assert (np.asarray(level.method) == Method.facet).all()
    assert (np.asarray(found.method) == Method.footprint).all()
    for name in ("cov_enu", "circular", "linear", "spherical"):
        np.testing.assert_allclose(getattr(found, name), getattr(level, name), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.diagnostics.facet, 2.0 * np.asarray(found.diagnostics.footprint), rtol=1e-6)


def test_mistakes() -> None:
    shots, uv = batch()
    ground = ConstantHeight(0.0)
    with pytest.raises(ValueError, match=r"one length, 1 or more; got shot 3, uv 2"):
        accuracy(sensor(), shots, uv[:2], ground, MODEL, in_axes=OF_SHOTS)
    with pytest.raises(ValueError, match="in_axes must be 0 or None for each of sensor, shot, uv, terrain, errors"):
        accuracy(sensor(), shots, uv, ground, MODEL, in_axes=(None, 0))
    with pytest.raises(ValueError, match="terrain is a batch by in_axes, but holds a single number"):
        accuracy(sensor(), shots, uv, ground, MODEL, in_axes=(None, 0, 0, 0, None))
    with pytest.raises(ValueError, match="errors has no source"):
        accuracy(sensor(), shots, uv, ground, ErrorModel(()), in_axes=OF_SHOTS)
    with pytest.raises(ValueError, match="between 0 and 1"):
        accuracy(sensor(), shots, uv, ground, MODEL, probability=1.0, in_axes=OF_SHOTS)
