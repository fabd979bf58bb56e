"""Gimbals: order and sense of the axes, gains, offsets, limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.sensor import Gimbal

GIMBALS = {
    "fixed": Gimbal.fixed(),
    "two axes": Gimbal.two_axis(),
    "mirror": Gimbal.mirror_two_axis(),
    "three axes": Gimbal.three_axis(),
    "pan and tilt": Gimbal.from_degrees(
        axes={"pan": "z", "tilt": "y"}, sign=(1, -1), gain=(1.0, 0.5), offset=(10.0, -3.0), limits=(-90.0, 90.0)
    ),
}


def literal(gimbal: Gimbal, readings: np.ndarray) -> np.ndarray:
    """Intrinsic rotations about the axes in order, by SciPy."""
    angles = gimbal.sign * gimbal.gain * (readings - gimbal.offset)
    R = np.eye(3)
    for axis, angle in zip(gimbal.axes, angles, strict=True):
        R = R @ Rotation.from_euler(axis, float(angle)).as_matrix()
    return R


@pytest.mark.parametrize("name", GIMBALS)
def test_head_turns_about_the_axes_in_order(name):
    gimbal = GIMBALS[name]
    readings = np.random.default_rng(1).uniform(-1.2, 1.2, len(gimbal.axes))
    R = gimbal.R_base_from_head(readings)
    np.testing.assert_allclose(R, literal(gimbal, readings), rtol=0, atol=1e-15)
    np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=1e-15)
    np.testing.assert_allclose(gimbal.R_base_from_head(gimbal.neutral_readings()), np.eye(3), rtol=0, atol=1e-15)


def test_outer_reading_of_the_two_axis_frame_looks_to_the_right():
    gimbal = Gimbal.two_axis()
    down = np.array([0.0, 0.0, 1.0])
    sight = gimbal.R_base_from_head(gimbal.readings_from_degrees(outer=30.0, inner=0.0)) @ down
    np.testing.assert_allclose(sight, [0.0, 0.5, np.sqrt(0.75)], rtol=0, atol=1e-15)
    sight = gimbal.R_base_from_head(gimbal.readings_from_degrees(outer=0.0, inner=30.0)) @ down
    np.testing.assert_allclose(sight, [0.5, 0.0, np.sqrt(0.75)], rtol=0, atol=1e-15)


def test_mirror_turns_the_sight_twice_as_far_as_its_drive():
    gimbal = Gimbal.mirror_two_axis()
    theta, phi = gimbal.angles(gimbal.readings_from_degrees(depression=16.0, azimuth=45.4))
    np.testing.assert_allclose(np.rad2deg([theta, phi]), [-74.0, -0.8], rtol=0, atol=1e-12)


def test_drone_reports_heading_and_elevation_of_the_head():
    gimbal = Gimbal.three_axis()
    assert gimbal.reference == "level"
    forward = np.array([1.0, 0.0, 0.0])
    sight = gimbal.R_base_from_head(gimbal.readings_from_degrees(yaw=90.0, pitch=-60.0, roll=0.0)) @ forward
    np.testing.assert_allclose(sight, [0.0, 0.5, np.sqrt(0.75)], rtol=0, atol=1e-15)  # east and down


def test_limits_include_their_bounds():
    gimbal = Gimbal.from_degrees(axes={"pan": "z", "tilt": "y"}, limits=((-170.0, 170.0), (-90.0, 30.0)))
    for pan, tilt, inside in ((0.0, 0.0, True), (170.0, -90.0, True), (171.0, 0.0, False), (0.0, 31.0, False)):
        assert gimbal.inside_limits(gimbal.readings_from_degrees(pan=pan, tilt=tilt)) == inside
    assert Gimbal.fixed().inside_limits(np.zeros(0))
    np.testing.assert_allclose(
        Gimbal.from_degrees(axes={"tilt": "y"}, limits=(20.0, 30.0)).neutral_readings(), np.deg2rad([20.0])
    )


def test_readings_may_be_a_batch():
    gimbal = Gimbal.two_axis()
    readings = gimbal.readings_from_degrees(inner=0.5, outer=np.array([70.0, 75.0]))
    np.testing.assert_allclose(np.rad2deg(readings), [[70.0, 0.5], [75.0, 0.5]])
    assert Gimbal.fixed().readings_from_degrees().shape == (0,)


MISTAKES = {
    "axis": (lambda: Gimbal.from_degrees(axes={"pan": "up"}), "Axis 'pan' must turn about 'x', 'y' or 'z'.*got 'up'"),
    "sign": (lambda: Gimbal.from_degrees(axes={"pan": "z"}, sign=2.0), r"sign must be \+1 or -1 .* got \[2.0\]"),
    "gain": (lambda: Gimbal.from_degrees(axes={"pan": "z"}, gain=0.0), r"gain must not be zero.* got \[0.0\]"),
    "offset": (lambda: Gimbal.from_degrees(axes={"pan": "z"}, offset=np.nan), "offset must be finite, in deg"),
    "limits": (
        lambda: Gimbal.from_degrees(axes={"pan": "z"}, limits=(9.0, 1.0)),
        "limits must be .lowest, highest.",
    ),
    "missing reading": (lambda: Gimbal.two_axis().readings_from_degrees(outer=1.0), "readings are outer, inner; got"),
    "reading not finite": (
        lambda: Gimbal.two_axis().readings_from_degrees(outer=np.inf, inner=0.0),
        "outer must be finite, in deg; got inf",
    ),
    "too many readings": (lambda: Gimbal.two_axis().R_base_from_head(np.zeros(3)), r"2 axes \(outer, inner\).*\(3,\)"),
    "a batch of readings": (lambda: Gimbal.fixed().R_base_from_head(np.zeros(1)), r"0 axes \(none\).* got \(1,\)"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named(name):
    mistake, message = MISTAKES[name]
    with pytest.raises(ValueError, match=message):
        mistake()
