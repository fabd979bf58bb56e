"""Laws of the bundle adjustment, against the truth of simulated blocks and against dense least squares."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Dem, Geodetic, Sensor, Shot
from jaxgeo.adjust import (
    Adjustment,
    Block,
    Cauchy,
    Fixed,
    Free,
    GroundPoints,
    HeightObservations,
    Huber,
    ImagePoints,
    Images,
    InnerConstraints,
    LeastSquares,
    LocalFrame,
    NotConverged,
    Prior,
    Solver,
    Tukey,
    Unknowns,
    adjust,
    reliability,
)
from jaxgeo.adjust import layout as layouts
from jaxgeo.adjust.problem import prepared
from jaxgeo.adjust.solve import solve
from jaxgeo.terrain import TangentGrid
from tests.support.dense_block import Dense, dense
from tests.support.simulated_block import (
    CONTROL,
    MOUNT,
    SIGMA_ATTITUDE,
    SIGMA_POSITION,
    Simulated,
    camera,
    disturbed,
    ground,
    simulated,
)

EVERYTHING = Unknowns(
    focal=Free(),
    aspect=Prior(1e-3),
    principal=Free(),
    distortion={"k1": Free(), "k2": Prior(1e-2), "p1": Prior(1e-3)},
    boresight=Free(),
    lever=Prior(0.5),
    shift=Prior(0.1),
    drift=Prior(0.01),
)


@pytest.fixture(scope="module")
def adjusted() -> Adjustment:
    """A block on control and navigation, with noise."""
    return adjust(simulated().noisy(1).block())


@pytest.fixture(scope="module")
def calibrated() -> Adjustment:
    """The same, from a camera and a mount that are not quite known."""
    return adjust(astray(simulated().noisy(1)), EVERYTHING)


def astray(of: Simulated, **changes: Any) -> Block:
    """A block whose camera and mount start elsewhere."""
    mount = eqx.tree_at(
        lambda m: (m.R_body_from_base, m.lever_body), MOUNT, (np.eye(3), np.asarray(MOUNT.lever_body) + 0.1)
    )
    given = Sensor(camera(focal_px=4020.0, principal_px=(1999.5, 1499.5)), of.sensor.gimbal, mount)
    return of.block(sensor=given, **changes)


def assert_same(a: np.ndarray, b: np.ndarray, sigma: np.ndarray, within: float) -> None:
    """Covariances (N, N) that agree to a share of the standard deviations."""
    scale = np.where(sigma > 0.0, sigma, 1.0)
    np.testing.assert_allclose(a / np.outer(scale, scale), b / np.outer(scale, scale), rtol=0.0, atol=within)


def assert_is(adjustment: Adjustment, oracle: Dense, within: float = 1e-7) -> None:
    """Covariances, leverages, redundancy and unit weight are those of dense least squares, whose gradient is zero."""
    N, points = len(adjustment.columns), len(adjustment.places)
    sigma = np.sqrt(np.diagonal(oracle.covariance))
    assert_same(adjustment.covariance, oracle.covariance[:N, :N], sigma[:N], within)
    at = N + 3 * np.arange(points)[:, None] + np.arange(3)
    own = oracle.covariance[at[:, :, None], at[:, None, :]]
    largest = np.abs(own).max(axis=(1, 2), keepdims=True)
    scale = np.where(largest > 0.0, largest, 1.0)
    np.testing.assert_allclose(adjustment.points.covariance / scale, own / scale, rtol=0.0, atol=within)
    np.testing.assert_allclose(adjustment.points.sigma, sigma[N:].reshape(-1, 3), rtol=0.0, atol=within)
    left = 1.0 - np.diagonal(oracle.leverage)
    k = len(adjustment.block.observations)
    np.testing.assert_allclose(reliability(adjustment).redundancy.ravel(), left[: 2 * k], rtol=0.0, atol=within)
    observed = np.any(oracle.jacobian != 0.0, axis=1) | (oracle.residual != 0.0)
    assert adjustment.redundancy == pytest.approx(np.sum(left[observed]), abs=1e-6)
    squares = np.sum(oracle.residual**2)
    assert adjustment.cost == pytest.approx(0.5 * squares, abs=1e-9 * squares)
    assert adjustment.sigma0 == pytest.approx(np.sqrt(squares / adjustment.redundancy), abs=1e-9)
    gradient = oracle.jacobian.T @ oracle.residual * sigma[oracle.free]
    np.testing.assert_allclose(gradient, 0.0, atol=1e-4)


PLACES = [
    ("fixed", 47.0, 11.0),
    ("fixed", -0.001, -180.0),
    ("two_axis", 89.998, 20.0),
    ("drone", -35.0, 179.9999),
    ("drone", -90.0, 0.0),
]


@pytest.mark.parametrize("kind, lat, lon", PLACES)
def test_exact_measurements_give_the_truth_back(kind: str, lat: float, lon: float) -> None:
    truth = simulated(kind, lat, lon)
    found = adjust(disturbed(truth.block()))
    off = truth.offsets(found)
    assert found.converged
    assert off["centre"] < 1e-6  # m
    assert off["turn"] < 1e-10  # rad
    assert off["points"] < 1e-6  # m
    assert found.sigma0 < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fixed", "two_axis", "drone"])
def test_exact_measurements_give_camera_and_mount_back(kind: str) -> None:
    truth = simulated(kind)
    known = replace(EVERYTHING, aspect=Prior(1e3), distortion={"k1": Free(), "k2": Prior(1e3), "p1": Prior(1e3)})
    loose = replace(known, lever=Prior(1e4), shift=Prior(1e4), drift=Prior(1e-3))
    # Over straight strips the lever arm and the shift of the strip are one; that of the drone's body is none at all.
    unknowns = replace(loose, shift=Prior(1e-9), drift=Prior(1e-9))
    lens = eqx.tree_at(lambda c: c.distortion.k1, camera(focal_px=4020.0, principal_px=(2000.0, 1500.0)), -0.04)
    name = "R_head_from_camera" if kind == "drone" else "R_body_from_base"
    mount = eqx.tree_at(
        lambda m: (getattr(m, name), m.lever_body),
        truth.sensor.mount,
        (
            np.asarray(getattr(simulated(kind).sensor.mount, name)) @ rotation(0.002, 0.004, -0.003),
            np.asarray(truth.sensor.mount.lever_body) + 0.2,
        ),
    )
    found = adjust(disturbed(truth.block(sensor=Sensor(lens, truth.sensor.gimbal, mount))), unknowns)
    assert found.converged
    own, right = found.cameras["camera"], truth.sensor.camera
    np.testing.assert_allclose(own.focal_px, right.focal_px, rtol=0.0, atol=1e-4)  # px
    np.testing.assert_allclose(own.principal_px, right.principal_px, rtol=0.0, atol=1e-4)  # px
    np.testing.assert_allclose(own.distortion.coefficients(), right.distortion.coefficients(), rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(getattr(found.mounts["camera"], name), getattr(truth.sensor.mount, name), atol=1e-8)
    np.testing.assert_allclose(found.mounts["camera"].lever_body, truth.sensor.mount.lever_body, rtol=0.0, atol=1e-4)


def rotation(*vector: float) -> np.ndarray:
    """A rotation matrix by its vector, rad."""
    from tests.support.simulated_block import small_turn

    return small_turn(*vector)


@pytest.mark.costly
def test_it_is_dense_least_squares(adjusted: Adjustment) -> None:
    assert_is(adjusted, dense(adjusted))


@pytest.mark.costly
def test_calibration_is_dense_least_squares(calibrated: Adjustment) -> None:
    oracle = dense(calibrated)
    assert_is(calibrated, oracle)
    at = [calibrated.columns.index((p.whose, p.name)) for p in calibrated.parameters]
    sigma = np.sqrt(np.diagonal(oracle.covariance))[at]
    np.testing.assert_allclose([p.sigma / s for p, s in zip(calibrated.parameters, sigma, strict=True)], 1.0, atol=1e-7)
    np.testing.assert_allclose(
        calibrated.correlations, oracle.covariance[np.ix_(at, at)] / np.outer(sigma, sigma), rtol=0.0, atol=1e-7
    )


def mixed(seed: int | None) -> tuple[Block, Unknowns, HeightObservations]:
    """Two cameras on two mounts, one on a drone's gimbal, some of all held, known beforehand, and free; a terrain."""
    first, second = simulated(), simulated("drone")
    if seed is not None:
        first, second = first.noisy(seed), second.noisy(seed + 1)
    control = GroundPoints(
        CONTROL[:5],
        first.points.of(CONTROL[:5]).place,
        [[0.02] * 3, [np.inf, np.inf, 0.05], [0.0, 0.0, 0.03], [0.0] * 3, [0.1] * 3],
    )
    parts = [part_of(first, slice(0, 10), "a"), part_of(second, slice(10, 15), "b")]
    block = replace(parts[0].with_block(parts[1]), control=control)
    east = np.linspace(-600.0, 600.0, 25)
    posts = ground(*np.meshgrid(east, east[::-1]))
    grid = TangentGrid.centred(first.frame.origin, spacing=(50.0, 50.0), shape=posts.shape)
    unknowns = Unknowns(
        images={"i03": Fixed(), "i11": Fixed()},
        focal=Free(),
        aspect=Prior(1e-3),
        principal={"a": Free(), "b": Prior([3.0, 4.0])},
        distortion={"k1": Free(), "p1": Prior(1e-3), "p2": Fixed(), "k2": Prior(1e-2)},
        boresight={"a": Free(), "b": Prior(1e-3)},
        lever=Prior([0.2, 0.3, 0.4]),
        shift=Prior(0.1),
        drift={"north": Prior(0.01), "across": Free()},
    )
    return block, unknowns, HeightObservations(Dem.from_array(posts, grid), 2.0)


