"""Closed formulas of overlap over level ground: the paper's numbers, the laws between them, and refusals."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.coverage import geometry
from jaxgeo.coverage.compensation_formulas import (
    angles_towards,
    compensation_of_eqs_25_26,
    exact_compensation,
    line_of_sight_head,
    line_of_sight_ned,
)
from jaxgeo.rotations import R_from_heading_pitch_roll

CHANGES = np.radians([0.2, 0.4, 0.6, 0.8, 1.0])
LOOK = {"off_nadir": math.radians(74.0), "field_of_view": math.radians(0.88)}
LEVEL = {"height_above_ground": 8143.0, **LOOK}
SPEED = 620.09 / 3.6  # m/s


def by_heading() -> jax.Array:
    return geometry.overlap_change_by_heading(heading_change=CHANGES, **LOOK)


def by_pitch() -> jax.Array:
    return geometry.overlap_change_by_pitch(pitch_change=CHANGES, **LOOK)


def by_roll() -> jax.Array:
    return geometry.overlap_change_by_roll(off_nadir_change=CHANGES, off_nadir=LOOK["off_nadir"], overlap=0.15)


def over_the_mountain() -> jax.Array:
    return 0.15 + geometry.overlap_change_by_height(height_change=-620.0, height_above_ground=8080.0)


# Li et al. (2020), Tables 1 to 3 and section 4. The prints of Table 2 are 2.155 % larger than the formula.
@pytest.mark.parametrize(
    "find, expected, tolerance",
    [
        (by_heading, [0.2185, 0.4369, 0.6554, 0.8738, 1.0923], 5e-5),
        (by_heading, [0.2185, 0.4369, 0.6553, 0.8738, 1.0920], 3e-4),
        (by_pitch, [-0.06264, -0.12529, -0.18794, -0.25059, -0.31325], 5e-6),
        (by_roll, [0.0104, 0.0207, 0.0311, 0.0415, 0.0519], 5e-5),
        (over_the_mountain, 0.0733, 5e-5),
    ],
)
def test_numbers_of_the_paper(find, expected, tolerance) -> None:
    np.testing.assert_allclose(find(), expected, rtol=0, atol=tolerance)


def test_print_of_table_2_is_a_constant_factor_larger() -> None:
    printed = np.array([-0.0640, -0.1280, -0.1920, -0.2560, -0.3200])
    ratio = printed / np.asarray(by_pitch())
    np.testing.assert_allclose(ratio, 1.02155, rtol=0, atol=1e-4)


def test_period_of_table_4() -> None:
    """Row 1 and the mean depression of the line of sight, 16.047 deg."""
    look = {"off_nadir": math.radians(90.0 - 16.047), "field_of_view": math.radians(0.88)}
    period = geometry.period_of_overlap(overlap=0.15, speed=SPEED, height_above_ground=8143.0, **look)
    assert float(period) == pytest.approx(2.233, abs=5e-4)


def test_straight_down() -> None:
    """At nadir the frame is 2 H tan(omega/2), heading has no part, and pitch shifts by H tan."""
    nadir = {"off_nadir": 0.0, "field_of_view": 0.2}
    length = geometry.frame_length(height_above_ground=1000.0, **nadir)
    assert float(length) == pytest.approx(2000.0 * math.tan(0.1), rel=1e-15)
    assert float(geometry.overlap_change_by_heading(heading_change=0.3, **nadir)) == 0.0
    assert float(geometry.along_offset_by_heading(heading_change=0.3, height_above_ground=1.0, off_nadir=0.0)) == 0.0
    shift = -geometry.overlap_change_by_pitch(pitch_change=0.05, **nadir) * length
    assert float(shift) == pytest.approx(1000.0 * math.tan(0.05), rel=1e-14)


def test_changes_of_heading_are_offsets_over_the_length() -> None:
    """Eq 18 is Eq 17 over Eq 1, whatever the height; both offsets lie on a circle about the aircraft's foot."""
    place = {"height_above_ground": 8143.0, "off_nadir": LOOK["off_nadir"]}
    along = geometry.along_offset_by_heading(heading_change=CHANGES, **place)
    across = geometry.across_offset_by_heading(heading_change=CHANGES, **place)
    change = by_heading()
    np.testing.assert_allclose(along / geometry.frame_length(**LEVEL), change, rtol=1e-14)
    radius = 8143.0 * math.tan(LOOK["off_nadir"])
    np.testing.assert_allclose(np.hypot(along, radius - across), radius, rtol=1e-14)


def test_roll_keeps_the_step() -> None:
    """Eq 22 is the difference of Eq 20 at the two angles, for the step that gives the wished overlap."""
    step = geometry.path_of_overlap(overlap=0.15, **LEVEL)
    for change in CHANGES.tolist():
        rolled = {**LEVEL, "off_nadir": LOOK["off_nadir"] + change}
        difference = geometry.overlap_at(step=step, **rolled) - geometry.overlap_at(step=step, **LEVEL)
        found = geometry.overlap_change_by_roll(off_nadir_change=change, off_nadir=LOOK["off_nadir"], overlap=0.15)
        assert float(found) == pytest.approx(float(difference), abs=1e-14)


