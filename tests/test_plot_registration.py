"""Pictures of a registration: what is drawn lies where the records say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.patches import Ellipse

from jaxgeo import plot
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.io.registration_report import report_of, tie_rows
from jaxgeo.plot.registration_page import telling_pass
from jaxgeo.register import Outcome, Pass
from jaxgeo.register.passes import AT_FIRST
from tests.support.drawn import (
    CELL,
    CENTRES,
    a_fix,
    a_pass,
    block_places,
    image,
    labels,
    line,
    new_axes,
    registration,
    words,
)
from tests.support.drawn import MAP_SHAPE as SHAPE


@pytest.fixture
def ax():
    return new_axes()


def test_shifts_to_the_right_and_upwards(ax) -> None:
    assert plot.shifts(a_pass(), ax, covariance=np.diag([100.0, 400.0])) is ax
    dots, rings, ellipse = (line(ax, label) for label in words(ax))
    np.testing.assert_array_equal(dots, [[5.0, -2.0], [-9.0, -9.0], [6.0, -2.0], [3.0, 8.0]])
    np.testing.assert_array_equal(rings, [[5.0, -2.0], [6.0, -2.0]])
    wide = [math.sqrt(-2.0 * math.log(1e-3) * (var + AT_FIRST**2)) + 1.0 for var in (1.0, 4.0)]  # cells, and a margin
    np.testing.assert_allclose(ellipse.max(axis=0), wide, rtol=0, atol=1e-2)
    assert words(ax) == ["candidates of 3 blocks", "2 that agree", "searched"]
    assert ax.get_xlabel() == "shift to the right, cells of 10 m"


def test_shifts_of_no_candidate(ax) -> None:
    nothing = a_pass(peak=(-1,) * 4)
    nothing = Pass(**{**vars(nothing), "matches": nothing.matches.only(np.zeros((4, 2), bool))})
    with pytest.raises(ValueError, match="no block of this pass has a candidate"):
        plot.shifts(nothing, ax)


def test_blocks_lie_on_the_map_and_arrows_are_as_long_as_is_said(ax) -> None:
    """A residual of 1 m to the east, 200 times as long: north of the map is up, to the convergence of a small map."""
    plot.ties_on_map(image(1.0), registration(), block_places(), ax, exaggeration=200.0)
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in ax.lines}
    cells = 1e-3 * CELL * np.stack([CENTRES[:, 1] + 0.5, SHAPE[0] - 0.5 - CENTRES[:, 0]], axis=1)  # km
    np.testing.assert_allclose(lines["tie points, 2"], cells[:2], rtol=0, atol=1e-5)
    np.testing.assert_allclose(lines["matched, but not in agreement, 1"], cells[2:3], rtol=0, atol=1e-5)
    assert sum(len(one) > 0 for one in lines.values()) == 2, "the last block is over unknown ground"
    arrow = np.array(ax.texts[0].xy) - np.array(ax.texts[0].xyann)
    np.testing.assert_allclose(arrow, [0.2, 0.0], rtol=0, atol=1e-3)
    assert labels(ax)[-1] == "image less map, 200 times as long; rms 1 m"


def test_the_board_shows_both_in_turn(ax) -> None:
    known = np.ones(SHAPE, bool)
    known[:, 200:] = False
    plot.checkerboard(image(1.0), image(0.0, known), ax, squares=6)
    (shown,) = (np.asarray(one.get_array()) for one in ax.images)
    assert shown.shape == SHAPE
    assert (shown[25, 25], shown[25, 75], shown[75, 25]) == (0.0, 1.0, 1.0)
    assert np.all(shown[4:, 200:] == 1.0), "where the image is unknown the reference is shown"
    np.testing.assert_allclose([*ax.get_xlim(), *ax.get_ylim()], [0.0, 3.0, 0.0, 2.0], rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="the same cells"):
        plot.checkerboard(image(1.0), image(0.0).window(0, 0, (10, 10)), ax)


@pytest.mark.costly
def test_circles_have_the_radii_of_the_fixes(ax) -> None:
    direct, updated = a_fix(40.0), a_fix(10.0, degrees=0.5)
    plot.circles_on_map(image(1.0), image(0.5), direct, updated, ax)
    rings = [np.asarray(line.get_xydata()) for line in ax.lines if len(line.get_xydata()) > 1]
    middle = np.asarray(R_ecef_from_enu(direct.fix.position).T @ (updated.fix.ecef - direct.fix.ecef))[:2]
    for ring, fix, centre in zip(rings, (direct, updated), (np.zeros(2), middle), strict=True):
        radius = np.linalg.norm(ring - centre[None], axis=1)
        np.testing.assert_allclose(radius, float(fix.circular_error(0.9)), rtol=1e-6)
    outer, inner = [one for one in ax.patches if isinstance(one, Ellipse)]
    axes = math.sqrt(2.0 * math.log(10.0)) * np.array([160.0, 80.0])  # of 90 %, from side to side
    np.testing.assert_allclose([outer.width, outer.height], axes, rtol=1e-3)
    np.testing.assert_allclose([inner.width, inner.height], axes / 4.0, rtol=1e-3)
    assert f"CE90 {float(direct.circular_error(0.9)):.3g} m\n47.000000° N, 11.000000° E" in words(ax)[0]


def test_the_page_of_what_failed_says_why(tmp_path) -> None:
    """What was never found has no picture; the words are there."""
    page = plot.registration_figure(registration(), image(1.0), places=block_places(), before=image(0.5))
    page.savefig(tmp_path / "page.png", dpi=30)
    said = " ".join(text.get_text() for ax in page.axes for text in ax.texts).replace("\n", " ")
    assert Outcome.few_agree.message in said
    assert "2 of 3 agree" in said
    assert sum(ax.axison for ax in page.axes) == 3
    assert (tmp_path / "page.png").stat().st_size > 10_000


def test_the_pass_that_tells_is_the_first_that_is_no_chance() -> None:
    chance, sure, later = a_pass(1.0), a_pass(1e-9), a_pass(1e-30)
    assert telling_pass(registration(passes=(chance, sure, later))) is sure
    assert telling_pass(registration(passes=(sure, chance))) is sure
    assert telling_pass(registration(passes=(chance, chance))) is chance
    assert telling_pass(registration(passes=())) is None


def test_rows_of_a_registration_that_failed() -> None:
    """Every block with a place has one; what agreed has no residual, since there is no pose to have it from."""
    tied, also, alone = tie_rows(registration(), block_places())
    assert (tied.chosen, also.chosen, alone.chosen) == (True, True, False)
    assert tied.residual_column_px is None
    assert tied.sigma_m == pytest.approx(math.hypot(1.0, 0.5))
    assert "none agrees" in alone.reason
    assert tied.lat_deg == pytest.approx(math.degrees(float(block_places().ground.lat[0])), abs=1e-9)
    report = report_of(registration())
    assert report["outcome"] == "few_agree"
    assert report["passes"][0]["outcomes"] == {"matched": 3, "no_texture": 1}
    assert "unknowns" not in report