def part_of(of: Simulated, rows: slice, name: str) -> Block:
    """Some of the images as a block by themselves; that its points may be seen once only is none of its business."""
    shots = jax.tree.map(lambda x: np.asarray(x)[rows], of.shots)
    own = np.isin(of.observations.image, of.names[rows])
    all_ = GroundPoints(of.points.name, of.points.place, np.inf)
    return Block.from_shots(
        of.sensor,
        list(of.names[rows]),
        shots,
        of.observations.of(own),
        sigma_position=SIGMA_POSITION,
        sigma_attitude=SIGMA_ATTITUDE,
        frame=of.frame,
        camera=name,
        strip=of.strip[rows],
        control=all_,
    )


@pytest.mark.slow
def test_all_kinds_of_unknowns_at_once_are_dense_least_squares() -> None:
    block, unknowns, terrain = mixed(3)
    covariance = np.diag([1.0, 2.0, 3.0]) * 1e-4 + 5e-5
    for given in (block, replace(block, control=replace(block.control, covariance=np.stack([covariance] * 5)))):
        found = adjust(given, unknowns, terrain=terrain)
        assert_is(found, dense(found, terrain), within=1e-6)
        held = found.covariance_of_images[[3, 11]]
        np.testing.assert_array_equal(held, 0.0)
        np.testing.assert_array_equal(found.images.centre[[3, 11]], block.images.centre[[3, 11]])


