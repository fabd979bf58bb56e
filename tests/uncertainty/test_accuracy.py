"""One record for one fix and for many: shapes, words, old names, and sampling options in one place."""

from __future__ import annotations

import dataclasses
import functools
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Exposure, Observation, Sampling, uncertainty
from jaxgeo.uncertainty import NO_FIX, Accuracy, Method, Sobol, accuracy, sample
from jaxgeo.uncertainty.sampling import resolve_sampling
from tests.support import looks

UV, GROUND = looks.LEVEL_UV, looks.LEVEL
SCENE = (looks.level_sensor(), looks.level_shot(), UV, GROUND, looks.level_errors())
PIXELS = np.array([[UV, (UV[0] + 5.0, UV[1])], [(-1e4, 0.0), (UV[0], UV[1] + 7.0)]])
RADII = ("circular", "linear", "spherical")


@pytest.fixture(scope="module")
def one() -> Accuracy:
    return accuracy(*SCENE)


@pytest.fixture(scope="module")
def many() -> Accuracy:
    sensor, shot, _, terrain, errors = SCENE
    return accuracy(sensor, shot, PIXELS, terrain, errors, block=4)


def test_every_field_of_one_fix_is_an_array(one: Accuracy) -> None:
    for name in ("probability", *RADII, "method", "cov_enu", "bias_enu", "failed"):
        assert isinstance(getattr(one, name), jax.Array), name
    assert (one.shape, one.words, one.level()) == ((), Method.facet.words, 0.9)
    assert "nearly planar" in one.because
    low, high = one.circular_interval
    assert str(one) == (
        f"CE90 {float(one.circular):.4g} m ({float(low):.3g} to {float(high):.3g}), "
        f"LE90 {float(one.linear):.4g} m, SE90 {float(one.spherical):.4g} m, "
        f"by linear propagation. {one.because}"
    )
    np.testing.assert_array_equal(one.cov_enu, one.propagation.cov_enu)
    assert np.isnan(one.failed)
    with pytest.raises(IndexError, match="one fix"):
        one[0]


@pytest.mark.costly
def test_the_interval_of_a_figure_grows_with_what_planes_leave_out(one: Accuracy, many: Accuracy) -> None:
    """On level ground it is narrowest; it does not depend on which of facet and footprint is off, nor on the sign."""

    def half(**changed: float) -> float:
        diagnostics = one.diagnostics._replace(**{name: jnp.asarray(value) for name, value in changed.items()})
        low, high = dataclasses.replace(one, diagnostics=diagnostics).circular_interval
        assert float(low * high) == pytest.approx(float(one.circular) ** 2, rel=1e-12)
        return float(jnp.log(high / one.circular))

    profile = float(one.diagnostics.profile)
    narrowest = half(facet=profile, footprint=profile)
    assert half() == pytest.approx(narrowest, rel=0.05)
    widths = [half(facet=profile * off, footprint=profile) for off in (1.0, 1.02, 1.05, 1.1, 1.3, 3.0)]
    assert widths[0] == narrowest > 0.0
    assert np.all(np.diff(widths[:4]) > 0.0)
    assert widths[-1] == widths[-2]  # such fixes are rare, and sent to samples
    assert half(facet=profile, footprint=profile / 1.05) == pytest.approx(widths[2], rel=1e-9)
    assert half(facet=profile, footprint=profile, jumps=0.005) > narrowest + 0.05
    np.testing.assert_array_equal(np.isnan(many.circular_interval[0]), ~np.asarray(many.has_fix))
    np.testing.assert_allclose(many.circular_interval[1][0, 0], one.circular_interval[1], rtol=1e-6)


@pytest.mark.costly
def test_the_interval_of_samples_is_theirs(one: Accuracy) -> None:
    drawn = sample(*SCENE, count=2000)
    found = dataclasses.replace(one, method=jnp.asarray(Method.samples.value), sampled=drawn)
    expected = drawn.circular_error(0.9)
    assert found.circular_interval == (expected.low, expected.high)
    assert np.isnan(dataclasses.replace(found, sampled=None).circular_interval[0])


@pytest.mark.costly
def test_it_goes_through_jit_and_pickle(one: Accuracy, many: Accuracy) -> None:
    for found in (one, many):
        for again in (jax.jit(lambda found: found)(found), pickle.loads(pickle.dumps(found))):
            assert again.count == found.count
            np.testing.assert_array_equal(again.circular, found.circular)