def test_height_keeps_the_step_too() -> None:
    """The overlap itself after a change of height; Eq 28 is its slope for frames that do not overlap."""
    step = geometry.path_of_overlap(overlap=0.15, **LEVEL)
    change = float(geometry.height_change(aircraft=-100.0, ground=520.0))
    after = geometry.overlap_after_height_change(height_change=change, height_above_ground=8143.0, overlap=0.15)
    direct = geometry.overlap_at(step=step, **{**LEVEL, "height_above_ground": 8143.0 - 620.0})
    assert float(after) == pytest.approx(float(direct), abs=1e-14)

    def overlap(metres: jax.Array) -> jax.Array:
        return geometry.overlap_after_height_change(height_change=metres, height_above_ground=8143.0, overlap=0.0)

    slope = geometry.overlap_change_by_height(height_change=1.0, height_above_ground=8143.0)
    assert float(jax.grad(overlap)(0.0)) == pytest.approx(float(slope), rel=1e-14)


@pytest.mark.parametrize("overlap", [0.0, 0.15, 0.6, 0.99])
def test_inverse_pairs(overlap) -> None:
    period = geometry.period_of_overlap(overlap=overlap, speed=SPEED, **LEVEL)
    path = geometry.path_of_overlap(overlap=overlap, **LEVEL)
    integral = geometry.velocity_height_of_overlap(overlap=overlap, **LOOK)
    back = [
        geometry.overlap_of_period(period=period, speed=SPEED, **LEVEL),
        geometry.overlap_of_path(path=path, **LEVEL),
        geometry.overlap_of_velocity_height(integral=integral, **LOOK),
        geometry.overlap_of_step(geometry.step_of_overlap(overlap, 453.7), 453.7),
    ]
    np.testing.assert_allclose(back, overlap, rtol=0, atol=1e-14)
    assert float(period) * SPEED == pytest.approx(float(path), rel=1e-14)
    assert float(integral) * 8143.0 == pytest.approx(float(path), rel=1e-14)


def test_speed_changes_the_path() -> None:
    faster = geometry.overlap_of_period(period=2.2, speed=SPEED + 1.7, **LEVEL)
    usual = geometry.overlap_of_period(period=2.2, speed=SPEED, **LEVEL)
    change = geometry.overlap_change_by_speed(speed_change=1.7, period=2.2, **LEVEL)
    assert float(change) == pytest.approx(float(faster - usual), abs=1e-14)
    assert float(change) < 0.0


DERIVATIVES = {
    "heading": (lambda x: geometry.overlap_change_by_heading(heading_change=x, **LOOK), 0.01),
    "across": (
        lambda x: geometry.across_offset_by_heading(heading_change=x, height_above_ground=1.0, off_nadir=1.2),
        0.0,
    ),
    "pitch": (lambda x: geometry.overlap_change_by_pitch(pitch_change=x, **LOOK), 0.01),
    "roll": (lambda x: geometry.overlap_change_by_roll(off_nadir_change=x, off_nadir=1.2, overlap=0.15), 0.01),
    "off nadir": (lambda x: geometry.overlap_at(step=385.0, **{**LEVEL, "off_nadir": x}), 1.2),
    "field": (lambda x: geometry.overlap_at(step=385.0, **{**LEVEL, "field_of_view": x}), 0.0154),
    "period": (lambda x: geometry.period_of_overlap(overlap=x, speed=SPEED, **LEVEL), 0.15),
}


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives(name) -> None:
    """Forward mode against central differences, under jit."""
    function, at = DERIVATIVES[name]
    step = 1e-6
    numeric = (float(function(at + step)) - float(function(at - step))) / (2.0 * step)
    exact = jax.jit(jax.jacfwd(function))(jnp.asarray(at))
    assert float(exact) == pytest.approx(numeric, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: geometry.overlap_at(step=1.0, **{**LEVEL, "field_of_view": 0.0}), "field_of_view .* covers no .* 0.0"),
        (
            lambda: geometry.frame_length(**{**LEVEL, "field_of_view": math.pi}),
            "field_of_view must lie between .* 3.14",
        ),
        (
            lambda: geometry.frame_length(**{**LEVEL, "field_of_view": -0.1}),
            "field_of_view must lie between .* got -0.1",
        ),
        (lambda: geometry.frame_length(**{**LEVEL, "off_nadir": 0.5 * math.pi}), r"off_nadir .* \[0, pi/2\) .* 1.57"),
        (lambda: geometry.frame_length(**{**LEVEL, "off_nadir": -0.2}), "off_nadir .* got -0.2"),
        (
            lambda: geometry.frame_length(**{**LEVEL, "height_above_ground": 0.0}),
            "height_above_ground .* above 0 m; got 0",
        ),
        (lambda: geometry.frame_length(**{**LEVEL, "height_above_ground": math.nan}), "height_above_ground .* finite"),
        (
            lambda: geometry.period_of_overlap(overlap=1.0, speed=1.0, **LEVEL),
            r"overlap must lie in \[0, 1\).* got 1.0",
        ),
        (lambda: geometry.path_of_overlap(overlap=-0.1, **LEVEL), r"overlap must lie in \[0, 1\).* got -0.1"),
        (lambda: geometry.period_of_overlap(overlap=0.1, speed=0.0, **LEVEL), "speed must be above 0 m/s; got 0.0"),
        (lambda: geometry.overlap_of_period(period=-1, speed=1.0, **LEVEL), "period must be above 0 s; got -1"),
        (lambda: geometry.overlap_of_step(1.0, [1.0, -2.0]), r"length must be above 0 m; got \[1.0, -2.0\]"),
        (lambda: geometry.overlap_of_step(math.inf, 1.0), "step must be finite"),
        (
            lambda: geometry.overlap_after_height_change(height_change=-9.0, height_above_ground=8.0, overlap=0.1),
            "height_above_ground . height_change must be above 0 m; got -1.0",
        ),
    ],
)
def test_refusals(call, message) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_single_precision_is_refused() -> None:
    with pytest.raises(TypeError, match="off_nadir has dtype float32"):
        geometry.frame_length(**{**LEVEL, "off_nadir": np.float32(1.2)})


