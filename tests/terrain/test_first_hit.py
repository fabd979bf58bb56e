"""The first hit against a walk over every cell, and every status that a ray can end with."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import median_slope_deg
from support.scenes import SIZE, flat, hit, local_ray, rough, small_dem

from jaxgeo import WGS84, Bisection, Dem, FirstHit, Geodetic, Ray, Status, intersect
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.status import count_statuses
from jaxgeo.terrain import GeographicGrid, TangentGrid

pytestmark = pytest.mark.costly

WRONG_DISTANCE = 1e-3  # m
TIE = 1e-6  # m of height


@pytest.mark.slow
def test_every_ray_over_rough_mountains_meets_the_same_ground_as_an_exhaustive_walk(mountains):
    assert median_slope_deg(mountains.numpy.posts, mountains.numpy.spacing) == pytest.approx(20.0, abs=1.0)
    fix = jax.jit(jax.vmap(intersect, in_axes=(0, None)))(mountains.rays, mountains.dem)
    every = mountains.walked(mountains.rays.origin.shape[0])
    expected = np.array([walked.distance for walked in every])
    closest = np.array([walked.closest for walked in every])
    doubles = sum(walked.crossings == 2 for walked in every)
    away = np.abs(np.asarray(fix.slant_range) - expected)
    differs = ~(away <= WRONG_DISTANCE)
    ties = np.flatnonzero(differs & (closest <= TIE))
    print(f"largest distance {np.nanmax(away[~differs]):.1e} m; {doubles} double crossings; ties: {ties.tolist()}")
    assert doubles >= 200
    assert np.all(np.isfinite(expected))
    assert np.flatnonzero(differs & (closest > TIE)).tolist() == []
    assert ties.size < 1e-4 * expected.size + 1
    assert set(count_statuses(fix.status)) <= {Status.hit, Status.enters_from_side, Status.near_tangent}


@pytest.mark.slow
def test_bisection_finds_a_crossing_but_not_always_the_first(mountains):
    rays = jax.tree.map(lambda x: x[:200], mountains.rays)
    fix = jax.jit(jax.vmap(lambda ray, dem: intersect(ray, dem, search=Bisection()), in_axes=(0, None)))(
        rays, mountains.dem
    )
    distance = np.asarray(fix.slant_range)
    first = np.array([walked.distance for walked in mountains.walked(200)])
    beyond = distance - first
    assert np.all(beyond > -WRONG_DISTANCE)
    print(
        f"bisection lands beyond the first hit for {np.mean(beyond > 1.0):.1%} of the rays, up to {beyond.max():.0f} m"
    )
    assert 0.01 < np.mean(beyond > 1.0) < 0.5
    point = np.asarray(rays.origin) + distance[:, None] * np.asarray(rays.direction)
    rowcol, _ = mountains.numpy.over(point)
    assert np.abs(mountains.numpy.clearance(point, np.floor(rowcol).astype(int))).max() < 1e-6


EDGE = 30.0 * (SIZE - 1) / 2.0  # m from the centre to the last post


def peak() -> np.ndarray:
    posts = flat(100.0)
    posts[8, 8] = 400.0
    return posts


def with_void() -> np.ndarray:
    posts = peak()
    posts[8, 11] = np.nan
    return posts


CASES = {
    "straight down": (flat, (0, 0, 500), (0, -90), Status.hit),
    "straight down on a post": (peak, (0, 0, 500), (0, -90), Status.hit),
    "along a line of posts": (flat, (-200, 0, 200), (90, -45), Status.hit),
    "horizontal into the peak": (peak, (-200, 0.0, 250), (90, 0), Status.hit),
    "up from the valley to the peak": (peak, (-100, 0, 120), (90, 60), Status.hit),
    "up past the peak": (peak, (-100, 0, 120), (90, 80), Status.rises_away),
    "up from above": (flat, (0, 0, 500), (0, 45), Status.rises_away),
    "level above everything": (flat, (0, 0, 500), (0, 0), Status.rises_away),
    "out over the edge": (peak, (0, 100, 150), (0, -5), Status.leaves_terrain),
    "out over the edge, still high": (flat, (0, 200, 500), (0, -45), Status.leaves_terrain),
    "over a corner and out, high": (flat, (-EDGE - 100, 0, 2000), (90, -45), Status.leaves_terrain),
    "down beside the terrain": (flat, (1000, 0, 500), (0, -90), Status.ray_misses_terrain),
    "away from the terrain": (flat, (-1000, 0, 500), (270, -30), Status.ray_misses_terrain),
    "up, away from the terrain": (flat, (-1000, 0, 500), (270, 30), Status.rises_away),
    "in over the edge from below the ceiling": (peak, (-1000, 10, 150), (90, -2), Status.enters_from_side),
    "in over the edge from above the ceiling": (peak, (-1000, 10, 1100), (90, -40), Status.hit),
    "in over the edge underground": (peak, (-1000, 10, 99), (90, 1e-2), Status.enters_below_terrain),
    "from underground": (flat, (0, 0, 50), (0, -45), Status.camera_below_terrain),
    "from underground, up": (flat, (0, 0, 50), (0, 45), Status.camera_below_terrain),
    "straight down into the void": (with_void, (95, 0, 500), (0, -90), Status.hits_void),
    "over the void to the ground": (with_void, (60, 0, 580), (90, -70), Status.hit),
    "below the ceiling over the void": (with_void, (30, 0, 460), (90, -40), Status.hits_void),
    "from within the void": (with_void, (95, 0, 200), (0, -80), Status.hits_void),
    "from the far side of the Earth": (flat, (-1.2e7, 0, 500), (90, -40), Status.ray_misses_terrain),
}


@pytest.mark.parametrize("name", CASES)
def test_status(name):
    posts, (east, north, height), (azimuth, elevation), expected = CASES[name]
    fix = hit([local_ray(east, north, height, azimuth=azimuth, elevation=elevation)], small_dem(posts()))
    status = Status(int(fix.status[0]))
    assert status is expected, status.message
    has_point = expected in (Status.hit, Status.enters_from_side, Status.hits_void)
    assert np.all(np.isfinite(fix.ecef[0])) == has_point
    assert fix.found[0] == has_point
    assert fix.ok[0] == (expected is Status.hit)


@pytest.mark.parametrize("elevation", [80.0, 20.0, 12.0])
def test_a_camera_in_a_geostationary_orbit_sees_the_ground(elevation):
    """The origin lies far beyond where the grid's map means anything; the ground it sees does not."""
    down = local_ray(0.0, 0.0, 100.0, azimuth=130.0, elevation=elevation)
    ray = Ray(down.origin + 3.95e7 * down.direction, -down.direction)
    fix = hit([ray], small_dem(flat()))
    assert Status(int(fix.status[0])) is Status.hit
    assert fix.slant_range[0] == pytest.approx(3.95e7, abs=1e-6, rel=0)


