"""Highest-density regions hold what they state, are as small as can be, and say where the truth may lie.

Held against: the exact regions of a normal distribution (an ellipse) and of two far apart; fresh draws.
"""

from __future__ import annotations

import itertools
import math
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import shapely
from scipy.special import chdtri

import jaxgeo
from jaxgeo import Pose, Shot
from jaxgeo.studies.scenes import CENTRE, fractal_posts
from jaxgeo.terrain import Dem, TangentGrid
from jaxgeo.uncertainty import ErrorModel, sample, sources
from jaxgeo.uncertainty._level_sets import level_set
from jaxgeo.uncertainty._region_words import area_words, length_words, percent
from jaxgeo.uncertainty.origin import Origin
from jaxgeo.uncertainty.regions import checked_probability
from tests.support.clouds import PLACE, SHARE, cloud, density_of_two_hills, normal, two_hills

COUNT = 20_000
COVS = {
    "round": [[100.0, 0.0], [0.0, 100.0]],
    "tight": [[0.04, 0.0], [0.0, 0.04]],
    "long": [[900.0, 0.0], [0.0, 25.0]],
    "oblique": [[5000.0, 4950.0], [4950.0, 5000.0]],
}
PROBABILITIES = (0.5, 0.9, 0.99)


def content(region, points: np.ndarray) -> float:
    """Share of points (n, 2) east and north of the fix that lie in a region."""
    return float(np.mean(shapely.contains_xy(region.polygon_enu, *points.T)))


@pytest.fixture(scope="module")
def hills():
    return cloud(two_hills(COUNT, seed=1), up=np.where(two_hills(COUNT, seed=1)[:, 0] > 500.0, 80.0, 0.0))


@pytest.fixture(scope="module")
def found(hills):
    return hills.probability_map()


# Laws of the region.


@pytest.mark.parametrize("name", COVS)
def test_region_of_a_normal_cloud_is_its_ellipse(name: str) -> None:
    cov = np.array(COVS[name])
    found = cloud(normal(COUNT, cov, seed=3)).probability_map()
    fresh = normal(100_000, cov, seed=4)
    for probability in PROBABILITIES:
        region = found.region(probability)
        exact = math.pi * chdtri(2, 1.0 - probability) * math.sqrt(np.linalg.det(cov))
        assert region.area == pytest.approx(exact, rel=0.04)
        assert content(region, fresh) == pytest.approx(probability, abs=0.012)
        assert len(region.modes) == 1
        assert region.modes[0].holds_fix
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    ring = np.linalg.cholesky(cov) @ np.stack([np.cos(turn), np.sin(turn)]) * math.sqrt(chdtri(2, 0.1))
    ellipse = shapely.Polygon(ring.T)
    assert found.region(0.9).polygon_enu.symmetric_difference(ellipse).area < 0.09 * ellipse.area


def test_content_is_unbiased_for_few_samples() -> None:
    held = [
        content(cloud(normal(1000, COVS["long"], seed)).region(0.9), normal(20_000, COVS["long"], 100 + seed))
        for seed in range(12)
    ]
    # A calibration by 1000 samples has a standard deviation of 0.95 %, the mean of twelve 0.27 %.
    assert np.mean(held) == pytest.approx(0.9, abs=0.01)
    assert np.std(held) < 0.02


def test_two_hills_are_two_pieces_with_their_shares(hills, found) -> None:
    region = found.region(0.9)
    near, far = region.modes
    draws = two_hills(200_000, seed=9)
    density = density_of_two_hills(draws)
    inside = density > np.quantile(density, 0.1)  # the exact region of 90 %
    shares = [np.mean(inside & (draws[:, 0] < 500.0)), np.mean(inside & (draws[:, 0] > 500.0))]
    for mode, share in zip((near, far), shares, strict=True):
        assert mode.share.low - 0.002 < share < mode.share.high + 0.002
        assert 0.005 < mode.share.high - mode.share.low < 0.02
    assert near.holds_fix
    assert not far.holds_fix
    assert far.distance == pytest.approx(math.hypot(1000.0, 600.0), abs=1.0)
    assert far.azimuth == pytest.approx(math.atan2(1000.0, 600.0), abs=1e-3)
    assert far.rise == pytest.approx(80.1, abs=0.2)  # the Earth's curvature adds 0.11 m
    assert region.words == (
        f"90 % in 2 areas of {area_words(region.area)} in all: {percent(near.share.value)} lie around the fix; "
        f"{percent(far.share.value)} lie 1.2 km to the north-east, 80 m higher. 10 % outside."
    )
    whole = found.region(0.999)
    assert [mode.share.value for mode in whole.modes] == pytest.approx([SHARE, 1.0 - SHARE], abs=0.012)
    circle = math.pi * hills.circular_error(0.9).value ** 2
    assert region.area < 0.002 * circle


