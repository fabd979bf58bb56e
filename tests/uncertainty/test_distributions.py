"""Distributions of errors that are not normal, against SciPy, and their way through each propagation method."""

from __future__ import annotations

import copy
import functools
import math
import pickle
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import jaxgeo
from jaxgeo import uncertainty as un
from jaxgeo._checks import as_float64
from jaxgeo.uncertainty import ErrorModel, PerImage, Random, Sampling, Sobol, sources
from jaxgeo.uncertainty._second_order import axis_moments, moments_of_points, sigma_points_of
from jaxgeo.uncertainty.copula import normal_correlation
from jaxgeo.uncertainty.distributions import (
    AbstractDistribution,
    Arcsine,
    Empirical,
    Laplace,
    Mixture,
    StudentT,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from jaxgeo.uncertainty.model import checked_model
from jaxgeo.uncertainty.normality import is_nearly_normal
from tests.support import looks


class Row(NamedTuple):
    """A distribution, the same in SciPy, and the relative accuracy of its quantiles."""

    ours: AbstractDistribution
    theirs: Any
    accuracy: float = 1e-12


TABLE = {
    "uniform": Row(Uniform(), scipy.stats.uniform()),
    "triangular": Row(Triangular(), scipy.stats.triang(0.5)),
    "arcsine": Row(Arcsine(), scipy.stats.arcsine()),
    "Laplace": Row(Laplace(), scipy.stats.laplace()),
    "t5": Row(StudentT(5), scipy.stats.t(5)),
    "t2.5": Row(StudentT(2.5), scipy.stats.t(2.5), 1e-9),
    "t1e6": Row(StudentT(1e6), scipy.stats.t(1e6), 1e-10),
    "t1": Row(StudentT(1), scipy.stats.cauchy(), 1e-9),
    "two limits": Row(TruncatedNormal(-1.0, 2.0), scipy.stats.truncnorm(-1.0, 2.0)),
    "half normal": Row(TruncatedNormal(0.0, math.inf), scipy.stats.halfnorm()),
    "far tail": Row(TruncatedNormal(4.0, 7.0), scipy.stats.truncnorm(4.0, 7.0), 1e-9),
    "outliers": Row(Mixture.of_outliers(share=0.05, times=10.0), None, 1e-9),
    "biased outliers": Row(Mixture(*map(np.array, ([0.7, 0.2, 0.1], [1.0, 2.0, 0.5], [0.0, 3.0, -5.0]))), None),
    "residuals": Row(Empirical.of_residuals([0.3, -0.2, 0.9, 0.1, 4.0]), None),
}  # fmt: skip
NORMAL = np.concatenate([np.linspace(-7.9, 7.9, 80), [0.0]])
DENSITY = np.linspace(-8.4, 8.4, 40_001)
WEIGHT = np.exp(-0.5 * DENSITY**2) / math.sqrt(2.0 * math.pi) * (DENSITY[1] - DENSITY[0])
IN_SCIPY = [name for name, row in TABLE.items() if row.theirs is not None]


BLOCK = 4001  # numbers of one program


def of_arrays(ours: AbstractDistribution) -> Any:
    return jax.tree.map(np.asarray, ours)


@jax.jit
def standardised(ours: AbstractDistribution, normal: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Values and their derivatives: one program for a form of distribution, whatever its numbers."""
    return jax.jvp(ours.standardised, (normal,), (jnp.ones_like(normal),))


def with_slopes(ours: AbstractDistribution, normal: Any) -> tuple[np.ndarray, np.ndarray]:
    """In blocks of one size, the last one padded."""
    flat = np.ravel(normal)
    blocks = -(-flat.size // BLOCK)
    padded = np.pad(flat, (0, blocks * BLOCK - flat.size)).reshape(blocks, BLOCK)
    parts = zip(*(standardised(of_arrays(ours), block) for block in padded), strict=True)
    value, slope = (np.concatenate(part)[: flat.size].reshape(np.shape(normal)) for part in parts)
    return value, slope


def values(ours: AbstractDistribution, normal: Any = NORMAL) -> np.ndarray:
    return with_slopes(ours, normal)[0]


@jax.jit
def with_table(ours: AbstractDistribution) -> AbstractDistribution:
    return ours.prepared()


@jax.jit
def skewness_and_kurtosis(ours: AbstractDistribution) -> tuple[Any, Any]:
    return ours.skewness, ours.kurtosis


@pytest.mark.parametrize("name", IN_SCIPY)
def test_quantiles_are_those_of_scipy(name: str) -> None:
    ours, theirs, accuracy = TABLE[name]
    mean, sigma = theirs.mean(), theirs.std()
    if not math.isfinite(sigma):
        mean, sigma = 0.0, 1.0  # in units of the scale
    lower = theirs.ppf(scipy.stats.norm.cdf(NORMAL))
    expected = (lower - mean) / sigma
    # Above the median through the upper tail, which is exact where SciPy has an own one; else only as far as 1 - p is.
    upper = (theirs.isf(scipy.stats.norm.sf(NORMAL)) - mean) / sigma
    near = NORMAL < 4.0 if isinstance(ours, TruncatedNormal | Triangular) else NORMAL < 9.0
    expected = np.where(NORMAL < 0.0, expected, upper)[near]
    found = np.asarray(ours.standardised(jnp.asarray(NORMAL)))
    np.testing.assert_allclose(found[near], expected, rtol=accuracy, atol=10.0 * accuracy)


@pytest.mark.parametrize("name", IN_SCIPY)
def test_skewness_and_kurtosis_are_those_of_scipy(name: str) -> None:
    ours, theirs, accuracy = TABLE[name]
    if ours.finite_orders <= 4.0:
        assert math.isinf(float(ours.kurtosis))
        return
    skewness, excess = theirs.stats("sk")
    assert float(ours.skewness) == pytest.approx(float(skewness), abs=1e3 * accuracy)
    assert float(ours.kurtosis) == pytest.approx(float(excess) + 3.0, rel=1e3 * accuracy)


@pytest.mark.costly
@pytest.mark.parametrize("name", [name for name, row in TABLE.items() if row.ours.finite_orders > 4.0])
def test_mean_variance_and_moments_are_those_of_the_quantiles(name: str) -> None:
    ours = TABLE[name].ours
    drawn = values(ours, DENSITY)
    mean, variance, third, fourth = (float(np.sum(WEIGHT * drawn**k)) for k in range(1, 5))
    skewness, kurtosis = (float(one) for one in skewness_and_kurtosis(of_arrays(ours)))
    assert mean == pytest.approx(0.0, abs=1e-7)
    assert variance == pytest.approx(1.0, abs=1e-6)
    assert third == pytest.approx(skewness, abs=1e-5 if name != "t5" else 1e-9)
    assert fourth == pytest.approx(kurtosis, rel=1e-5 if name != "t5" else 0.02)  # its tail ends at 8.4 sigma


@pytest.mark.costly
@pytest.mark.parametrize("name", ["outliers", "biased outliers"])
def test_quantiles_of_mixtures_have_their_probability(name: str) -> None:
    ours: Any = TABLE[name].ours
    shares, sigmas = np.asarray(ours.shares), np.asarray(ours.sigmas)
    means = np.broadcast_to(np.asarray(ours.means), shares.shape)
    mean = np.sum(shares * means)
    sigma = math.sqrt(np.sum(shares * (sigmas**2 + (means - mean) ** 2)))
    at = mean + sigma * values(ours)
    below = np.sum(shares * scipy.stats.norm.cdf((at[:, None] - means) / sigmas), axis=1)
    above = np.sum(shares * scipy.stats.norm.sf((at[:, None] - means) / sigmas), axis=1)
    np.testing.assert_allclose(below[NORMAL < 0.0], scipy.stats.norm.cdf(NORMAL[NORMAL < 0.0]), rtol=1e-9)
    np.testing.assert_allclose(above[NORMAL > 0.0], scipy.stats.norm.sf(NORMAL[NORMAL > 0.0]), rtol=1e-9)


@pytest.mark.costly
def test_the_table_of_a_mixture_is_close_to_it() -> None:
    for times, accuracy in ((10.0, 1e-9), (100.0, 2e-5)):
        ours = Mixture.of_outliers(share=0.01, times=times)
        normal = np.linspace(-8.0, 8.0, 2001) + 1e-4
        np.testing.assert_allclose(
            values(with_table(of_arrays(ours)), normal), values(ours, normal), rtol=0.0, atol=accuracy
        )


def test_residuals_have_the_distribution_of_the_supplement() -> None:
    """JCGM 101:2008, 7.5: number i of n in order has the probability (i - 1/2) / n, linear between."""
    ordered = np.array([-0.2, 0.1, 0.3, 0.9, 4.0])
    found = Empirical.of_residuals(ordered[[2, 0, 3, 1, 4]])
    at = found.mean + found.standard_deviation * found.quantile((np.arange(5) + 0.5) / 5)
    np.testing.assert_allclose(at, ordered, atol=1e-12)
    assert float(found.mean + found.standard_deviation * found.quantile(0.4)) == pytest.approx(0.2, abs=1e-12)


@pytest.mark.costly
@pytest.mark.parametrize("name", list(TABLE))
def test_quantiles_increase_and_have_their_derivative(name: str) -> None:
    ours = TABLE[name].ours
    middle = 0.1 if name == "residuals" else 0.0  # their slope changes at the median
    normal = np.array([-3.1, -1.2, -0.3, middle, 0.7, 2.2])
    step = 1e-6
    _, slopes = with_slopes(ours, normal)
    differences = (values(ours, normal + step) - values(ours, normal - step)) / (2.0 * step)
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-9)
    assert np.all(np.diff(values(ours, np.linspace(-8.0, 8.0, 4001))) >= -1e-14)


@pytest.mark.costly
@pytest.mark.parametrize(
    "of_parameters, at",
    [
        (lambda share, times: Mixture.of_outliers(share=share, times=times), [0.05, 8.0]),
        (lambda low: TruncatedNormal(low, 2.0), [-1.0]),
        (lambda value: Empirical(jnp.array([0.0, 0.3, 1.0]), jnp.stack([jnp.zeros(()), value, jnp.ones(())])), [0.2]),
    ],
    ids=["share and times", "limit", "value"],
)
def test_derivatives_by_parameters_are_differences(of_parameters: Any, at: list[float]) -> None:
    def value(parameters: jax.Array) -> jax.Array:
        return of_parameters(*parameters).standardised(jnp.array([-2.0, 0.4, 1.9]))

    compiled = jax.jit(lambda at: (value(at), jax.jacfwd(value)(at), jax.jacrev(value)(at)))
    steps = 1e-6 * np.eye(len(at))
    quotient = np.stack([(compiled(at + step)[0] - compiled(at - step)[0]) / 2e-6 for step in steps], axis=1)
    _, forward, reverse = compiled(np.array(at))
    np.testing.assert_allclose(forward, quotient, atol=1e-7)
    np.testing.assert_allclose(reverse, quotient, atol=1e-7)


@pytest.mark.costly
@pytest.mark.parametrize("name", ["uniform", "t5", "outliers", "residuals"])
def test_copies_and_pickles_are_the_same(name: str) -> None:
    ours = TABLE[name].ours
    for other in (copy.deepcopy(ours), pickle.loads(pickle.dumps(ours))):
        np.testing.assert_array_equal(values(other), values(ours))
        assert other.words == ours.words


# What is refused.
UP = sources.TerrainHeight.from_metres
HALF = np.array([0.5, 0.5])


@pytest.mark.parametrize(
    "distribution, message",
    [
        (TruncatedNormal(2.0, -1.0), "terrain height: the limits of TruncatedNormal must be two numbers, low"),
        (TruncatedNormal(9.0, 10.0), "within 8 of its middle"),
        (TruncatedNormal(0.0, math.nan), "low below high"),
        (Mixture(np.array([0.5, 0.4]), np.ones(2)), r"must be positive and sum to 1; got \[0.5, 0.4\]"),
        (Mixture(np.array([1.5, -0.5]), np.ones(2)), "must be positive and sum to 1"),
        (Mixture(HALF, np.array([1.0, 0.0])), "sigmas of Mixture must be positive"),
        (Mixture(HALF, np.array([1.0, -2.0])), "sigmas of Mixture must be positive"),
        (Mixture(HALF, np.ones(3)), "a share and a sigma for each part"),
        (Mixture(HALF, np.array([1.0, math.nan])), "sigmas of Mixture must be finite"),
        (Empirical(np.array([0.0, 0.5, 1.0]), np.array([-1.0, 2.0, 1.0])), "must be sorted, as quantiles are; got 2"),
        (Empirical(np.array([0.0, 0.0, 1.0]), np.array([-1.0, 0.0, 1.0])), "probabilities of Empirical must increase"),
        (Empirical(np.array([0.1, 1.0]), np.array([-1.0, 1.0])), "begin with 0 and end with 1"),
        (Empirical(np.array([0.0, 1.0]), np.array([1.0, 1.0])), "leaves no error"),
        (Empirical(np.array([0.0, 1.0]), np.ones(3)), "a value for each probability"),
        ((Uniform(), Uniform()), "a tuple with one for each of height; got 2"),
        (StudentT(2), "Student-t with 2 degrees of freedom has no finite variance, which linear propagation"),
    ],
)  # fmt: skip
def test_bad_distributions_are_refused(distribution: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        checked_model((UP(1.0, distribution=distribution),), _level_inputs())


@pytest.mark.parametrize("distribution", ["uniform", Uniform, 3.0, ("normal",)])
def test_no_distributions_are_refused(distribution: Any) -> None:
    with pytest.raises(TypeError, match=r"distribution must be one of jaxgeo.uncertainty.distributions"):
        checked_model((UP(1.0, distribution=distribution),), _level_inputs())


@pytest.mark.parametrize("df", [0.5, -3.0, 1e7, math.inf, math.nan, "5", True])
def test_degrees_of_freedom_are_numbers_from_one_to_a_million(df: Any) -> None:
    with pytest.raises(ValueError, match="df of StudentT, its degrees of freedom, must be a plain number"):
        StudentT(df)


def test_no_outliers_and_few_residuals_are_refused() -> None:
    with pytest.raises(ValueError, match="share must lie in"):
        Mixture.of_outliers(share=1.5, times=3.0)
    with pytest.raises(ValueError, match="times must lie in"):
        Mixture.of_outliers(share=0.5, times=-3.0)
    with pytest.raises(ValueError, match="2 or more numbers"):
        Empirical.of_residuals([1.0])
    with pytest.raises(ValueError, match="finite"):
        Empirical.of_residuals([1.0, math.nan])
    with pytest.raises(ValueError, match="probability must lie in"):
        Uniform().quantile(1.1)
    with pytest.raises(ValueError, match="has no standard deviation"):
        _ = StudentT(1.5).per_scale


def test_correlations_that_no_copula_has_are_refused() -> None:
    correlation = np.array([[1.0, 0.99, 0.0], [0.99, 1.0, 0.0], [0.0, 0.0, 1.0]])

    def position(correlation: np.ndarray, *shapes: Any) -> sources.Position:
        return sources.Position(jnp.ones(3), jnp.asarray(correlation), distribution=shapes)

    with pytest.raises(ValueError, match=r"north \(uniform\) and east \(normal\) cannot have the correlation 0.99"):
        position(correlation, Uniform(), None, None).check_numbers()
    with pytest.raises(ValueError, match="has no variance, so that its errors have no correlation"):
        position(correlation, None, None, StudentT(2)).check_numbers()
    near = np.array([[1.0, 0.9, 0.9], [0.9, 1.0, 0.63], [0.9, 0.63, 1.0]])
    with pytest.raises(ValueError, match="no Gaussian copula gives errors of these distributions this correlation"):
        position(near, Arcsine(), None, None).check_numbers()
    position(near, None, None, None).check_numbers()


# The copula.
def test_correlations_of_normal_numbers_are_the_known_ones() -> None:
    """Uniform: 2 sin(pi r / 6) (Pearson 1907); uniform and normal: r (pi / 3)^(1/2)."""
    wanted = np.linspace(-0.95, 0.95, 4)
    for r in wanted:
        correlation = jnp.full((3, 3), r).at[jnp.arange(3), jnp.arange(3)].set(1.0)
        found, low, high = normal_correlation(correlation, (Uniform(), Uniform(), None))
        assert float(found[0, 1]) == pytest.approx(2.0 * math.sin(math.pi * r / 6.0), abs=1e-9)
        assert float(found[0, 2]) == pytest.approx(r * math.sqrt(math.pi / 3.0), abs=1e-9)
        assert float(high[1, 2]) == pytest.approx(math.sqrt(3.0 / math.pi), abs=1e-9)
        assert float(low[0, 1]) == pytest.approx(-1.0, abs=1e-9)


@pytest.mark.costly
def test_errors_have_the_stated_correlation() -> None:
    """By quadrature over both normal numbers, for nine tenths of the largest that two distributions reach."""
    shapes = drawn_block()[0].sources[0].shapes
    stated = 0.9 * normal_correlation(jnp.eye(4), shapes)[2]
    found = np.asarray(normal_correlation(stated, shapes)[0])
    nodes = np.linspace(-8.0, 8.0, 801)
    weights = np.exp(-0.5 * nodes**2) / np.sum(np.exp(-0.5 * nodes**2))
    ours: Any = [shape and with_table(of_arrays(shape)) for shape in shapes]
    for k, m in ((0, 2), (0, 3), (2, 3)):
        second = found[k, m] * nodes[:, None] + math.sqrt(1.0 - found[k, m] ** 2) * nodes[None, :]
        product = values(ours[k], nodes)[:, None] * values(ours[m], second)
        assert float(stated[k, m]) > 0.5
        assert weights @ product @ weights == pytest.approx(float(stated[k, m]), abs=2e-4)


@functools.cache
def drawn_block(count: int = 2**16) -> tuple[ErrorModel, np.ndarray]:
    """A block of correlated axes with a distribution each, and errors drawn from it."""
    block = sources.Correlated.of(
        sources.Position.from_ned(north=1.0, east=2.0, down=3.0, distribution=(Uniform(), None, Laplace())),
        sources.TerrainHeight.from_metres(0.5, distribution=Mixture.of_outliers(share=0.1, times=4.0)),
        correlation=0.6 * np.eye(4) + 0.4,
        sharing=PerImage(),
    )
    model = checked_model((block,), _level_inputs())
    return model, drawn(model, count)


def drawn(model: ErrorModel, count: int) -> np.ndarray:
    """Error vectors of Sobol points."""

    def errors(numbers: jax.Array) -> jax.Array:
        roots = model.roots()
        normal = jax.vmap(lambda k: Sobol().standard_normal(jax.random.key(7), k, model.size))(numbers)
        return jax.vmap(lambda z: model.draw(roots, z))(normal)

    return np.asarray(jax.jit(errors)(jnp.arange(count)))


def _distance(values: np.ndarray, cdf: Any) -> float:
    """Largest difference between the shares of values and probabilities below a value (Kolmogorov)."""
    result: Any = scipy.stats.ks_1samp(values, cdf)
    return float(result.statistic)


@pytest.mark.costly
def test_distributions_are_kept_under_correlation() -> None:
    errors = drawn_block()[1]
    limit = 3.0 / math.sqrt(len(errors))  # Kolmogorov's distance of independent draws is beyond this once in 10^7
    spread = Mixture.of_outliers(share=0.1, times=4.0)
    core = 0.5 / float(spread.per_core)

    def outliers(x: np.ndarray) -> np.ndarray:
        return 0.9 * scipy.stats.norm.cdf(x / core) + 0.1 * scipy.stats.norm.cdf(x / (4.0 * core))

    expected = (
        scipy.stats.uniform(-math.sqrt(3.0), 2.0 * math.sqrt(3.0)).cdf,
        scipy.stats.norm(scale=2.0).cdf,
        scipy.stats.laplace(scale=3.0 / math.sqrt(2.0)).cdf,
        outliers,
    )
    for axis, cdf in zip(errors.T, expected, strict=True):
        assert _distance(axis, cdf) < limit
    assert np.max(np.abs(errors[:, 0])) <= math.sqrt(3.0)


@pytest.mark.costly
def test_errors_have_the_stated_correlation_and_variance() -> None:
    model, errors = drawn_block()
    np.testing.assert_allclose(np.corrcoef(errors.T), 0.6 * np.eye(4) + 0.4, atol=4e-3)
    covariance = np.asarray(model.covariance())
    np.testing.assert_allclose(errors.std(axis=0), np.sqrt(np.diagonal(covariance)), rtol=4e-3)
    np.testing.assert_allclose(model.factor() @ model.factor().T, covariance, atol=1e-12)


def test_every_source_takes_a_distribution() -> None:
    """Uniform errors of all sources with independent axes are within their limits, and fill them."""
    given = [one for one in looks.all_sources().sources if one.is_independent]
    assert len(given) == 15
    shaped = tuple(
        jax.tree.map(lambda x: x, one).__class__(**(vars(one) | {"distribution": Uniform()})) for one in given
    )
    model = as_float64(ErrorModel(shaped), "errors")
    for source in model.sources:
        source.check_numbers()
    sigma = np.sqrt(np.diagonal(np.asarray(model.covariance())))
    ratio = np.max(np.abs(drawn(model, 2048)), axis=0) / sigma
    assert np.all((ratio > 1.69) & (ratio <= math.sqrt(3.0) * (1.0 + 1e-12)))


@pytest.mark.costly
def test_a_field_of_heights_keeps_its_distribution_and_variogram() -> None:
    field = sources.TerrainField.of_variograms(gaussian=[(2.0, 100.0)], nodes=5, distribution=Laplace())
    place = jnp.stack([jnp.array([6.4e6, 25.0 * k, 0.0]) for k in range(5)])
    placed = as_float64(jax.tree.map(lambda x: x, field), "field")
    placed = type(field)(**(vars(placed) | {"place": place}))
    errors = drawn(ErrorModel((placed,)), 2**16)
    assert _distance(errors[:, 2], scipy.stats.laplace(scale=math.sqrt(2.0)).cdf) < 0.012
    expected = np.exp(-((25.0 * np.subtract.outer(np.arange(5), np.arange(5)) / 100.0) ** 2))
    np.testing.assert_allclose(np.corrcoef(errors.T), expected, atol=0.02)


# The methods of propagation, over level ground from above: heights move the fix up.
def _level_inputs() -> Any:
    sensor, shot = looks.level_sensor(), looks.level_shot()
    return un.model_inputs.ModelInputs.of(sensor, shot, looks.LEVEL_UV, looks.LEVEL)


def _scene(*errors: Any) -> tuple[Any, ...]:
    return looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL, errors


@pytest.mark.costly
def test_linear_propagation_uses_the_variance_and_says_so() -> None:
    shaped = jaxgeo.propagate(
        *_scene(
            UP(2.0, distribution=Laplace()),
            sources.GimbalAngles.from_degrees(outer=0.1, inner=0.1, distribution=(Uniform(), None)),
        )
    )
    normal = ErrorModel((UP(2.0), sources.GimbalAngles.from_degrees(outer=0.1, inner=0.1)))
    np.testing.assert_allclose(shaped.cov_error, normal.covariance(), rtol=1e-12)
    np.testing.assert_allclose(shaped.cov_enu, shaped.jacobian @ normal.covariance() @ shaped.jacobian.T, atol=1e-9)
    assert normal.left_out is None
    assert shaped.note == (
        "Linear propagation uses the variance of 2 sources that are not normal: terrain height (Laplace), gimbal "
        "angles (uniform, normal); samples use the distribution."
    )


@pytest.mark.slow
def test_budgets_say_what_they_left_out() -> None:
    propagation = jaxgeo.propagate(*_scene(UP(2.0, distribution=Laplace())))
    found = un.budget(propagation)
    assert found.note == propagation.note
    assert str(found).endswith(str(propagation.note))
    assert found.to_dict()["note"] == propagation.note
    assert "note" not in un.budget(jaxgeo.propagate(*_scene(UP(2.0)))).to_dict()


def _linear(distribution: Any, others: float) -> un.Propagation:
    """Linear propagation of one height with a distribution, and a normal one, in a view straight down."""
    model = as_float64(ErrorModel((UP(1.0, distribution=distribution), UP(others))), "errors")
    nominal = _level_inputs().nominal_fix(jaxgeo.FirstHit())
    up = jnp.array([[0.2, 0.2], [0.5, 0.5], [1.0, 1.0]])
    cov = model.covariance()
    surface = un.slopes.Surface(jnp.array([0.0, 0.0, 1.0]), *(jnp.asarray(x) for x in (0.0, 0.0, 1.0)))
    return un.Propagation(nominal.fix, up, cov, up @ cov @ up.T, jnp.zeros(3), surface, nominal, model)


@pytest.mark.costly
@pytest.mark.parametrize(
    "distribution, others, expected",
    [
        (Uniform(), 0.2, False),
        (Uniform(), 0.4, True),
        (Laplace(), 0.7, False),
        (Laplace(), 1.0, True),
        (StudentT(4), 10.0, False),
        (TruncatedNormal(0.0, math.inf), 0.1, False),
        (TruncatedNormal(0.0, math.inf), 2.0, True),
        (Mixture.of_outliers(share=0.05, times=10.0), 1.0, False),
        (None, 1.0, True),
    ],
)
def test_few_errors_far_from_normal_leave_a_fix_normal(distribution: Any, others: float, expected: bool) -> None:
    assert bool(is_nearly_normal(_linear(distribution, others))) is expected


@pytest.mark.slow
def test_accuracy_says_what_it_left_out() -> None:
    scene = _scene(UP(2.0, distribution=Uniform()), sources.Geoid.from_metres(2.0))
    found = jaxgeo.accuracy(*scene, sampling=None)
    assert "1 source that is not normal: terrain height (uniform)" in str(found)
    assert found.because is not None
    assert found.because.endswith("samples use the distribution.")
    many = jaxgeo.accuracy(*scene[:2], np.array([looks.LEVEL_UV] * 2), *scene[3:], sampling=None)
    assert many.note == found.note
    assert many[0].because == found.because
    assert str(many).endswith(str(found.note))
    assert jaxgeo.accuracy(*_scene(UP(2.0)), sampling=None).note is None


@pytest.mark.slow
def test_accuracy_draws_samples_of_errors_far_from_normal() -> None:
    scene = _scene(UP(2.0, distribution=StudentT(3)))
    found = jaxgeo.accuracy(*scene, sampling=Sampling(count=32_000, draws=Sobol()))
    assert found.words == "samples"
    assert str(found.because).startswith("The error of the fix is far from normal. Linear propagation uses")
    exact = 2.0 * float(scipy.stats.t(3).ppf(0.95)) / math.sqrt(3.0)  # of a normal error: 3.29 m
    assert float(found.linear) == pytest.approx(exact, rel=0.01)
    many = jaxgeo.accuracy(*scene[:2], np.array([looks.LEVEL_UV] * 2), *scene[3:], sampling=None)
    assert np.all(np.isnan(many.linear))
    assert many[0].because == found.because
    each = jaxgeo.accuracy(
        *scene[:2], np.array([looks.LEVEL_UV] * 2), *scene[3:], in_axes=(None, None, 0, None, None), sampling=None
    )
    np.testing.assert_array_equal(each.method, many.method)


def test_a_tuple_of_normal_axes_is_normal() -> None:
    """It is drawn by the same program, to the bit."""
    plain, listed = (
        as_float64(ErrorModel((sources.Position.from_ned(north=1, east=2, down=3, **more),)), "errors")
        for more in ({}, {"distribution": (None, None, None)})
    )
    normal = jnp.array([0.3, -1.2, 2.0])
    programs = [jax.make_jaxpr(lambda z, m=model: m.draw(m.roots(), z))(normal) for model in (plain, listed)]
    assert str(programs[0]) == str(programs[1])
    assert plain.left_out is listed.left_out is None


@pytest.mark.slow
def test_samples_have_the_distribution() -> None:
    """Heights over level ground seen steeply: the vertical error is that of the heights."""
    scene = _scene(UP(2.0, distribution=Uniform()))
    found = jaxgeo.sample(*scene, count=3200, draws=Sobol(), keep=True)
    assert found.errors_enu is not None
    assert np.max(np.abs(found.errors_enu[:, 2])) <= 2.0 * math.sqrt(3.0) * (1.0 + 1e-6)
    assert found.quantile("LE", 0.9).value == pytest.approx(0.9 * 2.0 * math.sqrt(3.0), rel=2e-3)
    pure = un.error_samples(*scene, jax.random.key(0), np.arange(5), draws=Sobol())
    np.testing.assert_allclose(pure.errors_enu, found.errors_enu[:5], atol=1e-7)


@pytest.mark.costly
def test_errors_without_a_variance_can_be_sampled_only() -> None:
    scene = _scene(UP(2.0, distribution=StudentT(1)))
    errors = drawn(checked_model(scene[4], _level_inputs(), moments=0), 2**14)
    assert np.quantile(errors, 0.95) == pytest.approx(2.0 * float(scipy.stats.cauchy.ppf(0.95)), rel=0.02)
    for method in (jaxgeo.propagate, jaxgeo.accuracy, un.sobol_indices, un.gauss_helmert, un.second_order):
        with pytest.raises(ValueError, match="has no finite"):
            method(*scene)
    with pytest.raises(ValueError, match="no finite fourth moment, which sigma points and second order need"):
        un.sigma_points(*_scene(UP(2.0, distribution=StudentT(4))))


SKEWED = TruncatedNormal(0.0, math.inf)


def test_sigma_points_are_exact_for_polynomials_of_second_degree() -> None:
    """Sum of f_k(e_k) of independent errors, by SciPy's moments of half normal, uniform and normal ones."""
    model = as_float64(
        ErrorModel((sources.Position(jnp.array([0.5, 2.0, 1.5]), distribution=(SKEWED, Uniform(), None)),)), "errors"
    )
    order = axis_moments(model)
    points = sigma_points_of(3, order) @ model.factor().T
    half = scipy.stats.halfnorm
    by_axis = [
        (lambda x: 1.3 * x + 0.7 * x**2, half(-half.mean() / half.std() * 0.5, 0.5 / half.std())),
        (lambda x: -0.4 * x + 0.3 * x**2, scipy.stats.uniform(-2.0 * math.sqrt(3.0), 4.0 * math.sqrt(3.0))),
        (lambda x: 0.8 * x - 0.2 * x**2, scipy.stats.norm(scale=1.5)),
    ]
    offsets = sum(f(points[:, k]) for k, (f, _) in enumerate(by_axis))
    nominal = _level_inputs().nominal_fix(jaxgeo.FirstHit())
    three = offsets[:, None] * jnp.array([1.0, 0.0, -2.0])[None, :]
    found = moments_of_points(nominal, three, jnp.zeros(7, jnp.int8), order)
    means = [theirs.expect(f) for f, theirs in by_axis]
    variance = sum(
        theirs.expect(lambda x, f=f, m=m: (f(x) - m) ** 2) for (f, theirs), m in zip(by_axis, means, strict=True)
    )
    assert float(found.mean_enu[0]) == pytest.approx(sum(means), abs=1e-7)
    assert float(found.cov_enu[0, 0]) == pytest.approx(variance, rel=1e-7)
    assert float(found.cov_enu[0, 2]) == pytest.approx(-2.0 * variance, rel=1e-7)


@pytest.mark.slow
def test_sigma_points_second_order_and_samples_agree_where_ground_is_level() -> None:
    """A large angle error of a shape far from normal, at a low elevation."""
    outliers = Mixture(jnp.array([0.8, 0.2]), jnp.array([1.0, 1.0]), jnp.array([0.0, 3.0]))
    scene = _scene(sources.GimbalAngles.from_degrees(outer=1.0, inner=0.5, distribution=(outliers, Uniform())))
    drawn = jaxgeo.sample(*scene, count=2**16, draws=Sobol())
    for found in (un.sigma_points(*scene), un.second_order(*scene)):
        np.testing.assert_allclose(found.mean_enu, drawn.mean_enu, atol=0.02 * float(np.sqrt(drawn.cov_enu.max())))
        np.testing.assert_allclose(found.cov_enu, drawn.cov_enu, atol=0.02 * float(drawn.cov_enu.max()))
    linear = jaxgeo.propagate(*scene)
    assert abs(float(linear.cov_enu.max()) / drawn.cov_enu.max() - 1.0) > 0.03


@pytest.mark.costly
def test_indices_use_the_distribution() -> None:
    """A failure of half of the axis' errors to be small: shares of variance are those of the variances."""
    scene = _scene(UP(3.0, distribution=Arcsine()), sources.Geoid.from_metres(4.0, distribution=Laplace()))
    found = un.sobol_indices(*scene, sampling=Sampling(count=1024))
    assert found.of("terrain height", "up").total == pytest.approx(9.0 / 25.0, abs=0.02)
    assert found.variance["up"] == pytest.approx(25.0, rel=0.05)


@pytest.mark.slow
def test_comparison_leaves_out_what_has_no_moments() -> None:
    options = {"sampling": Sampling(count=1000, draws=Random())}
    few = un.compare(*_scene(UP(2.0, distribution=StudentT(3))), **options)
    all_ = un.compare(*_scene(UP(2.0, distribution=StudentT(5))), **options)
    assert {row.method for row in all_.rows} - {row.method for row in few.rows} == {"second order", "sigma points"}
    assert next(row for row in all_.rows if row.method == "sigma points").values[2] == pytest.approx(3.29, abs=0.01)
