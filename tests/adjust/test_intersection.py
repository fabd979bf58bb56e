"""Forward intersection: exact data give the point, its covariance is what draws have, and weak geometry says so."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Atmosphere, BrownConrady, ConstantHeight, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot, Status
from jaxgeo.adjust.intersection import forward_intersection
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.observation import Exposure
from jaxgeo.sensor import boresight_from_degrees
from jaxgeo.uncertainty import ErrorModel, PerFlight, circular_error, joint_covariance, linear_error, propagate, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import PerMeasurement

RAYS, DRAWS = 6, 2500
ALL = np.ones(RAYS, bool)
TWO = np.array([True, False, True, False, False, False])


def sensor(*, plain: bool = False) -> Sensor:
    """Looking along the body, with a lens, a boresight and lever arms; or the same kind without."""
    lens = BrownConrady() if plain else BrownConrady(k1=-0.05, k2=-0.01, p1=1e-4, p2=-2e-4)
    turn = (0.0, 0.0, 0.0) if plain else (0.4, -0.3, 0.2)
    mount = Mount.forward(
        R_body_from_base=boresight_from_degrees(heading=turn[0], pitch=turn[1], roll=turn[2]),
        lever_body=np.zeros(3) if plain else np.array([0.8, -0.2, 0.4]),
        lever_head=np.zeros(3) if plain else np.array([0.05, 0.0, 0.1]),
    )
    camera = FrameCamera.from_pixels(focal_px=10_000.0, width=8001, height=6001, distortion=lens)
    return jax.tree.map(lambda x: jnp.asarray(x, float), Sensor(camera, mount=mount))  # alike for the compiler


SENSOR, PLAIN = sensor(), sensor(plain=True)
AIR = Atmosphere()
OBLIQUE = np.array([(3000, 0, 3000), (-2500, 1000, 3200), (0, 4000, 2800), (0, -3500, 3000), (2000, 2500, 3100), (500, -3000, 2500)])  # fmt: skip  # noqa: E501
NADIR = np.array([(x, y, 1500.0) for x in (-300.0, 0.0, 300.0) for y in (-200.0, 200.0)])
SITES = {
    "nadir": ((47.0, 11.0, 500.0), NADIR),
    "oblique": ((45.0, 7.0, 300.0), OBLIQUE),
    "high": ((30.0, -100.0, 1200.0), np.array([(-50e3 + 20e3 * k, 58e3 - 2e3 * k, 15e3) for k in range(RAYS)])),
    "pole": ((89.99999, 100.0, 50.0), OBLIQUE),
    "date line": ((-17.0, 179.99999, 0.0), OBLIQUE),
}


def target_at(site: str) -> jaxgeo.Geodetic:
    lat, lon, height = SITES[site][0]
    return jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=height)


def stacked(items: list):
    return jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y, float) for y in x]), *items)


@jax.jit
def shots_about(point: jaxgeo.Geodetic, offsets_enu) -> Shot:
    """Shots that look at a point from offsets in m east, north, up of it."""

    def shot(offset) -> Shot:
        position = WGS84.to_geodetic(WGS84.to_ecef(point) + R_ecef_from_enu(point) @ offset)
        return Shot(Pose.looking_at(position=position, point=point))

    return jax.tree.map(lambda x: x.astype(float), jax.vmap(shot)(offsets_enu))  # no weak types


@jax.jit
def images_of(sensor: Sensor, shots: Shot, point: jaxgeo.Geodetic):
    return jax.vmap(lambda shot: jaxgeo.project(sensor, shot, point).uv)(shots)


@jax.jit
def images_through_air(shots: Shot, point: jaxgeo.Geodetic):
    return jax.vmap(lambda shot: jaxgeo.project(SENSOR, shot, point, atmosphere=AIR).uv)(shots)


@jax.jit
def by_pixels(sensor: Sensor, shots: Shot, uvs, use, sigma=0.5):
    """Many points, each in six images at most."""
    one = lambda shots, uvs, use: forward_intersection(sensor, shots, uvs, sigma=sigma, use=use)  # noqa: E731
    return jax.vmap(one)(shots, uvs, use)


def point_by_pixels(sensor: Sensor, shots: Shot, uvs, use=ALL, sigma=0.5):
    """One point, by the program for as many as there are sites."""
    given = (shots, uvs, jnp.asarray(use))
    many = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * len(SITES)), given)
    return jax.tree.map(lambda x: x[0], by_pixels(sensor, *many, sigma))


POINT = target_at("oblique")
P_ECEF = np.asarray(WGS84.to_ecef(POINT))
SHOTS = shots_about(POINT, OBLIQUE)
UVS = images_of(SENSOR, SHOTS, POINT)
NOISE = np.random.default_rng(1).normal(0.0, 0.5, (RAYS, 2))
MODEL = ErrorModel(
    (
        sources.Attitude.from_degrees(heading=0.03, pitch=0.02, roll=0.02),
        sources.Position.from_ned(north=1.0, east=1.0, down=1.5),
        sources.Boresight.from_degrees(heading=0.04, pitch=0.03, roll=0.02),
        sources.InteriorOrientation.from_pixels(focal=4.0, principal_column=2.0, principal_row=1.0),
        sources.PixelMeasurement.from_pixels(column=0.7, row=0.5),
    )
)


def several(*, attitude: float = 1.0) -> tuple:
    """Attitudes, pixels and a terrain that is of no effect: one compiled program for all their sizes."""
    return (
        sources.Attitude.from_degrees(heading=0.03 * attitude, pitch=0.02 * attitude, roll=0.02 * attitude),
        sources.PixelMeasurement.from_pixels(column=0.5, row=0.5),
        sources.TerrainHeight.from_metres(9.0),
    )


@jax.jit
def shots_and_images(points: jaxgeo.Geodetic, offsets_enu):
    """Shots about many points, their pixels and perspective centres, and the points in ECEF."""
    shots = jax.vmap(shots_about)(points, offsets_enu)
    uvs = jax.vmap(lambda shots, point: images_of(SENSOR, shots, point))(shots, points)
    return shots, uvs, jax.vmap(jax.vmap(SENSOR.perspective_centre))(shots), jax.vmap(WGS84.to_ecef)(points)


@pytest.fixture(scope="module")
def all_sites():
    points = stacked([target_at(site) for site in SITES])
    return points, shots_and_images(points, jnp.asarray([offsets for _, offsets in SITES.values()]))


def test_exact_data_give_the_point(all_sites) -> None:
    points, (shots, uvs, centres, p_ecef) = all_sites
    found = by_pixels(SENSOR, shots, uvs, jnp.ones((len(SITES), RAYS), bool), 0.5)
    assert np.all(found.ok)
    np.testing.assert_allclose(np.linalg.norm(found.p_ecef - p_ecef, axis=-1), 0.0, atol=1e-6)  # m
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-6)  # px
    np.testing.assert_allclose(found.position.height, points.height, atol=1e-6)  # m
    assert found.rays.tolist() == [RAYS] * len(SITES)
    assert found.degrees_of_freedom.tolist() == [2 * RAYS - 3] * len(SITES)
    ranges = np.linalg.norm(centres - found.p_ecef[:, None], axis=-1)
    np.testing.assert_allclose(found.slant_ranges, ranges, atol=1e-6)
    away = (np.asarray(centres) - np.asarray(found.p_ecef)[:, None]) / ranges[..., None]
    cosines = np.einsum("sia,sja->sij", away, away)
    np.testing.assert_allclose(found.angle, np.arccos(cosines.min(axis=(1, 2))), atol=1e-7)


@pytest.mark.slow
def test_exact_data_through_the_air(all_sites) -> None:
    """The bent lines of sight meet at the point too; the straight ones, from high up, tens of metres beside it."""
    points, (shots, _, _, p_ecef) = all_sites
    uvs = jax.vmap(images_through_air)(shots, points)
    bent = jax.jit(jax.vmap(lambda s, u: forward_intersection(SENSOR, s, u, sigma=0.5, atmosphere=AIR)))(shots, uvs)
    assert np.all(bent.ok)
    np.testing.assert_allclose(np.linalg.norm(bent.p_ecef - p_ecef, axis=-1), 0.0, atol=1e-6)  # m
    straight = by_pixels(SENSOR, shots, uvs, jnp.ones((len(SITES), RAYS), bool), 0.5)
    assert np.linalg.norm(straight.p_ecef - p_ecef, axis=-1)[list(SITES).index("high")] > 20.0


@pytest.mark.costly
def test_order_and_padding_do_not_matter() -> None:
    uvs = np.asarray(UVS) + NOISE
    use = np.array([True, True, True, True, False, False])
    found = point_by_pixels(SENSOR, SHOTS, uvs, use)
    order = np.array([3, 5, 0, 1, 4, 2])
    turned = point_by_pixels(SENSOR, jax.tree.map(lambda x: x[order], SHOTS), uvs[order], use[order])
    np.testing.assert_allclose(turned.p_ecef, found.p_ecef, atol=1e-8)
    np.testing.assert_allclose(turned.cov_enu, found.cov_enu, rtol=1e-9)
    np.testing.assert_allclose(turned.residuals, found.residuals[order], atol=1e-8)
    junk = jax.tree.map(lambda x: x.at[4:].set(jnp.nan), (SHOTS, jnp.asarray(uvs)))
    padded = point_by_pixels(SENSOR, *junk, use)
    np.testing.assert_allclose(padded.p_ecef, found.p_ecef, atol=1e-8)
    assert np.all(np.isnan(padded.residuals[4:]))
    assert np.all(np.isfinite(padded.residuals[:4]))
    first = jax.tree.map(lambda x: x[:4], (SHOTS, uvs))
    short = forward_intersection(SENSOR, *first, sigma=0.5)
    np.testing.assert_allclose(short.p_ecef, found.p_ecef, atol=1e-8)
    assert float(short.chi_square) == pytest.approx(float(found.chi_square), rel=1e-9)


@pytest.mark.costly
def test_two_rays_of_the_normal_case() -> None:
    """Two parallel plumb images on a base B: height errs by sqrt(2) sigma H^2 / (B f), the plane by
    sigma H / (f sqrt 2) (Kraus 2007, "Photogrammetry")."""
    base, height, focal, sigma = 600.0, 1500.0, 10_000.0, 0.5
    east = np.where(np.arange(RAYS) < 2, -base / 2, base / 2)
    position = shots_about(POINT, np.stack([east, 0.0 * east, 0.0 * east + height], axis=1)).pose.position
    shots = Shot(Pose(position, 0.0 * east, 0.0 * east - math.pi / 2, 0.0 * east), np.zeros((RAYS, 0)), np.zeros(RAYS))
    found = point_by_pixels(PLAIN, shots, images_of(PLAIN, shots, POINT), TWO)
    deviations = np.sqrt(np.diagonal(found.cov_enu))
    across = sigma * height / focal / math.sqrt(2.0)
    np.testing.assert_allclose(deviations, [across, across, across * 2.0 * height / base], rtol=1e-3)
    assert float(found.angle) == pytest.approx(2.0 * math.atan(base / 2 / height), rel=1e-3)
    assert float(found.le90) == pytest.approx(float(linear_error(found.cov_enu[2, 2], 0.9)), rel=1e-12)
    assert float(found.ce90) == pytest.approx(float(circular_error(found.cov_enu[:2, :2], 0.9)), rel=1e-12)
    R = np.asarray(R_ecef_from_enu(found.position))
    np.testing.assert_allclose(found.cov_ecef, R @ np.asarray(found.cov_enu) @ R.T, atol=1e-12)


@pytest.mark.costly
def test_linear_equations_of_xue_meet_in_the_same_point() -> None:
    """l1 X + l2 Y + l3 Z - lx = 0 and the same for y, with lx = l1 Xs + l2 Ys + l3 Zs (Xue et al. 2019, Eq 2)."""
    uvs = np.asarray(images_of(PLAIN, SHOTS, POINT))
    sights = jax.vmap(PLAIN.sight)(SHOTS)
    tangents = (uvs - np.array([4000.0, 3000.0])) / 10_000.0
    R = np.asarray(sights.R_ecef_from_camera)
    rows = R[:, :, :2] - R[:, :, 2:] * tangents[:, None, :]  # (rays, 3, two equations)
    offsets = np.asarray(sights.centre) - P_ECEF
    right = np.einsum("iae,ia->ie", rows, offsets)
    linear = np.linalg.lstsq(rows.transpose(0, 2, 1).reshape(-1, 3), right.reshape(-1), rcond=None)[0]
    found = point_by_pixels(PLAIN, SHOTS, uvs)
    np.testing.assert_allclose(np.asarray(found.p_ecef) - P_ECEF, linear, atol=1e-6)


# Draws and derivatives: one program for all points with the error model, one for one.


def simulated(key, index):
    """Pixels of the point as a world with errors in it shows it: shared errors once, others for each ray."""

    def draw(number, source, place):
        key_of_source = jax.random.fold_in(jax.random.fold_in(key, index), number)
        shared = isinstance(source.sharing, PerFlight)
        normal = jax.random.normal(key_of_source, (1 if shared else RAYS, place.stop - place.start))
        return jnp.broadcast_to(normal * jnp.asarray(source.sigma)[None, :], (RAYS, place.stop - place.start))

    parts = [draw(number, *part) for number, part in enumerate(MODEL.parts())]

    def image(shot, uv, error):
        look = MODEL.moved(ModelInputs(Exposure(SENSOR, shot, 0.0), uv), error)
        return look.sensor.project_ecef(look.motion, jnp.asarray(P_ECEF))[0] - (look.uv - uv)

    return jax.vmap(image)(SHOTS, UVS, jnp.concatenate(parts, axis=1))


@pytest.fixture(scope="module")
def drawn():
    """Without any error, and then as it is drawn."""
    return jax.jit(jax.vmap(simulated, in_axes=(None, 0)))(jax.random.key(7), jnp.arange(DRAWS + 1)).at[0].set(UVS)


@jax.jit
def with_errors(uvs, use):
    return jax.vmap(lambda uvs: forward_intersection(SENSOR, SHOTS, uvs, errors=MODEL, use=use))(uvs)


@pytest.mark.slow
@pytest.mark.parametrize("use", [TWO, ALL], ids=["2 rays", "6 rays"])
def test_covariance_is_that_of_draws(use: np.ndarray, drawn) -> None:
    """Of shared and own errors: every entry of the draws' covariance, whitened, and the mean of their chi-squares."""
    found = with_errors(drawn, jnp.asarray(use))
    assert np.all(found.ok)
    expected = np.asarray(found.cov_ecef[0])
    misses = np.asarray(found.p_ecef)[1:] - P_ECEF
    whitened = np.linalg.solve(np.linalg.cholesky(expected), misses.T)
    spread = whitened @ whitened.T / DRAWS
    bound = 4.5 * np.sqrt((1.0 + np.eye(3)) / DRAWS)
    np.testing.assert_array_less(np.abs(spread - np.eye(3)), bound)
    assert abs(np.mean(np.sum(whitened**2, axis=0)) - 3.0) < 4.0 * math.sqrt(6.0 / DRAWS)
    freedom = 2 * int(use.sum()) - 3
    assert abs(np.mean(found.chi_square[1:]) - freedom) < 4.5 * math.sqrt(2.0 * freedom / DRAWS)
    np.testing.assert_allclose(np.mean(np.asarray(found.sigma0[1:]) ** 2), 1.0, atol=0.2)


