"""Accuracy metrics against tables, closed forms, high-precision integrals and their own laws."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import ncx2

from jaxgeo.uncertainty import metrics as m
from jaxgeo.uncertainty.metrics._host import host_radii, host_slopes

PROBABILITIES = np.array([0.5, 0.9, 0.95])
RATIOS = [0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0]
HOYT = {  # circles of unequal axes, in larger standard deviations
    0.5: [0.674489750196, 0.681985088272, 0.725434382183, 0.870417428244, 1.0270906088, 1.11806574791, 1.17741002252],
    0.9: [1.64485362695, 1.64791160624, 1.66460579706, 1.73707993427, 1.90334936361, 2.04235992634, 2.14596602629],
    0.95: [1.95996398454, 1.96252959676, 1.97650506395, 2.03585872029, 2.18580192236, 2.33179798323, 2.44774683068],
    0.99: [2.57582930355, 2.5777809445, 2.58838997037, 2.63256675502, 2.74916160595, 2.89743476617, 3.03485425877],
}
BIASES = [0.0, 0.5, 1.0, 2.0, 3.0, 5.0]
RICE = {  # circles of a round error with a bias, in standard deviations
    0.5: [1.177410023, 1.251580186, 1.475479092, 2.245802257, 3.165245788, 5.099676038],
    0.9: [2.145966026, 2.274617855, 2.601947398, 3.473382266, 4.419703977, 6.370384203],
    0.95: [2.447746831, 2.591660651, 2.939762553, 3.826252944, 4.777225027, 6.731138692],
}
OBLIQUE, UPRIGHT = [[4.0, 1.2], [1.2, 1.0]], [[100.0, 0.0], [0.0, 625.0]]
GENERAL = [  # covariance, bias, CE50, CE90, CE95
    (OBLIQUE, [0.0, 0.0], [1.650288938, 3.549828802, 4.197209261]),
    (OBLIQUE, [1.5, -0.7], [2.252134008, 4.232751715, 4.920695903]),
    (UPRIGHT, [0.0, 0.0], [20.19631784, 42.47957644, 50.1284311]),
    (UPRIGHT, [8.0, -12.0], [23.64940459, 47.64111526, 55.84004244]),
]
SPHERES = [  # standard deviations, SE50, SE90, SE95
    ([1.0, 1.0, 1.0], [1.5381722545, 2.5002777108, 2.7954834829]),
    ([1.0, 0.5, 0.25], [0.90809145, 1.75581149, 2.05179551]),
    ([2.0, 1.0, 1.5], [2.30893011, 3.96145934, 4.50639143]),
]
FLAT, ROUND, SLANTED = [[1.0, 0.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.3], [0.3, 0.2]]


def ellipses(ratios: list[float]) -> np.ndarray:
    return np.stack([np.diag([1.0, r**2]) for r in ratios])


def turned(cov: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return R @ cov @ R.T


@pytest.mark.parametrize("probability", HOYT)
def test_circles_of_unequal_axes(probability):
    np.testing.assert_allclose(m.circular_error(ellipses(RATIOS), probability), HOYT[probability], rtol=1e-11)


@pytest.mark.parametrize("probability", RICE)
def test_circles_with_a_bias(probability):
    bias = np.stack([BIASES, np.zeros(6)], axis=-1)
    np.testing.assert_allclose(m.circular_error(np.eye(2), probability, bias), RICE[probability], rtol=1e-9)


@pytest.mark.parametrize("cov, bias, radii", GENERAL)
def test_circles_of_any_covariance(cov, bias, radii):
    np.testing.assert_allclose(m.circular_error(cov, PROBABILITIES, bias), radii, rtol=1e-9)


@pytest.mark.parametrize("sigmas, radii", SPHERES)
def test_spheres(sigmas, radii):
    np.testing.assert_allclose(m.spherical_error(np.diag(sigmas) ** 2, PROBABILITIES), radii, rtol=1e-8)


@pytest.mark.costly
@pytest.mark.parametrize("d", [1, 2, 3])
def test_radii_in_numpy_are_those_of_the_program(d: int) -> None:
    """A few radii called directly are computed in NumPy, traced ones and many by a program."""
    rng = np.random.default_rng(d)
    n = 24
    axes = np.linalg.qr(rng.normal(size=(n, d, d)))[0]
    sigmas = 10.0 ** rng.uniform(-2.0, 1.0, (n, d))
    sigmas[: n // 4, 1:] = 0.0
    cov = np.einsum("nij,nj,nkj->nik", axes, sigmas**2, axes)
    cov = 0.5 * (cov + cov.transpose(0, 2, 1))
    bias = rng.normal(size=(n, d)) * rng.choice([0.0, 0.3, 3.0], (n, 1)) * sigmas[:, :1]
    probability = rng.choice([0.01, 0.5, 0.9, 0.9973], n)
    cov, bias = (cov[:, 0, 0], bias[:, 0]) if d == 1 else (cov, bias)
    radius = (m.linear_error, m.circular_error, m.spherical_error)[d - 1]
    direct, traced = radius(cov, probability, bias), jax.jit(radius)(cov, probability, bias)
    np.testing.assert_allclose(direct, traced, rtol=1e-11)


def test_figures_of_shotgroups():
    """R's shotGroups 0.8: qHoyt and pHoyt with omega the mean square and q the ratio of the axes, qRice."""
    hoyt = np.array([5.0, 10.0, 15.0])[:, None, None] / 1.25 * np.diag([1.0, 0.25])
    np.testing.assert_allclose(
        m.circular_error(hoyt, 0.5), [1.740834856488, 2.461912263898, 3.015214419025], rtol=1e-11
    )
    chance = m.circular_probability(hoyt[1], np.array([0.1, 0.5, 0.9]))
    np.testing.assert_allclose(chance, [0.00124902403737, 0.030648907993933, 0.09514900943661], rtol=1e-11)
    rice = np.array([25.0, 100.0, 225.0])[:, None, None] * np.eye(2)
    radii = m.circular_error(rice, 0.5, [0.5, 0.0])
    np.testing.assert_allclose(radii, [5.901773343614, 11.781459742211, 17.666056421745], rtol=1e-11)


