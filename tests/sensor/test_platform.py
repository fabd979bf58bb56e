"""Mounts and poses: frames, attitudes, and the angles of photogrammetry."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.sensor import FrameCamera, Mount, Pose, Sensor, Shot, boresight_from_degrees

HERE = Geodetic.from_degrees(lat=48.6, lon=7.7, height=1200.0)


def test_attitude_turns_heading_then_pitch_then_roll():
    pose = Pose.from_degrees(lat=10.0, lon=20.0, height=5e3, heading=-102.48, pitch=2.8679, roll=-0.3876)
    literal = Rotation.from_euler("ZYX", [-102.48, 2.8679, -0.3876], degrees=True).as_matrix()
    np.testing.assert_allclose(pose.R_ned_from_body, literal, rtol=0, atol=1e-15)
    nose = Pose(HERE, 0.0, 0.1, 0.0).R_ned_from_body @ jnp.array([1.0, 0.0, 0.0])
    right_wing = Pose(HERE, 0.0, 0.0, 0.1).R_ned_from_body @ jnp.array([0.0, 1.0, 0.0])
    assert nose[2] < 0.0
    assert right_wing[2] > 0.0


def test_boresight_is_a_rotation_of_any_size():
    literal = Rotation.from_euler("ZYX", [-4.2, 100.0, 19.0], degrees=True).as_matrix()
    R = boresight_from_degrees(heading=-4.2, pitch=100.0, roll=19.0)
    np.testing.assert_allclose(R, literal, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(boresight_from_degrees(), np.eye(3))


@pytest.mark.parametrize(
    "mount, right, down, forward",
    [
        (Mount(), [1, 0, 0], [0, 1, 0], [0, 0, 1]),
        (Mount.nadir(), [0, 1, 0], [-1, 0, 0], [0, 0, 1]),
        (Mount.forward(), [0, 1, 0], [0, 0, 1], [1, 0, 0]),
    ],
    ids=["identity", "nadir", "forward"],
)
def test_mounts_point_the_camera(mount, right, down, forward):
    np.testing.assert_array_equal(np.stack([right, down, forward], axis=1), mount.R_head_from_camera)
    assert np.linalg.det(mount.R_head_from_camera) == pytest.approx(1.0)
    assert np.all(mount.lever_body == 0.0)
    assert np.all(mount.lever_head == 0.0)


def angles_of_photogrammetry(count: int = 20) -> np.ndarray:
    return np.random.default_rng(2).uniform([-0.8, -0.8, -3.1], [0.8, 0.8, 3.1], (count, 3))


def test_omega_phi_kappa_and_back():
    def there_and_back(angles, convergence):
        pose = Pose.from_omega_phi_kappa(HERE, *angles, convergence=convergence)
        return jnp.stack(pose.to_omega_phi_kappa(convergence=convergence)), pose.R_ned_from_body

    angles, convergence = angles_of_photogrammetry(), np.linspace(-0.5, 0.5, 20)
    back, R = jax.jit(jax.vmap(there_and_back))(angles, convergence)
    np.testing.assert_allclose(back, angles, rtol=0, atol=1e-14)
    np.testing.assert_allclose(jnp.einsum("nij,nkj->nik", R, R), np.tile(np.eye(3), (20, 1, 1)), rtol=0, atol=1e-14)


def test_omega_phi_kappa_project_as_the_collinearity_equations_of_photogrammetry():
    """Two literal forms, by SciPy, of the same fact: that of the block `dbat_sxb` and that of `ign_block`.

    d = (Rx(omega) Ry(phi) Rz(kappa))' (P - C), column = xp - f d_x / d_z, row = yp + f d_y / d_z; and world to camera
    = Rx(pi) R_xyz_extrinsic(-omega, -phi, -kappa), column = xp + f X / Z, row = yp + f Y / Z.
    """
    f, convergence, (xp, yp) = 20656.0, 0.3, (4429.5, 6468.5)
    sensor = Sensor(FrameCamera.from_pixels(focal_px=f, width=9000, height=13000, principal_px=(xp, yp)))
    # Easting, northing and up of the grid in ECEF; its north is turned clockwise.
    R_enu_from_map = Rotation.from_euler("z", -convergence).as_matrix()
    R_ecef_from_map = R_ecef_from_enu(HERE) @ R_enu_from_map

    @jax.jit
    @jax.vmap
    def project(angles, offset):
        pose = Pose.from_omega_phi_kappa(HERE, *angles, convergence=convergence)
        return sensor.project_ecef(Shot(pose), WGS84.to_ecef(HERE) + R_ecef_from_map @ offset)[0]

    angles = angles_of_photogrammetry() * [0.2, 0.2, 1.0]
    offsets = np.random.default_rng(4).uniform([-100, -100, -1200], [100, 100, -1000], (20, 3))
    uv = project(angles, offsets)
    for i, ((omega, phi, kappa), offset) in enumerate(zip(angles, offsets, strict=True)):
        d = Rotation.from_euler("XYZ", [omega, phi, kappa]).as_matrix().T @ offset
        np.testing.assert_allclose(uv[i], [xp - f * d[0] / d[2], yp + f * d[1] / d[2]], rtol=0, atol=1e-6)  # px
        extrinsic = Rotation.from_euler("xyz", [-omega, -phi, -kappa]).as_matrix()
        X, Y, Z = Rotation.from_euler("x", np.pi).as_matrix() @ extrinsic @ offset
        np.testing.assert_allclose(uv[i], [xp + f * X / Z, yp + f * Y / Z], rtol=0, atol=1e-6)


def test_a_level_camera_with_its_top_to_grid_north_has_no_angles():
    pose = Pose.from_omega_phi_kappa(HERE, 0.0, 0.0, 0.0, convergence=np.deg2rad(2.0))
    np.testing.assert_allclose(np.rad2deg([pose.heading, pose.pitch, pose.roll]), [2.0, 0.0, 0.0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("lat, lon, height", [(48.7, 7.5, 300.0), (48.5, 7.7, 9000.0), (48.6, 7.7, 0.0), (49, 8, 1e3)])
def test_pose_looks_at_a_point(lat, lon, height):
    point = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    pose = Pose.looking_at(position=HERE, point=point, roll=0.2)
    sight = WGS84.to_ecef(point) - WGS84.to_ecef(HERE)
    forward = R_ecef_from_ned(HERE) @ pose.R_ned_from_body[:, 0]
    np.testing.assert_allclose(forward, sight / np.linalg.norm(sight), rtol=0, atol=1e-9)  # 1e-9 rad: of ECEF metres
    assert pose.roll == 0.2
    camera = FrameCamera.from_pixels(focal_px=1000.0, width=200, height=100)
    uv, _ = Sensor(camera, mount=Mount.forward()).project_ecef(Shot(pose), WGS84.to_ecef(point))
    np.testing.assert_allclose(uv, [99.5, 49.5], rtol=0, atol=2e-6)


MISTAKES = {
    "heading": ({"heading": 400.0}, r"heading must lie in \[-360, 360\] deg; got 400"),
    "pitch": ({"pitch": -91.0}, r"pitch must lie in \[-90, 90\] deg; got -91"),
    "roll": ({"roll": np.nan}, "roll must be finite, in deg; got nan"),
    "latitude": ({"lat": 95.0}, r"lat must lie in \[-90, 90\] deg; got 95"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_from_degrees_says_what_is_wrong(name):
    arguments, message = MISTAKES[name]
    with pytest.raises(ValueError, match=message):
        Pose.from_degrees(**{"lat": 1.0, "lon": 2.0, "height": 3.0, **arguments})


def test_mount_and_boresight_say_what_is_wrong():
    with pytest.raises(ValueError, match="lever_head must be finite, in m"):
        Mount.nadir(lever_head=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"boresight roll must lie in \[-360, 360\] deg; got 1000"):
        boresight_from_degrees(roll=1000.0)


def test_records_may_carry_a_batch_axis():
    four = np.arange(4.0)
    poses = Pose.from_degrees(lat=four, lon=four, height=four, heading=four, pitch=0 * four, roll=0 * four)
    R = jax.vmap(lambda pose: pose.R_ned_from_body)(poses)
    np.testing.assert_allclose(R[3], Rotation.from_euler("z", 3.0, degrees=True).as_matrix(), rtol=0, atol=1e-15)