def test_a_ray_along_the_surface_is_near_tangent():
    posts = flat(100.0) + 30.0 * np.arange(SIZE)[:, None] * np.tan(np.deg2rad(20.0))
    rays = [
        local_ray(0, 0, 100 + 8 * 30 * np.tan(np.deg2rad(20.0)) + 0.01, azimuth=0, elevation=-20 - d)
        for d in (0.02, 2.0)
    ]
    fix = hit(rays, small_dem(posts))
    assert [Status(int(code)) for code in fix.status] == [Status.near_tangent, Status.hit]
    assert np.all(np.isfinite(fix.ecef))


def test_the_void_is_entered_at_its_ceiling_and_passed_above_it():
    ray = local_ray(95, 0, 1000)
    low, high = (hit([ray], small_dem(with_void(), void_ceiling=ceiling)) for ceiling in (400.0, 700.0))
    assert low.position.height[0] == pytest.approx(400.0, abs=1e-6)
    assert high.position.height[0] == pytest.approx(700.0, abs=1e-6)
    passing = local_ray(60, 0, 580, azimuth=90, elevation=-70)
    assert Status(int(hit([passing], small_dem(with_void(), void_ceiling=700.0)).status[0])) is Status.hits_void


@pytest.mark.parametrize(
    "lat, lon", [(90.0, 0.0), (-90.0, 0.0), (0.0, 180.0), (60.0, -180.0), (0.0, 0.0), (89.9995, 77.0)]
)
def test_nothing_is_special_about_a_pole_or_the_date_line(lat, lon):
    """The same posts and rays in another place: only the Earth's curvature, 1e-2 m of range here, may differ."""
    where = [(120.0, 40.0, 400.0, 250.0, -35.0), (-100.0, -80.0, 300.0, 30.0, -60.0), (7.0, 5.0, 500.0, 0.0, -90.0)]
    fixes = []
    for place in ((lat, lon), (47.0, 11.0)):
        rays = [local_ray(e, n, h, azimuth=a, elevation=el, lat=place[0], lon=place[1]) for e, n, h, a, el in where]
        fixes.append(hit(rays, small_dem(rough(), lat=place[0], lon=place[1])))
    assert np.all(fixes[0].ok)
    np.testing.assert_allclose(fixes[0].slant_range, fixes[1].slant_range, rtol=0, atol=2e-2)
    np.testing.assert_allclose(fixes[0].slope, fixes[1].slope, rtol=0, atol=1e-3)