@pytest.mark.costly
def test_many_pixels_have_the_shape_of_the_pixels(one: Accuracy, many: Accuracy) -> None:
    assert many.shape == (2, 2)
    assert many.cov_enu.shape == (2, 2, 3, 3)
    np.testing.assert_array_equal(many.method, [[0, 0], [NO_FIX, 0]])
    np.testing.assert_array_equal(many.has_fix, [[True, True], [False, True]])
    assert int(many.fix.status[1, 0]) == jaxgeo.Status.outside_image
    for name in RADII:
        assert float(getattr(many[0, 0], name)) == pytest.approx(float(getattr(one, name)), rel=1e-9)
        assert np.isnan(getattr(many, name)[1, 0])
    assert many[0, 0].because == one.because
    assert many[1, 0].because is many[1, 0].words is None
    assert str(many[1, 0]).startswith("No fix: outside_image")
    assert str(many).startswith("3 of 4 observations have a fix. CE90 up to")
    assert many[0].shape == (2,)
    with pytest.raises(ValueError, match=r"found\[3\]\.because"):
        _ = many.because


@pytest.mark.slow
def test_without_samples_it_is_a_function_for_jit_vmap_and_derivatives(many: Accuracy) -> None:
    sensor, shot, _, terrain, errors = SCENE

    @jax.jit
    @functools.partial(jax.value_and_grad, argnums=1, has_aux=True)
    def radii(shot, pixels):
        found = accuracy(sensor, shot, pixels, terrain, errors, sampling=None)
        return found.circular[0, 0], found

    def radius(uv):
        return accuracy(sensor, shot, uv, terrain, errors, sampling=None).circular

    assert jax.eval_shape(jax.vmap(radius), PIXELS[0]).shape == (2,)
    (_, found), slopes = radii(shot, PIXELS)
    np.testing.assert_allclose(found.circular, many.circular, rtol=1e-9)
    step = np.zeros_like(PIXELS)  # px
    step[0, 0, 0] = 1.0
    numeric = (radii(shot, PIXELS + step)[0][0] - radii(shot, PIXELS - step)[0][0]) / 2.0
    assert float(slopes[0, 0, 0]) == pytest.approx(float(numeric), rel=1e-3)
    assert np.count_nonzero(slopes) == 2
    none = radii(looks.level_shot(120.0), PIXELS)[0][1]
    assert np.all(none.method == NO_FIX)
    assert str(none[0, 0]).startswith("No fix")


@pytest.mark.costly
def test_without_samples_it_is_a_function_of_pixels_for_jit_vmap_and_derivatives(many: Accuracy) -> None:
    """Of many pixels, one of them outside the image, and, by its shape alone, of one that is mapped."""
    sensor, shot, _, terrain, errors = SCENE
    along = np.zeros_like(PIXELS)  # px
    along[..., 0] = 1.0

    def radii(pixels):
        found = accuracy(sensor, shot, pixels, terrain, errors, sampling=None)
        return found.circular, (found.cov_enu, found.fix)

    @jax.jit
    def derived(pixels):
        (values, more), (slopes, _) = jax.jvp(radii, (pixels,), (along,))
        return values, slopes, more

    values, slopes, (cov_enu, fix) = derived(PIXELS)
    np.testing.assert_allclose(values, many.circular, rtol=1e-9)
    ahead, behind = (np.asarray(derived(PIXELS + way * along)[0]) for way in (1.0, -1.0))
    seen = np.asarray(many.has_fix)
    np.testing.assert_allclose(np.asarray(slopes)[seen], ((ahead - behind) / 2.0)[seen], rtol=1e-3)
    np.testing.assert_array_equal(np.asarray(fix.status) == jaxgeo.Status.outside_image, ~seen)
    for figure in (values, cov_enu, fix.ecef, fix.position.lat):
        assert np.all(np.isnan(np.asarray(figure)[~seen]))
        assert np.all(np.isfinite(np.asarray(figure)[seen]))
    assert jax.eval_shape(jax.vmap(lambda uv: radii(uv)[0]), PIXELS[0]).shape == (2,)


@pytest.mark.slow
def test_without_samples_one_pixel_is_mapped_and_derived(many: Accuracy) -> None:
    sensor, shot, _, terrain, errors = SCENE

    def radius(uv):
        return accuracy(sensor, shot, uv, terrain, errors, sampling=None).circular

    pixels = jnp.asarray(PIXELS[0])
    np.testing.assert_allclose(jax.vmap(radius)(pixels), many.circular[0], rtol=1e-9)
    slope, step = jax.grad(radius)(pixels[0]), np.array([1.0, 0.0])  # px
    numeric = (radius(pixels[0] + step) - radius(pixels[0] - step)) / 2.0
    assert float(slope[0]) == pytest.approx(float(numeric), rel=1e-3)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap, jax.grad], ids=["jit", "vmap", "grad"])
def test_samples_under_a_transformation_are_refused_in_words(transform) -> None:
    sensor, shot, _, terrain, errors = SCENE
    pixels = jnp.stack([jnp.asarray(UV)] * 2) if transform is jax.vmap else jnp.asarray(UV)
    with pytest.raises(TypeError, match="Pass sampling=None"):
        transform(lambda uv: accuracy(sensor, shot, uv, terrain, errors).circular)(pixels)


