"""Blocks matched with a reference: exact correlation, honest shifts, and reasons for what is not matched."""

from __future__ import annotations

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.register.blocks import BlockOutcome, Matches, blocks_of, count_outcomes
from jaxgeo.register.chance import false_alarms, second_best
from jaxgeo.register.clusters import Clusters
from jaxgeo.register.correlation import correlations
from jaxgeo.register.flattening import remove_illumination
from jaxgeo.register.matching import match_blocks
from jaxgeo.register.peaks import MOST_ADDED, _top_of_paraboloid, best_peaks, ellipses, joined

SIDE, SIZE = 160, 40
SHIFT = np.array([2.3, -1.4])
ALL = np.ones((SIDE, SIDE), bool)


def scene(seed: int) -> np.ndarray:
    """Spectrum of a random texture without an edge: half its detail is finer than some eight cells."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.fftfreq(SIDE)[None, :])
    spectrum = np.fft.fft2(rng.standard_normal((SIDE, SIDE))) / np.maximum(frequency, 1.0 / SIDE)
    spectrum *= np.exp(-0.5 * (2 * np.pi * 0.7 * frequency) ** 2)
    spectrum[0, 0] = 0.0
    return spectrum / np.std(np.fft.ifft2(spectrum).real)


def moved(spectrum: np.ndarray, shift: np.ndarray, blur: float = 0.0) -> np.ndarray:
    """The texture moved by (rows, cols), exactly, and blurred by a Gaussian of some cells."""
    row, col = np.fft.fftfreq(SIDE)[:, None], np.fft.fftfreq(SIDE)[None, :]
    phase = np.exp(-2j * np.pi * (row * shift[0] + col * shift[1]))
    return np.fft.ifft2(spectrum * phase * np.exp(-0.5 * (2 * np.pi * blur * np.hypot(row, col)) ** 2)).real


def pair(seed: int, shift: np.ndarray = SHIFT, noise: float = 0.1, blur: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A rectified image and a reference with another gain and offset, both noisy."""
    rng, spectrum = np.random.default_rng(1000 + seed), scene(seed)
    first, second = moved(spectrum, np.zeros(2)), moved(spectrum, shift, blur)
    noises = noise * rng.standard_normal((2, SIDE, SIDE))
    return first + noises[0], 40.0 + 3.0 * (second + noises[1])


def matched(rectified, reference, known=ALL, known_reference=ALL, sigma=2.0, centres=None, **options) -> Matches:
    centres = blocks_of(ALL, SIZE) if centres is None else centres
    covariance = np.tile(sigma**2 * np.eye(2), (len(centres), 1, 1))
    return match_blocks(rectified, known, reference, known_reference, centres, covariance, size=SIZE, **options)


def direct(block, known, window, known_window, row, col) -> float:
    """Normalised correlation at one shift, from its definition."""
    part = np.s_[row : row + block.shape[0], col : col + block.shape[1]]
    both = known & known_window[part]
    return float(np.corrcoef(block[both], window[part][both])[0, 1])


def test_correlation_is_the_definition() -> None:
    rng = np.random.default_rng(5)
    blocks, windows = 900.0 + rng.standard_normal((2, 12, 11)), 7e3 + rng.standard_normal((2, 21, 18))
    known, known_windows = rng.random((2, 12, 11)) > 0.2, rng.random((2, 21, 18)) > 0.2
    blocks[~known], windows[~known_windows] = 1e6, np.nan
    surface = correlations(*(jnp.asarray(x) for x in (blocks, known, windows, known_windows)), jnp.asarray(0.3))
    expected = [
        [[direct(blocks[k], known[k], windows[k], known_windows[k], i, j) for j in range(8)] for i in range(10)]
        for k in range(2)
    ]
    np.testing.assert_allclose(surface.score, expected, rtol=0.0, atol=1e-9)