def test_a_batch_is_its_rays_one_by_one():
    dem = small_dem(rough(3))
    rays = [
        local_ray(e, -50.0, 400.0, azimuth=a, elevation=-40.0) for e, a in ((0, 0), (50, 90), (-90, 200), (1000, 90))
    ]
    together = hit(rays, dem)
    for k, ray in enumerate(rays):
        alone = hit([ray], dem)
        assert alone.status[0] == together.status[k]
        np.testing.assert_array_equal(alone.ecef[0], together.ecef[k])


SEARCHES = {"first hit": FirstHit(), "bisection": Bisection()}


@pytest.mark.parametrize("name", SEARCHES)
def test_the_point_found_lies_on_the_ray_and_on_the_surface(name):
    search = SEARCHES[name]
    dem = small_dem(rough(5))
    rays = [local_ray(-60.0, -80.0, 400.0, azimuth=a, elevation=-55.0) for a in range(0, 80, 10)]
    fix = hit(rays, dem, search)
    assert np.all(fix.ok)
    heights = jax.vmap(dem.height_at)(fix.position)
    np.testing.assert_allclose(heights, fix.position.height, rtol=0, atol=1e-8)
    for ray, ecef, distance in zip(rays, fix.ecef, fix.slant_range, strict=True):
        np.testing.assert_allclose(ray.origin + distance * ray.direction, ecef, rtol=0, atol=2e-9)


PADDED = [local_ray(0, 0, 300, azimuth=a, elevation=-50) for a in (0, 90, 180, 270)] + [local_ray(200, 0, 300)]


def padded(posts: np.ndarray, grid: TangentGrid, with_: float) -> Dem:
    """The same ground with rows and columns more, which do not count."""
    more = np.full((SIZE, SIZE), with_)
    more[: posts.shape[0], : posts.shape[1]] = posts
    return Dem.from_array(more, grid, extent=posts.shape)


@pytest.mark.slow
def test_padding_does_not_change_the_answer():
    posts = rough(7)[:12, :9]
    centre = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    grid = TangentGrid.centred(centre, spacing=(30.0, 30.0), shape=posts.shape)
    plain, larger = hit(PADDED, Dem.from_array(posts, grid)), hit(PADDED, padded(posts, grid, -500.0))
    np.testing.assert_array_equal(plain.status, larger.status)
    np.testing.assert_allclose(plain.slant_range, larger.slant_range, rtol=0, atol=1e-8)  # another program's rounding


@pytest.mark.parametrize("with_", [-500.0, 150.0, 1000.0, np.nan])
def test_what_lies_in_the_padding_is_no_ground(with_):
    """Within its extent it is the larger terrain, and beyond it there is nothing."""
    posts = rough(7)
    dem = small_dem(posts)
    plain, larger = hit(PADDED, dem), hit(PADDED, padded(posts[:15, :14], dem.grid, with_))
    assert np.all(plain.ok)
    assert [Status(int(code)) for code in larger.status] == [Status.hit] * 4 + [Status.ray_misses_terrain]
    np.testing.assert_allclose(plain.slant_range[:4], larger.slant_range[:4], rtol=0, atol=5e-9)


BISECTED = {
    "down": (flat, (0, 0, 500), (0, -60), Status.hit),
    "up, so that nothing brackets the ground": (peak, (-100, 0, 120), (90, 60), Status.not_converged),
    "above everything": (flat, (0, 0, 500), (0, 10), Status.rises_away),
    "beside the terrain": (flat, (0, 200, 500), (0, -45), Status.leaves_terrain),
    "into the void": (with_void, (95, 0, 500), (0, -90), Status.hits_void),
    "from underground": (flat, (0, 0, 50), (0, -45), Status.camera_below_terrain),
    "from the far side of the Earth": (flat, (-1.2e7, 0, 500), (90, -40), Status.ray_misses_terrain),
}


@pytest.mark.parametrize("name", BISECTED)
def test_status_of_bisection(name):
    posts, (east, north, height), (azimuth, elevation), expected = BISECTED[name]
    ray = local_ray(east, north, height, azimuth=azimuth, elevation=elevation)
    fix = hit([ray], small_dem(posts()), Bisection())
    assert Status(int(fix.status[0])) is expected
    assert np.all(np.isfinite(fix.ecef[0])) == (expected in (Status.hit, Status.hits_void))


def test_a_ray_out_of_a_void_into_its_wall_has_no_answer():
    """With a void ceiling below the neighbouring ground the surface has walls, of which nothing is known."""
    posts = flat(300.0)
    posts[:, 11] = np.nan
    posts[0, 0] = 0.0
    fix = hit([local_ray(95, 0, 330, azimuth=90, elevation=-60.0)], small_dem(posts, void_ceiling=100.0))
    assert Status(int(fix.status[0])) is Status.hits_void