def test_a_long_ellipse_against_forty_digits():
    """The integral over the direction, inverted with mpmath."""
    cov = turned(np.diag([25.3**2, 6.9**2]), 0.7)
    radii = m.circular_error(cov, np.array([0.5, 0.9]))
    np.testing.assert_allclose(radii, [18.6218417662336559, 42.2142211952627948], rtol=1e-12)


def noncentral(radius: np.ndarray, bias: np.ndarray, d: int) -> np.ndarray:
    return ncx2.cdf(radius**2, d, bias**2)


@pytest.mark.parametrize("d", [2, 3])
def test_every_probability_of_a_biased_round_error(d):
    """Against SciPy's noncentral chi-square, to ten standard deviations and from 0.001 to 0.9999."""
    bias, probability = np.meshgrid([0.5, 2.0, 10.0], [0.001, 0.1, 0.9, 0.9999])
    direction = np.array([0.48, 0.6, 0.64])[:d] / np.linalg.norm(np.array([0.48, 0.6, 0.64])[:d])
    error = m.circular_error if d == 2 else m.spherical_error
    radius = np.asarray(error(np.eye(d), probability, bias[..., None] * direction))
    np.testing.assert_allclose(noncentral(radius, bias, d), probability, rtol=1e-10)


@pytest.mark.parametrize("bias", [100.0, 1e4])
def test_a_far_bias_leaves_the_error_along_it(bias):
    """The circle is a line there, but for sigma² / 2 |bias| of bend: N(|bias|, sigma²) along the bias."""
    radius = m.circular_error(np.diag([1.0, 0.25]), 0.9, [0.0, bias])
    np.testing.assert_allclose(radius - bias, 0.5 * 1.2815515655446004, atol=1.1 / bias)  # m


def test_a_flat_error_is_that_along_the_line():
    cov, bias = turned(np.diag([4.0, 0.0]), 0.4), 3.0 * np.array([np.cos(0.4), np.sin(0.4)])
    along = m.linear_error(4.0, PROBABILITIES, 3.0)
    np.testing.assert_allclose(m.circular_error(cov, PROBABILITIES, bias), along, rtol=1e-10)
    np.testing.assert_allclose(m.linear_error(1.0, 0.9), 1.6448536269514722, rtol=1e-13)


