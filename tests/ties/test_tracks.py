"""Tracks, connected parts, image levels and interest points."""

from __future__ import annotations

import numpy as np
import pytest

from jaxgeo import ConstantHeight
from jaxgeo.ties import Matching, PairMatches, Pictures, TieOutcome, Views, connected, find_ties
from jaxgeo.ties.interest import cell_of, interest_points
from jaxgeo.ties.pictures import sample
from jaxgeo.ties.tracks import Tracks

NAMES = np.array(["a", "b", "c", "d"])


def matches(first: int, second: int, uv_first: np.ndarray, uv_second: np.ndarray) -> PairMatches:
    n = len(uv_first)
    sigma = np.full((n, 2), 0.2)
    outcome = np.where(np.isfinite(uv_second[:, 0]), TieOutcome.tied, TieOutcome.not_found).astype(np.int8)
    return PairMatches(first, second, uv_first, uv_second, sigma, sigma, np.ones(n), outcome, 0.0)


def test_matches_of_pairs_become_tracks() -> None:
    tracks, here = Tracks(), np.arange(6.0).reshape(3, 2)
    numbers = tracks.new(3)
    tracks.add(matches(0, 1, here, here + 10.0), numbers)
    again, uv = tracks.in_image(1)
    tracks.add(matches(1, 2, uv, np.where([[True], [True], [False]], uv + 10.0, np.nan)), again)
    found = tracks.observations(NAMES)
    assert [np.count_nonzero(found.point == name) for name in ("tie 0", "tie 1", "tie 2")] == [3, 3, 2]
    assert np.array_equal(found.uv[(found.point == "tie 1") & (found.image == "c")], here[1:2] + 20.0)


def test_contradicting_measurements_are_both_left_out() -> None:
    tracks, here = Tracks(), np.array([[1.0, 2.0]])
    number = tracks.new(1)
    tracks.add(matches(0, 2, here, here + 5.0), number)
    tracks.add(matches(0, 1, here, here + 1.0), number)
    tracks.add(matches(1, 2, here + 1.0, here + 9.0), number)
    tracks.add(matches(0, 2, here, here + 5.0), number)
    assert tracks.contradictions == 1
    assert set(tracks.observations(NAMES).image) == {"a", "b"}
    with pytest.raises(ValueError, match="no two images"):
        Tracks().observations(NAMES)


def test_parts_are_joined_by_enough_points() -> None:
    tracks = Tracks()
    for first, second, count in ((0, 1, 5), (1, 2, 2), (2, 3, 3)):
        here = np.arange(2.0 * count).reshape(count, 2)
        tracks.add(matches(first, second, here, here), tracks.new(count))
    observed = tracks.observations(NAMES)
    assert sorted(map(sorted, connected(NAMES, observed))) == [["a", "b"], ["c", "d"]]
    assert len(connected(NAMES, observed, least=2)) == 1
    assert len(connected(NAMES, None)) == 4


def test_levels_show_the_same_place() -> None:
    """A linear image is itself at every level, at pixels of the whole image."""
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    read = []
    pictures = Pictures(lambda row: (read.append(row) or 2.0 * u - 3.0 * v + row, None), most=2)
    uv = np.array([[20.3, 17.8], [40.0, 30.0], [-5.0, 3.0]])
    for power in (0, 1):
        values, known = sample(pictures.level(1, power), uv, power)
        assert known.tolist() == [True, True, False]
        assert np.allclose(values[:2], (2.0 * uv[:, 0] - 3.0 * uv[:, 1] + 1.0)[:2], atol=1e-4)
    for row in (2, 3, 3, 1):
        pictures.level(row, 0)
    assert read == [1, 2, 3, 1]


def test_points_are_spread_and_on_texture() -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(size=(96, 128)) * (np.arange(128) < 64)
    uv, cells = interest_points(Pictures(lambda row: (image, None)).level(0, 0), 0, (96, 128), 48)
    assert len(np.unique(cells)) == len(cells)
    assert {8 * row + col for row in range(6) for col in range(4)} <= set(cells.tolist())
    assert np.array_equal(cell_of(uv, (96, 128), 48), cells)
    assert np.all(uv[:, 0] < 70.0)  # the window of the texture is some pixels wide


@pytest.mark.parametrize(
    "options, words",
    [
        ({"sigma_height": 0.0}, "sigma_height must be positive"),
        ({"size": 15}, "even number"),
        ({"uniqueness": 1.5}, "uniqueness"),
        ({"least": 2}, "least must be 3"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Matching(**options)  # pyright: ignore[reportArgumentType]


def test_wrong_images_are_refused() -> None:
    with pytest.raises(ValueError, match="at least two"):
        Views.of([], [], [])
    with pytest.raises(ValueError, match="must be"):
        Pictures(lambda row: (np.zeros((4, 4)), None)).level(0, 0)
    with pytest.raises(ValueError, match="2 images"):
        Pictures(lambda row: (np.zeros((64, 64)), None), most=1)
    with pytest.raises(TypeError, match="views"):
        find_ties(None, ConstantHeight(0.0), None)  # pyright: ignore[reportArgumentType]
