"""Local level frames against each other, textbook places and the derivative of `to_ecef`."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu, R_ecef_from_ned

NED, ENU = jax.jit(jax.vmap(R_ecef_from_ned)), jax.jit(jax.vmap(R_ecef_from_enu))


def sample():
    rng = np.random.default_rng(0)
    lat, lon = rng.uniform(-np.pi / 2, np.pi / 2, 60), rng.uniform(-np.pi, np.pi, 60)
    lat[:4], lon[:4] = [np.pi / 2, -np.pi / 2, 0.0, 0.0], [0.3, 2.0, np.pi, -np.pi]
    return Geodetic(lat=lat, lon=lon, height=rng.uniform(-100, 9000, 60))


@pytest.mark.parametrize("frame", [NED, ENU], ids=["ned", "enu"])
def test_frames_are_rotations(frame):
    R = np.asarray(frame(sample()))
    np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.broadcast_to(np.eye(3), R.shape), rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, rtol=0, atol=1e-15)


def test_enu_is_ned_renamed():
    ned, enu = np.asarray(NED(sample())), np.asarray(ENU(sample()))
    np.testing.assert_array_equal(enu, np.stack([ned[..., 1], ned[..., 0], -ned[..., 2]], axis=-1))


def test_axes_are_the_directions_in_which_the_position_moves():
    """By central differences of `to_ecef` in latitude, longitude and height."""
    g, to_ecef = sample(), jax.jit(jax.vmap(WGS84.to_ecef))
    R = np.asarray(NED(g))
    M, N = jax.vmap(WGS84.meridian_radius)(g.lat), jax.vmap(WGS84.prime_vertical_radius)(g.lat)
    ground = {
        "lat": np.asarray(M) + g.height,
        "lon": (np.asarray(N) + g.height) * np.cos(g.lat),
        "height": -np.ones(60),
    }
    for axis, (name, metres) in enumerate(ground.items()):
        step = 100.0 if name == "height" else 1e-5
        moved = [
            to_ecef(Geodetic(**{k: getattr(g, k) + (sign * step if k == name else 0.0) for k in ground}))
            for sign in (1.0, -1.0)
        ]
        slope = np.asarray(moved[0] - moved[1]) / (2 * step)
        np.testing.assert_allclose(slope, R[..., axis] * metres[:, None], rtol=0, atol=2e-3 if step < 1 else 1e-9)


def test_axes_at_the_origin_of_longitudes_and_at_the_pole():
    equator = R_ecef_from_ned(Geodetic(lat=0.0, lon=0.0, height=0.0))
    np.testing.assert_allclose(equator, [[0, 0, -1], [0, 1, 0], [1, 0, 0]], rtol=0, atol=1e-16)
    pole = R_ecef_from_ned(Geodetic(lat=np.pi / 2, lon=0.0, height=0.0))
    np.testing.assert_allclose(pole, [[-1, 0, 0], [0, 1, 0], [0, 0, -1]], rtol=0, atol=1e-16)


def test_up_is_the_normal_of_the_ellipsoid():
    g = sample()
    normal, _ = jax.vmap(WGS84.normal_and_height)(jax.vmap(WGS84.to_ecef)(g))
    np.testing.assert_allclose(-np.asarray(NED(g))[..., 2], normal, rtol=0, atol=1e-15)


def test_float32_angles_are_refused():
    with pytest.raises(TypeError, match=r"position\.lat has dtype float32"):
        R_ecef_from_ned(Geodetic(lat=jnp.float32(0.5), lon=0.0, height=0.0))