@pytest.mark.slow
def test_a_sphere_without_height_is_a_circle():
    cov, bias = np.zeros((3, 3)), np.zeros((2, 3))
    cov[:2, :2], bias[1] = OBLIQUE, [1.5, -0.7, 0.0]
    expected = m.circular_error(OBLIQUE, 0.9, bias[:, :2])
    np.testing.assert_allclose(m.spherical_error(cov, 0.9, bias), expected, rtol=1e-10)


@pytest.mark.parametrize("cov", [FLAT, ROUND, SLANTED])
@pytest.mark.parametrize("bias", [[0.0, 0.0], [0.3, -0.8]])
def test_probability_inverts_the_radius_and_axes_do_not_matter(cov, bias):
    probability = np.array([0.02, 0.5, 0.98])
    radius = m.circular_error(cov, probability, bias)
    np.testing.assert_allclose(m.circular_probability(cov, radius, bias), probability, atol=1e-12)
    R = np.array([[np.cos(1.1), -np.sin(1.1)], [np.sin(1.1), np.cos(1.1)]])
    np.testing.assert_allclose(m.circular_error(R @ cov @ R.T, probability, R @ bias), radius, rtol=1e-9)


def by_parts(parts: jax.Array) -> jax.Array:
    """Circle of a vector of var_x, cov, var_y, probability, bias x and bias y."""
    cov = jnp.stack([jnp.stack([parts[0], parts[1]]), jnp.stack([parts[1], parts[2]])])
    return m.circular_error(cov, parts[3], parts[4:])


RADIUS_AND_GRADIENT = jax.jit(jax.value_and_grad(by_parts))  # one program for both


def radius_of(parts: Any) -> jax.Array:
    return RADIUS_AND_GRADIENT(parts)[0]


def gradient_of(parts: Any) -> jax.Array:
    return RADIUS_AND_GRADIENT(parts)[1]


CASES = [[[1.0, 0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0, 1.0], [0.5, -0.3]], [[4.0, 1.2, 1.0], [1.5, -0.7]]]
CASES += [[[1.0, 0.0, 1e-4], [0.0, 0.2]], [[1.0, 0.0, 1e-4], [0.0, 0.0]]]


@pytest.mark.costly
@pytest.mark.parametrize("variances, bias", CASES)
def test_gradient_is_the_central_difference(variances, bias):
    """For round errors, thin ones, and without a bias."""
    parts = jnp.array([*variances, 0.9, *bias])
    step = np.array([1e-5, 1e-5 * variances[2], 1e-5 * variances[2], 1e-5, 1e-5, 1e-5])
    around = [(float(radius_of(parts + d)), float(radius_of(parts - d))) for d in np.diag(step)]
    differences = np.array([(a - b) for a, b in around]) / (2.0 * step)
    loose = 2e-14 / step + 1e-8
    np.testing.assert_array_less(np.abs(gradient_of(parts) - differences), loose + 1e-7 * np.abs(differences))


@pytest.mark.costly
def test_gradient_at_the_edge_of_what_can_be():
    """A flat error: the derivative by the missing variance is one-sided; no error at all: finite, and zero."""
    flat = jnp.array([1.0, 0.0, 0.0, 0.9, 0.0, 0.0])
    gradient = gradient_of(flat)
    step = 1e-5
    ahead = [float(radius_of(flat.at[2].set(k * step))) for k in (0.0, 1.0, 2.0)]
    one_sided = (-3.0 * ahead[0] + 4.0 * ahead[1] - ahead[2]) / (2.0 * step)
    np.testing.assert_allclose(gradient[2], one_sided, atol=1e-7)
    np.testing.assert_allclose(gradient[0], 0.5 * 1.6448536269514722, rtol=1e-9)
    np.testing.assert_array_equal(gradient_of(jnp.array([0.0, 0.0, 0.0, 0.9, 0.0, 0.0])), np.zeros(6))
    np.testing.assert_allclose(gradient_of(jnp.array([0.0, 0.0, 0.0, 0.9, 3.0, 4.0]))[4:], [0.6, 0.8], rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("variances", [[1.0, 0.0, 1.0], [1.0, 0.0, 1e-2]])
def test_second_derivatives_are_differences_of_the_first(variances):
    parts = jnp.array([*variances, 0.9, 0.0, 0.0])
    hessian = HESSIAN(parts)
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-9)
    step = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])
    differences = [(gradient_of(parts + d) - gradient_of(parts - d)) / (2.0 * np.max(d)) for d in np.diag(step)]
    np.testing.assert_allclose(hessian, np.stack(differences), atol=2e-5, rtol=2e-5)


