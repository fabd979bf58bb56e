"""Positions from degrees: what is accepted, and what each refusal says."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.earth import Geodetic


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
