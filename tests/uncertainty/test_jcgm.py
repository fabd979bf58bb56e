"""Examples of JCGM 101:2008 (Supplement 1 to the GUM), section 9, with the printed figures.

The printed figures of its Monte Carlo method are from samples, and their intervals are good to some units of the last
digit: each is held to its last digit where the exact value rounds to it, and else to what its own samples leave open.
Exact values are by quadrature here.

Other software's tests hold the same printed figures of tables 2 and 3 (Suncal, phonometry, fullseye), and of 9.4 the
three intervals of independent quantities (fullseye) and the standard deviations 50, 67 and 121 (an evaluation of
GUM-5 examples, DB48X). The figures of 9.2.4, 9.3, the intervals of correlated quantities and 9.5 were not compared with
another copy.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import jaxgeo
from jaxgeo._checks import as_float64
from jaxgeo.uncertainty import ErrorModel, PerMeasurement, Sobol, sources
from jaxgeo.uncertainty.distributions import Arcsine, StudentT, Uniform
from jaxgeo.uncertainty.sources.base import AbstractSource
from tests.support import looks

COUNT = 2**18
SQUARES = [0.000, 0.010, 0.050]


class Quantity(AbstractSource):
    """One or two input quantities of a measurement, which move nothing: only their draws are used."""

    sigma: Any
    correlation: Any = None
    sharing: Any = PerMeasurement()
    names: ClassVar = ("x",)
    unit: ClassVar = "1"

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(f"x{k}" for k in range(len(self.sigma)))

    def moved(self, inputs: Any, error: Any) -> Any:
        return inputs


def quantity(sigma: float, distribution: Any = None) -> Quantity:
    return Quantity(jnp.array([sigma]), distribution=distribution)


def drawn(*quantities: Quantity, count: int = COUNT) -> np.ndarray:
    """Errors (axes, count) of independent quantities, by Sobol points of one scramble."""
    model = as_float64(ErrorModel(quantities), "quantities")
    for one in model.sources:
        one.check_numbers()

    def errors(model: ErrorModel, numbers: jax.Array) -> jax.Array:
        roots = model.roots()
        normal = jax.vmap(lambda k: Sobol(scrambles=1).standard_normal(jax.random.key(5), k, model.size))(numbers)
        return jax.vmap(lambda z: model.draw(roots, z))(normal)

    return np.asarray(jax.jit(errors)(model, jnp.arange(count))).T


def shortest_interval(values: np.ndarray, probability: float) -> tuple[float, float]:
    """The shortest coverage interval (JCGM 101:2008, 5.3.4 and 7.7.2)."""
    ordered = np.sort(values)
    inside = round(probability * len(ordered))
    first = int(np.argmin(ordered[inside:] - ordered[:-inside]))
    return float(ordered[first]), float(ordered[first + inside])


def middle_interval(values: np.ndarray, probability: float = 0.95) -> tuple[float, float]:
    """The probabilistically symmetric coverage interval."""
    low, high = np.quantile(values, [0.5 - 0.5 * probability, 0.5 + 0.5 * probability])
    return float(low), float(high)


# 9.2: Y = X1 + X2 + X3 + X4, tables 2 to 4.
def test_sum_of_four_normal_quantities() -> None:
    y = drawn(*[quantity(1.0)] * 4).sum(axis=0)
    assert f"{y.mean():.2f}".strip("-") == "0.00"
    assert f"{y.std():.2f}" == "2.00"
    assert middle_interval(y) == pytest.approx((-3.92, 3.92), abs=0.005)


def test_sum_of_four_rectangular_quantities() -> None:
    y = drawn(*[quantity(1.0, Uniform())] * 4).sum(axis=0)
    exact = 2.0 * math.sqrt(3.0) * (2.0 - (3.0 / 5.0) ** 0.25)  # 9.2.3.4
    assert f"{exact:.2f}" == "3.88"
    assert f"{y.mean():.2f}".strip("-") == "0.00"
    assert f"{y.std():.2f}" == "2.00"
    assert middle_interval(y) == pytest.approx((-exact, exact), abs=0.006)


def test_sum_of_rectangular_quantities_of_which_one_is_ten_times_as_wide() -> None:
    y = drawn(*[quantity(1.0, Uniform())] * 3, quantity(10.0, Uniform())).sum(axis=0)
    assert f"{y.std():.1f}" == "10.1"
    assert middle_interval(y) == pytest.approx((-17.0, 17.0), abs=0.05)  # of a normal one it would be 19.9


@pytest.mark.slow
def test_sums_of_rectangular_errors_of_a_fix() -> None:
    """The same sums as errors of height of a fix over level ground, through the whole engine."""
    for widest, printed, digits in ((1.0, 3.88, 2), (10.0, 17.0, 1)):
        heights = (
            *(sources.TerrainHeight.from_metres(1.0, distribution=Uniform()) for _ in range(2)),
            sources.Geoid.from_metres(1.0, distribution=Uniform()),
            sources.Geoid.from_metres(widest, distribution=Uniform()),
        )
        scene = looks.level_sensor(), looks.level_shot(0.0), looks.LEVEL_UV, looks.LEVEL, heights
        found = jaxgeo.sample(*scene, count=2**18)
        assert found.quantile("LE", 0.95).value == pytest.approx(printed, abs=0.6 * 10.0**-digits)
        linear = float(jaxgeo.propagate(*scene).linear_error(0.95))
        assert f"{linear:.{digits}f}" == {1.0: "3.92", 10.0: "19.9"}[widest]


# 9.3: calibration of a mass, tables 5 and 6; in mg.
def test_calibration_of_a_mass() -> None:
    reference, balance, air, weight, standard = drawn(
        quantity(0.050),
        quantity(0.020),
        quantity(0.10 / math.sqrt(3.0), Uniform()),
        quantity(1e3 / math.sqrt(3.0), Uniform()),
        quantity(0.05e3 / math.sqrt(3.0), Uniform()),
    )
    buoyancy = (1.20 + air - 1.20) * (1.0 / (8e3 + weight) - 1.0 / (8e3 + standard))
    mass = (100_000.000 + reference + 1.234 + balance) * (1.0 + buoyancy) - 100_000.0
    assert mass.mean() == pytest.approx(1.2341, abs=2e-4)  # exact: 1.2340
    # E(1/W) is ln(9/7) / 2000, E(1/W^2) is 1 / 63e6, and likewise of the standard.
    inverse, square = math.log(9.0 / 7.0) / 2e3, 1.0 / 63e6
    other, its_square = math.log(8.05 / 7.95) / 1e2, 1.0 / (8.05e3 * 7.95e3)
    by_air = 1e10 * (0.1**2 / 3.0) * (square - 2.0 * inverse * other + its_square)
    exact = math.sqrt(0.050**2 + 0.020**2 + by_air)
    assert exact == pytest.approx(0.0754, abs=1e-4)  # 0.07548; the printed figure is of samples
    assert mass.std() == pytest.approx(exact, abs=5e-5)
    low, high = shortest_interval(mass, 0.95)
    assert (low, high) == pytest.approx((1.0834, 1.3825), abs=1.5e-3)
    assert high - low == pytest.approx(1.3825 - 1.0834, abs=5e-4)


# 9.4: comparison loss of a microwave power meter, dY = X1^2 + X2^2, tables 7 to 9; in 1e-6.
@pytest.mark.costly
@pytest.mark.parametrize(
    "x1, u, low, high", list(zip(SQUARES, (50, 112, 502), (0, 0, 1590), (150, 367, 3543), strict=True))
)
def test_comparison_loss_of_independent_quantities(x1: float, u: int, low: float, high: float) -> None:
    errors = drawn(quantity(0.005), quantity(0.005))
    loss = 1e6 * ((x1 + errors[0]) ** 2 + errors[1] ** 2)
    assert loss.mean() == pytest.approx(1e6 * x1**2 + 50.0, abs=0.5)
    assert loss.std() == pytest.approx(u, abs=0.6)  # 504.5 before it is rounded to 505
    exact: Any = scipy.stats.ncx2(2, (x1 / 0.005) ** 2, scale=25.0)
    assert shortest_interval(loss, 0.95) == pytest.approx((low, high), abs=12.0 if x1 == 0.05 else 1.5)
    assert middle_interval(loss) == pytest.approx(tuple(exact.ppf([0.025, 0.975])), rel=5e-3)


@pytest.mark.costly
@pytest.mark.parametrize(
    "x1, u, low, high", list(zip(SQUARES, (67, 121, 505), (0, 13, 1628), (185, 398, 3555), strict=True))
)
def test_comparison_loss_of_correlated_quantities(x1: float, u: int, low: float, high: float) -> None:
    pair = Quantity(jnp.array([0.005, 0.005]), jnp.array([[1.0, 0.9], [0.9, 1.0]]))
    errors = drawn(pair)
    loss = 1e6 * ((x1 + errors[0]) ** 2 + errors[1] ** 2)
    assert loss.mean() == pytest.approx(1e6 * x1**2 + 50.0, abs=0.5)
    assert loss.std() == pytest.approx(u, abs=0.6)  # 504.5 before it is rounded to 505
    found = shortest_interval(loss, 0.95)
    assert found == pytest.approx((low, high), abs=12.0 if x1 == 0.05 else 1.5)
    assert found[1] - found[0] == pytest.approx(high - low, abs=4.0)


# 9.5: calibration of a gauge block, tables 10 and 11; in nm. Its t-distributions are scaled, its trapezoids products.
def test_calibration_of_a_gauge_block() -> None:
    length, difference, random, systematic, expansion, mean, cycle, alike, d_step, warmth, w_step = drawn(
        *(quantity(s * StudentT(df).per_scale, StudentT(df)) for s, df in ((25, 18), (6, 24), (4, 5), (7, 8))),
        quantity(2e-6 / math.sqrt(3.0), Uniform()),
        quantity(0.2),
        quantity(0.5 / math.sqrt(2.0), Arcsine()),
        *[quantity(1.0 / math.sqrt(3.0), Uniform())] * 4,
    )

    def trapezoid(half: float, inexact: float, share: np.ndarray, width: np.ndarray) -> np.ndarray:
        """Curvilinear trapezoid: uniform within limits ± (half + a uniform error within ± inexact) (6.4.3)."""
        return (half + inexact * width) * share

    standard = 50_000_623.0 + length
    in_expansion = trapezoid(1e-6, 1e-7, alike, d_step)
    in_warmth = trapezoid(0.050, 0.025, warmth, w_step)
    by_heat = in_expansion * (-0.1 + mean + cycle) + (11.5e-6 + expansion) * in_warmth
    y = standard + 215.0 + difference + random + systematic - standard * by_heat - 50_000_000.0
    assert f"{y.mean():.0f}" == "838"
    assert f"{y.std():.0f}" == "36"
    assert shortest_interval(y, 0.99) == pytest.approx((745.0, 932.0), abs=2.0)


@pytest.mark.costly
def test_product_of_a_normal_and_a_uniform_quantity() -> None:
    """Moments by those of the factors, quantiles by quadrature over the uniform one."""
    x, y = drawn(quantity(0.3), quantity(0.5, Uniform()))
    product = (2.0 + x) * (1.0 + y)
    assert product.mean() == pytest.approx(2.0, abs=1e-3)
    assert product.std() == pytest.approx(math.sqrt(4.0 * 0.25 + 0.09 + 0.09 * 0.25), abs=1e-3)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    factors = 1.0 + 0.5 * math.sqrt(3.0) * nodes  # all positive
    for probability, value in zip((0.025, 0.5, 0.975), np.quantile(product, (0.025, 0.5, 0.975)), strict=True):
        below = 0.5 * np.sum(weights * scipy.stats.norm.cdf((value / factors - 2.0) / 0.3))
        assert below == pytest.approx(probability, abs=3e-4)