HESSIAN = jax.jit(jax.jacfwd(jax.grad(by_parts)))


@pytest.mark.slow
def test_trace_of_a_gradient_is_the_scale_law():
    """Radius is homogeneous: 2 tr(cov d/dcov) + bias d/dbias gives it back, in space too."""
    cov, bias = jnp.diag(jnp.array([1.0, 1.0, 0.04])), jnp.array([0.1, -0.2, 0.3])
    by_cov, by_bias = jax.jit(jax.grad(lambda c, b: m.spherical_error(c, 0.9, b), (0, 1)))(cov, bias)
    twice = 2.0 * jnp.sum(by_cov * cov) + by_bias @ bias
    np.testing.assert_allclose(twice, m.spherical_error(cov, 0.9, bias), rtol=1e-9)


@pytest.mark.parametrize(
    "cov, probability, words",
    [
        ([[1.0, 2.0], [2.0, 1.0]], 0.5, "eigenvalue -1"),
        ([[1.0, 0.1], [0.2, 1.0]], 0.5, "row 0, column 1"),
        ([[1.0, np.nan], [0.0, 1.0]], 0.5, "finite"),
        ([[np.inf, 0.0], [0.0, 1.0]], 0.5, "finite"),
        (ROUND, 1.0, "probability"),
        (ROUND, 90.0, "0.9"),
        (np.eye(3), 0.5, "shape"),
    ],
)
def test_mistakes_are_named(cov, probability, words):
    with pytest.raises(ValueError, match=words):
        m.circular_error(cov, probability)


def test_traced_mistakes_are_nan():
    bad = jnp.array([[[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]], ROUND])
    np.testing.assert_array_equal(np.isnan(jax.jit(lambda c: m.circular_error(c, 0.5))(bad)), [True, True, False])


def test_two_drms_holds_no_fixed_share():
    cov = ellipses([0.0, 0.25, 0.5, 0.75, 1.0])
    held = m.circular_probability(cov, m.two_drms(cov))
    np.testing.assert_allclose(held, [0.95449974, 0.95921523, 0.96984347, 0.97887125, 0.98168436], atol=1e-8)
    np.testing.assert_allclose(m.circular_probability(np.eye(2), 3.0), 1.0 - np.exp(-4.5), rtol=1e-14)


def test_ellipse_points_from_north():
    """Long axis to the east-north-east, 60 degrees from north; the whole holds what it says."""
    ellipse = m.error_ellipse(turned(np.diag([9.0, 1.0]), np.pi / 6), 0.9)
    np.testing.assert_allclose(ellipse.azimuth, np.pi / 3, atol=1e-14)  # rad
    np.testing.assert_allclose([ellipse.major, ellipse.minor], np.array([3.0, 1.0]) * np.sqrt(-2 * np.log(0.1)))
    np.testing.assert_allclose(m.error_ellipse(ROUND, 0.9).major, m.circular_error(ROUND, 0.9), rtol=1e-12)
    np.testing.assert_allclose(m.rms_3d(np.diag([1.0, 4.0, 4.0]), [4.0, 0.0, 0.0]), 5.0)


def test_classical_circles_hold_other_shares():
    """An ellipse of 278 m and 68 m."""
    table = m.compare_classical(np.diag([278.0**2, 68.0**2]))
    gu = table["2.146 RMS axis"]
    np.testing.assert_allclose([gu.exact, gu.radius], [462.5, 434.3], atol=0.05)  # m
    np.testing.assert_allclose(gu.contains, 0.877, atol=5e-4)
    np.testing.assert_allclose(table["RMS / 1.2"].contains, 0.587, atol=5e-4)
    held = m.circular_probability(np.diag([278.0**2, 68.0**2]), gu.radius)
    np.testing.assert_allclose(gu.contains, held)