@pytest.mark.slow
def test_no_weights_are_better_than_the_errors_own(drawn) -> None:
    best = jax.tree.map(lambda x: x[0], with_errors(drawn, jnp.asarray(ALL)))
    plain = forward_intersection(SENSOR, SHOTS, UVS, errors=MODEL, sigma=1.0)
    gain = np.asarray(plain.cov_enu - best.cov_enu)
    assert np.linalg.eigvalsh(gain)[0] > -1e-9
    assert np.trace(gain) > 0.01 * np.trace(best.cov_enu)
    np.testing.assert_allclose(plain.p_ecef, best.p_ecef, atol=1e-6)  # exact data
    assert float(plain.chi_square) == pytest.approx(float(best.chi_square), abs=1e-6)


@pytest.mark.slow
def test_plain_weights_with_errors_of_the_pixels_are_those_of_sigma() -> None:
    uvs, pixels = np.asarray(UVS) + NOISE, several(attitude=0.0)
    found, plain = forward_intersection(SENSOR, SHOTS, uvs, errors=pixels), point_by_pixels(SENSOR, SHOTS, uvs)
    np.testing.assert_allclose(found.p_ecef, plain.p_ecef, atol=1e-7)
    np.testing.assert_allclose(found.cov_enu, plain.cov_enu, rtol=1e-6)
    assert float(found.chi_square) == pytest.approx(float(plain.chi_square), rel=1e-6)
    assert 0.3 < float(plain.sigma0) < 2.0


