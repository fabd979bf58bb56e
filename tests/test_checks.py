"""The public doors: what they let in, and what they say to the rest."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo._checks import as_array, as_float64, check_finite, check_range, given_array, require_x64
from jaxgeo.earth import WGS84, Geodetic


@pytest.fixture
def x64_off():
    jax.config.update("jax_enable_x64", False)
    yield
    jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize(
    "door",
    [
        require_x64,
        lambda: as_float64(np.float64(1.0), "x"),
        lambda: Geodetic.from_degrees(lat=1.0, lon=2.0, height=3.0),
        lambda: WGS84.to_geodetic(jnp.array([6.4e6, 0.0, 0.0])),
        lambda: WGS84.to_ecef(Geodetic(lat=0.0, lon=0.0, height=0.0)),
    ],
)
def test_every_door_asks_for_64_bits_and_says_how(x64_off, door):
    with pytest.raises(RuntimeError, match=r"needs 64-bit floats.*jaxgeo\.enable_x64\(\).*JAX_ENABLE_X64=1"):
        door()


def test_enable_x64_opens_the_doors(x64_off):
    jaxgeo.enable_x64()
    assert as_float64(jnp.asarray(1), "x").dtype == jnp.float64


@pytest.mark.parametrize("value", [1, 1.0, np.int16(1), np.float64(1.0), np.uint8(1), jnp.int32(1)])
def test_numbers_and_integers_are_promoted(value):
    found = as_float64(value, "x")
    assert isinstance(found, jax.Array)
    assert found.dtype == jnp.float64
    assert float(found) == 1.0


@pytest.mark.parametrize("dtype", [np.float32, np.float16, jnp.bfloat16, np.complex128])
def test_other_floats_are_refused_by_name(dtype):
    tree = {"pose": Geodetic(lat=0.5, lon=np.zeros(3, dtype), height=0.0)}
    with pytest.raises(TypeError, match=r"shot\['pose'\]\.lon has dtype .*computes in float64.*np\.float64"):
        as_float64(tree, "shot")
    with pytest.raises(TypeError, match=r"^shot\['pose'\]\.lon has dtype "):
        as_float64((1.0, tree, 2.0), ("time", "shot", "uv"))


def test_what_is_not_a_number_passes_untouched():
    tree = {"name": "camera", "nothing": None, "values": np.arange(3)}
    found = as_float64(tree, "x")
    assert found["name"] == "camera"
    assert found["nothing"] is None
    assert found["values"].dtype == jnp.float64


def test_doors_work_on_traced_values():
    assert jax.jit(lambda x: as_float64(x, "x"))(jnp.arange(3)).dtype == jnp.float64
    with pytest.raises(TypeError, match="float32"):
        jax.jit(lambda x: as_float64(x, "x"))(jnp.float32(1.0))


def test_finite_and_range_checks_name_value_and_unit():
    check_finite(np.array([1.0, 2.0]), "height", "m")
    check_range(45.0, "lat", "deg", -90.0, 90.0)
    check_range(np.zeros(0), "lat", "deg", -90.0, 90.0)
    with pytest.raises(ValueError, match=r"height must be finite, in m; got .*nan.* of shape \(2,\)"):
        check_finite(np.array([1.0, np.nan]), "height", "m")
    with pytest.raises(ValueError, match=r"lat must lie in \[-90, 90\] deg; got 91\.0"):
        check_range(91.0, "lat", "deg", -90.0, 90.0)
    with pytest.raises(ValueError, match="lat must be finite"):
        check_range(np.nan, "lat", "deg", -90.0, 90.0)


@pytest.mark.parametrize("check", [as_array, as_float64, lambda value, name: check_finite(value, name, "deg")])
def test_texts_are_refused_by_name(check) -> None:
    with pytest.raises(TypeError, match=r"^uv must be numbers; got the text '1200,2400'\. Convert it first"):
        check("1200,2400", "uv")


def test_a_large_array_is_not_printed_whole():
    with pytest.raises(ValueError, match=r"of shape \(1000,\)") as caught:
        check_range(np.full(1000, 99.0), "lat", "deg", -90.0, 90.0)
    assert len(str(caught.value)) < 200


def test_checks_let_tracers_pass():
    def f(x):
        check_range(x, "x", "deg", 0.0, 1.0)
        return x

    assert float(jax.jit(f)(jnp.asarray(5.0))) == 5.0


@pytest.mark.parametrize(
    "uv, said",
    [
        ({"u": 1.0, "v": 2.0}, r"uv must be numbers in order; got a dict with the keys 'u', 'v'\. Give its values, as "
                               r"\(given\['u'\], given\['v'\]\)\."),
        ({1.0, 2.0}, r"uv must be numbers; got set\. Give an array, or a list of numbers\."),
        ([1.0, {2.0}], r"uv\[1\] must be numbers; got set\."),
        ([None, 2.0], r"uv\[0\] must be a number; got None\. Give all 2 values\."),
        ([[1.0, 2.0], [3.0, None]], r"uv\[1\]\[1\] must be a number; got None"),
        (np.array(["a", "b"]), r"uv must be numbers; got texts, such as 'a'\. Convert them first"),
    ],
)  # fmt: skip
def test_what_is_no_number_is_refused_in_words(uv: Any, said: str) -> None:
    with pytest.raises(TypeError, match=said):
        as_array(uv, "uv")


@pytest.mark.parametrize(
    "values, said",
    [
        (["a", "b"], "got texts, such as 'a'"),
        ([b"a"], "got texts, such as b'a'"),
        (np.array([None, 2.0]), "got an array of objects, such as None"),
        ([True, False], "got truth values, such as True"),
        (np.array(["2026-01-01"], "datetime64[D]"), "got dates, such as "),
        (np.zeros(0, "U1"), "got texts"),
    ],
)
def test_arrays_of_no_numbers_are_not_said_to_lose_metres(values: Any, said: str) -> None:
    with pytest.raises(TypeError, match=f"^lat must be numbers; {said}") as refused:
        as_float64(np.asarray(values), "lat")
    assert "metres" not in str(refused.value)
    with pytest.raises(TypeError, match=r"^point\['lat'\] must be numbers; "):
        as_float64({"lat": np.asarray(values)}, "point")


def test_rows_of_unlike_lengths_are_named() -> None:
    with pytest.raises(
        ValueError, match=r"^uv must have parts of one shape; uv\[0\] has \(2,\), but uv\[1\] has \(1,\)"
    ):
        as_array([[1.0, 2.0], [3.0]], "uv")


def test_a_missing_argument_is_said() -> None:
    with pytest.raises(TypeError, match=r"^uv is missing \(None\): give one pixel\.$"):
        given_array(None, "uv", "one pixel")
    assert given_array((1.0, 2.0), "uv", "one pixel").shape == (2,)


CALLS = """
import jax
import numpy as np
import jaxgeo
jaxgeo.enable_x64()
camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=1000, height=1000)
sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1600.0))
level = jaxgeo.ConstantHeight(600.0)
calls = {
    "locate": lambda uv: jaxgeo.locate(sensor, shot, uv, level),
    "accuracy": lambda uv: jaxgeo.accuracy(sensor, shot, uv, level, []),
    "propagate": lambda uv: jaxgeo.propagate(sensor, shot, uv, level, []),
    "sample": lambda uv: jaxgeo.sample(sensor, shot, uv, level, [], key=jax.random.key(0)),
    "gsd": lambda uv: jaxgeo.coverage.ground_sample_distance(sensor, shot, uv, level),
}
for name, call in calls.items():
    for uv in (None, [None, 2.0], np.array(["a", "b"])):
        try:
            call(uv)
        except TypeError as error:
            print(name, error)
"""
REFUSED = (
    "uv is missing (None): give one pixel (column, row).",
    "uv[0] must be a number; got None. Give all 2 values.",
    "uv must be numbers; got texts, such as 'a'. Convert them first, as by np.asarray(x, np.float64).",
)


@pytest.mark.costly
def test_pixels_that_are_none_are_refused_in_words() -> None:
    """As users call the functions, without the type checks of the tests: in a process of its own."""
    done = subprocess.run([sys.executable, "-c", CALLS], capture_output=True, text=True, check=True)
    names = ("locate", "accuracy", "propagate", "sample", "gsd")
    assert done.stdout.splitlines() == [f"{name} {said}" for name in names for said in REFUSED]


def test_the_values_of_a_dict_are_taken_as_the_message_has_them() -> None:
    given = {"u": 1.0, "v": 2.0}
    with pytest.raises(TypeError) as refused:
        as_array(given, "uv")
    way = str(refused.value).partition("Give its values, as ")[2].removesuffix(".")
    assert np.array_equal(as_array(eval(way, {"given": given}), "uv"), [1.0, 2.0])
