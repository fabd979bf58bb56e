"""Pictures: what is drawn lies where the records say."""

from __future__ import annotations

import importlib
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxgeo import plot
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.status import Status
from jaxgeo.terrain import Dem, GeographicGrid, TangentGrid

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


def test_without_matplotlib_the_import_says_what_to_install(monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "jaxgeo.plot")
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgeo\[plot\]'"):
        importlib.import_module("jaxgeo.plot")
