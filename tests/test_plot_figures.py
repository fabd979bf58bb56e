"""Figures for print: what is drawn is what was given, in units that the axes name, and colours can be told apart."""

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
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxgeo import ConstantHeight, Dem, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot, propagate
from jaxgeo.adjust import Adjustment, Reliability, adjust, reliability
from jaxgeo.demo.made import scene_file
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.earth.ray import Ray
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.locate import intersect
from jaxgeo.plot import style
from jaxgeo.plot.adjustment import draw_residual_histogram, draw_residuals
from jaxgeo.plot.budgets import draw_budget
from jaxgeo.plot.comparison import draw_comparison
from jaxgeo.plot.conventions import PANELS, conventions_figure, draw_convention
from jaxgeo.plot.sightline import Section, draw_sight_line, section_under
from jaxgeo.status import Status
from jaxgeo.uncertainty import Budget, Comparison, Propagation, Sampled, sources
from jaxgeo.uncertainty.budget import SigmaShare, SourceShare, Variance
from jaxgeo.uncertainty.compare import Row
from tests.support.simulated_block import SIGMA_UV, simulated


@pytest.fixture
def ax():
    with mpl.rc_context(style.style(style.COLUMN)):
        figure = Figure(figsize=(style.COLUMN, style.COLUMN), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure.add_subplot()


def words(axes) -> list[str]:
    """What the legend says, line by line."""
    return [text.get_text() for text in axes.get_legend().get_texts()]


def line(axes, label: str) -> np.ndarray:
    """Places (n, 2) of the line with a label."""
    (found,) = [one for one in axes.lines if one.get_label() == label]
    return np.asarray(found.get_xydata())


def covers_no_data(axes) -> bool:
    """Whether the legend stands clear of the axes, once all is laid out."""
    axes.figure.canvas.draw()
    legend, box = axes.get_legend().get_window_extent(), axes.get_window_extent()
    return legend.y1 <= box.y0 or legend.x0 >= box.x1


# Colours and type.

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
    (style.SKY, style.BLUE, style.INK, style.ORANGE),
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


# The line of sight.

LEVEL = 200.0  # m, the ground of a level terrain
HIGH, DOWN = 3000.0, 10.0  # m, deg: where the camera is, and how far it looks down


@pytest.fixture(scope="module")
def demo() -> tuple[Ray, Dem]:
    """The optical axis of the demonstration, over the terrain that comes with the package."""
    scene = read_scene(scene_file())
    assert scene.shot is not None
    camera = scene.sensor.camera
    assert isinstance(camera, FrameCamera)
    middle = np.array([0.5 * (camera.width - 1), 0.5 * (camera.height - 1)])
    origin, direction, _ = scene.sensor.ray_ecef(scene.shot, middle)
    return Ray(origin, direction), example_dem()


def like(dem: Dem, posts: np.ndarray) -> Dem:
    """Other heights on the grid of a terrain, so that nothing is compiled again."""
    return Dem.from_array(posts, dem.grid)


def straight(camera: Geodetic, azimuth_deg: float, down_deg: float) -> Ray:
    azimuth, down = math.radians(azimuth_deg), math.radians(down_deg)
    ned = jnp.array([math.cos(down) * math.cos(azimuth), math.cos(down) * math.sin(azimuth), math.sin(down)])
    return Ray(WGS84.to_ecef(camera), R_ecef_from_ned(camera) @ ned)


@pytest.fixture(scope="module")
def section(demo) -> Section:
    return section_under(*demo)


def test_the_first_hit_is_the_fix(demo, section) -> None:
    fix = intersect(*demo)
    distance, height = section.hits[0]
    assert section.status == Status.hit
    assert height == pytest.approx(float(fix.position.height), abs=1e-6)
    foot = WGS84.to_ecef(Geodetic(lat=fix.position.lat, lon=fix.position.lon, height=jnp.asarray(0.0)))
    normal, camera_height = WGS84.normal_and_height(demo[0].origin)
    chord = float(jnp.linalg.norm(foot - (demo[0].origin - camera_height * normal)))
    assert distance == pytest.approx(chord * (1.0 + (chord / 6.37e6) ** 2 / 24.0), abs=0.05)  # the arc over its chord
    assert np.interp(distance, section.distance, section.sight - section.ground) == pytest.approx(0.0, abs=0.5)


def test_a_straight_line_bends_up_over_the_ellipsoid(demo) -> None:
    """From height h over a sphere of radius R, down by an angle a: (R + h) cos a / cos(a - d / R) - R at distance d."""
    level = like(demo[1], np.full(np.shape(demo[1].posts), LEVEL))
    camera = Geodetic.from_degrees(lat=36.3, lon=-84.1, height=HIGH)
    found = section_under(straight(camera, 270.0, DOWN), level, reach=17_500.0)
    radius = float(WGS84.prime_vertical_radius(camera.lat))  # westwards
    turn, down = found.distance / radius, math.radians(DOWN)
    expected = (radius + HIGH) * math.cos(down) / np.cos(down - turn) - radius
    np.testing.assert_allclose(found.sight, expected, rtol=0, atol=0.05)  # m
    tangent = HIGH - (radius + HIGH) / radius * math.tan(down) * found.distance
    np.testing.assert_allclose(found.flat, tangent, rtol=0, atol=0.05)  # m
    drop = 0.5 * found.hits[0, 0] ** 2 / radius
    assert found.curved == pytest.approx(drop, rel=0.1)
    assert found.hits[0, 1] == pytest.approx(LEVEL, abs=1e-6)
    np.testing.assert_allclose(found.ground[np.isfinite(found.ground)], LEVEL, rtol=0, atol=1e-9)


def test_a_second_ridge_is_a_farther_hit(demo) -> None:
    """Two walls across a low line of sight: it goes into the first, comes out, and goes into the second."""
    dem = demo[1]
    rows, columns = (int(n) for n in np.asarray(dem.extent))
    posts = np.full((rows, columns), LEVEL)
    first, second = columns // 2, columns // 4
    posts[:, first - 3 : first + 4] = posts[:, second - 3 : second + 4] = 3000.0
    posts[:, first - 20 : first - 10] = np.nan
    middle = dem.grid.normal(jnp.array([rows / 2, columns - 20.0]))
    lat, lon = math.asin(float(middle[2])), math.atan2(float(middle[1]), float(middle[0]))
    camera = Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.asarray(2500.0))
    found = section_under(straight(camera, 270.0, 1.0), like(dem, posts))
    assert len(found.hits) == 2
    assert found.status == Status.hit
    assert found.void.any()
    assert np.isnan(found.ground[found.void]).all()
    heights = np.interp(found.hits[:, 0], found.distance, found.sight)
    np.testing.assert_allclose(found.hits[:, 1], heights, rtol=0, atol=1.0)


