"""Regions and probability maps in figures: what is drawn is the region, with its shares beside the pieces."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
import shapely
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch

from jaxgeo import plot
from jaxgeo.plot import style
from jaxgeo.plot.close_up import Posts, interpolated
from tests.support.clouds import cloud, two_hills
from tests.support.drawn import new_axes


@pytest.fixture(scope="module")
def sampled():
    return cloud(two_hills(3000, seed=1))


@pytest.fixture(scope="module")
def found(sampled):
    return sampled.probability_map()


@pytest.fixture
def ax():
    with mpl.rc_context(style.style(style.COLUMN)):
        yield new_axes()


def regions_of(ax: Axes) -> list[PathPatch]:
    return [one for one in ax.get_children() if isinstance(one, PathPatch) and one.get_label() == "_region"]


def drawn_area(patch: PathPatch) -> float:
    """Area of the rings of a patch; the shapes of these tests have no holes."""
    return sum(shapely.Polygon(ring).area for ring in patch.get_path().to_polygons(closed_only=True))


def test_regions_are_drawn_on_the_map_as_they_are(found, ax: Axes) -> None:
    several = [found.region(0.9), found.region(0.5)]
    assert plot.region_on_map(several, ax) is ax
    fills = regions_of(ax)[::2]
    assert [drawn_area(one) for one in fills] == pytest.approx([one.polygon.area for one in several], rel=1e-9)
    keys = {one.get_label() for one in ax.get_children() if not str(one.get_label()).startswith("_")}
    assert {"region of 90 %", "region of 50 %"} <= keys
    texts = [one.get_text() for one in ax.texts]
    assert texts == [f"{100.0 * mode.share.value:.0f} %" for mode in several[0].modes]
    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    assert shapely.box(west, south, east, north).covers(several[0].polygon)


def test_shares_can_be_left_out(found, ax: Axes) -> None:
    plot.region_on_map(found.region(0.9), ax, shares=False)
    assert not ax.texts


def test_probabilities_are_drawn_per_square_metre(found, ax: Axes) -> None:
    plot.probability_on_map(found, ax)
    (mesh,) = [one for one in ax.collections if one.get_array() is not None]
    values = np.ma.compressed(mesh.get_array())
    held = values.sum() * np.prod(found.cell_size)
    assert held == pytest.approx(0.999, abs=1e-3)
    bar = plot.colour_bar(ax, "probability per m²")
    assert bar.vmax == pytest.approx(found.probability.max() / np.prod(found.cell_size))


def test_a_cloud_shows_its_region_in_metres(sampled, found, ax: Axes) -> None:
    region = found.region(0.9)
    plot.error_cloud(sampled, ax, region=region)
    assert drawn_area(regions_of(ax)[0]) == pytest.approx(region.polygon_enu.area)
    legend = ax.get_legend()
    assert legend is not None
    assert any(text.get_text().startswith("90 % region, ") for text in legend.get_texts())


def test_other_objects_are_refused(sampled, found) -> None:
    with pytest.raises(ValueError, match="got none"):
        plot.region_on_map([])
    with pytest.raises(TypeError, match=r"Sampled\.region"):
        plot.region_on_map([found])
    with pytest.raises(TypeError, match=r"Sampled\.region"):
        plot.error_cloud(sampled, region=found)
    with pytest.raises(TypeError, match=r"Sampled\.probability_map"):
        plot.probability_on_map(sampled)
    with pytest.raises(ValueError, match=r"held must lie in \(0, 1\]; got 0"):
        plot.probability_on_map(found, held=0.0)


def test_a_close_up_interpolates_posts_and_keeps_voids(ax: Axes) -> None:
    row, col = np.indices((40, 50), float)
    height = 500.0 + 80.0 * np.sin(row / 5.0) * np.cos(col / 6.0)
    height[20, 20] = np.nan
    posts = Posts(10.0 + 1e-3 * col, 47.0 - 1e-3 * row, height)
    assert interpolated(posts, ax) is posts, "no limits are set"
    ax.set(xlim=(10.015, 10.030), ylim=(46.972, 46.985))
    fine = interpolated(posts, ax)
    finer = round(1e-3 / float(fine.lon[0, 1] - fine.lon[0, 0]))
    assert finer > 4
    at = {(round(lon, 6), round(lat, 6)): z for lon, lat, z in zip(*(leaf.ravel() for leaf in posts), strict=True)}
    shown = [leaf[::finer, ::finer].ravel() for leaf in fine]
    known = [(at[round(x, 6), round(y, 6)], z) for x, y, z in zip(*shown, strict=True)]
    np.testing.assert_allclose(*np.array(known).T, atol=1.0)  # the filled void bends splines near it
    assert np.count_nonzero(np.isnan(fine.height)) == (2 * finer - 1) ** 2
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    assert interpolated(posts, ax) is posts, "none of them is seen"