@pytest.mark.slow
def test_fused_fixes_come_to_the_same(drawn) -> None:
    """Fixes on ground of unknown height, fused with all that their errors have in common."""
    ground = ConstantHeight(float(POINT.height))
    unknown = sources.TerrainHeight.from_metres(1000.0, sharing=PerMeasurement())
    errors = ErrorModel((*MODEL.sources, unknown))
    looks = [(jax.tree.map(lambda x, k=k: x[k], SHOTS), UVS[k]) for k in np.flatnonzero(TWO)]
    fixes = joint_covariance([propagate(SENSOR, shot, uv, ground, errors) for shot, uv in looks])
    p_ecef, cov_enu = fixes.fused()
    found = jax.tree.map(lambda x: x[0], with_errors(drawn, jnp.asarray(TWO)))
    np.testing.assert_allclose(found.p_ecef, p_ecef, atol=1e-5)
    np.testing.assert_allclose(found.cov_enu, cov_enu, atol=1e-3 * float(np.trace(cov_enu)))


@pytest.mark.costly
def test_shots_in_common_share_their_errors() -> None:
    """Rays that are told to be of one shot have one attitude, which hardly counts in the plane where they look from all
    sides; but not in different flights."""
    turned = several()
    apart = forward_intersection(SENSOR, SHOTS, UVS, errors=turned)
    together = forward_intersection(SENSOR, SHOTS, UVS, errors=turned, shot_of=np.zeros(RAYS))
    assert float(together.cov_enu[0, 0]) < 0.1 * float(apart.cov_enu[0, 0])
    assert float(together.cov_enu[2, 2]) > 2.0 * float(apart.cov_enu[2, 2])
    flights = forward_intersection(SENSOR, SHOTS, UVS, errors=turned, shot_of=np.zeros(RAYS), flight_of=np.arange(RAYS))
    np.testing.assert_allclose(flights.cov_enu, apart.cov_enu, rtol=1e-9)