def test_order_does_not_matter(adjusted: Adjustment) -> None:
    block, rng = adjusted.block, np.random.default_rng(0)
    seen, images, nav = rng.permutation(len(block.observations)), rng.permutation(15), block.navigation
    assert nav is not None
    given = block.images
    shuffled = replace(
        block,
        observations=block.observations.of(seen),
        images=Images(
            given.name[images], given.camera[images], given.centre[images], given.R_frame_from_camera[images]
        ),
        navigation=nav.of(images),
        control=block.control.of(rng.permutation(block.control.name)),
    )
    found = adjust(shuffled)
    np.testing.assert_allclose(found.images.centre, adjusted.images.centre[images], rtol=0.0, atol=1e-7)  # m
    np.testing.assert_allclose(found.points.place, adjusted.points.place, rtol=0.0, atol=1e-6)  # m
    np.testing.assert_allclose(found.points.covariance, adjusted.points.covariance, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(found.covariance_of_images, adjusted.covariance_of_images[images], rtol=1e-5, atol=1e-13)
    np.testing.assert_allclose(found.residuals, adjusted.residuals[seen], rtol=0.0, atol=1e-6)  # px
    np.testing.assert_allclose(
        reliability(found).redundancy, reliability(adjusted).redundancy[seen], rtol=0.0, atol=1e-8
    )


def test_names_do_not_matter(adjusted: Adjustment) -> None:
    block = adjusted.block
    told = {name: f"Punkt {name[::-1]} — 点" for name in adjusted.places}
    point = np.array([told[name] for name in block.observations.point.tolist()])
    control = GroundPoints(
        [told[name] for name in block.control.name.tolist()], block.control.place, block.control.sigma
    )
    seen = ImagePoints(block.observations.image, point, block.observations.uv, block.observations.sigma)
    found = adjust(replace(block, observations=seen, control=control))
    for name, place in adjusted.places.items():
        np.testing.assert_allclose(found.places[told[name]], place, rtol=0.0, atol=1e-6)  # m


def test_the_frame_does_not_matter(adjusted: Adjustment) -> None:
    of, old = simulated().noisy(1), simulated().frame
    new = LocalFrame(Geodetic.from_degrees(lat=47.3, lon=10.4, height=500.0))
    R = np.asarray(new.R_ecef_from_local).T @ np.asarray(old.R_ecef_from_local)
    control = of.control()
    covariance = np.stack([R @ np.diag(s**2) @ R.T for s in control.sigma])
    moved = GroundPoints(
        control.name,
        np.asarray(new.from_ecef(old.to_ecef(control.place))),
        covariance=0.5 * (covariance + np.swapaxes(covariance, 1, 2)),
    )
    found = adjust(of.block(frame=new, control=moved))
    for attribute in ("images", "points"):
        places = [
            getattr(getattr(a, attribute), "centre" if attribute == "images" else "place") for a in (adjusted, found)
        ]
        np.testing.assert_allclose(old.to_ecef(places[0]), new.to_ecef(places[1]), rtol=0.0, atol=1e-5)  # m
    rotated = R @ adjusted.points.covariance @ R.T
    np.testing.assert_allclose(found.points.covariance, rotated, rtol=0.0, atol=1e-6 * np.abs(rotated).max())
    assert found.sigma0 == pytest.approx(adjusted.sigma0, abs=1e-9)


@pytest.mark.costly
def test_the_unit_of_weight_does_not_matter(calibrated: Adjustment) -> None:
    of = simulated().noisy(1)
    seen = ImagePoints(of.observations.image, of.observations.point, of.observations.uv, 3.0 * of.observations.sigma)
    block = astray(
        of,
        observations=seen,
        sigma_position=3.0 * SIGMA_POSITION,
        sigma_attitude=3.0 * SIGMA_ATTITUDE,
        control=of.control(0.06),
    )
    triple = {
        name: Prior(3.0 * np.asarray(choice.sigma))
        for name, choice in vars(EVERYTHING).items()
        if isinstance(choice, Prior)
    }
    lens = {"k1": Free(), "k2": Prior(3e-2), "p1": Prior(3e-3)}
    found = adjust(block, replace(EVERYTHING, **triple, distortion=lens), solver=Solver(absolute=1e-12))
    exact = adjust(calibrated.block, EVERYTHING, solver=Solver(absolute=1e-12))
    assert found.sigma0 == pytest.approx(exact.sigma0 / 3.0, abs=1e-7)
    np.testing.assert_allclose(found.points.place, exact.points.place, rtol=0.0, atol=1e-5)  # m
    for one, three in zip(exact.parameters, found.parameters, strict=True):
        assert three.value == pytest.approx(one.value, abs=1e-4 * one.sigma)
        assert three.sigma == pytest.approx(3.0 * one.sigma, rel=1e-5)
        assert three.prior == pytest.approx(3.0 * one.prior)


@pytest.mark.costly
def test_a_tight_prior_holds_and_a_loose_one_does_nothing(calibrated: Adjustment) -> None:
    tight = adjust(calibrated.block, replace(EVERYTHING, boresight=Prior(1e-12), focal=Prior(1e-9)))
    by_name = {p.name: p for p in tight.parameters}
    assert by_name["focal"].value == pytest.approx(4020.0, abs=1e-6)  # px
    assert by_name["boresight z"].value == pytest.approx(0.0, abs=1e-9)  # rad
    assert by_name["focal"].sigma == pytest.approx(1e-9, rel=1e-3)
    loose = adjust(calibrated.block, replace(EVERYTHING, boresight=Prior(1e4), focal=Prior(1e8)))
    for free, known in zip(calibrated.parameters, loose.parameters, strict=True):
        assert known.value == pytest.approx(free.value, abs=1e-3 * free.sigma)
        assert known.sigma == pytest.approx(free.sigma, rel=1e-5)


@pytest.mark.costly
def test_what_is_fixed_is_the_limit_of_a_prior(calibrated: Adjustment) -> None:
    # Sigmas of the others that are known beforehand keep the program; only what is free of a mount changes.
    held = adjust(calibrated.block, replace(EVERYTHING, boresight=Fixed(), shift=Fixed()))
    tight = adjust(calibrated.block, replace(EVERYTHING, boresight=Prior(1e-10), shift=Prior(1e-7)))
    assert not [p for p in held.parameters if p.name.startswith(("boresight", "shift"))]
    np.testing.assert_allclose(held.points.place, tight.points.place, rtol=0.0, atol=1e-4)  # m
    np.testing.assert_allclose(held.points.sigma, tight.points.sigma, rtol=1e-4)
    names = [(p.whose, p.name) for p in held.parameters]
    others = [p for p in tight.parameters if (p.whose, p.name) in names]
    for one, other in zip(held.parameters, others, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-2 * one.sigma)
        assert one.sigma == pytest.approx(other.sigma, rel=1e-4)
    assert held.redundancy == tight.redundancy + 0
    fixed = [i for i, (_, what) in enumerate(held.columns) if what.startswith(("boresight", "shift"))]
    np.testing.assert_array_equal(held.covariance[fixed], 0.0)
    np.testing.assert_array_equal(held.mounts["camera"].R_body_from_base, np.eye(3))


def test_it_gets_there_from_far_off_and_tells_how(adjusted: Adjustment) -> None:
    told: list[Any] = []
    found = adjust(disturbed(adjusted.block, 10.0, np.deg2rad(2.0)), callback=told.append)
    np.testing.assert_allclose(found.images.centre, adjusted.images.centre, rtol=0.0, atol=1e-4)  # m
    np.testing.assert_allclose(found.points.place, adjusted.points.place, rtol=0.0, atol=1e-3)  # m
    assert found.converged
    assert tuple(told) == found.log[1:]
    assert [step.number for step in found.log] == list(range(len(found.log)))
    for before, step in zip(found.log, found.log[1:], strict=False):
        if step.accepted:
            assert step.cost <= before.cost * (1.0 + 1e-12)
            assert step.cost == pytest.approx(before.cost - step.decrease, rel=1e-12, abs=1e-12 * before.cost)
        else:
            assert step.cost == before.cost
    assert found.cost == found.log[-1].cost


def test_iterations_that_did_not_end_are_no_answer(adjusted: Adjustment) -> None:
    with pytest.raises(
        NotConverged, match=r"has not converged in 1 iterations; the cost is .* solver=Solver"
    ) as caught:
        adjust(disturbed(adjusted.block, 10.0, 0.03), solver=Solver(max_iterations=1))
    assert len(caught.value.log) == 2


def test_an_image_without_navigation_is_found_by_its_points() -> None:
    truth = simulated()
    position, attitude = np.tile(SIGMA_POSITION, (15, 1)), np.tile(SIGMA_ATTITUDE, (15, 1))
    position[4] = attitude[4] = np.inf
    found = adjust(disturbed(truth.block(sigma_position=position, sigma_attitude=attitude)))
    assert found.redundancy == adjust(truth.block()).redundancy - 6
    assert truth.offsets(found)["centre"] < 1e-6  # m


def test_a_height_point_may_have_any_place_nearby() -> None:
    truth, names = simulated(), CONTROL[:4]
    place = truth.points.of(names).place.copy()
    place[0, :2] = 0.0
    sigma = np.full((4, 3), 0.02)
    sigma[0, :2] = np.inf
    found = adjust(truth.block(control=GroundPoints(names, place, sigma)))
    assert truth.offsets(found)["points"] < 1e-6  # m
    assert found.redundancy == adjust(truth.block(control=truth.control(names=names))).redundancy - 2


@pytest.mark.slow
def test_all_points_known_leaves_resections() -> None:
    of = simulated().noisy(2)
    found = adjust(of.block(control=of.control(0.0, tuple(of.points.name))))
    np.testing.assert_array_equal(found.points.place, of.points.place)
    np.testing.assert_array_equal(found.points.covariance, 0.0)
    assert found.unknown_count == 6 * 15
    assert_is(found, dense(found))


@pytest.mark.slow
def test_all_images_known_leaves_intersections() -> None:
    of = simulated().noisy(2)
    found = adjust(of.block(), Unknowns(images=Fixed()))
    np.testing.assert_array_equal(found.images.centre, found.block.images.centre)
    np.testing.assert_array_equal(found.covariance, 0.0)
    assert_is(found, dense(found))


@pytest.mark.parametrize("loss", [LeastSquares(), Huber(), Huber(1.3), Cauchy(), Cauchy(1.0), Tukey(), Tukey(2.0)])
def test_weights_are_the_derivatives_of_losses(loss: Any) -> None:
    s = jnp.concatenate([jnp.linspace(0.0, 60.0, 601) + 1e-3, jnp.array([0.0, 1e-12, 1e6])])
    by_autodiff = jax.vmap(jax.grad(loss.rho))(s)
    np.testing.assert_allclose(loss.weight(s), by_autodiff, rtol=0.0, atol=1e-12)
    assert float(loss.rho(jnp.array(0.0))) == 0.0
    assert float(loss.weight(jnp.array(0.0))) == 1.0
    assert np.all(np.diff(np.asarray(loss.weight(jnp.sort(s)))) <= 0.0)


# Free networks


@pytest.fixture(scope="module")
def free() -> Adjustment:
    """A free network: nothing but image points."""
    of = simulated().noisy(4)
    block = replace(of.block(), navigation=None, control=None)
    return adjust(disturbed(block, 0.5, 0.002), datum=InnerConstraints())


def motions_of(adjustment: Adjustment) -> np.ndarray:
    """Rows (7, unknowns): how all unknowns change with shifts, turns and the scale of the whole."""
    place, centre = adjustment.points.place, adjustment.images.centre
    middle, R = place.mean(axis=0), adjustment.images.R_frame_from_camera
    rows = []
    for axis in np.eye(3):
        rows.append((np.tile(axis, (len(centre), 1)), np.zeros((len(centre), 3)), np.tile(axis, (len(place), 1))))
    for axis in np.eye(3):
        rows.append((np.cross(axis, centre - middle), np.swapaxes(R, 1, 2) @ axis, np.cross(axis, place - middle)))
    rows.append((centre - middle, np.zeros((len(centre), 3)), place - middle))
    return np.stack([np.concatenate([np.concatenate([c, t], axis=1).ravel(), p.ravel()]) for c, t, p in rows])


@pytest.mark.costly
def test_a_free_network_is_dense_least_squares_with_inner_constraints(free: Adjustment) -> None:
    constraints = motions_of(free)
    constraints[:, : len(free.columns)] = 0.0
    oracle = dense(free, constraints=constraints)
    np.testing.assert_allclose(oracle.jacobian @ motions_of(free)[:, oracle.free].T, 0.0, atol=1e-7)
    assert free.redundancy == 2 * len(free.block.observations) - 6 * 15 - 3 * 64 + 7
    assert_is(free, oracle, within=1e-6)


@pytest.mark.costly
def test_no_datum_gives_points_less_spread(free: Adjustment) -> None:
    trace = np.trace(free.points.covariance.sum(axis=0))
    N, index = len(free.columns), {name: i for i, name in enumerate(free.points.name.tolist())}
    for chosen in (("p00", "p11", "p22"), ("p33", "p05", "p60")):
        rows = np.zeros((7, N + 3 * len(index)))
        for row, (name, axis) in enumerate(
            [
                (chosen[0], 0),
                (chosen[0], 1),
                (chosen[0], 2),
                (chosen[1], 0),
                (chosen[1], 1),
                (chosen[1], 2),
                (chosen[2], 2),
            ]
        ):
            rows[row, N + 3 * index[name] + axis] = 1.0
        oracle = dense(free, constraints=rows)
        assert np.trace(oracle.covariance[N:, N:]) > 1.01 * trace
        np.testing.assert_allclose(  # what the datum has no part in
            1.0 - np.diagonal(oracle.leverage)[: 2 * len(free.block.observations)],
            reliability(free).redundancy.ravel(),
            rtol=0.0,
            atol=1e-6,
        )


@pytest.mark.costly
def test_points_of_a_free_network_stay_where_they_started(free: Adjustment) -> None:
    start = np.asarray(free.prepared.problem.start.points)[free.prepared.order.row_of_point]
    place = free.points.place
    np.testing.assert_allclose(place.mean(axis=0), start.mean(axis=0), rtol=0.0, atol=1e-7)  # m
    a, b = place - place.mean(axis=0), start - start.mean(axis=0)
    np.testing.assert_allclose(np.cross(a, b).sum(axis=0) / np.sum(a * a), 0.0, atol=1e-10)  # rad
    assert np.sum(a * (b - a)) / np.sum(a * a) == pytest.approx(0.0, abs=1e-10)  # scale


@pytest.mark.costly
def test_a_network_that_is_free_to_turn_about_a_point_keeps_that_point() -> None:
    of = simulated().noisy(4)
    one = of.control(names=("p05",))
    nothing = {"sigma_position": np.inf, "sigma_attitude": np.inf}
    found = adjust(disturbed(of.block(control=one, **nothing), 0.5, 0.002), datum=InnerConstraints())
    assert found.redundancy == 2 * len(of.observations) - 6 * 15 - 3 * 64 + 7  # the point's place is no use to itself
    np.testing.assert_allclose(found.differences(one), 0.0, atol=1e-6)  # m
    np.testing.assert_allclose(found.points.of(["p05"]).sigma, 0.02, rtol=0.0, atol=1e-6)  # m
    start = np.asarray(found.prepared.problem.start.points)[found.prepared.order.row_of_point]
    a, b = found.points.place - one.place[0], start - one.place[0]
    np.testing.assert_allclose(np.cross(a, b).sum(axis=0) / np.sum(a * a), 0.0, atol=1e-9)  # rad
    assert np.sum(a * (b - a)) / np.sum(a * a) == pytest.approx(0.0, abs=1e-9)


# The ways in which it is computed


def small(cameras: int) -> tuple[Block, Unknowns]:
    """Five images of one strip, each of one of so many cameras, on much control."""
    of = simulated().noisy(6)
    own = np.isin(of.observations.image, of.names[10:])
    seen = of.observations.of(own).seen_often()
    names = np.array([f"c{k % cameras}" for k in range(5)])
    images = Images(of.names[10:], names, of.centre[10:], of.R_frame_from_camera[10:])
    control = of.control(0.02, tuple(np.unique(seen.point)[::2]))
    block = Block(of.frame, {name: camera() for name in names.tolist()}, images, seen, control)
    return block, Unknowns(focal=Prior(10.0), principal=Prior(5.0), distortion={"k1": Free()})


@pytest.mark.slow
def test_lenses_of_single_images_are_found_with_them_or_apart() -> None:
    block, unknowns = small(5)
    found = adjust(block, unknowns)
    assert found.prepared.problem.own_lens
    apart = replace_static(prepared(block, unknowns).problem, own_lens=False)
    solution = solve(apart)
    other = replace(found, prepared=found.prepared._replace(problem=apart), solution=solution)
    other = Adjustment(block, unknowns, other.prepared, solution, found.loss)
    np.testing.assert_allclose(found.images.centre, other.images.centre, rtol=0.0, atol=1e-6)  # m
    np.testing.assert_allclose(found.points.place, other.points.place, rtol=0.0, atol=1e-6)  # m
    np.testing.assert_allclose(found.points.covariance, other.points.covariance, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(reliability(found).redundancy, reliability(other).redundancy, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(found.correlations, other.correlations, rtol=0.0, atol=1e-7)
    assert [(p.whose, p.name) for p in found.parameters] == [(p.whose, p.name) for p in other.parameters]
    for a, b in zip(found.parameters, other.parameters, strict=True):
        assert a.value == pytest.approx(b.value, abs=1e-5 * b.sigma)
        assert a.sigma == pytest.approx(b.sigma, rel=1e-6)
    assert_is(found, dense(found))


def replace_static(problem: Any, **changes: Any) -> Any:
    """A problem with other static fields."""
    fields = {name: getattr(problem, name) for name in problem.__dataclass_fields__} | changes
    return type(problem)(**fields)


CHUNKS = {  # settings, whether all groups then have all columns (or some do not), whether any has many chunks
    "all columns": ({"SCATTER": 1e9}, True, False),
    "all columns, in parts": ({"SCATTER": 1e9, "DENSE_BYTES": 1, "DENSE_POINTS": 20}, True, True),
    "few columns": ({"DENSE_COLUMNS": 0, "POINTS": (5,)}, False, True),
    "images in many rows": ({"SCATTER": 1e9, "MOST_UNLIKE": 0}, True, False),
    "few columns, in batches": ({"DENSE_COLUMNS": 0, "POINTS": (5,), "BATCH_BYTES": 1}, False, True),
}


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [1, 5])
def test_how_points_are_chunked_does_not_matter(cameras: int, monkeypatch: pytest.MonkeyPatch) -> None:
    block, unknowns = small(cameras)
    ways = []
    for settings, dense_columns, many in CHUNKS.values():
        with monkeypatch.context() as patch:
            for name, value in settings.items():
                patch.setattr(layouts, name, value)
            ways.append(adjust(block, unknowns))
        groups = ways[-1].prepared.problem.layout.groups
        assert all(group.dense for group in groups) == dense_columns
        assert any(group.chunks > 1 for group in groups) == many
    dense_way = ways[0]
    for found in ways[1:]:
        assert found.cost == pytest.approx(dense_way.cost, rel=1e-10)
        np.testing.assert_allclose(found.images.centre, dense_way.images.centre, rtol=0.0, atol=1e-7)  # m
        np.testing.assert_allclose(found.points.place, dense_way.points.place, rtol=0.0, atol=1e-7)  # m
        sigma = np.sqrt(np.diagonal(dense_way.covariance))
        assert_same(found.covariance, dense_way.covariance, sigma, 1e-8)
        np.testing.assert_allclose(found.points.covariance, dense_way.points.covariance, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(
            reliability(found).redundancy, reliability(dense_way).redundancy, rtol=0.0, atol=1e-9
        )


# Chance


@pytest.mark.slow
def test_covariances_are_those_of_many_draws() -> None:
    truth, draws = simulated(), 150
    rng = np.random.default_rng(0)
    places, centres, sigma0 = [], [], []
    for seed in range(draws):
        drawn = truth.noisy(1000 + seed)
        control = GroundPoints(CONTROL, truth.control().place + rng.normal(0.0, 0.02, (len(CONTROL), 3)), 0.02)
        found = adjust(drawn.block(control=control))
        places.append(found.points.place - truth.points.place)
        centres.append(found.images.centre - truth.centre)
        sigma0.append(found.sigma0**2 * found.redundancy)
    covariance = found.points.covariance
    factor = np.linalg.inv(np.linalg.cholesky(covariance))
    whitened = np.einsum("pij,npj->npi", factor, np.stack(places))
    squares = np.sum(whitened**2, axis=0) / draws  # each about one, to sqrt(2 / draws)
    assert np.abs(squares - 1.0).max() < 5.0 * np.sqrt(2.0 / draws)
    assert abs(squares.mean() - 1.0) < 0.07
    cross = np.einsum("npi,npj->pij", whitened, whitened) / draws
    assert np.abs(cross - np.eye(3)[None]).max() < 5.0 * np.sqrt(2.0 / draws)
    own = np.sqrt(np.diagonal(found.covariance_of_images, axis1=1, axis2=2))[:, :3]
    ratio = np.mean(np.stack(centres) ** 2, axis=0) / own**2
    assert np.abs(ratio - 1.0).max() < 5.0 * np.sqrt(2.0 / draws)
    assert abs(np.mean(sigma0) / found.redundancy - 1.0) < 5.0 * np.sqrt(2.0 / (draws * found.redundancy))


@pytest.mark.costly
def test_draws_of_any_kind_of_shot_are_of_its_standard_deviations() -> None:
    """W of the attitude is that of heading, pitch and roll, or of the reference's axes, at any attitude."""
    from jaxgeo.adjust.navigation import navigation_of
    from jaxgeo.rotations import R_from_heading_pitch_roll, rotation_vector_from_R
    from jaxgeo.sensor import Gimbal, Pose

    angles = np.array([[2.0, 0.4, -0.9], [-1.0, -1.2, 0.3], [0.1, 0.0, 3.0], [4.0, 1.0, 2.0]])
    position = jax.tree.map(lambda x: np.repeat(np.asarray(x), 4), Geodetic.from_degrees(lat=10.0, lon=3.0, height=0.0))
    shots = Shot(Pose(position, *angles.T), np.zeros((4, 0)), np.zeros(4))
    of = simulated()
    nav = navigation_of(of.frame, Sensor(camera(), Gimbal.fixed(), MOUNT), shots, 1.0, SIGMA_ATTITUDE, "m", ["s"] * 4)

    def turn(change: Any, given: Any) -> Any:
        R, moved = R_from_heading_pitch_roll(*given), R_from_heading_pitch_roll(*(given + change))
        return rotation_vector_from_R(R.T @ moved)

    slopes = jax.jit(jax.vmap(jax.jacfwd(turn), in_axes=(None, 0)))(jnp.zeros(3), jnp.asarray(angles))
    for T, W in zip(np.asarray(slopes), nav.information_attitude, strict=True):
        np.testing.assert_allclose(W @ T, np.diag(1.0 / SIGMA_ATTITUDE), rtol=0.0, atol=1e-6)
