"""Pictures: what is drawn lies where the records say."""

from __future__ import annotations

import importlib
import math
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxgeo import plot
from jaxgeo.coverage import Footprint, Overlap
from jaxgeo.earth import WGS84, Geodetic, TransverseMercator
from jaxgeo.fix import Fix
from jaxgeo.plot.cloud import ground_about
from jaxgeo.status import Status
from jaxgeo.terrain import Dem, GeographicGrid, TangentGrid
from jaxgeo.uncertainty import Budget, Comparison, Sampled, Trust
from jaxgeo.uncertainty.budget import SigmaShare, SourceShare, Variance

SHAPE = (41, 61)


def hill(shape: tuple[int, int] = SHAPE) -> np.ndarray:
    row, col = np.indices(shape)
    return 500.0 + 300.0 * np.exp(-((row - 20.0) ** 2 + (col - 30.0) ** 2) / 80.0)


def north_up() -> Dem:
    affine = (0.001, 0.0, 5.0, 0.0, -0.001, 44.04)
    return Dem.from_array(hill(), GeographicGrid.from_affine(affine, SHAPE))


def turned() -> Dem:
    centre = Geodetic.from_degrees(lat=44.02, lon=5.03, height=500.0)
    grid = TangentGrid.centred(centre, spacing=(90.0, 90.0), shape=SHAPE, heading=2.0)
    return Dem.from_array(hill(), grid)


@pytest.fixture
def ax():
    figure = Figure(figsize=(4, 4))
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def fixes() -> Fix:
    lat = np.deg2rad([44.01, 44.02, np.nan])
    lon = np.deg2rad([5.01, 5.02, np.nan])
    number = np.array([1.0, 1.0, np.nan])
    status = np.array([Status.hit, Status.enters_from_side, Status.rises_away], np.int8)
    position = Geodetic(lat=lat, lon=lon, height=number)
    return Fix(position, np.zeros((3, 3)), number, number, number, number, jnp.asarray(status))