SCALES = np.array([1.0, 1e-4, 1.0, 1.0])  # px, rad, px, m


def moved_point(change, said: dict):
    """The point (from where it is, m) and a part of its covariance, with a pixel, a heading, the focal length and a
    height changed, of images that do not meet."""
    change = change * SCALES
    uvs = jnp.asarray(np.asarray(UVS) + NOISE).at[1, 0].add(change[0])
    shots = eqx.tree_at(lambda s: s.pose.heading, SHOTS, SHOTS.pose.heading.at[2].add(change[1]))
    shots = eqx.tree_at(lambda s: s.pose.position.height, shots, shots.pose.position.height.at[0].add(change[3]))
    camera = eqx.tree_at(lambda s: s.camera.focal_px, SENSOR, SENSOR.camera.focal_px + change[2])
    found = forward_intersection(camera, shots, uvs, **said)
    return jnp.concatenate([found.p_ecef - P_ECEF, found.cov_enu[2]])


def differences(function, step: float) -> np.ndarray:
    columns = [(function(step * e) - function(-step * e)) / (2.0 * step) for e in np.eye(len(SCALES))]
    return np.stack([np.asarray(column) for column in columns], axis=-1)


TURNED = (sources.Boresight.from_degrees(heading=0.04, pitch=0.03, roll=0.02), MODEL.sources[-1])


