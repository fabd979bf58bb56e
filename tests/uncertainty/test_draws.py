"""Draws hang on key and index alone; Sobol points are Sobol's, and their scrambles even, unbiased and independent."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.special
import scipy.stats.qmc
from jax.extend.random import threefry_2x32

from jaxgeo.uncertainty import sobol
from jaxgeo.uncertainty.draws import OWN, AbstractDraws, Random, Sobol, _centre, normal_quantile, threefry

KEY = jax.random.key(7)
DRAWS = [Random(), Sobol()]
SIZE = 6
POINTS = 1024  # of each scramble


@jax.jit
def one(draws: AbstractDraws, key: jax.Array, index: jax.Array) -> jax.Array:
    return draws.standard_normal(key, index, SIZE)


@jax.jit
def crowd(draws: AbstractDraws, key: jax.Array, index: jax.Array) -> jax.Array:
    return jax.vmap(lambda i: draws.standard_normal(key, i, SIZE))(index)


@pytest.fixture(scope="module")
def scrambles() -> np.ndarray:
    """Uniform numbers of 16 scrambles, (16, 1024, 6), in the order of the points."""
    normal = crowd(Sobol(), KEY, jnp.arange(16 * POINTS))
    return scipy.special.ndtr(np.asarray(normal)).reshape(POINTS, 16, SIZE).swapaxes(0, 1)


@pytest.mark.costly
@pytest.mark.parametrize("draws", DRAWS)
def test_a_sample_hangs_on_key_and_index_alone(draws: AbstractDraws) -> None:
    together = np.asarray(crowd(draws, KEY, jnp.arange(16 * POINTS)))
    np.testing.assert_array_equal(crowd(draws, KEY, jnp.arange(700, 727)), together[700:727])
    for index in (0, 705, 16383):
        np.testing.assert_array_equal(one(draws, KEY, jnp.asarray(index)), together[index])
        np.testing.assert_array_equal(one(draws, KEY, jnp.asarray(index, jnp.int32)), together[index])


@pytest.mark.parametrize("draws", DRAWS)
def test_first_numbers_do_not_change_with_the_size(draws: AbstractDraws) -> None:
    few = jax.jit(lambda index: draws.standard_normal(KEY, index, 2))(705)
    np.testing.assert_allclose(few, one(draws, KEY, jnp.asarray(705))[:2], rtol=0.0, atol=1e-14)
    assert jax.eval_shape(lambda index: draws.standard_normal(KEY, index, 0), 705).shape == (0,)


@pytest.mark.parametrize("draws", DRAWS)
def test_other_keys_and_far_indices_give_other_samples(draws: AbstractDraws) -> None:
    samples = [
        one(draws, key, jnp.asarray(index))
        for key in (KEY, jax.random.key(8))
        for index in (0, 1, 2**31 - 1, 2**31, 2**32 - 1)
    ]
    assert len(np.unique(np.round(np.concatenate(samples), 9))) == 10 * SIZE
    assert np.all(np.isfinite(samples))


@pytest.mark.parametrize("draws", DRAWS)
def test_samples_are_standard_normal_and_uncorrelated(draws: AbstractDraws) -> None:
    normal = np.asarray(crowd(draws, KEY, jnp.arange(16 * POINTS)))
    assert np.abs(normal.mean(axis=0)).max() < 4.0 / np.sqrt(len(normal))
    np.testing.assert_allclose(np.cov(normal.T), np.eye(SIZE), rtol=0.0, atol=4.0 * np.sqrt(2.0 / len(normal)))
    assert scipy.stats.kstest(normal.ravel(), "norm").pvalue > 1e-3


def test_random_neighbours_are_uncorrelated() -> None:
    normal = np.asarray(crowd(Random(), KEY, jnp.arange(16 * POINTS)))
    beside = np.corrcoef(normal[1:].T, normal[:-1].T)[:SIZE, SIZE:]
    assert np.abs(beside).max() < 4.0 / np.sqrt(len(normal))


def test_points_are_those_of_joe_and_kuo() -> None:
    """In the order of the integers: scipy goes by the Gray code, so that its point n is number n ^ n >> 1."""
    size, count = 1024, 512
    table = jnp.asarray(sobol.point_table(size))
    number = np.arange(count, dtype=np.uint32)
    point = jax.vmap(lambda n: sobol.mirror(sobol.sobol_point(n, table)))(number ^ number >> 1)
    expected = scipy.stats.qmc.Sobol(size, scramble=False, bits=32).random(count)
    np.testing.assert_array_equal(np.asarray(point) * 2.0**-32, expected)


def test_points_of_all_32_bits_add_like_their_numbers() -> None:
    """Sobol points are linear over the field of two elements, and their matrices are triangular with full diagonal."""
    directions, table = sobol.direction_numbers(128), jnp.asarray(sobol.point_table(128))
    a, b = np.random.default_rng(0).integers(0, 2**32, (2, 20), dtype=np.uint32)
    point = jax.vmap(lambda n: sobol.sobol_point(n, table))
    np.testing.assert_array_equal(point(a ^ b), point(a) ^ point(b))
    highest = np.floor(np.log2(np.asarray(directions, np.float64)))
    np.testing.assert_array_equal(highest, np.broadcast_to(np.arange(32), (128, 32)))


def test_scrambling_is_nested() -> None:
    """Numbers with k digits in common, and no more, still have just those in common; no digit is treated alike."""
    words = jax.random.bits(KEY, (4, 4000), jnp.uint32)
    other = words[0] ^ (jnp.uint32(1) << jnp.arange(4000, dtype=jnp.uint32) % 32) * (words[3] | 1)
    before = words[0] ^ other
    after = sobol.scramble(words[0], words[1], words[2]) ^ sobol.scramble(other, words[1], words[2])
    np.testing.assert_array_equal(before & -before, after & -after)
    flipped = words[0] ^ sobol.scramble(words[0], words[1], words[2])
    share = np.mean(np.asarray(flipped)[:, None] >> np.arange(32) & 1, axis=0)
    np.testing.assert_allclose(share, 0.5, atol=4.0 * 0.5 / np.sqrt(4000))


def test_every_cell_of_every_coordinate_holds_one_point(scrambles: np.ndarray) -> None:
    for points in (POINTS, 64, 8):
        cell = np.sort(np.floor(scrambles[:, :points] * points).astype(int), axis=1)
        np.testing.assert_array_equal(cell, np.broadcast_to(np.arange(points)[:, None], cell.shape))


def test_every_box_of_the_first_two_coordinates_holds_one_point(scrambles: np.ndarray) -> None:
    """A (0, 10, 2)-net: all shapes of 2^-10 in area, from tall to wide."""
    for columns in 2 ** np.arange(11):
        box = np.floor(scrambles[..., 0] * columns) * (POINTS // columns)
        box = box + np.floor(scrambles[..., 1] * (POINTS // columns))
        np.testing.assert_array_equal(np.sort(box, axis=1), np.broadcast_to(np.arange(POINTS), box.shape))


def test_points_lie_anywhere_in_their_cells(scrambles: np.ndarray) -> None:
    """Down to the bits below 2^-32, which no Sobol point has."""
    for scale in (2.0**10, 2.0**33):
        within = np.modf(scrambles[..., :2] * scale)[0]
        assert scipy.stats.kstest(within.ravel(), "uniform").pvalue > 1e-3


def test_smooth_means_are_unbiased_and_far_surer_than_random() -> None:
    """The mean of a sum of smooth functions: over 64 scrambles, by their spread and the truth."""
    draws = Sobol(scrambles=64)
    normal = np.asarray(crowd(draws, KEY, jnp.arange(64 * POINTS))).reshape(POINTS, 64, SIZE)
    value = np.sum(np.cos(normal) + np.tanh(normal) + np.arange(SIZE) * normal, axis=2)
    means = value.mean(axis=0)
    truth = SIZE * np.exp(-0.5)
    assert abs(means.mean() - truth) < 4.0 * means.std() / 8.0
    assert means.var() < value.var() / POINTS / 100.0


def test_scrambles_are_uncorrelated() -> None:
    """Over 1024 of them: the numbers of each of 16 points, and the mean of their squares."""
    normal = np.asarray(crowd(Sobol(scrambles=1024), KEY, jnp.arange(16 * 1024))).reshape(16, 1024, SIZE)
    square = np.sum(normal**2, axis=2).mean(axis=0)
    for scrambled in (*normal.swapaxes(1, 2).reshape(-1, 1024), square):
        assert abs(np.corrcoef(scrambled[1:], scrambled[:-1])[0, 1]) < 4.0 / np.sqrt(1024)


def test_the_quantile_inverts_the_normal_distribution() -> None:
    tails = [2.0**-52, 3.0 * 2.0**-52, 1e-13, 1.3e-11, 1.5e-11, 1e-6, 0.01, 0.0749, 0.0751, 0.3, 0.4999]
    with mpmath.workdps(40):
        expected = [float(-mpmath.sqrt(2) * mpmath.erfinv(1 - 2 * mpmath.mpf(0.5 - (0.5 - t)))) for t in tails]
    below = jnp.asarray(tails) - 0.5
    np.testing.assert_allclose(normal_quantile(below), expected, rtol=1e-14, atol=0.0)
    np.testing.assert_array_equal(normal_quantile(-below), -normal_quantile(below))
    assert normal_quantile(jnp.asarray(0.0)) == 0.0


def test_words_are_those_of_the_generator_behind_the_keys() -> None:
    key, counter = jax.random.key_data(KEY), jnp.arange(2**31 - 4, 2**31 + 4, dtype=jnp.uint32)
    first, second = jax.jit(threefry)(key, counter[:4], counter[4:])
    np.testing.assert_array_equal(jnp.concatenate([first, second]), threefry_2x32(key, counter))


def test_pairs_of_random_numbers_are_those_of_box_and_muller() -> None:
    """From the words of their counters, 2 k for the radius and 2 k + 1 for the angle; an odd last one by itself."""
    index, key = 705, jax.random.key_data(jax.random.fold_in(KEY, OWN))
    counter = jnp.append(jnp.full(6, index, jnp.uint32), jnp.arange(6, dtype=jnp.uint32))
    high, low = (words.tolist() for words in np.array_split(np.asarray(threefry_2x32(key, counter)), 2))
    expected = []
    for k in (0, 2, 4):
        uniform, turn = (high[i] / 2.0**32 + (low[i] >> 12 | 1) / 2.0**52 for i in (k, k + 1))
        expected += box_muller(uniform, turn - 0.5)
    np.testing.assert_allclose(one(Random(), KEY, jnp.asarray(index)), expected, rtol=0.0, atol=4e-15)
    odd = jax.jit(lambda index: Random().standard_normal(KEY, index, 5))(index)
    np.testing.assert_allclose(odd, expected[:5], rtol=0.0, atol=4e-15)


def box_muller(uniform: float, turn: float) -> list[float]:
    """Two normal numbers of a probability and an angle in turns, from 40 digits."""
    with mpmath.workdps(40):
        radius, angle = mpmath.sqrt(-2 * mpmath.log(mpmath.mpf(uniform))), 2 * mpmath.pi * mpmath.mpf(turn)
        return [float(radius * mpmath.cos(angle)), float(radius * mpmath.sin(angle))]


@pytest.mark.parametrize("centred", [-0.5 + 2.0**-52, 0.5 - 2.0**-52, 2.0**-52, -0.25, 0.25 + 2.0**-52])
@pytest.mark.parametrize("turn", [-0.5 + 2.0**-52, 0.5 - 2.0**-52, 2.0**-52, -0.25, 0.25 - 2.0**-52, 0.125])
def test_ends_of_what_may_be_drawn_are_finite_and_true(centred: float, turn: float) -> None:
    _, polar, normal = Random().stages(KEY, 2)
    found = jax.jit(lambda *pair: normal(polar(pair)))(jnp.array([centred]), jnp.array([turn]))
    np.testing.assert_allclose(found, box_muller(0.5 + centred, turn), rtol=1e-15, atol=1e-30)


def test_no_bits_give_an_end() -> None:
    """All zeros and all ones, compiled too: adding what keeps off the ends afterwards would be optimised away."""
    words = jnp.asarray([0, 2**32 - 1], jnp.uint32)
    low, high = jax.jit(lambda words: normal_quantile(_centre(words, words)))(words)
    assert -8.13 < low < -8.12
    assert low == -high


@pytest.mark.parametrize(
    "draw, message",
    [
        (lambda: Sobol().standard_normal(KEY, 0, 1025), "1024 dimensions; got 1025"),
        (lambda: Sobol(scrambles=0), "scrambles must be a whole number of at least 1; got 0"),
        (lambda: Sobol(scrambles=2).standard_normal(KEY, 2**33, 3), "from 0 to 8589934591.*got 8589934592"),
        (lambda: Random().standard_normal(KEY, -1, 3), "from 0 to 4294967295.*got -1"),
        (lambda: Random().standard_normal(KEY, jnp.arange(3), 3), r"shape \(3,\).*jax.vmap"),
        (lambda: Random().standard_normal(KEY, 0, -2), "size must be .* at least 0; got -2"),
        (lambda: Random().standard_normal(jax.random.key(0, impl="rbg"), 0, 2), "threefry2x32.*got rbg"),
    ],
)
def test_mistakes_are_named(draw, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        draw()
