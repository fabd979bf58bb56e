"""Charts: what is drawn is what was given, and colours can be told apart."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.colors
import matplotlib.path
import numpy as np
import pytest

from jaxgeo import plot
from jaxgeo.adjust import reliability
from jaxgeo.earth import WGS84
from jaxgeo.plot import style
from jaxgeo.plot.cloud import ground_about
from jaxgeo.status import Status
from jaxgeo.uncertainty import Budget, Comparison
from jaxgeo.uncertainty._budget import Variance
from tests.support.drawn import (
    a_budget,
    adjusted,
    compared,
    judged,
    level,
    line,
    new_axes,
    north_up,
    on_the_hill,
    said,
    sampled,
    words,
)


@pytest.fixture
def ax():
    with mpl.rc_context(style.style(style.COLUMN)):
        yield new_axes()


# Machado, Oliveira and Fernandes (2009), "A physiologically-based model for simulation of color vision deficiency",
# severity 1: linear RGB as seen with no cones for long, middle and short waves.
BLINDNESS = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TOGETHER = (  # colours that one figure has beside each other
    (style.BLUE, style.ORANGE, style.INK),
    (style.BLUE, style.VERMILLION, style.EARTH),
    (style.SKY, style.BLUE, style.INK, style.VERMILLION),
    (style.SAMPLE, style.SAMPLED, *style.LINEAR),
    (style.SAMPLE, style.SAMPLED, *style.LINEAR, style.REGION),
    (style.REGION, style.HIDDEN, style.FIX, style.SIGHT, style.EARTH),
    (*style.METHODS, style.HIDDEN),
    (style.HORIZONTAL, style.VERTICAL),
    (style.FIX, style.SIGHT, style.EDGE),
)


def lab(colour: str, seen_as: str | None = None) -> np.ndarray:
    """CIE L*a*b* of a colour under D65, as an eye sees it."""
    rgb = np.array(matplotlib.colors.to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    if seen_as is not None:
        linear = np.clip(np.array(BLINDNESS[seen_as]) @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(np.maximum(to_xyz @ linear / to_xyz.sum(axis=1), 0.008856))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("seen_as", [None, *BLINDNESS])
@pytest.mark.parametrize("colours", TOGETHER)
def test_colours_of_one_figure_are_told_apart_by_all_eyes(colours, seen_as) -> None:
    for one, other in itertools.combinations(colours, 2):
        assert np.linalg.norm(lab(one, seen_as) - lab(other, seen_as)) > 19.0, (one, other)


def test_type_has_the_size_that_is_read() -> None:
    assert style.style(style.COLUMN)["font.size"] == pytest.approx(7.0)
    assert style.style(style.PAGE)["font.size"] == pytest.approx(8.5)
    assert set(style.style()) <= set(mpl.rcParams)
    with pytest.raises(ValueError, match="width must be a positive length in inches; got -1"):
        style.style(-1.0)


@pytest.mark.parametrize(
    "length, said",
    [(59.94, "59.9 m"), (1234.0, "1234 m"), (12345.0, "12.3 km"), (math.inf, "without end"), (math.nan, "unknown")],
)
def test_lengths_in_words(length, said) -> None:
    assert style.metres(length) == said


@pytest.mark.parametrize("colours", [style.LINEAR, (style.HORIZONTAL, style.VERTICAL), (*style.METHODS, style.HIDDEN)])
def test_areas_and_lines_of_one_kind_are_told_apart_in_grey(colours) -> None:
    """Those that no mark and no dashes tell apart, by their lightness."""
    for one, other in itertools.combinations(colours, 2):
        assert abs(lab(one)[0] - lab(other)[0]) > 10.0, (one, other)


# Linear against sampled.


@pytest.mark.costly
def test_a_comparison_shows_both_by_ellipse_and_circle(ax) -> None:
    one = compared()
    assert plot.error_cloud(one, ax) is ax
    circle = np.hypot(*line(ax, "_circle, linear, facet").T)
    np.testing.assert_allclose(circle, float(level().circular_error(0.9)), rtol=0, atol=1e-9)
    circle = np.hypot(*line(ax, "_circle, sampled").T)
    np.testing.assert_allclose(circle, one.quantiles[1].value, rtol=0, atol=1e-9)
    ellipse = line(ax, "_ellipse, linear, facet")
    whitened = np.einsum("ni,ij,nj->n", ellipse, np.linalg.inv(np.asarray(level().cov_enu)[:2, :2]), ellipse)
    np.testing.assert_allclose(whitened, -2.0 * math.log(0.1), rtol=1e-9)  # of a normal distribution, 90 %
    assert np.ptp(ellipse[:, 0]) < np.ptp(ellipse[:, 1])
    assert len(line(ax, "_samples")) == 3000
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_aspect()) == ("east, m", "north, m", 1.0)
    assert f"linear, facet: CE90 {style.metres(float(level().circular_error(0.9)))}, not valid" in words(ax)
    assert said(ax).startswith(one.verdict)


@pytest.mark.costly
def test_an_ellipse_of_samples_holds_its_share(ax) -> None:
    plot.error_cloud(compared(), ax, propagations={})
    inside = matplotlib.path.Path(line(ax, "_ellipse, sampled")).contains_points(line(ax, "_samples"))
    assert inside.mean() == pytest.approx(0.9, abs=0.02)


@pytest.mark.costly
def test_samples_about_their_mean_lie_where_they_were(ax) -> None:
    """Where errors are counted from the mean, cloud, ellipse and circle have it as their middle."""
    one = compared()
    mean = np.array([20.0, -10.0, 0.0])
    drawn = eqx.tree_at(lambda x: (x.mean_enu, x.centre_enu), one.sampled, (mean, mean))
    plot.error_cloud(eqx.tree_at(lambda x: x.sampled, one, drawn), ax, propagations={})
    for label in ("_samples", "_ellipse, sampled", "_circle, sampled"):
        middle = line(ax, label)[:-1].mean(axis=0)  # rings end where they began
        np.testing.assert_allclose(middle, mean[:2], rtol=0, atol=0.7, err_msg=label)


@pytest.mark.costly
def test_samples_that_jump_are_marked_and_in_the_picture(ax) -> None:
    plot.error_cloud(compared(jumps=60, failed=100), ax)
    crosses = line(ax, "_jumped")
    assert len(crosses) == 60
    assert len(line(ax, "_samples")) == 2840
    assert "on other ground, 2 %" in words(ax)
    assert np.all(crosses[:, 0] > 700.0)
    assert ax.get_xlim()[1] < 700.0  # eight circles are the most: beyond, words must do
    assert "Outside the picture: 2 %." in said(ax)
    plot.error_cloud(compared(jumps=60), ax, reach=900.0)
    assert ax.get_xlim() == (-900.0, 900.0)


@pytest.mark.costly
def test_comparisons_that_cannot_be_drawn(ax) -> None:
    cases: tuple[tuple[Comparison, dict[str, Any], str], ...] = (
        (compared(keep=False), {}, "were not kept"),
        (compared(), {"reach": -3.0}, "reach must be a positive length in m; got -3.0"),
        (compared(), {"propagations": {str(k): level() for k in range(4)}}, "propagations must be 3 or fewer; got 4"),
        (compared(), {"jumped": np.zeros(7, bool)}, "each of the 3000 samples"),
        (compared(), {"probability": 1.0}, "between 0 and 1, both excluded; got 1.0"),
    )
    for one, given, message in cases:
        with pytest.raises(ValueError, match=message):
            plot.error_cloud(one, ax, **given)


def test_a_cloud_of_samples_alone_says_what_it_does_not_show(ax) -> None:
    plot.error_cloud(sampled(failed=400), ax, reach=20.0, jumped=np.arange(2000) < 100)
    assert "Without a fix: 20 %." in said(ax)
    assert "Outside the picture" in said(ax)
    assert words(ax)[:3] == ["2 000 samples", "on other ground, 5 %", "sampled: CE90 without end"]
    with pytest.raises(ValueError, match="none of the samples has a fix"):
        plot.error_cloud(sampled(10, failed=10), ax)


def test_another_probability_is_that_of_ellipses_and_circles(ax) -> None:
    plot.error_cloud(compared(), ax, probability=0.5)
    inside = matplotlib.path.Path(line(ax, "_ellipse, sampled")).contains_points(line(ax, "_samples"))
    assert inside.mean() == pytest.approx(0.5, abs=0.03)
    circle = np.hypot(*line(ax, "_circle, linear, facet").T)
    np.testing.assert_allclose(circle, float(level().circular_error(0.5)), rtol=0, atol=1e-9)
    assert "circle of 50 %, CE50" in words(ax)
    assert not any("valid" in one for one in words(ax)), "the verdict of a method is on CE90"


def test_the_ground_under_a_cloud_lies_where_the_terrain_says(ax) -> None:
    fix = on_the_hill()
    (east, north), height = ground_about(north_up(), fix, 300.0)
    at_fix = np.unravel_index(np.argmin(np.hypot(east, north)), east.shape)
    assert np.hypot(east[at_fix], north[at_fix]) < 1e-3  # m
    assert height[at_fix] == pytest.approx(800.0, abs=1e-9)
    metres_east = np.radians(0.001) * float(WGS84.prime_vertical_radius(jnp.radians(44.02)) + 800.0)
    cells = np.ptp(east[at_fix[0]]) / (metres_east * np.cos(np.radians(44.02)))
    assert cells == pytest.approx(round(cells), abs=1e-4)
    plot.error_cloud(sampled(), ax, dem=north_up())
    ax.figure.canvas.draw()
    assert len(ax.collections) >= 2  # shading and contour lines


# Budgets.


def test_bars_are_the_shares_of_both_variances(ax) -> None:
    assert plot.budget_bars(a_budget(), ax) is ax
    across, up = ax.containers
    np.testing.assert_allclose([bar.get_width() for bar in across], [50.0, 30.0, 15.0, 5.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose([bar.get_width() for bar in up], [20.0, 20.0, 60.0, 0.0], rtol=0, atol=1e-12)
    names = [tick.get_text() for tick in ax.get_yticklabels()]
    assert names == ["block", "source: 0, 0.573°", "source: 1, 2.5 m", "source: 2, 0.5 m"]
    beside = [text.get_text() for text in ax.texts]
    assert [one for one in beside if one.endswith(" m")] == ["4 m", "5 m", "6 m", "7 m"]
    assert "CE90 without" in beside
    assert ax.get_title("right") == "CE90 9 m, sigma of height 1 m"
    assert ax.get_xlabel() == "share of the variance, %"


def test_small_errors_share_a_bar(ax) -> None:
    plot.budget_bars(a_budget(), ax, most=3)
    across, up = ax.containers
    np.testing.assert_allclose([bar.get_width() for bar in across], [50.0, 30.0, 20.0], rtol=0, atol=1e-12)
    assert sum(bar.get_width() for bar in up) == pytest.approx(100.0)
    assert ax.get_yticklabels()[2].get_text() == "2 others"


def test_budgets_that_cannot_be_drawn(ax) -> None:
    with pytest.raises(ValueError, match="most must be 2 bars or more; got 1"):
        plot.budget_bars(a_budget(), ax, most=1)
    with pytest.raises(ValueError, match="horizontal variance of this budget is zero"):
        plot.budget_bars(Budget((), Variance(0.0, 0.0), 0.0, 0.9, Status.hit), ax)


# Residuals.


def quivers(axes) -> list:
    return [one for one in axes.collections if hasattr(one, "U")]


@pytest.mark.costly
@pytest.mark.slow
def test_arrows_are_the_residuals_of_an_image(ax) -> None:
    name = str(adjusted().block.images.name[3])
    assert plot.residual_arrows(adjusted(), ax, image=name, exaggeration=100.0) is ax
    (arrows,) = quivers(ax)
    rows = adjusted().block.observations.image == name
    np.testing.assert_allclose(
        np.asarray(arrows.get_offsets()), adjusted().block.observations.uv[rows], rtol=0, atol=1e-9
    )
    drawn = np.stack([arrows.U, arrows.V], axis=1) / arrows.scale
    np.testing.assert_allclose(drawn, 100.0 * adjusted().residuals[rows], rtol=0, atol=1e-9)
    assert (arrows.angles, arrows.scale_units) == ("xy", "xy")
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert bottom > top, "rows go down"
    (frame,) = ax.patches
    assert frame.get_bbox().bounds == (-0.5, -0.5, 4000.0, 3000.0)
    tips = adjusted().block.observations.uv[rows] + drawn
    assert np.all((tips > [low, top]) & (tips < [high, bottom])), "all tips are in the picture"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("column, px", "row, px")
    key = np.ptp(line(ax, "_key")[:, 0]) / 100.0
    assert f"a residual of {key:g} px (100 times)" in words(ax)


@pytest.mark.costly
@pytest.mark.slow
def test_residuals_beyond_the_test_are_marked(ax) -> None:
    plot.residual_arrows(adjusted(), ax, checked=judged(wrong=(4, 9)))
    within, beyond = quivers(ax)
    assert len(beyond.get_offsets()) == 2
    assert len(within.get_offsets()) == len(adjusted().residuals) - 2
    np.testing.assert_array_equal(np.asarray(beyond.get_offsets()), adjusted().block.observations.uv[[4, 9]])
    assert "2 beyond it" in words(ax)


@pytest.mark.costly
def test_the_histogram_counts_what_is_checked(ax) -> None:
    checked = judged(wrong=(4, 9))
    assert plot.residual_histogram(adjusted(), ax, checked=checked) is ax
    count = len(adjusted().residuals) - 1
    steps = [one.get_data() for one in ax.patches if hasattr(one, "get_data")]
    heights = [np.asarray(one.values).sum() for one in steps]
    assert heights == [count - 2, count]
    curve = line(ax, "expected, spread 1")
    edges = np.asarray(steps[0].edges)
    area = np.trapezoid(curve[:, 1], curve[:, 0]) / (edges[1] - edges[0])
    assert area == pytest.approx(count, rel=1e-3)
    assert said(ax).startswith("2 beyond ±3.29, by chance")
    assert "2 outside the picture; 2 of" in said(ax)
    assert f"{adjusted().sigma0:.3f}" in ax.get_title("left")
    assert "standard deviations" in ax.get_xlabel()
    assert "count" in ax.get_ylabel()


@pytest.mark.costly
@pytest.mark.slow
def test_residuals_of_a_good_block_spread_as_expected(ax) -> None:
    plot.residual_histogram(adjusted(), ax)
    spreads = [float(one.rsplit(" ", 1)[1]) for one in words(ax)[:2]]
    np.testing.assert_allclose(spreads, 1.0, rtol=0, atol=0.1)
    checked = reliability(adjusted())
    np.testing.assert_allclose(spreads, np.sqrt(np.nanmean(checked.standardised**2, axis=0)), rtol=0, atol=0.005)


@pytest.mark.costly
def test_residuals_that_cannot_be_drawn(ax) -> None:
    with pytest.raises(ValueError, match="image 'i99' has no measurements in this block; others are i00"):
        plot.residual_arrows(adjusted(), ax, image="i99")
    with pytest.raises(ValueError, match="exaggeration must be a positive number; got -2"):
        plot.residual_arrows(adjusted(), ax, exaggeration=-2.0)
    blind = replace(judged(), standardised=np.full(adjusted().residuals.shape, np.nan))
    with pytest.raises(ValueError, match="no residual is checked by another measurement"):
        plot.residual_histogram(adjusted(), ax, checked=blind)


# Conventions.


def tip(axes, label: str) -> np.ndarray:
    """Direction of a named arrow."""
    ends = line(axes, f"_{label}")
    return (ends[-1] - ends[0]) / np.linalg.norm(ends[-1] - ends[0])


@pytest.mark.parametrize(
    "panel, label, across, up",
    [
        ("heading", "x forward", math.sin(math.radians(35.0)), math.cos(math.radians(35.0))),  # clockwise from north
        ("heading", "y right", math.cos(math.radians(35.0)), -math.sin(math.radians(35.0))),
        ("pitch", "x forward", math.cos(math.radians(20.0)), math.sin(math.radians(20.0))),  # nose up
        ("roll", "y right", math.cos(math.radians(22.0)), -math.sin(math.radians(22.0))),  # right wing down
        ("outer", "line of sight", math.sin(math.radians(52.0)), -math.cos(math.radians(52.0))),  # to the right
        ("inner", "line of sight", math.sin(math.radians(30.0)), -math.cos(math.radians(30.0))),  # ahead
        ("level", "line of sight", math.cos(math.radians(42.0)), -math.sin(math.radians(42.0))),  # down
        ("image", "u", 1.0, 0.0),
        ("image", "v", 0.0, -1.0),
    ],
)
def test_arrows_point_as_the_signs_say(ax, panel, label, across, up) -> None:
    assert plot.convention(panel, ax) is ax
    np.testing.assert_allclose(tip(ax, label), [across, up], rtol=0, atol=1e-9)


def test_no_such_convention(ax) -> None:
    with pytest.raises(ValueError, match="name must be one of heading, pitch"):
        plot.convention("yaw", ax)
