"""Maps: what is drawn lies where the records say."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import plot
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.plot.legends import COLOURED
from jaxgeo.plot.maps import normals_at, places_of, radii_of_curvature
from jaxgeo.status import Status
from jaxgeo.terrain import Dem, GeographicGrid
from jaxgeo.uncertainty import Method
from tests.support.drawn import (
    ERROR,
    PLACE,
    RING,
    SHAPE,
    UV,
    accuracies,
    compared,
    fixes,
    hill,
    labels,
    level,
    line,
    new_axes,
    north_up,
    outlined,
    overlaps,
    sampled,
    turned,
)


@pytest.fixture
def ax():
    return new_axes()


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


ACROSS_DATE_LINE = GeographicGrid.from_affine((0.001, 0.0002, 179.97, 0.0001, -0.001, 10.0), SHAPE)


@pytest.mark.parametrize("grid", [ACROSS_DATE_LINE, turned().grid], ids=["geographic", "tangent"])
def test_places_and_normals_are_those_of_the_grid(grid: Any) -> None:
    dem = Dem.from_array(hill(), grid)
    rowcol = np.random.default_rng(1).uniform(0.0, SHAPE, (50, 2))
    normals = normals_at(dem, rowcol)
    np.testing.assert_allclose(normals, jax.vmap(grid.normal)(rowcol), rtol=0, atol=1e-14)
    np.testing.assert_allclose(places_of(dem, normals), rowcol, rtol=0, atol=1e-7)


@pytest.mark.parametrize("latitude", [0.0, 0.6, -1.2, math.pi / 2])
def test_radii_of_curvature_are_those_of_the_ellipsoid(latitude: float) -> None:
    lat = jnp.asarray(latitude)
    expected = WGS84.meridian_radius(lat), WGS84.prime_vertical_radius(lat)
    np.testing.assert_allclose(radii_of_curvature(latitude), expected, rtol=1e-14)


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
    plot.fixes(fixes(), ax)
    np.testing.assert_allclose(line(ax, "fixes"), [[5.01, 44.01]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(line(ax, "fixes, with reserve"), [[5.02, 44.02]], rtol=0, atol=1e-12)
    plot.sight_lines(camera, fixes(), ax)
    (lines,) = ax.collections
    ends = [segment[1] for segment in lines.get_segments()]
    np.testing.assert_allclose(ends, [[5.01, 44.01], [5.02, 44.02]], rtol=0, atol=1e-12)


def test_a_camera_outside_the_map_is_shown_at_its_edge(ax) -> None:
    plot.map_axes(north_up(), ax)
    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    far = Geodetic.from_degrees(lat=44.02, lon=6.0, height=3000.0)
    plot.camera(far, 0.0, ax, label="far")
    lon, lat = line(ax, "far")[0]
    assert 0.9 * (east - west) < lon - west < east - west
    assert south < lat < north
    inside = Geodetic.from_degrees(lat=44.02, lon=5.01, height=3000.0)
    plot.camera(inside, 0.0, ax, label="inside")
    np.testing.assert_allclose(line(ax, "inside"), [[5.01, 44.02]], rtol=0, atol=1e-9)


def test_a_kilometre_is_as_long_north_as_east(ax) -> None:
    plot.map_axes(north_up(), ax)
    assert ax.get_aspect() == pytest.approx(1.0 / np.cos(np.deg2rad(44.02)), rel=1e-3)


def test_the_scale_bar_has_the_length_it_says(ax) -> None:
    plot.map_axes(north_up(), ax)
    plot.scale_bar(ax, 1000.0)
    (bar,) = ax.lines
    x0, x1 = np.asarray(bar.get_xdata(), float)
    assert (x1 - x0) * 111_320.0 * np.cos(np.deg2rad(44.0)) == pytest.approx(1000.0, rel=5e-3)
    assert [text.get_text() for text in ax.texts] == ["1 km"]


def test_labels_of_degrees_tell_ticks_apart(ax) -> None:
    plot.map_axes(north_up(), ax)
    ax.set(xlim=(-0.0004, 0.0004), ylim=(-44.0004, -44.0))
    ax.figure.draw_without_rendering()
    for axis, sides in ((ax.xaxis, "EW"), (ax.yaxis, "S")):
        said = [tick.get_text() for tick in axis.get_majorticklabels()]
        assert len(set(said)) == len(said)
        assert {one[-1] for one in said} == set(sides)


def test_hidden_ground_is_flagged_post_by_post(ax) -> None:
    plot.hidden_ground(north_up(), hill() > 700.0, ax)
    (posts,) = ax.collections
    np.testing.assert_array_equal(np.asarray(posts.get_array())[..., 3] > 0.0, hill() > 700.0)
    with pytest.raises(ValueError, match=r"hidden must flag each post, \(41, 61\); got the shape \(3,\)"):
        plot.hidden_ground(north_up(), np.zeros(3, bool), ax)


# Errors on a map.


def offsets(origin: Geodetic, lonlat: np.ndarray) -> np.ndarray:
    """(n, 2) m east and north, on the level plane of a point, of places (n, 2) in deg at its height."""
    lat, lon = jnp.radians(lonlat[:, 1]), jnp.radians(lonlat[:, 0])
    there = jax.vmap(WGS84.to_ecef)(Geodetic(lat=lat, lon=lon, height=jnp.full(lat.shape, origin.height)))
    return (np.asarray(there) - np.asarray(WGS84.to_ecef(origin))) @ np.asarray(R_ecef_from_enu(origin))[:, :2]


def rings(ax) -> list[np.ndarray]:
    return [path for one in ax.collections for path in one.get_segments() if len(path) > 2]


@pytest.mark.costly
def test_an_ellipse_on_the_map_has_its_true_size(ax) -> None:
    plot.ellipses_on_map(level(), ax, times=1.0)
    (ring,) = rings(ax)
    east_north = offsets(level().fix.position, ring)
    cov = np.asarray(level().cov_enu)[:2, :2]
    whitened = np.einsum("ni,ij,nj->n", east_north, np.linalg.inv(cov), east_north)
    np.testing.assert_allclose(whitened, -2.0 * math.log(0.1), rtol=1e-4)  # of a normal distribution, 90 %
    assert labels(ax) == ["error ellipses, 90 %"]


def test_ellipses_that_are_enlarged_say_so(ax) -> None:
    """20 m on a map of some 5 km: as large as is needed, by a round factor, and clouds by the same."""
    far = jax.tree.map(lambda leaf: leaf, level())
    ax.set(xlim=(10.8, 11.2), ylim=(46.9, 47.1))
    plot.ellipses_on_map([far, far], ax, probability=0.5)
    first, second = rings(ax)
    (said,) = labels(ax)
    times = float(said.split(", ")[2].removesuffix(" times as large"))
    assert said.startswith("error ellipses, 50 %")
    assert times in (20.0, 50.0, 100.0, 200.0)
    np.testing.assert_array_equal(first, second)
    size = np.sqrt(-2.0 * math.log(0.5) * np.linalg.eigvalsh(np.asarray(level().cov_enu)[:2, :2])[-1])
    reach = np.linalg.norm(offsets(level().fix.position, first), axis=1).max()
    assert reach == pytest.approx(times * size, rel=1e-3)


def test_a_cloud_on_the_map_lies_about_its_fix(ax) -> None:
    one = compared(jumps=60)
    plot.cloud_on_map(one, ax, times=2.0)
    assert labels(ax) == ["samples, 2 times as large", "on other ground"]
    there = offsets(one.sampled.fix.position, line(ax, "_jumped"))
    errors = np.asarray(one.sampled.errors_enu)[:60, :2]
    np.testing.assert_allclose(there, 2.0 * errors[::2], rtol=0, atol=2.0)  # every other one is drawn; the Earth bends
    assert len(line(ax, "_samples")) == 1470


@pytest.mark.parametrize(
    "draw, message",
    [
        (lambda ax: plot.ellipses_on_map(level(), ax, times=-2.0), "times must be a positive number; got -2"),
        (lambda ax: plot.ellipses_on_map(level(), ax, probability=1.0), "between 0 and 1; got 1.0"),
        (lambda ax: plot.ellipses_on_map([], ax), "one fix or more; got none"),
        (lambda ax: plot.cloud_on_map(sampled(keep=False), ax), "keep=True"),
        (lambda ax: plot.cloud_on_map([], ax), "one fix or more; got none"),
    ],
)
def test_errors_that_cannot_be_put_on_a_map(ax, draw, message) -> None:
    with pytest.raises(ValueError, match=message):
        draw(ax)


# Maps of accuracy.


def test_a_map_of_accuracy_has_its_values_in_its_places(ax) -> None:
    plot.accuracy_map(accuracies(), ax, limits=(1.0, 8.0))
    (cells,) = [one for one in ax.collections if one.get_gid() == COLOURED]
    values = np.ma.filled(cells.get_array(), np.nan).reshape(ERROR.shape)
    np.testing.assert_array_equal(values, np.where(np.isinf(ERROR), 1e9, ERROR))
    assert (cells.norm.vmin, cells.norm.vmax) == (1.0, 8.0)
    assert labels(ax) == ["hidden by terrain"]
    bar = plot.colour_bar(ax, "CE90, m")
    assert bar.ax.get_ylabel() == "CE90, m"


def test_a_map_of_methods_has_their_shares(ax) -> None:
    plot.method_map(accuracies(), ax)
    shares = {one.words: share for one, share in zip(Method, ("55 %", "18 %", "27 %"), strict=True)}
    assert labels(ax) == [*(f"{name}, {share}" for name, share in shares.items()), "hidden by terrain"]


def test_places_that_are_no_lattice_are_marks(ax) -> None:
    flat = jax.tree.map(
        lambda leaf: np.reshape(leaf, (12, *np.shape(leaf)[2:])) if np.ndim(leaf) > 1 else leaf, accuracies()
    )
    plot.accuracy_map(flat, ax, values=flat.linear)
    (marks,) = [one for one in ax.collections if one.get_gid() == COLOURED]
    assert len(marks.get_offsets()) == 11
    np.testing.assert_allclose(marks.get_offsets()[1], [5.01, 44.0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "given, message",
    [
        ({"values": UV}, r"values must have the shape of found, \(3, 4\); got \(3, 4, 2\)"),
        ({"values": np.full(ERROR.shape, np.nan)}, "nothing to draw"),
    ],
)
def test_a_map_of_accuracy_refuses_what_does_not_belong_together(ax, given: Any, message) -> None:
    with pytest.raises(ValueError, match=message):
        plot.accuracy_map(accuracies(), ax, **given)


# What images see.


def drawn(ax, dashes: str) -> np.ndarray:
    """All places on lines of one kind, (n, 2), without what parts them."""
    lines = [np.asarray(one.get_xydata()) for one in ax.lines if one.get_linestyle() == dashes]
    places = np.concatenate(lines)
    return places[np.isfinite(places).all(axis=1)]


def test_footprints_in_kilometres(ax) -> None:
    plot.footprints([outlined(), outlined()], ax, labels=["one", "other"], origin=PLACE)
    assert labels(ax) == ["one", "other"]
    np.testing.assert_allclose(drawn(ax, "-")[:6], 1e-3 * np.append(RING, RING[:1], axis=0), rtol=0, atol=0.01)
    assert drawn(ax, "--").size == drawn(ax, ":").size == 0
    assert ax.get_xlabel() == "east, km"
    assert ax.get_aspect() == 1.0


def test_what_footprints_hide_and_miss(ax) -> None:
    """A jump is dashed; from where the outline leaves the ground to where it comes back a dotted line goes."""
    plot.footprints(outlined(lost=(2,), hidden=(3,)), ax, dem=north_up())
    assert labels(ax)[1:] == ["nearer ground hides the way", "no ground is seen between"]
    lon, lat = plot.lonlat_deg(outlined().fix.position)
    places = np.stack([lon, lat], axis=-1)
    np.testing.assert_allclose(drawn(ax, "--"), places[[3, 4]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(drawn(ax, ":"), places[[1, 3]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(drawn(ax, "-"), places[[0, 1, 3, 4, 0]], rtol=0, atol=1e-12)
    assert len(ax.collections) == 1, "the relief"


def test_an_outline_is_a_footprint_too(ax) -> None:
    plot.footprints(outlined(lost=(2,)).fix.position, ax)
    places = np.stack(plot.lonlat_deg(outlined().fix.position), axis=-1)
    np.testing.assert_allclose(drawn(ax, "-"), places[[0, 1, 3, 4, 0]], rtol=0, atol=1e-12)
    assert labels(ax) == ["footprint 1", "no ground is seen between"]


def test_footprints_that_cannot_be_drawn(ax) -> None:
    for seen, names, words in (
        ([], None, "got 0 footprints"),
        ([outlined()], ["one", "two"], "labels must name"),
        ([outlined(lost=(0, 1, 2, 3, 4))], None, "crosses the horizon"),
    ):
        with pytest.raises(ValueError, match=words):
            plot.footprints(seen, ax, labels=names)


def test_overlap_along_and_its_gap(ax) -> None:
    plot.overlap_along(overlaps([[-0.05, 0.1, 0.2]]), ax, required=0.15)
    np.testing.assert_allclose(ax.lines[0].get_xydata(), [[0.0, -5.0], [1.0, 10.0], [2.0, 20.0]], rtol=0, atol=1e-9)
    assert set(labels(ax)) == {"overlap", "required, 15 %", "gap between the images"}
    assert ax.get_xlim() == (0.0, 2.0)


def test_overlap_of_many_pairs(ax) -> None:
    """Those that see no ground have no line; of none that do there is nothing to draw."""
    many = [[0.1, 0.1, 0.2], [np.nan] * 3, [0.15, 0.2, 0.3]]
    plot.overlap_along(overlaps(many), ax)
    assert len([one for one in ax.lines if len(np.asarray(one.get_xdata()))]) == 2
    assert labels(ax) == ["overlap"]
    with pytest.raises(ValueError, match="leaves the terrain's area"):
        plot.overlap_along(overlaps([[np.nan] * 3], Status.leaves_terrain), ax)