def test_posts_lie_where_the_grid_says() -> None:
    lon, lat = plot.lonlat_deg(plot.post_positions(north_up()))
    np.testing.assert_allclose(lon[0], 5.0 + 0.001 * np.arange(SHAPE[1]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(lat[:, 0], 44.04 - 0.001 * np.arange(SHAPE[0]), rtol=0, atol=1e-12)
    thinned, _ = plot.lonlat_deg(plot.post_positions(north_up(), step=7))
    np.testing.assert_allclose(thinned, lon[::7, ::7], rtol=0, atol=1e-12)


def test_no_jump_at_the_date_line() -> None:
    dem = Dem.from_array(hill(), GeographicGrid.from_affine((0.001, 0.0, 179.97, 0.0, -0.001, 10.0), SHAPE))
    lon, _ = plot.lonlat_deg(plot.post_positions(dem))
    np.testing.assert_allclose(np.diff(lon, axis=1), 0.001, rtol=0, atol=1e-9)


@pytest.mark.parametrize("make", [north_up, turned])
def test_slopes_towards_the_light_are_brighter(make) -> None:
    dem = make()
    lon, lat = plot.lonlat_deg(plot.post_positions(dem))
    top = np.unravel_index(np.argmax(hill()), SHAPE)
    east = (lon - lon[top]) * np.cos(np.deg2rad(44.0))
    north = lat - lat[top]
    rgba = plot.shaded_relief(dem, light_azimuth_deg=90.0)
    near = np.hypot(east, north) < 0.008
    brightness = rgba[..., :3].sum(axis=-1)
    facing, away = near & (east > 0.004), near & (east < -0.004)
    assert brightness[facing].mean() > 1.3 * brightness[away].mean()
    assert np.all(rgba[..., 3] == 1.0)


def test_voids_stay_blank() -> None:
    posts = hill()
    posts[5:9, 5:9] = np.nan
    dem = Dem.from_array(posts, north_up().grid)
    rgba = plot.shaded_relief(dem)
    assert np.all(rgba[5:9, 5:9, 3] == 0.0)
    assert np.all(np.isfinite(rgba))


def test_fixes_and_lines_of_sight_keep_only_what_has_a_place(ax) -> None:
    camera = Geodetic.from_degrees(lat=44.0, lon=5.0, height=3000.0)
    points = plot.fixes(fixes(), ax)
    np.testing.assert_allclose(np.asarray(points.get_xydata()), [[5.01, 44.01]], rtol=0, atol=1e-12)
    plot.sight_lines(camera, fixes(), ax)
    (lines,) = ax.collections
    ends = [segment[1] for segment in lines.get_segments()]
    np.testing.assert_allclose(ends, [[5.01, 44.01], [5.02, 44.02]], rtol=0, atol=1e-12)


def test_a_camera_outside_the_map_is_shown_at_its_edge(ax) -> None:
    plot.map_axes(ax, north_up())
    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    far = Geodetic.from_degrees(lat=44.02, lon=6.0, height=3000.0)
    lon, lat = np.asarray(plot.camera(far, 0.0, ax).get_xydata())[0]
    assert 0.9 * (east - west) < lon - west < east - west
    assert south < lat < north
    inside = Geodetic.from_degrees(lat=44.02, lon=5.01, height=3000.0)
    np.testing.assert_allclose(np.asarray(plot.camera(inside, 0.0, ax).get_xydata()), [[5.01, 44.02]])


def test_a_kilometre_is_as_long_north_as_east(ax) -> None:
    plot.map_axes(ax, north_up())
    assert ax.get_aspect() == pytest.approx(1.0 / np.cos(np.deg2rad(44.02)), rel=1e-3)


def test_the_scale_bar_has_the_length_it_says(ax) -> None:
    plot.map_axes(ax, north_up())
    plot.scale_bar(ax, 1000.0)
    (bar,) = ax.lines
    x0, x1 = np.asarray(bar.get_xdata(), float)
    assert (x1 - x0) * 111_320.0 * np.cos(np.deg2rad(44.0)) == pytest.approx(1000.0, rel=5e-3)
    assert [text.get_text() for text in ax.texts] == ["1 km"]


def test_everything_together_draws(ax) -> None:
    dem = north_up()
    plot.map_axes(ax, dem)
    plot.hillshade(dem, ax)
    plot.hidden_ground(dem, hill() > 700.0, ax)
    plot.footprint(fixes().position, ax)
    plot.north_arrow(ax)
    plot.scale_bar(ax)
    ax.figure.canvas.draw()
    assert float(np.asarray(ax.figure.canvas.buffer_rgba())[..., :3].std()) > 10.0


def on_the_hill() -> Fix:
    """A fix at the post in row 20 and column 30."""
    position = Geodetic.from_degrees(lat=44.02, lon=5.03, height=800.0)
    number = jnp.asarray(1.0)
    return Fix(position, WGS84.to_ecef(position), number, number, number, number, jnp.asarray(0, jnp.int8))


def sampled(count: int = 2000, failed: int = 0, keep: bool = True) -> Sampled:
    """Errors of 20 m east and 10 m north, of which the last have no fix."""
    errors = np.random.default_rng(0).standard_normal((count, 3)) * [20.0, 10.0, 5.0]
    errors[count - failed :] = np.nan
    radii = {"CE": np.nan_to_num(np.hypot(errors[:, 0], errors[:, 1]), nan=np.inf)}
    kept = errors if keep else None
    zero = np.zeros(3)
    return Sampled(on_the_hill(), count, count - failed, {}, zero, np.eye(3), zero, radii, 0, 0.95, kept)


def labels(handles) -> list[str]:
    return [handle.get_label() for handle in handles]


def test_a_cloud_shows_the_samples_and_their_circles(ax) -> None:
    marked = np.arange(2000) < 500
    handles = plot.error_cloud(sampled(), ax, jumped=marked, reach=60.0)
    plain, jumped, *_ = ax.lines
    assert (len(plain.get_xdata()), len(jumped.get_xdata())) == (1500, 500)
    np.testing.assert_allclose(plain.get_xydata(), np.asarray(sampled().errors_enu)[500:, :2], rtol=0, atol=1e-12)
    radius = sampled().circular_error(0.9).value
    drawn = [np.hypot(*np.asarray(line.get_xydata()).T) for line in ax.lines[2:4]]
    np.testing.assert_allclose(drawn[1], radius, rtol=0, atol=1e-9)
    assert drawn[0].max() < radius
    assert labels(handles)[:2] == ["samples", "samples that jumped"]
    assert f"CE90 {radius:.3g} m" in labels(handles)[2]
    assert ax.get_xlabel() == "east, m"
    assert ax.get_xlim() == (-60.0, 60.0)


def test_a_cloud_of_a_comparison_marks_its_jumps(ax) -> None:
    beyond = np.arange(2000) < 100
    compared = Comparison(on_the_hill(), (), (), 2, 0.05, 0.0, sampled(), {}, beyond)
    handles = plot.error_cloud(compared, ax)
    assert [len(line.get_xdata()) for line in ax.lines[:2]] == [1900, 100]
    assert labels(handles)[1] == "samples that jumped"


def test_a_cloud_says_what_it_does_not_show(ax) -> None:
    handles = plot.error_cloud(sampled(failed=400), ax, reach=20.0)
    (remark,) = [text.get_text() for text in ax.texts]
    assert "20 % without a fix" in remark
    assert "outside the picture" in remark
    assert "CE90 without end" in labels(handles)[1]


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


@pytest.mark.parametrize(
    "change, message",
    [
        ({"errors": sampled(keep=False)}, "keep=True"),
        ({"errors": sampled(10, failed=10)}, "none of the samples has a fix"),
        ({"jumped": np.zeros(7, bool)}, "each of the 2000 samples"),
        ({"reach": -1.0}, "reach must be a positive length in m"),
        ({"probabilities": (0.5, 1.0)}, "between 0 and 1"),
    ],
)
def test_a_cloud_refuses_what_it_cannot_draw(ax, change, message) -> None:
    given = {"errors": sampled(), **change}
    errors = given.pop("errors")
    with pytest.raises(ValueError, match=message):
        plot.error_cloud(errors, ax, **given)


def a_budget(shares=(6.0, 3.0, 1.0)) -> Budget:
    lines = tuple(
        SigmaShare(f"source: {k}", 1.0, "m", Variance(share, 0.0), 5.0 + k, 0.1) for k, share in enumerate(shares)
    )
    source = SourceShare("source", Variance(sum(shares), 0.0), 0.0, False, lines)
    block = SourceShare("block", Variance(10.0, 1.0), 4.0, True, ())
    return Budget((source, block), Variance(10.0 + sum(shares), 1.0), 9.0, 0.9, Status.hit)


def test_bars_of_a_budget_are_its_shares(ax) -> None:
    bars = plot.budget_bars(a_budget(), ax)
    np.testing.assert_allclose([bar.get_width() for bar in bars], [50.0, 30.0, 15.0, 5.0], rtol=0, atol=1e-12)
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["block", "source: 0", "source: 1", "source: 2"]
    said = [text.get_text() for text in ax.texts]
    assert {"4.00", "5.00", "6.00", "7.00", "CE90 without, m"} <= set(said)


def test_small_bars_are_drawn_as_one(ax) -> None:
    bars = plot.budget_bars(a_budget(), ax, most=2)
    np.testing.assert_allclose([bar.get_width() for bar in bars], [50.0, 50.0], rtol=0, atol=1e-12)
    assert ax.get_yticklabels()[1].get_text() == "3 others"


def test_bars_refuse_what_has_no_shares(ax) -> None:
    with pytest.raises(ValueError, match="most must be 2 bars or more; got 1"):
        plot.budget_bars(a_budget(), ax, most=1)
    nothing = Budget((), Variance(0.0, 0.0), 0.0, 0.9, Status.hit)
    with pytest.raises(ValueError, match="horizontal variance of this budget is zero"):
        plot.budget_bars(nothing, ax)


UV = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
ERROR = np.array([[1.0, 2.0, 4.0, 8.0], [1.0, 2.0, np.nan, 8.0], [1.0, 2.0, 4.0, np.inf]])
TRUST = np.array([[0, 0, 1, 2], [0, 0, 1, 2], [0, 0, 1, 2]])


def test_a_map_of_accuracy_marks_each_method(ax) -> None:
    colours, handles = plot.accuracy_map(ERROR, TRUST, UV, ax, limits=(1.0, 8.0))
    cells, *marks = ax.collections
    alpha = np.asarray(cells.get_array())[..., 3]
    np.testing.assert_array_equal(alpha == 0.0, np.isnan(ERROR))
    footprint, samples = (np.asarray(one.get_offsets()) for one in marks)
    np.testing.assert_array_equal(footprint, [[2.0, 0.0], [2.0, 2.0]])
    np.testing.assert_array_equal(samples, [[3.0, 0.0], [3.0, 1.0], [3.0, 2.0]])  # the infinite one too
    assert (colours.norm.vmin, colours.norm.vmax) == (1.0, 8.0)
    assert [label.rsplit(",", 1)[0] for label in labels(handles)[1:]] == [one.words for one in list(Trust)[1:]]


def test_a_map_of_accuracy_on_the_ground_is_in_degrees(ax) -> None:
    lon, lat = np.deg2rad(5.0 + 0.01 * UV[..., 0]), np.deg2rad(44.0 + 0.01 * UV[..., 1])
    _, handles = plot.accuracy_map(ERROR, TRUST, Geodetic(lat=lat, lon=lon, height=np.zeros_like(lat)), ax)
    places = [np.asarray(marks.get_offsets()) for marks in ax.collections]
    assert [len(place) for place in places] == [6, 2, 3]
    np.testing.assert_allclose(places[1], [[5.02, 44.0], [5.02, 44.02]], rtol=0, atol=1e-9)
    assert [label.rsplit(",", 1)[0] for label in labels(handles)] == [one.words for one in Trust]


@pytest.mark.parametrize(
    "error, trust, where, message",
    [
        (ERROR, TRUST[:2], UV, "trust must have the shape of error"),
        (ERROR, TRUST, UV[:2], "where must have the shape of error"),
        (ERROR, TRUST + 1, UV, "must hold codes of Trust"),
        (np.full_like(ERROR, np.nan), TRUST, UV, "nothing to draw"),
    ],
)
def test_a_map_of_accuracy_refuses_what_does_not_belong_together(ax, error, trust, where, message) -> None:
    with pytest.raises(ValueError, match=message):
        plot.accuracy_map(error, trust, where, ax)


def test_without_matplotlib_the_import_says_what_to_install(monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "jaxgeo.plot")
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgeo\[plot\]'"):
        importlib.import_module("jaxgeo.plot")


PLACE = Geodetic.from_degrees(lat=44.02, lon=5.03, height=500.0)
RING = np.array([[0.0, 0.0], [900.0, 0.0], [1800.0, 0.0], [1800.0, 900.0], [0.0, 900.0]])  # m east and north


def outlined(*, lost: tuple[int, ...] = (), hidden: tuple[int, ...] = ()) -> Footprint:
    """The footprint of a ring of places, of which some see nothing, and some lie before a jump."""
    count = len(RING)
    metres = math.radians(1.0) * 6.37e6
    lat = np.deg2rad(44.02 + RING[:, 1] / metres)
    lon = np.deg2rad(5.03 + RING[:, 0] / metres / math.cos(math.radians(44.02)))
    status = np.full(count, Status.hit, np.int8)
    status[list(lost)] = Status.rises_away
    lat, lon = (np.where(status == Status.hit, x, np.nan) for x in (lat, lon))
    number = np.ones(count)
    position = Geodetic(lat=lat, lon=lon, height=np.full(count, 500.0))
    fix = Fix(position, np.zeros((count, 3)), number, number, number, number, jnp.asarray(status))
    jumps = np.isin(np.arange(count), hidden)
    whole = np.asarray(Status.crosses_horizon if lost else Status.hit, np.int8)
    outline = np.where((status == Status.hit)[:, None], RING, np.nan)
    return Footprint(RING, fix, jumps, outline, whole, TransverseMercator.gauss_krueger(PLACE.lon))


def drawn(ax, dashes: str) -> np.ndarray:
    """All places on lines of one kind, (n, 2), without what parts them."""
    lines = [np.asarray(line.get_xydata()) for line in ax.lines if line.get_linestyle() == dashes]
    places = np.concatenate(lines)
    return places[np.isfinite(places).all(axis=1)]


def test_footprints_in_kilometres(ax) -> None:
    handles = plot.footprints([outlined(), outlined()], ax, labels=["one", "other"], origin=PLACE)
    assert [handle.get_label() for handle in handles] == ["one", "other"]
    np.testing.assert_allclose(drawn(ax, "-")[:6], 1e-3 * np.append(RING, RING[:1], axis=0), rtol=0, atol=0.01)
    assert drawn(ax, "--").size == drawn(ax, ":").size == 0
    assert ax.get_xlabel() == "east, km"
    assert ax.get_aspect() == 1.0


def test_what_footprints_hide_and_miss(ax) -> None:
    """A jump is dashed; from where the outline leaves the ground to where it comes back a dotted line goes."""
    handles = plot.footprints([outlined(lost=(2,), hidden=(3,))], ax, dem=north_up())
    assert [handle.get_label() for handle in handles[1:]] == [
        "nearer ground hides the way",
        "no ground is seen between",
    ]
    lon, lat = plot.lonlat_deg(outlined().fix.position)
    places = np.stack([lon, lat], axis=-1)
    np.testing.assert_allclose(drawn(ax, "--"), places[[3, 4]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(drawn(ax, ":"), places[[1, 3]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(drawn(ax, "-"), places[[0, 1, 3, 4, 0]], rtol=0, atol=1e-12)
    assert len(ax.collections) == 1, "the relief"


def test_footprints_that_cannot_be_drawn(ax) -> None:
    for seen, labels, words in (
        ([], None, "got 0 footprints"),
        ([outlined()], ["one", "two"], "labels must name"),
        ([outlined(lost=(0, 1, 2, 3, 4))], None, "crosses the horizon"),
    ):
        with pytest.raises(ValueError, match=words):
            plot.footprints(seen, ax, labels=labels)


def overlaps(along: list[list[float]], status: Status = Status.hit) -> Overlap:
    values = jnp.array(along)
    count, stations = values.shape
    across = jnp.broadcast_to(jnp.linspace(1000.0, 3000.0, stations), values.shape)
    number, codes = np.zeros(count), np.full(count, status, np.int8)
    least, sideways = values.min(axis=1), np.zeros((count, 2))
    return Overlap(values[:, 0], values[:, -1], least, values, across, number, sideways, number, number, codes)


def test_overlap_along_and_its_gap(ax) -> None:
    handles = plot.overlap_along(overlaps([[-0.05, 0.1, 0.2]]), ax, wished=0.15)
    np.testing.assert_allclose(ax.lines[0].get_xydata(), [[0.0, -5.0], [1.0, 10.0], [2.0, 20.0]], rtol=0, atol=1e-9)
    assert [handle.get_label() for handle in handles] == ["overlap", "wished 15%", "gap between the images"]
    assert ax.get_xlim() == (0.0, 2.0)


def test_overlap_of_many_pairs(ax) -> None:
    """Those that see no ground have no line; of none that do there is nothing to draw."""
    many = [[0.1, 0.1, 0.2], [np.nan] * 3, [0.15, 0.2, 0.3]]
    handles = plot.overlap_along(overlaps(many), ax)
    assert len(ax.lines) == 2
    assert len(handles) == 1
    with pytest.raises(ValueError, match="leaves over the terrain's edge"):
        plot.overlap_along(overlaps([[np.nan] * 3], Status.leaves_terrain), ax)