def test_correlation_of_what_has_nothing_in_common_varies_as_said() -> None:
    """Bartlett's formula, for white images and for smooth ones."""
    spectra = [scene(seed) for seed in range(16)]
    smooth = np.stack([moved(s, np.zeros(2), 1.0) for s in spectra])
    for images in (np.random.default_rng(0).standard_normal((16, SIDE, SIDE)), smooth):
        arrays = (images[:8, :60, :60], np.ones((8, 60, 60), bool), images[8:, :90, :90], np.ones((8, 90, 90), bool))
        surface = correlations(*(jnp.asarray(x) for x in arrays), jnp.asarray(0.5))
        ratio = np.sqrt(np.mean(np.asarray(surface.score) ** 2)) / np.sqrt(np.mean(np.asarray(surface.chance) ** 2))
        assert 0.6 < ratio < 1.4


def test_blocks_reach_the_edges_and_lie_where_the_image_is_known() -> None:
    known = np.zeros((100, 95), bool)
    known[:, :50] = True
    centres = blocks_of(known, 30)
    assert centres[:, 0].min() == 14.5
    assert centres[:, 0].max() == 100 - 15.5
    assert centres[:, 1].max() < 50
    assert len(blocks_of(np.ones((100, 95), bool), 30)) == 16
    assert len(blocks_of(np.ones((100, 95), bool), 30, 10)) == 8 * 8
    np.testing.assert_array_equal(blocks_of(np.ones((9, 21), bool), 300), [[4.0, 10.0]])
    assert blocks_of(np.zeros((60, 60), bool), 30).shape == (0, 2)
    assert blocks_of(np.zeros((0, 60), bool), 30).shape == (0, 2)


@pytest.mark.costly
def test_the_shift_is_found_whatever_gain_and_offset() -> None:
    rectified, reference = pair(0)
    found = matched(rectified, reference)
    assert count_outcomes(found.outcome) == {BlockOutcome.matched: 16}
    np.testing.assert_allclose(found.shift[:, 0], np.tile(SHIFT, (16, 1)), atol=0.2)  # cells
    assert np.all(np.diff(np.nan_to_num(found.score, nan=-1.0), axis=1) <= 0.0)
    other = matched(-5.0 + 20.0 * rectified, 0.1 * reference)
    np.testing.assert_allclose(other.shift, found.shift, atol=1e-9)
    np.testing.assert_allclose(other.covariance, found.covariance, rtol=1e-6)
    np.testing.assert_allclose(other.score, found.score, atol=1e-12)


@pytest.mark.costly
def test_images_exchanged_give_the_opposite_shift() -> None:
    rectified, reference = pair(1)
    there, back = matched(rectified, reference), matched(reference, rectified)
    np.testing.assert_allclose(np.mean(there.shift[:, 0] + back.shift[:, 0], axis=0), 0.0, atol=0.02)  # cells
    np.testing.assert_array_equal(there.searched, back.searched)


@pytest.mark.costly
def test_unknown_cells_have_no_influence() -> None:
    rectified, reference = pair(2)
    known, known_reference = ALL.copy(), ALL.copy()
    known[:30, 50:90], known_reference[100:130, 60:] = False, False
    found = matched(rectified, reference, known, known_reference)
    for junk in (np.nan, 1e9):
        again = matched(
            np.where(known, rectified, junk), np.where(known_reference, reference, -junk), known, known_reference
        )
        for a, b in ((found.shift, again.shift), (found.covariance, again.covariance), (found.score, again.score)):
            np.testing.assert_array_equal(a, b)
    ok = found.outcome == BlockOutcome.matched
    assert np.count_nonzero(ok) > 10
    np.testing.assert_allclose(found.shift[ok, 0], np.broadcast_to(SHIFT, (int(np.sum(ok)), 2)), atol=0.25)  # cells