@pytest.mark.parametrize(
    "said",
    [
        pytest.param({"sigma": 0.5}, id="sigma"),
        pytest.param({"errors": TURNED}, id="errors", marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_derivatives_are_those_of_differences(said: dict) -> None:
    """Forward and reverse of the point and of its covariance, and the second of a coordinate."""

    @jax.jit
    def derivatives(change):
        value = lambda change: moved_point(change, said)  # noqa: E731
        reverse = jax.grad(lambda change: moved_point(change, said)[0])
        return value(change), jax.jacfwd(value)(change), reverse(change), jax.jacfwd(reverse)(change)

    none = jnp.zeros(len(SCALES))
    _, first, reverse, second = map(np.asarray, derivatives(none))
    np.testing.assert_allclose(first, differences(lambda change: derivatives(change)[0], 0.5), atol=1e-6)
    np.testing.assert_allclose(reverse, first[0], atol=1e-10)
    assert np.abs(first[:3]).max() > 0.1
    np.testing.assert_allclose(second, differences(lambda change: derivatives(change)[2], 0.5), rtol=1e-5, atol=1e-8)
    assert np.abs(second).max() > 1e-5


def failing():
    """(shots, pixels, which are used) of points of every kind, and what is the matter with each."""
    same = jax.tree.map(lambda x: jnp.stack([x[0]] * RAYS), SHOTS)
    apart = eqx.tree_at(lambda s: s.pose.heading, SHOTS, SHOTS.pose.heading + math.pi)
    apart = eqx.tree_at(lambda s: s.pose.pitch, apart, -SHOTS.pose.pitch)
    unknown = jax.tree.map(lambda x: x.at[2].set(jnp.nan), SHOTS)
    beside = UVS.at[3].set(jnp.array([1e7, 0.0]))
    one, rest = np.arange(RAYS) == 3, np.arange(RAYS) != 2
    cases = [
        (SHOTS, UVS, ALL, Status.hit),
        (SHOTS, UVS, one, Status.too_few_rays),
        (SHOTS, UVS, ~ALL, Status.too_few_rays),
        (unknown, UVS, ALL, Status.invalid_input),
        (unknown, UVS.at[2].set(jnp.inf), rest, Status.hit),
        (same, jnp.stack([UVS[0]] * RAYS), ALL, Status.weak_intersection),
        (same, UVS[:1] + 1e-3 * NOISE, ALL, Status.weak_intersection),
        (apart, UVS, ALL, Status.behind_camera),
        (SHOTS, beside, ALL, Status.outside_image),
    ]
    shots, uvs, use, statuses = zip(*cases, strict=True)
    return stacked(list(shots)), jnp.stack(uvs), jnp.asarray(np.stack(use)), statuses


@pytest.mark.slow
@pytest.mark.parametrize(
    "said",
    [{"sigma": 0.5}, pytest.param({"errors": TURNED}, marks=pytest.mark.slow)],
    ids=["sigma", "errors"],
)
def test_what_has_no_answer_says_why(said: dict) -> None:
    shots, uvs, use, statuses = failing()

    @jax.jit
    def sum_and_all(shots: Shot, uvs):
        one = lambda shots, uvs, use: forward_intersection(SENSOR, shots, uvs, use=use, **said)  # noqa: E731
        found = jax.vmap(one)(shots, uvs, use)
        return jnp.sum(jnp.where(found.ok[:, None], found.p_ecef, 0.0)), found

    gradient, found = jax.grad(sum_and_all, argnums=(0, 1), has_aux=True)(shots, uvs)
    assert [Status(int(code)) for code in found.status] == list(statuses)
    ok = np.asarray(found.ok)
    for numbers in (found.p_ecef, found.position.lat, found.cov_enu, found.residuals, found.chi_square):
        assert np.all(np.isnan(np.asarray(numbers)[~ok]))
    assert np.all(np.isfinite(found.p_ecef[ok]))
    assert np.all(np.isfinite(found.cov_enu[ok]))
    for leaf in jax.tree.leaves(gradient):
        leaf = np.asarray(leaf)
        assert np.all(np.isfinite(leaf))
        np.testing.assert_array_equal(leaf[~ok], 0.0)
    assert np.any(np.asarray(gradient[1])[ok] != 0.0)
    np.testing.assert_allclose(found.angle[5:7], 0.0, atol=1e-4)  # rad: rays tell why


def test_weak_is_what_the_errors_cannot_tell() -> None:
    """Rays half a degree apart are enough for a good camera, and not for pixels that err by 60."""
    offsets = jnp.asarray([(20.0 * k, 0.0, 3000.0) for k in range(RAYS)])
    shots = shots_about(POINT, offsets)
    uvs = images_of(SENSOR, shots, POINT)
    good = point_by_pixels(SENSOR, shots, uvs)
    assert bool(good.ok)
    assert float(good.angle) < 0.04
    bad = point_by_pixels(SENSOR, shots, uvs, sigma=60.0)
    assert int(bad.status) == Status.weak_intersection
    assert np.isnan(bad.p_ecef).all()
    assert float(bad.angle) == pytest.approx(float(good.angle), abs=1e-9)
    assert int(point_by_pixels(SENSOR, shots, uvs, sigma=-1.0).status) == Status.invalid_input  # traced


def test_a_gross_error_shows() -> None:
    found = point_by_pixels(SENSOR, SHOTS, UVS.at[2, 0].add(2000.0))
    assert bool(found.ok)
    assert int(np.argmax(np.abs(np.asarray(found.residuals)).max(axis=1))) == 2
    assert float(found.sigma0) > 100.0


@pytest.mark.costly
def test_sensors_and_shots_may_come_as_lists() -> None:
    shots = [jax.tree.map(lambda x, k=k: x[k], SHOTS) for k in range(RAYS)]
    uvs = np.asarray(UVS)
    uvs = np.concatenate([uvs[:3], np.asarray(images_of(PLAIN, SHOTS, POINT))[3:]])
    found = forward_intersection([SENSOR] * 3 + [PLAIN] * 3, shots, uvs, sigma=0.5)
    np.testing.assert_allclose(found.p_ecef, P_ECEF, atol=1e-6)
    batch = stacked([SENSOR] * 3 + [PLAIN] * 3)
    again = forward_intersection(batch, SHOTS, uvs, sigma=np.full(RAYS, 0.5))
    np.testing.assert_allclose(again.p_ecef, P_ECEF, atol=1e-6)


REFRACTION = sources.Refraction.from_kelvin_and_pascal(temperature=1.0, pressure=1.0)
GOOD = {"sensor": SENSOR, "shots": SHOTS, "uvs": UVS, "sigma": 1.0}
FIRST = jax.tree.map(lambda x: x[:1], SHOTS)


@pytest.mark.parametrize(
    "change, kind, message",
    [
        ({"uvs": UVS[0]}, ValueError, r"uvs must hold a pixel .* shape \(rays, 2\); got shape \(2,\)"),
        ({"uvs": UVS[:4]}, ValueError, r"shots.* must have the shape \(4"),
        ({"uvs": UVS[:1], "shots": FIRST}, ValueError, "at least two rays; got 1"),
        ({"uvs": np.asarray(UVS, np.float32)}, TypeError, "float32"),
        ({"shots": "north"}, TypeError, "shots must be a jaxgeo Shot"),
        ({"shots": []}, ValueError, "shots must not be empty"),
        ({"sensor": [SENSOR] * 2}, ValueError, "one for each of the 6 rays; got 2"),
        ({"sensor": SENSOR.camera}, TypeError, "sensor must be a jaxgeo Sensor"),
        ({"sensor": [SENSOR] * 5 + [Sensor(SENSOR.camera, Gimbal.two_axis())]}, ValueError, "must all be alike"),
        ({"sensor": stacked([SENSOR] * 3)}, ValueError, "leading axis of 6 rays"),
        ({"sigma": None}, ValueError, "give sigma, in px, or errors"),
        ({"sigma": 0.0}, ValueError, "sigma must be positive and finite, in px; got 0.0"),
        ({"sigma": np.full(RAYS, np.nan)}, ValueError, "sigma must be positive and finite, in px; got nan"),
        ({"sigma": np.ones(3)}, ValueError, r"sigma must be a number, one for each ray.* got shape \(3,\)"),
        ({"use": np.ones(RAYS)}, ValueError, "use must be true or false for each of the 6 rays"),
        ({"shot_of": [0, 1]}, ValueError, "shot_of must have a number for each of the 6 rays"),
        ({"errors": 3.0}, TypeError, "errors must be a jaxgeo ErrorModel"),
        ({"errors": (sources.TerrainHeight.from_metres(3.0),)}, ValueError, "only sources of the terrain"),
        ({"errors": (sources.GimbalAngles.from_degrees(outer=1.0, inner=1.0),)}, ValueError, "this gimbal has none"),
        ({"errors": (REFRACTION,)}, ValueError, "needs the air"),
    ],
)  # fmt: skip
def test_mistakes_are_refused_in_words(change: dict, kind: type, message: str) -> None:
    with pytest.raises(kind, match=message):
        forward_intersection(**{**GOOD, **change})


def test_degrees_are_refused() -> None:
    shots = eqx.tree_at(lambda s: s.pose.position.lat, SHOTS, SHOTS.pose.position.lat * 57.3)
    with pytest.raises(ValueError, match="within pi/2"):
        forward_intersection(SENSOR, shots, UVS, sigma=1.0)