def test_a_void_ceiling_below_all_ground_is_reached():
    posts = flat(100.0)
    posts[8, 11] = np.nan
    fix = hit([local_ray(95, 0, 500)], small_dem(posts, void_ceiling=50.0))
    assert Status(int(fix.status[0])) is Status.hits_void
    assert fix.position.height[0] == pytest.approx(50.0, abs=1e-6)
    dem = small_dem(posts)
    raised = hit([local_ray(95, 0, 500)], dem.with_posts(dem.posts + 50.0))
    assert raised.position.height[0] == pytest.approx(150.0, abs=1e-6)


@pytest.mark.parametrize("lon, lat", [(0.0, 0.0), (90.0, 10.0), (-150.0, -80.0), (20.0, 89.0)])
@pytest.mark.slow
def test_a_grid_of_the_whole_earth_is_met_everywhere(lon, lat):
    affine = (30.0, 0.0, -180.0, 0.0, -30.0, 90.0)
    posts = np.full((9, 13), 100.0)  # the last two rows do not count
    dem = Dem.from_array(posts, GeographicGrid.from_affine(affine, (7, 13)), extent=(7, 13))
    origin = WGS84.to_ecef(Geodetic.from_degrees(lat=lat, lon=lon, height=5000.0))
    up, _ = WGS84.normal_and_height(origin)
    fix = hit([Ray(origin, -up)], dem)
    assert fix.ok[0]
    assert fix.position.height[0] == pytest.approx(100.0, abs=1e-6)


@pytest.mark.slow
def test_a_track_that_bends_over_a_line_of_posts_and_back_is_settled_on_each_side():
    """Quarter-degree cells at 60 degrees north, a valley along a parallel: straight lines bulge over it by metres."""
    step, posts = 0.25, np.zeros((9, 13))  # of the shape above, so that nothing new is compiled
    posts[3] = posts[5] = 6000.0
    grid = GeographicGrid.from_affine((step, 0, -4 * step, 0, -step, 60 + 4 * step), (9, 9))
    dem = Dem.from_array(posts, grid, extent=(9, 9))
    rng = np.random.default_rng(4)
    centre = Geodetic.from_degrees(lat=60.0, lon=0.0, height=0.0)
    R, rays = np.asarray(R_ecef_from_enu(centre)), []
    for _ in range(8):
        north, height, dip = rng.uniform([-8.0, 2.0, -1.2e-3], [8.0, 8.0, -3e-4])
        origin = np.asarray(WGS84.to_ecef(centre)) + R @ np.array([-9000.0, north, height])
        line = R @ np.array([np.cos(dip), rng.normal(0.0, 5e-4), np.sin(dip)])
        rays.append(Ray(jnp.asarray(origin), jnp.asarray(line / np.linalg.norm(line))))
    fix = hit(rays, dem)

    @jax.jit
    def clearance(ray, distance):
        def one(s):
            rowcol, height = dem.over(ray.at(s))
            return height - dem.surface(rowcol, dem.cell_of(rowcol))

        return jax.vmap(one)(distance)

    assert np.sum(fix.found) >= 4
    for k in np.flatnonzero(fix.found):
        before = clearance(rays[k], jnp.linspace(0.0, fix.slant_range[k] - 1e-3, 20_001))
        assert float(jnp.min(before)) > -1e-6
        after = clearance(rays[k], fix.slant_range[k] + jnp.array([0.0, 1e-3]))
        assert abs(float(after[0])) < 1e-6


@pytest.mark.slow
def test_a_ray_that_turns_within_a_hair_of_a_line_of_posts_comes_to_its_end():
    """Near the pole, where a level ray turns back within a cell: a step to the line may lead to where it began."""
    posts = np.random.default_rng(0).normal(size=(200, 160)) * 60.0 + 200.0
    dem = Dem.from_array(posts, GeographicGrid.from_affine((1.0, 0.0, 10.0, 0.0, -0.001, 89.95), posts.shape))
    origin = jnp.array([-2700.4833732383886, 25920.601217773325, 6357138.646995209])
    direction = jnp.array([0.9934677367447737, 0.05165107022561921, -0.10175471975178986])
    bracket = jax.jit(lambda ray: dem.bracket(ray, FirstHit()))(Ray(origin, direction))
    height = dem.clearance(Ray(origin, direction).at(bracket.near), bracket.cell)
    assert bracket.status == Status.hit
    assert abs(float(height)) < 1e-5
