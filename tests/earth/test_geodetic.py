"""Positions from degrees: what is accepted, and what each refusal says."""

from __future__ import annotations

import pickle
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo.earth import WGS84, Geodetic


def test_degrees_become_radians_and_come_back():
    g = Geodetic.from_degrees(lat=45, lon=-180.0, height=np.int32(7))
    assert (float(g.lat), float(g.lon), float(g.height)) == (np.pi / 4, -np.pi, 7.0)
    assert all(x.dtype == jnp.float64 for x in (g.lat, g.lon, g.height))
    np.testing.assert_allclose(np.stack(g.to_degrees()), [45.0, -180.0, 7.0], rtol=0, atol=1e-14)


def test_a_batch_keeps_its_shape():
    g = Geodetic.from_degrees(lat=np.zeros((2, 3)), lon=np.full((2, 3), 359.0), height=np.ones((2, 3)))
    assert g.lat.shape == g.lon.shape == g.height.shape == (2, 3)


@pytest.mark.parametrize(
    "values, words",
    [
        ({"lat": 90.1}, r"lat must lie in \[-90, 90\] deg; got 90\.1"),
        ({"lat": np.array([0.0, -91.0])}, r"lat must lie in .*-91.* of shape \(2,\)"),
        ({"lon": 361.0}, r"lon must lie in \[-360, 360\] deg; got 361\.0"),
        ({"lat": np.nan}, r"lat must be finite, in deg; got nan"),
        ({"lon": -np.inf}, r"lon must be finite, in deg; got -inf"),
        ({"height": np.nan}, r"height must be finite, in m above the ellipsoid; got nan"),
    ],
)
def test_values_out_of_range_are_named(values, words):
    with pytest.raises(ValueError, match=words):
        Geodetic.from_degrees(**{"lat": 1.0, "lon": 2.0, "height": 3.0, **values})


def test_float32_degrees_are_refused():
    with pytest.raises(TypeError, match="has dtype float32, but jaxgeo computes in float64"):
        Geodetic.from_degrees(lat=np.float32(45.0), lon=0.0, height=0.0)


def test_traced_values_pass_unchecked():
    """A check on a tracer would break `jit`; bad numbers then become a status further on."""
    lat = jax.jit(lambda x: Geodetic.from_degrees(lat=x, lon=0.0, height=0.0).lat)(jnp.asarray(100.0))
    assert float(lat) == pytest.approx(np.radians(100.0))


NAN = np.nan


@pytest.mark.parametrize(
    "lat, lon, words",
    [
        (36.3, -84.2, r"lat must lie within pi/2 rad of the equator; got 36\.3"),
        (jnp.asarray(-36.3), 1, r"lat must lie within .* got -36\.3"),
        (np.float64(1.2), 8.0, r"lon must lie within 2 pi rad of Greenwich; got 8"),
        (90, -180, "lat must lie"),
        (
            np.array([0.1, NAN, -47.0]),
            np.zeros(3),
            r"lat .* got -47\. Geodetic takes radians; Geodetic\.from_degrees takes",
        ),
        (100.0, 0.0, r"got 100\. Geodetic takes radians; Geodetic\.from_degrees takes"),
    ],
)
def test_degrees_for_radians_are_refused_wherever_a_position_is_made(lat, lon, words):
    with pytest.raises(ValueError, match=words):
        jaxgeo.Pose(Geodetic(lat=lat, lon=lon, height=900.0))


@pytest.mark.parametrize("lat, lon", [(36.3, -84.2), (-jnp.asarray(89.0), 360), (np.float64(1.2), 8.0)])
def test_the_call_that_is_advised_makes_the_position_meant(lat, lon):
    with pytest.raises(ValueError, match="takes degrees") as refused:
        Geodetic(lat=lat, lon=lon, height=np.float64(900.5))
    (call,) = re.findall(r"jaxgeo\.Geodetic\.from_degrees\([^)]*\)", str(refused.value))
    made = eval(call, {"jaxgeo": jaxgeo})
    np.testing.assert_allclose(made.to_degrees(), (lat, lon, 900.5), rtol=1e-15)


def test_what_is_no_known_angle_passes():
    """Positions at the poles and the date line, numbers that are not known, structures, and what is wrong elsewhere."""
    edge = Geodetic(lat=np.array([-0.5 * np.pi, 0.5 * np.pi + 1e-7]), lon=np.array([-2.0 * np.pi, NAN]), height=0.0)
    again = pickle.loads(pickle.dumps(edge))
    np.testing.assert_array_equal(again.lat, edge.lat)
    lat = jnp.linspace(40.0, 50.0, 3)
    each = jax.jit(jax.vmap(lambda lat: WGS84.to_ecef(Geodetic(lat=lat, lon=0.0, height=0.0))))(lat)
    assert each.shape == (3, 3)
    slope = jax.grad(lambda lat: Geodetic(lat=3.0 * lat, lon=0.0, height=0.0).lat)(20.0)
    assert float(slope) == 3.0
    assert jax.tree.map(lambda _: 47.0, edge).lat == 47.0  # such as a field of derivatives