@pytest.mark.slow
def test_observations_with_a_leading_axis_are_many_exposures(one: Accuracy) -> None:
    sensor, shot, _, terrain, errors = SCENE
    pixels, grounds, models = np.stack([UV, UV]), looks.stacked(terrain, terrain), looks.stacked(errors, errors)
    parts = looks.stacked(sensor, sensor), looks.stacked(shot, shot)
    found = accuracy(Observation(Exposure(*parts), pixels), grounds, models, in_axes=(0, 0, 0))
    same = accuracy(*parts, pixels, grounds, models, in_axes=(0, 0, 0, 0, 0))
    with pytest.warns(DeprecationWarning, match="accuracy_of_each is now"):
        old = uncertainty.accuracy_of_each(*parts, pixels, grounds, models, in_axes=(0, 0, 0, 0, 0), count=5)
    assert (found.count, same.count, old.count) == (20_000, 20_000, 5)
    for each in (found, same, old):
        assert isinstance(each, Accuracy)
        np.testing.assert_allclose(each.circular, np.full(2, one.circular), rtol=1e-9)
        assert each[1].because == one.because


@pytest.mark.costly
def test_a_fix_that_is_missing_is_raised_for_one_and_told_of_many() -> None:
    sensor, _, _, terrain, errors = SCENE
    away = looks.level_shot(120.0)
    with pytest.raises(ValueError, match="cannot estimate accuracy, there is no fix"):
        accuracy(sensor, away, UV, terrain, errors)
    found = accuracy(sensor, away, [UV] * 4, terrain, errors, block=4)
    assert np.all(found.method == NO_FIX)
    assert np.all(np.isnan(found.circular))


# Old names, for one release.


@pytest.mark.costly
@pytest.mark.parametrize("old, new", [("trust", "method"), ("signs", "diagnostics")])
def test_old_fields_warn(one: Accuracy, many: Accuracy, old: str, new: str) -> None:
    for found in (one, many, uncertainty.AccuracyMap(many, many.fix.position, PIXELS)):
        with pytest.warns(
            DeprecationWarning, match=rf"{type(found).__name__}\.{old} is now .*\.{new}; .* version 0\.3"
        ):
            value = getattr(found, old)
        for a, b in zip(jax.tree.leaves(value), jax.tree.leaves(getattr(found, new)), strict=True):
            np.testing.assert_array_equal(a, b)
    with pytest.warns(DeprecationWarning, match="trust"):
        assert one.trust is Method.facet


@pytest.mark.slow
def test_old_functions_warn_and_give_the_record(one: Accuracy, many: Accuracy) -> None:
    sensor, shot, _, terrain, errors = SCENE
    with pytest.warns(DeprecationWarning, match=r"assess is now jaxgeo.uncertainty.accuracy\(\.\.\., sampling=None\)"):
        found = [uncertainty.assess(*SCENE)]
    with pytest.warns(DeprecationWarning, match="accuracy_of_pixels is now"):
        found.append(uncertainty.accuracy_of_pixels(sensor, shot, PIXELS, terrain, errors, block=4, count=0)[0, 0])
    for each in found:
        assert isinstance(each, Accuracy)
        assert each.shape == ()
        assert float(each.circular) == pytest.approx(float(one.circular), rel=1e-9)
    assert [each.count for each in found] == [0, 0]


# Options of sampling.


@pytest.mark.costly
def test_separate_options_warn_and_both_are_refused(one: Accuracy) -> None:
    with pytest.warns(DeprecationWarning, match=r"accuracy: give sampling=Sampling\(count=\.\.\., key=\.\.\.\)"):
        found = accuracy(*SCENE, count=100, key=jax.random.key(2))
    assert found.count == 100
    np.testing.assert_array_equal(found.circular, one.circular)
    with pytest.raises(TypeError, match=r"accuracy: give count within sampling=Sampling\(\.\.\.\)"):
        accuracy(*SCENE, count=100, sampling=Sampling())
    with pytest.raises(TypeError, match="sample: give key within"):
        sample(*SCENE, key=jax.random.key(2), sampling=Sampling())
    with pytest.raises(TypeError, match="sampling must be a jaxgeo Sampling"):
        resolve_sampling({"count": 3}, 1000)


def test_an_option_left_out_is_the_default_of_the_function() -> None:
    options = resolve_sampling(Sampling(count=32, draws=Sobol()), 1000)
    assert (options.count, options.scrambles, options.key) == (32, 16, None)
    assert resolve_sampling(Sampling(), 1000).count == 1000
    assert resolve_sampling(None, 1000, least=0).count == 0
    np.testing.assert_array_equal(jax.random.key_data(Sampling().random_key), jax.random.key_data(jax.random.key(0)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.count = 3


@pytest.mark.costly
def test_sampling_and_separate_options_draw_the_same() -> None:
    key = jax.random.key(5)
    here = sample(*SCENE, key=key, count=64)
    there = sample(*SCENE, sampling=Sampling(count=64, key=key))
    np.testing.assert_array_equal(here.radii["CE"], there.radii["CE"])
