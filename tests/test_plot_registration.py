"""Pictures of a registration: what is drawn lies where the records say."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxgeo import ConstantHeight, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot, plot, propagate
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.io.registration_report import report_of, tie_rows
from jaxgeo.plot.registration_page import telling_pass
from jaxgeo.register import BlockOutcome, Chosen, Matches, Orthoimage, Outcome, Pass, Registration, TieErrors, TiePoints
from jaxgeo.register.passes import AT_FIRST
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.prediction import Shifts
from jaxgeo.terrain import TangentGrid
from jaxgeo.uncertainty import sources

CENTRE = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
SHAPE, CELL = (200, 300), 10.0  # cells, m
GRID = TangentGrid.centred(CENTRE, spacing=(CELL, CELL), shape=SHAPE)
# Blocks: two that agree, one with a candidate elsewhere, one that was too even.
CENTRES = np.array([[50.0, 60.0], [50.0, 240.0], [150.0, 60.0], [150.0, 240.0]])
SHIFTS = np.array(
    [[[2.0, 5.0], [9.0, -9.0]], [[2.0, 6.0], [np.nan] * 2], [[-8.0, 3.0], [np.nan] * 2], [[np.nan] * 2] * 2]
)
OUTCOMES = [BlockOutcome.matched, BlockOutcome.matched, BlockOutcome.matched, BlockOutcome.no_texture]
SENSOR = Sensor(FrameCamera.from_pixels(focal_px=300.0, width=256, height=192), Gimbal.fixed(), Mount.nadir())
SHOT = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=2000.0))


def image(value: float, known: np.ndarray | None = None) -> Orthoimage:
    """Even, but for some dark rows, so that there is a range of brightness."""
    values = np.full(SHAPE, value)
    values[:4] = 0.0
    return Orthoimage.of(values, GRID, known)


def a_pass(false_alarms: float = 1e-20, peak: tuple[int, ...] = (0, 0, -1, -1)) -> Pass:
    """Blocks whose shift is that of the map alone: 0.1 cells for each m."""
    score = np.where(np.isfinite(SHIFTS[..., 0]), 0.8, np.nan)
    covariance = np.where(np.isfinite(score)[..., None, None], 0.01 * np.eye(2), np.nan)
    matches = Matches(CENTRES, SHIFTS, score, covariance, np.array(OUTCOMES, np.int8), np.array([99, 99, 99, 0]))
    by_error = np.broadcast_to(np.array([[0.0, -0.1], [0.1, 0.0]]), (4, 2, 2))  # north is up, and rows go down
    ones = np.ones(4)
    shifts = Shifts(CENTRES[:, ::-1], by_error, by_error, CELL * ones, ones, ones > 0.0, 0.0 * ones, np.zeros((4, 2)))
    chosen = Chosen(np.array(peak), ones, 10, 2)
    agreeing = sum(one >= 0 for one in peak)
    return Pass(CELL, 64, matches, chosen, shifts, 3, agreeing, 0, false_alarms, 297)


def registration(outcome: Outcome = Outcome.few_agree, passes: tuple[Pass, ...] | None = None) -> Registration:
    ground = normals_of(CENTRES[:2])
    ties = TiePoints(CENTRES[:2, ::-1], ground, np.broadcast_to(np.eye(2), (2, 2, 2)))
    done = (a_pass(),) if passes is None else passes
    return Registration(outcome, SENSOR, SHOT, ConstantHeight(0.0), None, TieErrors(0.5, 5.0, 10.0), ties, done)


def normals_of(places: np.ndarray) -> Geodetic:
    """Positions on the ellipsoid of places (n, 2) = (row, col)."""
    normal = np.stack([np.asarray(GRID.normal(jnp.asarray(place))) for place in places])
    x, y, z = normal.T
    return Geodetic(lat=np.arctan2(z, np.hypot(x, y)), lon=np.arctan2(y, x), height=np.zeros(len(places)))


def block_places(residual: float = 1.0) -> BlockPlaces:
    """Residuals of the ties to the east; the last block is over unknown ground."""
    ground = normals_of(CENTRES)
    ground = Geodetic(lat=np.where(np.arange(4) < 3, ground.lat, np.nan), lon=ground.lon, height=ground.height)
    offsets = np.array([[residual, 0.0], [residual, 0.0], [np.nan] * 2, [np.nan] * 2])
    return BlockPlaces(CENTRES[:, ::-1], ground, np.array([0, 1, -1, -1]), offsets)


@pytest.fixture
def ax():
    figure = Figure(figsize=(4, 4))
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def labels(handles) -> list[str]:
    return [handle.get_label() for handle in handles]


def test_shifts_to_the_right_and_upwards(ax) -> None:
    handles = plot.shifts(a_pass(), ax, covariance=np.diag([100.0, 400.0]))
    dots, rings, ellipse = (np.asarray(handle.get_xydata()) for handle in handles)
    np.testing.assert_array_equal(dots, [[5.0, -2.0], [-9.0, -9.0], [6.0, -2.0], [3.0, 8.0]])
    np.testing.assert_array_equal(rings, [[5.0, -2.0], [6.0, -2.0]])
    wide = [math.sqrt(-2.0 * math.log(1e-3) * (var + AT_FIRST**2)) + 1.0 for var in (1.0, 4.0)]  # cells, and a margin
    np.testing.assert_allclose(ellipse.max(axis=0), wide, rtol=0, atol=1e-2)
    assert labels(handles) == ["candidates of 3 blocks", "2 that agree", "searched"]
    assert ax.get_xlabel() == "shift to the right, cells of 10 m"


def test_shifts_of_no_candidate(ax) -> None:
    nothing = a_pass(peak=(-1,) * 4)
    nothing = Pass(**{**vars(nothing), "matches": nothing.matches.only(np.zeros((4, 2), bool))})
    with pytest.raises(ValueError, match="no block of this pass has a candidate"):
        plot.shifts(nothing, ax)


def test_blocks_lie_on_the_map_and_arrows_are_as_long_as_is_said(ax) -> None:
    """A residual of 1 m to the east, 200 times as long: north of the map is up, to the convergence of a small map."""
    handles = plot.ties_on_map(image(1.0), registration(), block_places(), ax, exaggeration=200.0)
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in ax.lines}
    cells = 1e-3 * CELL * np.stack([CENTRES[:, 1] + 0.5, SHAPE[0] - 0.5 - CENTRES[:, 0]], axis=1)  # km
    np.testing.assert_allclose(lines["tie points, 2"], cells[:2], rtol=0, atol=1e-5)
    np.testing.assert_allclose(lines["matched, but not in agreement, 1"], cells[2:3], rtol=0, atol=1e-5)
    assert len(lines) == 2, "the last block is over unknown ground"
    arrow = np.array(ax.texts[0].xy) - np.array(ax.texts[0].xyann)
    np.testing.assert_allclose(arrow, [0.2, 0.0], rtol=0, atol=1e-3)
    assert labels(handles)[-1] == "image less map, 200 times as long; rms 1 m"


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


def a_fix(sigma: float, degrees: float = 0.0):
    """Of the middle of the image, which errs by `sigma` m along north, twice as much along east."""
    pose = Pose.from_degrees(lat=47.0, lon=11.0, height=2000.0, pitch=degrees)
    model = (sources.Position.from_ned(north=sigma, east=2.0 * sigma, down=0.0),)
    return propagate(SENSOR, Shot(pose), (127.5, 95.5), ConstantHeight(0.0), model)


def test_circles_have_the_radii_of_the_fixes(ax) -> None:
    direct, updated = a_fix(40.0), a_fix(10.0, degrees=0.5)
    handles = plot.circles_on_map(image(1.0), image(0.5), direct, updated, ax)
    rings = [np.asarray(line.get_xydata()) for line in ax.lines if len(line.get_xydata()) > 1]
    middle = np.asarray(R_ecef_from_enu(direct.fix.position).T @ (updated.fix.ecef - direct.fix.ecef))[:2]
    for ring, fix, centre in zip(rings, (direct, updated), (np.zeros(2), middle), strict=True):
        radius = np.linalg.norm(ring - centre[None], axis=1)
        np.testing.assert_allclose(radius, float(fix.circular_error(0.9)), rtol=1e-6)
    outer, inner = ax.patches
    axes = math.sqrt(2.0 * math.log(10.0)) * np.array([160.0, 80.0])  # of 90 %, from side to side
    np.testing.assert_allclose([outer.width, outer.height], axes, rtol=1e-3)
    np.testing.assert_allclose([inner.width, inner.height], axes / 4.0, rtol=1e-3)
    assert f"CE90 {float(direct.circular_error(0.9)):.3g} m\n47.000000° N, 11.000000° E" in labels(handles)[0]


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