@pytest.mark.parametrize(
    "name, lowest, tolerance",
    [("linear", 0.3, 0.005), ("mean axis", 0.2, 0.021), ("Rayleigh", 0.9, 0.002), ("Grubbs-Patnaik", 0.0, 0.023)],
)
def test_classical_formulas_in_their_range(name, lowest, tolerance):
    table = m.compare_classical(ellipses([lowest, 0.5 + 0.5 * lowest, 1.0]))
    assert np.all(np.abs(table[name].relative_error) < tolerance)
    assert set(table) == set(m.CLASSICAL)


def test_nssda():
    """The standard's factors of a circle at 95 %; both are the exact circle where the error is round."""
    np.testing.assert_allclose(m.nssda_horizontal(2.0, 2.0), 1.7308 * np.sqrt(8.0), rtol=1e-15)
    np.testing.assert_allclose(m.nssda_horizontal(2.0, 1.5), 2.4477 * 1.75, rtol=1e-15)
    np.testing.assert_allclose(m.nssda_horizontal(1.0, 1.0), m.circular_error(ROUND, 0.95), rtol=1e-4)
    np.testing.assert_allclose(m.nssda_vertical(1.0), m.linear_error(1.0, 0.95), rtol=1e-4)
    with pytest.raises(ValueError, match=r"0\.6"):
        m.nssda_horizontal(1.0, 0.5)


def test_asprs_counts_the_survey_in():
    np.testing.assert_allclose(m.asprs_horizontal(2.0, 3.0, 6.0), 7.0)
    np.testing.assert_allclose(m.asprs_vertical(3.0, 4.0), 5.0)
    np.testing.assert_allclose(m.asprs_3d(5.0, 12.0), 13.0)
    np.testing.assert_allclose([m.asprs_class(0.071), m.asprs_class(0.07)], [0.08, 0.07])


def test_bins_have_names():
    bins = [("I", 6.0), ("II", 15.0), ("III", 30.0)]
    assert [m.categorise(v, bins) for v in (0.0, 6.0, 6.1, 30.0, 31.0, np.inf)] == ["I", "I", "II", "III", None, None]
    with pytest.raises(ValueError, match="rise"):
        m.categorise(1.0, bins[::-1])
    with pytest.raises(ValueError, match="NaN"):
        m.categorise(np.nan, bins)


@pytest.mark.parametrize("error", [0.0, 0.03, 425.3, 4095.0])
def test_misb_errors_come_back_to_half_a_step(error):
    assert abs(m.decode_misb_error(m.encode_misb_error(error)) - error) <= 0.5 * 4095.0 / 65535 + 1e-12


def test_misb_errors_do_not_saturate():
    assert m.encode_misb_error(4095.0) == b"\xff\xff"
    for wrong in (4095.1, -0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="error"):
            m.encode_misb_error(wrong)
    with pytest.raises(ValueError, match="2 bytes"):
        m.decode_misb_error(b"\x00")


def test_failures_count_as_infinitely_far():
    distances = m.radial_errors([[3.0, 4.0], [np.nan, 0.0], [0.0, 1.0], [6.0, 8.0]], np.array([0, 0, 0, 1], bool))
    np.testing.assert_array_equal(distances, [5.0, np.inf, 1.0, np.inf])
    assert m.sample_quantile(distances, 0.5) == 5.0
    assert m.sample_quantile(distances, 0.51) == np.inf
    assert m.sample_rms(distances) == np.inf
    assert m.failed_share(distances) == 0.5
    assert m.share_within(distances, 5.0) == 0.5


def test_quantile_is_an_order_statistic():
    distances = np.arange(1.0, 101.0)[::-1]
    assert [float(m.sample_quantile(distances, p)) for p in (0.001, 0.07, 0.071, 0.5, 0.999)] == [1, 7, 8, 50, 100]
    np.testing.assert_allclose(m.sample_rms(np.array([3.0, 4.0])), np.sqrt(12.5))
    with pytest.raises(ValueError, match="at least one"):
        m.sample_quantile(np.zeros(0), 0.5)