def test_a_block_stands_for_its_known_cells() -> None:
    rectified, reference = pair(2)
    known = ALL.copy()
    known[:, :15] = False
    found = matched(rectified, reference, known, centres=np.array([[60.0, 19.5]]))
    np.testing.assert_allclose(found.centre, [[60.0 - 0.5, 27.0]], atol=0.51)


@pytest.mark.costly
@pytest.mark.parametrize("noise, blur", [(0.1, 0.0), (0.3, 0.0), (0.2, 1.0)])
def test_covariances_are_honest(noise: float, blur: float) -> None:
    """Errors over predicted standard deviations, and bias, over shifts of all parts of a cell."""
    errors, scaled = [], []
    for seed in range(6):
        shift = np.random.default_rng(seed).uniform(-3.0, 3.0, 2)
        found = matched(*pair(seed, shift, noise, blur), floor=0.0)
        ok = found.outcome == BlockOutcome.matched
        error = found.shift[ok, 0] - shift
        errors.append(error)
        root = np.linalg.cholesky(found.covariance[ok, 0])
        scaled.append(np.linalg.solve(root, error[:, :, None])[:, :, 0])
    error, ratio = np.concatenate(errors), np.sqrt(np.mean(np.concatenate(scaled) ** 2))
    assert len(error) > 80
    assert np.all(np.abs(np.mean(error, axis=0)) < 0.03)  # cells
    assert np.sqrt(np.mean(error**2)) < 0.4 * noise + 0.05  # cells
    assert 0.6 < ratio < 1.5