def test_regions_are_nested(hills, found) -> None:
    regions = [found.region(probability) for probability in (0.3, *PROBABILITIES)]
    for small, large in itertools.pairwise(regions):
        assert small.polygon_enu.difference(large.polygon_enu).area < 1e-6 * small.area
        np.testing.assert_array_equal(small.cells, large.cells[: len(small.cells)])
    direct = hills.region(0.9)
    assert direct.polygon.equals(regions[2].polygon)


def test_a_turned_and_shifted_cloud_has_a_turned_and_shifted_region() -> None:
    points, angle, shift = two_hills(COUNT, seed=5), np.deg2rad(37.0), np.array([13.0, -8.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    one, other = (cloud(some[:5000]).region(0.9) for some in (points, points @ turn.T + shift))
    expected = shapely.transform(one.polygon_enu, lambda at: at @ turn.T + shift)
    assert other.area == pytest.approx(one.area, rel=0.01)
    assert other.polygon_enu.symmetric_difference(expected).area < 0.06 * one.area
    for mode, same in zip(one.modes, other.modes, strict=True):
        assert same.share.value == pytest.approx(mode.share.value, abs=0.003)


def test_map_sums_to_the_share_found_and_gives_its_regions_their_probability(found) -> None:
    assert found.probability.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.all(found.probability >= 0.0)
    for probability in PROBABILITIES:
        region = found.region(probability)
        assert region.cell_probability.sum() == pytest.approx(probability, abs=1e-3)
        lon, lat = found.lonlat_deg(region.cells)
        assert np.mean(shapely.contains_xy(region.polygon, lon, lat)) > 0.999
        cells = len(region.cells) * math.prod(found.cell_size)
        assert region.area == pytest.approx(cells, rel=0.02)


def test_density_of_a_map_is_the_density() -> None:
    found = cloud(normal(COUNT, COVS["round"], seed=3)).probability_map()
    lon, lat = found.lonlat_deg()
    density = found.density_at(lon, lat)
    np.testing.assert_allclose(density * math.prod(found.cell_size), found.probability, rtol=1e-6, atol=1e-9)
    place = jaxgeo.Geodetic.from_degrees(lat=PLACE[0], lon=PLACE[1], height=PLACE[2]).to_degrees()
    peak = 1.0 / (2.0 * np.pi * 100.0)
    assert found.density_at(float(place[1]), float(place[0])) == pytest.approx(peak, rel=0.15)
    assert found.density_at([0.0, np.nan], [0.0, 47.0]).tolist() == [0.0, 0.0]


def test_cells_are_those_of_the_dem_or_whole_parts_or_multiples_of_them() -> None:
    grid = TangentGrid.centred(CENTRE, spacing=(30.0, 20.0), shape=(40, 40))
    dem = Dem.from_array(np.zeros((40, 40)), grid)
    place = tuple(float(x) for x in CENTRE.to_degrees())
    for sigma in (1.0, 900.0):
        found = cloud(normal(COUNT, np.eye(2) * sigma**2, seed=2), place=place).probability_map(dem=dem)
        step = np.where(found.size < 1.0, 1.0 / found.size, found.size)
        np.testing.assert_allclose(step, np.round(step), rtol=1e-12)
        assert np.all(found.size < 1.0) if sigma < 2.0 else np.all(found.size > 1.0)
        corners = found.cells / found.size - 0.5
        np.testing.assert_allclose(corners, np.round(corners), atol=1e-6)
        assert found.region(0.9).area == pytest.approx(math.pi * chdtri(2, 0.1) * sigma**2, rel=0.04)
        np.testing.assert_allclose(found.post, [30.0, 20.0], rtol=1e-3)


def test_date_line_does_not_tear_a_region() -> None:
    region = cloud(normal(COUNT, COVS["round"], seed=3), place=(10.0, 179.99999, 0.0)).region(0.9)
    west, _, east, _ = region.polygon.bounds
    assert 179.999 < west < 180.0 < east < 180.001
    assert len(region.modes) == 1


def test_a_region_about_a_pole_is_refused() -> None:
    about = cloud(normal(2000, COVS["round"], seed=3), place=(89.99999, 0.0, 0.0))
    with pytest.raises(ValueError, match="surrounds a pole"):
        about.region(0.9)
    assert about.probability_map().probability.sum() == pytest.approx(1.0)


def test_samples_far_away_do_not_make_cells_coarse() -> None:
    points = normal(COUNT, COVS["tight"], seed=3)
    points[:40] += np.random.default_rng(2).uniform(-60_000.0, 60_000.0, (40, 2))
    region = cloud(points).region(0.9)
    assert region.area == pytest.approx(math.pi * chdtri(2, 0.1) * 0.04, rel=0.05)
    assert content(region, normal(100_000, COVS["tight"], seed=4)) == pytest.approx(0.9, abs=0.012)


@pytest.mark.parametrize("points", [np.zeros((200, 2)), np.linspace([0.0, 0.0], [90.0, 40.0], 500)])
def test_clouds_without_a_width_have_a_region(points: np.ndarray) -> None:
    region = cloud(points).region(0.9)
    assert 0.0 < region.area < 3000.0
    assert region.polygon.is_valid


# Samples without ground.


def test_samples_without_ground_are_outside() -> None:
    lost = cloud(normal(18_400, COVS["round"], seed=3), lost=1600)
    found = lost.probability_map()
    assert found.probability.sum() == pytest.approx(0.92, abs=1e-12)
    region = lost.region(0.9)
    fresh = normal(100_000, COVS["round"], seed=4)
    assert 0.92 * content(region, fresh) == pytest.approx(0.9, abs=0.01)
    assert region.without_ground.value == pytest.approx(0.08)
    assert region.inside.value + region.outside.value == pytest.approx(1.0)
    assert region.outside.value >= 0.08
    assert "8 % of all without ground" in region.words
    with pytest.raises(ValueError, match=r"no region holds the truth with 95 %: 8 % of the samples have no ground"):
        lost.region(0.95)


# Probability of an area.


def box_deg(half_m: float) -> shapely.Polygon:
    lat, lon = PLACE[:2]
    high, wide = half_m / 111_174.0, half_m / 76_110.0  # m per degree at 47 deg and 600 m, within 0.02 %
    return shapely.box(lon - wide, lat - high, lon + wide, lat + high)


def test_probability_of_an_area_counts_samples_with_the_binomial_interval() -> None:
    points = normal(5000, COVS["round"], seed=8)
    sampled = cloud(points, lost=500)
    share = sampled.probability_within(box_deg(10.0))
    inside = int(np.count_nonzero(np.abs(points).max(axis=1) < 10.0))
    assert share.value * 5500 == pytest.approx(inside, abs=3.0)  # the box is good to 2 mm
    exact = scipy.stats.binomtest(round(share.value * 5500), 5500).proportion_ci(0.95, "exact")
    assert (share.low, share.high) == pytest.approx((exact.low, exact.high), abs=1e-12)
    polygon = box_deg(10.0)
    feature = {"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(polygon)}
    for same in (feature, feature["geometry"], shapely.MultiPolygon([polygon])):
        assert sampled.probability_within(same) == share
    assert sampled.probability_within(box_deg(1e6 / 9.0)).value == pytest.approx(5000 / 5500)
    nothing = sampled.probability_within(shapely.box(12.0, 47.0, 12.1, 47.1))
    assert (nothing.value, nothing.low) == (0.0, 0.0)
    assert nothing.high == pytest.approx(1.0 - 0.025 ** (1.0 / 5500))


def test_areas_across_the_date_line_count_both_sides() -> None:
    sampled = cloud(normal(5000, COVS["round"], seed=8), place=(10.0, 180.0, 0.0))
    for west, east in ((179.9, 180.1), (-180.1, -179.9)):
        assert sampled.probability_within(shapely.box(west, 9.9, east, 10.1)).value == 1.0
    assert sampled.probability_within(shapely.box(179.9, 9.9, 180.0, 10.1)).value == pytest.approx(0.5, abs=0.03)


def test_scrambles_give_students_interval() -> None:
    points = normal(6400, COVS["round"], seed=8)
    share = cloud(points, scrambles=32).probability_within(box_deg(10.0))
    each = np.mean(np.abs(points).max(axis=1).reshape(-1, 32) < 10.0, axis=0)
    half = scipy.stats.t.ppf(0.975, 31) * each.std(ddof=1) / math.sqrt(32.0)
    assert share == pytest.approx((each.mean(), each.mean() - half, each.mean() + half), abs=1e-3)


# Words.


@pytest.mark.parametrize("heading, beside", [(59.0, "farther"), (239.0, "nearer"), (149.0, "left"), (329.0, "right")])
def test_pieces_are_told_as_the_camera_sees_them(heading: float, beside: str) -> None:
    fix = cloud(np.ones((2, 2))).fix
    back = np.deg2rad(heading + 180.0)
    offset = 5000.0 * np.array([np.sin(back), np.cos(back), 0.4])
    eye = jaxgeo.WGS84.to_geodetic(jnp.asarray(fix.ecef) + jaxgeo.earth.R_ecef_from_enu(fix.position) @ offset)
    region = cloud(two_hills(2000, seed=1), origin=Origin(shot=Shot(Pose(eye)))).region(0.99)
    assert region.modes[1].beside == beside


def test_numbers_in_words() -> None:
    assert [percent(x) for x in (0.9, 0.664, 0.0043, 0.9996, 1.0, 0.0)] == [
        "90 %",
        "66 %",
        "0.4 %",
        "99.96 %",
        "100 %",
        "0 %",
    ]
    assert [length_words(x) for x in (1234.0, 85.2, 999.0, 0.123)] == ["1.2 km", "85 m", "1 km", "0.12 m"]
    assert [area_words(x) for x in (5345.0, 12_345.0, 2.34e6)] == ["5300 m²", "1.2 ha", "2.3 km²"]


# What is refused.


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, 90.0, math.nan])
def test_probabilities_outside_0_to_1_are_refused(hills, probability) -> None:
    with pytest.raises(ValueError, match=r"probability must lie between 0 and 1, such as 0\.9"):
        hills.region(probability)


@pytest.mark.parametrize("probability", [None, "0.9", True, [0.5], np.array([0.5, 0.9])])
def test_what_is_no_probability_is_refused(probability) -> None:
    with pytest.raises(ValueError, match=r"probability must lie between 0 and 1"):
        checked_probability(probability)


def test_samples_that_were_not_kept_are_refused() -> None:
    unkept = cloud(normal(500, COVS["round"], seed=1), keep=False)
    for ask in (unkept.region, unkept.probability_map, lambda: unkept.probability_within(box_deg(1.0))):
        with pytest.raises(ValueError, match=r"were not kept: sample\(..., keep=True\)"):
            ask()


def test_too_few_samples_and_wrong_terrain_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"needs 100 samples with ground or more; got 60 of 100\..*ray_misses_terrain 40"
    ):
        cloud(normal(60, COVS["round"], seed=1), lost=40).region()
    with pytest.raises(TypeError, match="dem"):
        cloud(normal(500, COVS["round"], seed=1)).region(dem="dem.tif")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    "polygon, error, words",
    [
        ("POLYGON ((0 0, 1 1, 1 0))", TypeError, "shapely geometry or a GeoJSON mapping; got str"),
        ({"type": "Polygon"}, ValueError, "no GeoJSON geometry"),
        ({"type": "Feature", "geometry": None}, ValueError, "no GeoJSON geometry"),
        (shapely.Point(11.0, 47.0), ValueError, "got a Point"),
        (shapely.Polygon(), ValueError, "empty"),
        (shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), ValueError, "not valid: Self-intersection"),
        (shapely.box(46.9, 10.9, 47.1, 11.1), ValueError, r"seem to be \(latitude, longitude\)"),
        (shapely.box(600_000.0, 5_200_000.0, 600_100.0, 5_200_100.0), ValueError, "transform map coordinates"),
    ],
)
def test_polygons_that_cannot_be_used_are_refused(hills, polygon, error, words: str) -> None:
    with pytest.raises(error, match=words):
        hills.probability_within(polygon)