@pytest.mark.parametrize("left, close", [(1e-4, 1e-12), (1e-6, 1e-10), (1e-8, 1e-8), (1e-10, 1e-6)])
def test_near_one_radii_have_the_digits_that_are_promised(left: float, close: float) -> None:
    """Against mpmath, of round errors in the plane and in space, a flat one in the plane, and along a line."""
    import mpmath as mp

    with mp.workdps(40):
        rest = mp.mpf(1) - mp.mpf(1.0 - left)
        line = mp.sqrt(2) * mp.erfinv(1 - rest)
        plane = mp.sqrt(-2 * mp.log(rest))
        space = mp.findroot(
            lambda r: mp.erfc(r / mp.sqrt(2)) + mp.sqrt(2 / mp.pi) * r * mp.exp(-r * r / 2) - rest, plane + 0.3
        )
        line, plane, space = float(line), float(plane), float(space)
    level = 1.0 - left
    assert float(m.circular_error(np.eye(2), level)) == pytest.approx(plane, rel=close)
    assert float(m.circular_error(np.diag([9.0, 0.0]), level)) == pytest.approx(3.0 * line, rel=close)
    assert float(m.spherical_error(np.eye(3), level)) == pytest.approx(space, rel=close)
    assert float(m.linear_error(1.0, level)) == pytest.approx(line, rel=close)


@pytest.mark.parametrize("radius", [lambda p: m.circular_error(np.eye(2), p), lambda p: m.linear_error(1.0, p)])
def test_beyond_them_a_probability_is_refused(radius: Any) -> None:
    with pytest.raises(ValueError, match=r"at most 1 - 1e-10, up to which a radius has digits; got 1 - 1e-12"):
        radius(1.0 - 1e-12)
    assert np.isnan(jax.jit(radius)(1.0 - 1e-12))


def test_an_error_ellipse_prints_its_numbers() -> None:
    assert str(m.error_ellipse(np.diag([9.0, 1.0]))) == "semi-axes 3 and 1 m, the longer at 90 deg clockwise from north"
    several = str(m.error_ellipse(np.stack([np.diag([9.0, 1.0]), np.diag([1.0, 4.0])])))
    assert several == "semi-axes [3 2] and [1 1] m, the longer at [90 0] deg clockwise from north"


@pytest.mark.costly
def test_radii_are_the_same_bits_whatever_was_computed_before() -> None:
    """As results of several processes are compared; the figures of few fixes are computed in NumPy."""
    random = np.random.default_rng(5)
    roots = random.normal(size=(25, 3, 3))
    each = [(root @ root.T, mean) for root, mean in zip(roots, random.normal(size=(25, 3)), strict=True)]
    first = [float(m.spherical_error(cov, 0.5, mean)) for cov, mean in each]
    assert [float(m.spherical_error(cov, 0.5, mean)) for cov, mean in each] == first


@pytest.mark.parametrize("ratio", [1.0, 0.5, 0.05])
@pytest.mark.parametrize("bias", [(0.0, 0.0), (1.0, -2.0), (5.0, 0.0)])
def test_slopes_in_numpy_are_differences_of_the_radius(ratio: float, bias: tuple[float, float]) -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    cov, mean = turn @ np.diag([9.0, 9.0 * ratio**2]) @ turn.T, np.array(bias)

    def radius(cov: np.ndarray) -> float:
        found = host_radii(cov, 0.9, mean)
        assert found is not None
        return float(found)

    slopes = host_slopes(cov, radius(cov), mean)
    assert slopes is not None
    np.testing.assert_array_equal(slopes, slopes.T)
    step = 1e-4 * cov[1, 1]
    for change in ([[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.5], [0.5, 0.0]]):
        by = step * np.array(change)
        difference = (radius(cov + by) - radius(cov - by)) / (2.0 * step)
        assert np.sum(slopes * change) == pytest.approx(difference, rel=1e-5, abs=1e-8)
    # All variances grow by a factor: so does the square of the radius, if there is no bias.
    if not mean.any():
        assert np.sum(slopes * cov) == pytest.approx(0.5 * radius(cov), rel=1e-12)


def test_slopes_of_a_zero_covariance_are_zero() -> None:
    """As `circular_error` says of its derivative."""
    np.testing.assert_array_equal(host_slopes(np.zeros((2, 2)), 5.0, np.array([3.0, 4.0])), np.zeros((2, 2)))


def test_slopes_of_needles_are_left_to_the_program() -> None:
    for thin in (0.0, 1e-9):
        assert host_slopes(np.diag([1.0, thin]), 1.64, np.zeros(2)) is None
    assert host_slopes(np.eye(2), np.inf, np.zeros(2)) is None
