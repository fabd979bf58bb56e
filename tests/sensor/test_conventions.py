"""The papers' conventions, literally, against the sensors that stand for them; and Li 2020's flight data."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.sensor import FrameCamera, Pose, Shot, boresight_from_degrees, point_shot
from jaxgeo.sensor.conventions import li_2020_sensor, li_2020_uv, li_2023_sensor, li_2023_uv
from jaxgeo.status import Status

LI_2023 = li_2023_sensor(focal_length=1.9, pixel_pitch=10e-6, width=7584, height=5000)
LI_2020 = {"focal_length": 1.8, "pixel_pitch": 9e-6, "along_flight": 3072, "across_flight": 4096}
SIGHT = np.array([0.0, 0.0, 1.0])


def from_eq_3(theta: float, phi: float) -> np.ndarray:
    """C_S_from_AC of Li et al. 2020, Eq 3, transposed: camera to aircraft."""
    ct, st, cp, sp = np.cos(theta), np.sin(theta), np.cos(phi), np.sin(phi)
    return (np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]]) @ np.array([[1, 0, 0], [0, ct, st], [0, -st, ct]])).T


def from_eq_4(roll: float, pitch: float, heading: float) -> np.ndarray:
    """C_AC_from_NED of Li et al. 2020, Eq 4, transposed: aircraft to north-east-down."""
    ca, sa, cb, sb = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cl, sl = np.cos(heading), np.sin(heading)
    about_x = np.array([[1, 0, 0], [0, ca, sa], [0, -sa, ca]])
    about_y = np.array([[cb, 0, -sb], [0, 1, 0], [sb, 0, cb]])
    about_z = np.array([[cl, sl, 0], [-sl, cl, 0], [0, 0, 1]])
    return (about_x @ about_y @ about_z).T


POSE = Pose.from_degrees(lat=28.9702, lon=89.0043, height=15409.0, heading=-102.48, pitch=2.8679, roll=-0.3876)
ATTITUDE = from_eq_4(*np.deg2rad([-0.3876, 2.8679, -102.48]))


@pytest.mark.parametrize("m, n", [(0.0, 0.0), (3000.0, 0.0), (0.0, -2400.0), (-1234.0, 987.0)])
def test_eq_1_of_li_2023(m, n):
    a, f, outer, inner = 10e-6, 1.9, np.deg2rad(74.6747), np.deg2rad(0.2304)
    image_point = np.array([a * m, a * n, -f])
    literal = ATTITUDE @ from_eq_3(-outer, inner) @ -image_point
    readings = LI_2023.gimbal.readings_from_degrees(outer=74.6747, inner=0.2304)
    assert isinstance(LI_2023.camera, FrameCamera)
    uv = li_2023_uv(LI_2023.camera, m, n)
    _, direction, status = LI_2023.ray_ecef(Shot(POSE, readings), uv)
    assert status == Status.hit
    ned = R_ecef_from_ned(POSE.position).T @ direction
    np.testing.assert_allclose(ned, literal / np.linalg.norm(literal), rtol=0, atol=1e-15)


def test_ins_calibration_of_li_2023_lies_between_attitude_and_gimbal():
    calibration = np.deg2rad([0.3, -0.2, 0.1])  # heading, pitch, roll
    sensor = li_2023_sensor(
        focal_length=1.9,
        pixel_pitch=10e-6,
        width=7584,
        height=5000,
        R_body_from_base=boresight_from_degrees(heading=0.3, pitch=-0.2, roll=0.1),
    )
    literal = ATTITUDE @ from_eq_4(calibration[2], calibration[1], calibration[0]) @ from_eq_3(-1.3, 0.01) @ SIGHT
    np.testing.assert_allclose(
        sensor.R_ned_from_camera(Shot(POSE, np.array([1.3, 0.01]))) @ SIGHT, literal, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("i, j", [(1.0, 1.0), (3072.0, 4096.0), (1536.5, 2048.5), (100.0, 3000.0)])
def test_eq_13_of_li_2020(i, j):
    a, f, M, N = 9e-6, 1.8, 3072, 4096
    theta, phi = np.deg2rad([-74.0, -0.83])
    image_point = np.array([a * ((M + 1) / 2 - i), a * (j - (N + 1) / 2), -f])
    literal = ATTITUDE @ from_eq_3(theta, phi) @ -image_point
    for mirror, readings in ((False, np.array([-theta, phi])), (True, np.deg2rad([16.0, 45.415]))):
        sensor = li_2020_sensor(**LI_2020, mirror=mirror)
        _, direction, status = sensor.ray_ecef(Shot(POSE, readings), li_2020_uv(i, j))
        assert status == Status.hit
        ned = R_ecef_from_ned(POSE.position).T @ direction
        np.testing.assert_allclose(ned, literal / np.linalg.norm(literal), rtol=0, atol=1e-15)


def test_images_are_not_mirrored():
    for sensor in (LI_2023, li_2020_sensor(**LI_2020)):
        assert np.linalg.det(sensor.mount.R_head_from_camera) == pytest.approx(1.0)
        np.testing.assert_array_equal(sensor.mount.R_head_from_camera @ SIGHT, SIGHT)


def test_compensation_example_of_li_2020():
    """Heading 180 -> 179, pitch and roll 0 -> 1 deg at theta = -74, phi = 0: what brings the line of sight back."""
    frame, mirror = li_2020_sensor(**LI_2020, mirror=False), li_2020_sensor(**LI_2020)
    here = {"lat": 34.86, "lon": 109.51, "height": 8143.0}
    before = Pose.from_degrees(**here, heading=180.0)
    after = Pose.from_degrees(**here, heading=179.0, pitch=1.0, roll=1.0)
    sight_ned = frame.R_ned_from_camera(Shot(before, frame.gimbal.readings_from_degrees(outer=74.0, inner=0.0))) @ SIGHT
    b = after.R_ned_from_body.T @ sight_ned
    phi, theta = np.rad2deg(np.arcsin(b[0])), np.rad2deg(np.arctan2(-b[1], b[2]))
    assert theta + 74.0 == pytest.approx(-1.01613, abs=5e-6)
    assert abs(phi) == pytest.approx(1.23679, abs=5e-6)

    p_ecef = WGS84.to_ecef(before.position) + 3e4 * R_ecef_from_ned(before.position) @ sight_ned
    point = WGS84.to_geodetic(p_ecef)
    readings = point_shot(mirror, after, point).gimbal_readings
    np.testing.assert_allclose(np.rad2deg(mirror.gimbal.angles(readings)), [theta, phi], rtol=0, atol=1e-9)
    depression, azimuth = np.rad2deg(readings)
    assert depression - 16.0 == pytest.approx(-1.01613, abs=5e-6)
    assert abs(azimuth - 45.0) == pytest.approx(0.61839, abs=5e-6)


# Heading, pitch, roll, azimuth drive, depression drive in deg of five strips flown (Li et al. 2020, Table 4). The table
# prints beta with roll and alpha with pitch, the other way round than its Eq 4: the words hold.
TABLE_4 = np.array(
    [
        [159.086, 3.630, 2.158, 45.415, 13.885],
        [159.214, 3.789, 2.081, 45.398, 13.961],
        [159.263, 3.766, 1.820, 45.361, 14.216],
        [159.471, 3.621, 1.826, 45.235, 14.211],
        [159.543, 3.652, 1.820, 45.219, 14.216],
    ]
)


def azimuth_and_depression(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sensor, here = li_2020_sensor(**LI_2020), Geodetic.from_degrees(lat=34.86, lon=109.51, height=8143.0)

    def sight(heading, pitch, roll, azimuth, depression):
        readings = jax.numpy.stack([depression, azimuth])
        return sensor.R_ned_from_camera(Shot(Pose(here, heading, pitch, roll), readings)) @ SIGHT

    north, east, down = np.asarray(jax.jit(jax.vmap(sight))(*np.deg2rad(rows).T)).T
    return np.rad2deg(np.arctan2(east, north)) % 360.0, np.rad2deg(np.arcsin(down))


def test_line_of_sight_of_table_4_of_li_2020_stays_put():
    azimuth, depression = azimuth_and_depression(TABLE_4)
    assert azimuth.mean() == pytest.approx(248.93, abs=0.005)
    assert azimuth.std() < 0.02
    assert azimuth.std() == pytest.approx(0.018, abs=0.0005)
    assert 16.03 <= depression.min().round(2) <= depression.max().round(2) <= 16.06
    swapped = TABLE_4[:, [0, 2, 1, 3, 4]]
    assert azimuth_and_depression(swapped)[0].std() > 0.05