def test_only_what_the_navigation_allows_is_searched() -> None:
    rectified, reference = pair(3, np.array([0.0, 6.0]))
    centres = np.array([[80.0, 80.0], [60.0, 70.0]])
    wide, flat = np.diag([1.0, 9.0]), np.diag([9.0, 1.0])
    found = match_blocks(rectified, ALL, reference, ALL, centres, np.stack([wide, flat]), size=SIZE)
    np.testing.assert_allclose(found.shift[0, 0], [0.0, 6.0], atol=0.1)  # cells
    assert not np.any(np.hypot(*(found.shift[1] - [0.0, 6.0]).T) < 1.0)
    k = np.sqrt(-2.0 * np.log(0.001))
    np.testing.assert_allclose(found.searched, np.pi * (k + 1.0) * (3.0 * k + 1.0), rtol=0.05)
    whitening, extent = ellipses(np.stack([wide, np.zeros((2, 2))]), 0.999)
    np.testing.assert_allclose(extent, [[k + 1.0, 3.0 * k + 1.0], [1.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(whitening[0] @ [0.0, 3.0 * k + 1.0]), 1.0, atol=1e-9)


@pytest.mark.parametrize("block", [8, 32, 200])
def test_windows_of_few_blocks_have_one_size(block: int) -> None:
    """None is smaller than asked, all together cost little more, and no two that are left would."""
    rng = np.random.default_rng(block)
    widths = np.asarray([4, 6, 8, 24, 48, 512])[rng.integers(0, 6, (60, 2))]
    found = joined(widths, (block, block))
    assert np.all(found >= widths)
    cells = lambda half: np.prod(block + 2 * half, axis=-1)  # noqa: E731
    sizes = np.unique(found, axis=0)
    assert 1 < len(sizes) < len(np.unique(widths, axis=0))
    assert np.sum(cells(found) - cells(widths)) <= MOST_ADDED * len(np.unique(widths, axis=0))
    for one, other in itertools.combinations(sizes, 2):
        of_both = [np.all(found == size, axis=1) for size in (one, other)]
        both = cells(np.maximum(one, other))
        added = sum(
            np.count_nonzero(here) * (both - cells(size)) for here, size in zip(of_both, (one, other), strict=True)
        )
        assert added > MOST_ADDED


def test_what_is_not_matched_has_its_reason() -> None:
    rectified, reference = pair(4)
    known, known_reference = ALL.copy(), ALL.copy()
    known[:60, :60] = False
    rectified[110:, :60] = 7.0
    known_reference[:60, 100:] = False
    reference[100:, 100:] = np.random.default_rng(0).standard_normal((60, 60))
    reference[50:110, 50:110] = 7.0
    centres = np.array([[19.5, 19.5], [139.5, 19.5], [19.5, 139.5], [139.5, 139.5], [79.5, 79.5], [79.5, 19.5]])
    found = matched(rectified, reference, known, known_reference, centres=centres, least_score=0.5)
    names = "outside_image no_texture off_reference no_peak no_texture matched".split()
    assert [BlockOutcome(code).name for code in found.outcome] == names
    assert all(BlockOutcome(code).message.endswith(".") for code in BlockOutcome)
    assert np.all(np.isnan(found.shift[:5]))
    assert not np.any(found.is_candidate[:5])
    assert found.searched[0] == 0


def test_a_straight_edge_alone_is_not_refined() -> None:
    """Along it nothing says where the block is."""
    edge = np.where(np.arange(SIDE) > 80, 1.0, 0.0)[None, :] * np.ones((SIDE, 1))
    noise = 0.02 * np.random.default_rng(0).standard_normal((2, SIDE, SIDE))
    found = matched(edge + noise[0], edge + noise[1], centres=np.array([[80.0, 80.0]]))
    assert found.outcome[0] in (BlockOutcome.not_refined, BlockOutcome.no_peak)


def test_flattening_takes_out_what_varies_slowly() -> None:
    image = np.random.default_rng(0).standard_normal((SIDE, SIDE))
    slope = np.linspace(0.0, 1.0, SIDE)
    lit = (1.0 + 3.0 * slope[:, None]) * image + 50.0 * slope[None, :]
    known = ALL.copy()
    known[20:50, 30:70] = False
    lit[~known] = np.nan
    flat = np.asarray(remove_illumination(lit, known, 15))
    assert np.all(flat[~known] == 0.0)
    assert np.corrcoef(flat[known], np.asarray(remove_illumination(image, known, 15))[known])[0, 1] > 0.97
    here = np.s_[40:55, 63:78]
    cells = lit[here][known[here]]
    deviation = np.sqrt(np.var(cells) + 0.01 * np.var(lit[known]))
    np.testing.assert_allclose(flat[47, 70], (lit[47, 70] - np.mean(cells)) / deviation, atol=1e-9)
    assert np.all(np.asarray(remove_illumination(np.full((SIDE, SIDE), 3.0), ALL, 15)) == 0.0)


def test_images_of_different_places_agree_by_chance_alone() -> None:
    for seed in range(4):
        found = matched(pair(seed)[0], pair(seed + 50)[1])
        assert false_alarms(found, Clusters().choose(found)) > 1e-2


def test_a_texture_that_repeats_itself_gives_two_answers() -> None:
    col, noise = np.arange(SIDE), 0.1 * np.random.default_rng(0).standard_normal((2, SIDE, SIDE))
    rows = scene(8)
    striped = np.sin(2 * np.pi * col / 8)[None, :] + np.cos(2 * np.pi * col / 4)[None, :]
    both = np.fft.ifft2(rows).real.mean(axis=1, keepdims=True) * 8.0 * np.ones((1, SIDE)) + striped
    found = matched(both + noise[0], np.roll(both, (1, 4), axis=(0, 1)) + noise[1])
    chosen = Clusters().choose(found)
    second = second_best(Clusters(), found, chosen)
    assert chosen.count >= 10
    assert second.count >= 0.7 * chosen.count
    gap = np.nanmedian(chosen.of(found.shift), axis=0) - np.nanmedian(second.of(found.shift), axis=0)
    np.testing.assert_allclose(np.abs(gap), [0.0, 8.0], atol=0.1)  # cells


def test_no_blocks_no_matches() -> None:
    found = matched(*pair(0), centres=np.zeros((0, 2)))
    assert found.shift.shape == (0, 4, 2)
    assert count_outcomes(found.outcome) == {}


@pytest.mark.parametrize(
    "change, words",
    [
        ({"reference": np.zeros((SIDE, 9)), "known_reference": np.ones((SIDE, 9), bool)}, "same grid"),
        ({"rectified": np.full((SIDE, SIDE), np.nan)}, "rectified is not a number in 25600 cells"),
        ({"centres": np.array([[300.0, 5.0]])}, "does not lie on the image"),
        ({"covariance": -np.eye(2)[None]}, "covariance 0 is none"),
        ({"covariance": 1e6 * np.eye(2)[None]}, "match coarser images first"),
        ({"covariance": np.eye(2)}, r"\(n, 2, 2\)"),
        ({"probability": 1.0}, "probability"),
        ({"size": 3}, "8 cells"),
        ({"peaks": 0}, "peaks"),
        ({"least_overlap": 0.0}, "least_overlap"),
        ({"above_chance": -1.0}, "above_chance"),
        ({"floor": -0.1}, "floor"),
        ({"known": np.ones((2, 2), bool)}, "alike"),
    ],
)
def test_mistakes_are_named(change: dict, words: str) -> None:
    rectified, reference = pair(0)
    given: dict[str, Any] = {"rectified": rectified, "known": ALL, "reference": reference, "known_reference": ALL}
    given |= {"centres": np.array([[80.0, 80.0]]), "covariance": np.eye(2)[None], "size": SIZE}
    with pytest.raises(ValueError, match=words):
        match_blocks(**(given | change))


@pytest.mark.parametrize("place", [(0.3, -0.2), (-0.45, 0.1), (0.0, 0.0)])
def test_the_offset_of_a_peak_is_the_top_of_its_paraboloid(place: tuple[float, float]) -> None:
    """In cells, towards rows and columns that grow; one that would be further than half a cell away stays within."""
    row, col = np.mgrid[:7, :9].astype(float)
    score = 0.9 - 0.05 * (row - 3.0 - place[0]) ** 2 - 0.08 * (col - 5.0 - place[1]) ** 2
    top = _top_of_paraboloid(jnp.asarray(score), jnp.asarray(3), jnp.asarray(5))
    np.testing.assert_allclose(top, place, rtol=0, atol=1e-12)
    beside = _top_of_paraboloid(jnp.asarray(score), jnp.asarray(2), jnp.asarray(5))
    np.testing.assert_allclose(beside, (0.5, place[1]), rtol=0, atol=1e-12)


def test_the_best_peak_is_between_cells_where_the_texture_is() -> None:
    """Before any refinement: of a smooth texture moved by a known part of a cell."""
    rng, side, half = np.random.default_rng(3), 32, 4
    waves, phase = rng.normal(0.0, 0.4, (12, 2)), rng.uniform(0.0, 2.0 * np.pi, 12)

    def texture(begin: int, size: int, moved: np.ndarray) -> np.ndarray:
        place = np.arange(begin, begin + size, dtype=float)
        down, across = (place[:, None, None] - moved[0]), (place[None, :, None] - moved[1])
        return np.sum(np.cos(waves[:, 0] * down + waves[:, 1] * across + phase), axis=-1)

    whitening, _ = ellipses(np.eye(2)[None], 0.9)
    for moved in np.array([[1.3, -0.8], [-0.6, 2.3], [0.2, 0.4]]):
        block, window = texture(0, side, np.zeros(2)), texture(-half, side + 2 * half, moved)
        known = [np.ones((1, *each.shape), bool) for each in (block, window)]
        given = (block[None], known[0], window[None], known[1], whitening / 2.0, np.array(0.5), np.array(2.0))
        found = best_peaks(*map(jnp.asarray, given), peaks=1)
        np.testing.assert_allclose((np.asarray(found.shift) + np.asarray(found.offset))[0, 0], moved, atol=0.2)