def test_region_and_map_travel_between_processes(found) -> None:
    region = found.region(0.9)
    again = pickle.loads(pickle.dumps(found)).region(0.9)
    for other in (again, pickle.loads(pickle.dumps(region))):
        assert other.polygon.equals(region.polygon)
        assert other.words == region.words


# Level sets.


def test_level_set_holds_the_values_above_it() -> None:
    values = np.random.default_rng(0).random((40, 50))
    shape = level_set(values, 0.6)
    assert shape.is_valid
    inside = shapely.contains_xy(shape, *np.indices(values.shape).reshape(2, -1))
    np.testing.assert_array_equal(inside, values.ravel() > 0.6)


def test_level_set_of_a_ring_has_a_hole() -> None:
    radius = np.hypot(*(np.indices((81, 81)) - 40.0))
    shape = level_set(-np.abs(radius - 25.0), -5.0)
    (part,) = shape.geoms
    assert len(part.interiors) == 1
    assert shape.area == pytest.approx(math.pi * (30.0**2 - 20.0**2), rel=0.003)


# Over terrain: the whole study is benchmarks/regions.py.

SENSOR = jaxgeo.Sensor(
    jaxgeo.FrameCamera.from_metric(focal_length=0.3, pixel_pitch=5.5e-6, width=4000, height=4000),
    jaxgeo.Gimbal.fixed(),
    jaxgeo.Mount.forward(),
)