def a_section(**changes) -> Section:
    """A line that goes down through two ridges, made up."""
    distance = np.linspace(0.0, 4000.0, 401)
    ground = 100.0 + 300.0 * np.exp(-(((distance - 2000.0) / 150.0) ** 2))
    void = (distance > 500.0) & (distance < 800.0)
    hits = np.array([[1900.0, 330.0], [3100.0, 100.0]])
    given = {
        "distance": distance,
        "sight": 700.0 - 0.2 * distance,
        "ground": np.where(void, np.nan, ground),
        "flat": 698.0 - 0.2 * distance,
        "void": void,
        "hits": hits,
        "status": Status.hit,
    }
    return Section(**{**given, **changes})


def test_the_section_is_drawn_as_it_is(ax) -> None:
    section = a_section()
    assert draw_sight_line(ax, section) is ax
    before, behind = line(ax, "line of sight"), line(ax, "_behind the first hit")
    assert before[-1, 0] == pytest.approx(1.9)
    assert behind[0, 0] == pytest.approx(1.9)
    assert behind[-1, 0] == pytest.approx(4.0)
    np.testing.assert_allclose(before[:, 1], 700.0 - 200.0 * before[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(line(ax, "first hit"), [[1.9, 330.0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(line(ax, "1 crossing farther on"), [[3.1, 100.0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(line(ax, "_surface")[:, 1], section.ground, rtol=0, atol=1e-12)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("distance on the ellipsoid, km", "height above WGS 84, m")
    assert {"ground unknown", "over a flat Earth, 2 m lower"} <= set(words(ax))
    (void,) = [patch for patch in ax.patches if patch.get_hatch()]
    assert void.get_x() == pytest.approx(0.50)
    assert void.get_x() + void.get_width() == pytest.approx(0.80)
    assert covers_no_data(ax)


def test_a_line_without_a_fix_says_why(ax) -> None:
    draw_sight_line(ax, a_section(hits=np.zeros((0, 2)), status=Status.leaves_terrain))
    assert "no fix: leaves terrain" in words(ax)
    assert not any(one.get_label().startswith("first hit") for one in ax.lines)


def test_a_window_of_a_section(ax) -> None:
    draw_sight_line(ax, a_section(), window=(1500.0, 3500.0), legend=False)
    assert ax.get_xlim() == (1.5, 3.5)
    low, high = ax.get_ylim()
    assert low < 100.0
    assert 400.0 < high < 500.0
    assert ax.get_legend() is None
    with pytest.raises(ValueError, match=r"window must hold some of the section, 0 to 4000 m; got 5000.0 to 6000.0 m"):
        draw_sight_line(ax, a_section(), window=(5000.0, 6000.0))


def test_sections_that_cannot_be(demo) -> None:
    ray, dem = demo
    with pytest.raises(ValueError, match="reach must be a positive length in m; got 0"):
        section_under(ray, dem, reach=0.0)
    with pytest.raises(ValueError, match="nowhere above ground of this terrain"):
        section_under(straight(Geodetic.from_degrees(lat=0.0, lon=0.0, height=HIGH), 0.0, DOWN), dem)
    with pytest.raises(ValueError, match="plumb"):
        section_under(straight(Geodetic.from_degrees(lat=36.3, lon=-84.25, height=HIGH), 0.0, 90.0), dem)
    with pytest.raises(ValueError, match="ray must be finite"):
        section_under(replace_origin(ray, np.nan), dem)


def replace_origin(ray: Ray, value: float) -> Ray:
    return Ray(jnp.full(3, value), ray.direction)


# Linear against sampled.


@pytest.fixture(scope="module")
def level() -> Propagation:
    """Errors of a camera that looks straight down from 2 km at level ground."""
    sensor = Sensor(FrameCamera.from_pixels(focal_px=300.0, width=256, height=192), Gimbal.fixed(), Mount.nadir())
    shot = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=2000.0))
    errors = [sources.Position.from_ned(north=8.0, east=4.0, down=2.0)]
    return propagate(sensor, shot, np.array([127.5, 95.5]), ConstantHeight(0.0), errors)


def compared(level: Propagation, *, jumps: int = 0, failed: int = 0, keep: bool = True) -> Comparison:
    """The propagation against samples of its own covariance, of which some jump 800 m to the east, and some fail."""
    count = 3000
    errors = np.random.default_rng(2).multivariate_normal(np.zeros(3), np.asarray(level.cov_enu) + np.eye(3), count)
    errors[:jumps, 0] += 800.0
    errors[count - failed :] = np.nan
    found = errors[: count - failed]
    radii = {name: np.nan_to_num(np.hypot(errors[:, 0], errors[:, 1]), nan=np.inf) for name in ("CE", "LE", "SE")}
    mean, cov, kept = found.mean(axis=0), np.cov(found.T), errors if keep else None
    drawn = Sampled(level.fix, count, count - failed, {}, mean, cov, np.zeros(3), radii, 0, 0.95, kept)
    figures = (
        drawn.circular_error(0.5),
        drawn.circular_error(0.9),
        drawn.linear_error(0.9),
        drawn.spherical_error(0.9),
    )
    rows = (Row("linear, facet", (1.0, 2.0, 3.0, 4.0), ("valid", "not valid", "valid", "valid")),)
    beyond = np.arange(count) < jumps
    shares = (jumps / count, failed / count)
    return Comparison(level.fix, rows, figures, 2, *shares, drawn, {"linear, facet": level}, beyond)


def test_a_comparison_shows_both_by_ellipse_and_circle(ax, level) -> None:
    one = compared(level)
    assert draw_comparison(ax, one) is ax
    circle = np.hypot(*line(ax, "_circle, linear, facet").T)
    np.testing.assert_allclose(circle, float(level.circular_error(0.9)), rtol=0, atol=1e-9)
    circle = np.hypot(*line(ax, "_circle, sampled").T)
    np.testing.assert_allclose(circle, one.quantiles[1].value, rtol=0, atol=1e-9)
    ellipse = line(ax, "_ellipse, linear, facet")
    whitened = np.einsum("ni,ij,nj->n", ellipse, np.linalg.inv(np.asarray(level.cov_enu)[:2, :2]), ellipse)
    np.testing.assert_allclose(whitened, -2.0 * math.log(0.1), rtol=1e-9)  # of a normal distribution, 90 %
    assert np.ptp(ellipse[:, 0]) < np.ptp(ellipse[:, 1])
    assert len(line(ax, "_samples")) == 3000
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_aspect()) == ("east, m", "north, m", 1.0)
    assert f"linear, facet: CE90 {style.metres(float(level.circular_error(0.9)))}, not valid" in words(ax)
    assert ax.get_legend().get_title().get_text().replace("\n", " ").startswith(one.verdict)
    assert covers_no_data(ax)


def test_an_ellipse_of_samples_holds_its_share(ax, level) -> None:
    draw_comparison(ax, compared(level), methods=())
    inside = matplotlib.path.Path(line(ax, "_ellipse, sampled")).contains_points(line(ax, "_samples"))
    assert inside.mean() == pytest.approx(0.9, abs=0.02)


def test_samples_about_their_mean_lie_where_they_were(ax, level) -> None:
    """Where errors are counted from the mean, cloud, ellipse and circle have it as their middle."""
    one = compared(level)
    mean = np.array([20.0, -10.0, 0.0])
    drawn = eqx.tree_at(lambda x: (x.mean_enu, x.centre_enu), one.sampled, (mean, mean))
    draw_comparison(ax, eqx.tree_at(lambda x: x.sampled, one, drawn), methods=())
    for label in ("_samples", "_ellipse, sampled", "_circle, sampled"):
        middle = line(ax, label)[:-1].mean(axis=0)  # rings end where they began
        np.testing.assert_allclose(middle, mean[:2], rtol=0, atol=0.7, err_msg=label)


def test_samples_that_jump_are_marked_and_in_the_picture(ax, level) -> None:
    draw_comparison(ax, compared(level, jumps=60, failed=100))
    crosses = line(ax, "_jumped")
    assert len(crosses) == 60
    assert len(line(ax, "_samples")) == 2840
    assert "on other ground, 2 %" in words(ax)
    assert np.all(crosses[:, 0] > 700.0)
    assert ax.get_xlim()[1] < 700.0  # eight circles are the most: beyond, words must do
    assert "Outside the picture: 2.1 %." in ax.get_legend().get_title().get_text().replace("\n", " ")
    draw_comparison(ax, compared(level, jumps=60), reach=900.0)
    assert ax.get_xlim() == (-900.0, 900.0)


def test_comparisons_that_cannot_be_drawn(ax, level) -> None:
    cases: tuple[tuple[Comparison, dict[str, Any], str], ...] = (
        (compared(level, keep=False), {}, "were not kept"),
        (compared(level), {"reach": -3.0}, "reach must be a positive length in m; got -3.0"),
        (
            compared(level),
            {"methods": ["second order"]},
            r"of the linear ones \(linear, facet\); got \['second order'\]",
        ),
    )
    for one, given, message in cases:
        with pytest.raises(ValueError, match=message):
            draw_comparison(ax, one, **given)


# Budgets.


def a_budget() -> Budget:
    """A block and three errors, with 50 to 5 % of the horizontal, 60 to 0 % of the vertical variance."""
    parts = ((6.0, 0.2, "rad", 0.01), (3.0, 0.6, "m", 2.5), (1.0, 0.0, "m", 0.5))
    lines = tuple(
        SigmaShare(f"source: {k}", sigma, unit, Variance(across, up), 5.0 + k, 0.1)
        for k, (across, up, unit, sigma) in enumerate(parts)
    )
    source = SourceShare("source", Variance(10.0, 0.8), 0.0, False, lines)
    hidden = SigmaShare("block: a", 1.0, "m", None, 3.0, 0.1)
    block = SourceShare("block", Variance(10.0, 0.2), 4.0, True, (hidden,))
    return Budget((source, block), Variance(20.0, 1.0), 9.0, 0.9, Status.hit)


def test_bars_are_the_shares_of_both_variances(ax) -> None:
    assert draw_budget(ax, a_budget()) is ax
    across, up = ax.containers
    np.testing.assert_allclose([bar.get_width() for bar in across], [50.0, 30.0, 15.0, 5.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose([bar.get_width() for bar in up], [20.0, 20.0, 60.0, 0.0], rtol=0, atol=1e-12)
    names = [tick.get_text() for tick in ax.get_yticklabels()]
    assert names == ["block", "source: 0, 0.573°", "source: 1, 2.5 m", "source: 2, 0.5 m"]
    said = [text.get_text() for text in ax.texts]
    assert [one for one in said if one.endswith(" m")] == ["4 m", "5 m", "6 m", "7 m"]
    assert "CE90 without" in said
    assert ax.get_title("right") == "CE90 9 m, sigma of height 1 m"
    assert ax.get_xlabel() == "share of the variance, %"
    assert covers_no_data(ax)


def test_small_errors_share_a_bar(ax) -> None:
    draw_budget(ax, a_budget(), most=3)
    across, up = ax.containers
    np.testing.assert_allclose([bar.get_width() for bar in across], [50.0, 30.0, 20.0], rtol=0, atol=1e-12)
    assert sum(bar.get_width() for bar in up) == pytest.approx(100.0)
    assert ax.get_yticklabels()[2].get_text() == "2 others"


def test_budgets_that_cannot_be_drawn(ax) -> None:
    with pytest.raises(ValueError, match="most must be 2 bars or more; got 1"):
        draw_budget(ax, a_budget(), most=1)
    with pytest.raises(ValueError, match="horizontal variance of this budget is zero"):
        draw_budget(ax, Budget((), Variance(0.0, 0.0), 0.0, 0.9, Status.hit))


# Residuals.


@pytest.fixture(scope="module")
def adjusted() -> Adjustment:
    return adjust(simulated().noisy(8).block())


def judged(adjusted: Adjustment, wrong: tuple[int, ...] = ()) -> Reliability:
    """A judgement by hand: all of the same redundancy, some beyond the test, the last checked by nothing."""
    redundancy = np.full(adjusted.residuals.shape, 0.64)
    standardised = adjusted.residuals / SIGMA_UV / 0.8
    standardised = np.clip(standardised, -3.0, 3.0)
    standardised[list(wrong), 0] = 7.0
    standardised[-1] = np.nan
    return Reliability(redundancy, standardised, np.ones_like(redundancy), 0.001)


def quivers(axes) -> list:
    return [one for one in axes.collections if hasattr(one, "U")]


@pytest.mark.slow
def test_arrows_are_the_residuals_of_an_image(ax, adjusted) -> None:
    name = str(adjusted.block.images.name[3])
    assert draw_residuals(ax, adjusted, image=name, exaggeration=100.0) is ax
    (arrows,) = quivers(ax)
    rows = adjusted.block.observations.image == name
    np.testing.assert_allclose(
        np.asarray(arrows.get_offsets()), adjusted.block.observations.uv[rows], rtol=0, atol=1e-9
    )
    drawn = np.stack([arrows.U, arrows.V], axis=1) / arrows.scale
    np.testing.assert_allclose(drawn, 100.0 * adjusted.residuals[rows], rtol=0, atol=1e-9)
    assert (arrows.angles, arrows.scale_units) == ("xy", "xy")
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert bottom > top, "rows go down"
    (frame,) = ax.patches
    assert frame.get_bbox().bounds == (-0.5, -0.5, 4000.0, 3000.0)
    tips = adjusted.block.observations.uv[rows] + drawn
    assert np.all((tips > [low, top]) & (tips < [high, bottom])), "all tips are in the picture"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("column, px", "row, px")
    key = np.ptp(line(ax, "_key")[:, 0]) / 100.0
    assert f"a residual of {key:g} px (100 times)" in words(ax)
    assert covers_no_data(ax)


def test_residuals_beyond_the_test_are_marked(ax, adjusted) -> None:
    draw_residuals(ax, adjusted, checked=judged(adjusted, wrong=(4, 9)))
    within, beyond = quivers(ax)
    assert len(beyond.get_offsets()) == 2
    assert len(within.get_offsets()) == len(adjusted.residuals) - 2
    np.testing.assert_array_equal(np.asarray(beyond.get_offsets()), adjusted.block.observations.uv[[4, 9]])
    assert "2 beyond it" in words(ax)


def test_the_histogram_counts_what_is_checked(ax, adjusted) -> None:
    checked = judged(adjusted, wrong=(4, 9))
    assert draw_residual_histogram(ax, adjusted, checked=checked) is ax
    count = len(adjusted.residuals) - 1
    heights = [np.asarray(one.get_data().values).sum() for one in ax.patches]
    assert heights == [count - 2, count]
    curve = line(ax, "expected, spread 1")
    edges = np.asarray(ax.patches[0].get_data().edges)
    area = np.trapezoid(curve[:, 1], curve[:, 0]) / (edges[1] - edges[0])
    assert area == pytest.approx(count, rel=1e-3)
    said = ax.get_legend().get_title().get_text().replace("\n", " ")
    assert said.startswith("2 beyond ±3.29, by chance")
    assert "2 outside the picture; 2 of" in said
    assert f"{adjusted.sigma0:.3f}" in ax.get_title("left")
    assert "standard deviations" in ax.get_xlabel()
    assert "count" in ax.get_ylabel()
    assert covers_no_data(ax)


@pytest.mark.slow
def test_residuals_of_a_good_block_spread_as_expected(ax, adjusted) -> None:
    draw_residual_histogram(ax, adjusted)
    spreads = [float(one.rsplit(" ", 1)[1]) for one in words(ax)[:2]]
    np.testing.assert_allclose(spreads, 1.0, rtol=0, atol=0.1)
    checked = reliability(adjusted)
    np.testing.assert_allclose(spreads, np.sqrt(np.nanmean(checked.standardised**2, axis=0)), rtol=0, atol=0.005)


def test_residuals_that_cannot_be_drawn(ax, adjusted) -> None:
    with pytest.raises(ValueError, match="image 'i99' has no measurements in this block; others are i00"):
        draw_residuals(ax, adjusted, image="i99")
    with pytest.raises(ValueError, match="exaggeration must be a positive number; got -2"):
        draw_residuals(ax, adjusted, exaggeration=-2.0)
    blind = replace(judged(adjusted), standardised=np.full(adjusted.residuals.shape, np.nan))
    with pytest.raises(ValueError, match="no residual is checked by another measurement"):
        draw_residual_histogram(ax, adjusted, checked=blind)


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
    assert draw_convention(ax, panel) is ax
    np.testing.assert_allclose(tip(ax, label), [across, up], rtol=0, atol=1e-9)


@pytest.mark.parametrize("width", [style.COLUMN, style.PAGE])
def test_all_conventions_fit_into_one_figure(width) -> None:
    figure = conventions_figure(width)
    figure.canvas.draw()
    assert len(figure.axes) == len(PANELS)
    edge = figure.bbox
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert box is not None
        assert box.x0 > edge.x0 - 1.0
        assert box.x1 < edge.x1 + 1.0, axes.get_title("left")
        assert box.y1 < edge.y1 + 1.0


def test_no_such_convention(ax) -> None:
    with pytest.raises(ValueError, match="name must be one of heading, pitch"):
        draw_convention(ax, "yaw")