# Gimbal angles in closed form: Eqs 23-26.
THETA = math.radians(-74.0)


@pytest.fixture(scope="module")
def before() -> jax.Array:
    return attitude(180.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def after() -> jax.Array:
    return attitude(179.0, 1.0, 1.0)


def attitude(heading: float, pitch: float, roll: float) -> jax.Array:
    return R_from_heading_pitch_roll(*jnp.deg2rad(jnp.array([heading, pitch, roll])))


@pytest.mark.parametrize("solve", [exact_compensation, compensation_of_eqs_25_26])
def test_compensation_example(solve, before, after) -> None:
    """Heading 180 -> 179, pitch and roll 0 -> 1 deg: printed -1.016, and 0.618 for the mirror's drive."""
    change = solve(after, THETA, 0.0, line_of_sight_ned(before, THETA, 0.0))
    assert math.degrees(change.theta) == pytest.approx(-1.01613, abs=5e-6)
    assert math.degrees(change.phi) == pytest.approx(-1.23679, abs=5e-6)
    assert math.degrees(-0.5 * change.phi) == pytest.approx(0.61839, abs=5e-6)


@pytest.mark.parametrize("phi_deg, left_deg", [(0.0, 0.0), (10.0, 0.0102), (-10.0, 0.0212)])
def test_what_the_printed_compensation_leaves(phi_deg, left_deg, before, after) -> None:
    phi = math.radians(phi_deg)
    sight = line_of_sight_ned(before, THETA, phi)
    for solve, expected in ((exact_compensation, 0.0), (compensation_of_eqs_25_26, left_deg)):
        change = solve(after, THETA, phi, sight)
        reached = np.asarray(line_of_sight_ned(after, THETA + change.theta, phi + change.phi))
        left = math.degrees(np.linalg.norm(reached - np.asarray(sight)))
        assert left == pytest.approx(expected, abs=5e-5 if expected else 1e-13)


@pytest.mark.parametrize("theta, phi", [(-1.29, 0.0), (0.0, 0.2), (1.2, -0.4), (-2.5, 1.5)])
def test_angles_and_lines_of_sight_are_inverse(theta, phi, after) -> None:
    sight = line_of_sight_ned(after, theta, phi)
    found = angles_towards(after, 3.0 * sight)
    np.testing.assert_allclose(np.array(found), [theta, phi], rtol=0, atol=1e-14)
    np.testing.assert_allclose(line_of_sight_head(after, theta, phi, sight), [0.0, 0.0, 1.0], rtol=0, atol=1e-15)


def test_angles_have_derivatives(after) -> None:
    """Also along the body's x axis, where theta is undetermined, nothing is NaN."""
    sight = line_of_sight_ned(after, -1.29, 0.1)
    jacobian = np.asarray(jax.jacfwd(lambda s: jnp.stack(angles_towards(after, s)))(sight))
    back = jax.jacfwd(lambda a: line_of_sight_ned(after, a[0], a[1]))(jnp.array([-1.29, 0.1]))
    np.testing.assert_allclose(jacobian @ np.asarray(back), np.eye(2), rtol=0, atol=1e-13)
    ahead = jax.jacrev(lambda s: jnp.stack(angles_towards(after, s)))(after[:, 0])
    assert np.all(np.isfinite(ahead))