@pytest.mark.slow
@pytest.mark.parametrize("slope_deg", [4.0, 12.0, 22.0])
def test_regions_over_terrain_hold_fresh_samples(slope_deg: float) -> None:
    posts = fractal_posts(256, spacing=30.0, rms_slope=np.deg2rad(slope_deg), seed=5) + 500.0
    dem = Dem.from_array(posts, TangentGrid.centred(CENTRE, spacing=(30.0, 30.0), shape=posts.shape))
    model = ErrorModel(
        (sources.Attitude(jnp.deg2rad(jnp.array([0.05, 0.03, 0.03]))), sources.TerrainHeight(jnp.array([4.0])))
    )
    rng = np.random.default_rng(6)
    held, ratios, shares = [], [], []
    for number in range(25):
        azimuth, down = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(8.0, 40.0))
        away = np.exp(rng.uniform(np.log(6e3), np.log(3e4)))
        back = -away * np.array([np.cos(down) * np.sin(azimuth), np.cos(down) * np.cos(azimuth), -np.sin(down)])
        eye = jaxgeo.WGS84.to_geodetic(
            jaxgeo.WGS84.to_ecef(CENTRE) + jaxgeo.earth.R_ecef_from_enu(CENTRE) @ (back + np.array([0.0, 0.0, 500.0]))
        )
        shot = Shot(Pose.looking_at(position=eye, point=CENTRE))
        if not bool(jaxgeo.locate(SENSOR, shot, (1999.5, 1999.5), dem).ok):
            continue
        how = {"key": jax.random.key(number), "figures": ("CE",), "keep": True}
        drawn = sample(SENSOR, shot, (1999.5, 1999.5), dem, model, count=COUNT, **how)
        if drawn.failed > 0.05:
            continue
        other = how | {"key": jax.random.key(1000 + number)}  # later points of one key would fill the gaps of the first
        fresh = sample(SENSOR, shot, (1999.5, 1999.5), dem, model, count=60_000, **other)
        region = drawn.region(0.9)
        held.append(fresh.probability_within(region.polygon).value)
        ratios.append(region.area / (math.pi * drawn.circular_error(0.9).value ** 2))
        shares += [(mode.share, fresh.probability_within(mode.polygon)) for mode in region.modes]
    assert len(held) >= 10
    assert 0.88 < min(held) <= max(held) < 0.92
    assert np.mean(held) == pytest.approx(0.9, abs=0.003)
    assert max(ratios) < 1.05
    assert np.mean([own.low <= there.high and there.low <= own.high for own, there in shares]) > 0.95
