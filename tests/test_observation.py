"""Exposures and observations: every function that takes one gives what it gives of sensor, shot and pixel."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pathlib
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Atmosphere, Exposure, Observation, coverage, uncertainty
from jaxgeo.observation import accepts_observation
from tests.support import looks

SENSOR, SHOT, GROUND, ERRORS = looks.level_sensor(), looks.level_shot(), looks.LEVEL, looks.level_errors()
POSE = SHOT.pose
POSES = jaxgeo.Pose.from_degrees(
    lat=np.array([47.0, 47.001]), lon=np.full(2, 11.0), height=np.full(2, 3100.0), heading=160.0, pitch=3.0
)
FLIGHT = jaxgeo.Trajectory.from_knots(np.array([0.0, 4.0]), POSES, np.stack([SHOT.gimbal_readings] * 2))
UV = np.array(looks.LEVEL_UV)
AIR = Atmosphere()
POINT = jaxgeo.Geodetic.from_degrees(lat=46.98, lon=10.938, height=100.0)

EXPOSURES = {
    "shot": (Exposure(SENSOR, SHOT), (SENSOR, SHOT), {}),
    "shot in air": (Exposure(SENSOR, SHOT, atmosphere=AIR), (SENSOR, SHOT), {"atmosphere": AIR}),
    "trajectory": (Exposure(SENSOR, FLIGHT, 1.5), (SENSOR, FLIGHT), {"time": 1.5}),
}
OF_OBSERVATION = {
    "locate": (jaxgeo.locate, (GROUND,), {}),
    "at_range": (jaxgeo.at_range, (3000.0,), {}),
    "propagate": (jaxgeo.propagate, (GROUND, ERRORS), {}),
    "accuracy without samples": (jaxgeo.accuracy, (GROUND, ERRORS), {"sampling": None}),
}
MORE = {
    "accuracy": (jaxgeo.accuracy, (GROUND, ERRORS), {}),
    "sample": (jaxgeo.sample, (GROUND, ERRORS), {"key": jax.random.key(0), "count": 200}),
    "compare": (jaxgeo.compare, (GROUND, ERRORS), {"sampling": jaxgeo.Sampling(count=200)}),
    "second_order": (uncertainty.second_order, (GROUND, ERRORS), {}),
    "sigma_points": (uncertainty.sigma_points, (GROUND, ERRORS), {}),
    "gauss_helmert": (uncertainty.gauss_helmert, (GROUND, ERRORS), {}),
}
LONG = {"at_range", "propagate"}
LATER = {*MORE, "accuracy without samples"}  # the last is in `test_accuracy`, of many observations
OF_EXPOSURE = {"project": (jaxgeo.project, (POINT,), {})}
AIMING = {
    "point_gimbal": (coverage.point_gimbal, {"target": POINT}),
    "line_of_sight": (coverage.line_of_sight, {}),
}


def same(one: object, other: object) -> None:
    ours, theirs = jax.tree.leaves(one), jax.tree.leaves(other)
    assert len(ours) == len(theirs) > 0
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


@pytest.mark.parametrize("kind", EXPOSURES)
def test_an_observation_is_taken_apart(kind: str) -> None:
    """The function below gets what stands for an observation; real ones are compared by their results."""

    @accepts_observation
    def given(sensor, shot, uv, terrain, *, sampling=None, time=None, atmosphere=None):
        return (sensor, shot, uv, terrain), {"sampling": sampling, "time": time, "atmosphere": atmosphere}

    exposure, parts, moment = EXPOSURES[kind]
    positional, named = given(Observation(exposure, UV), GROUND, sampling="drawn")
    assert all(one is other for one, other in zip(positional, (*parts, UV, GROUND), strict=True))
    assert named == {"sampling": "drawn", "time": None, "atmosphere": None} | moment


# Compiled for a shot alone, the others are for the slow run: what an observation is taken apart into is tested above.
COMPILED = [
    pytest.param(name, kind, marks=[pytest.mark.slow] if name in LATER or (name in LONG and kind != "shot") else [])
    for name in (*OF_OBSERVATION, *MORE)
    for kind in EXPOSURES
]


@pytest.mark.costly
@pytest.mark.parametrize("name, kind", COMPILED)
def test_an_observation_stands_for_sensor_shot_and_pixel(name: str, kind: str) -> None:
    function, rest, named = (OF_OBSERVATION | MORE)[name]
    exposure, parts, moment = EXPOSURES[kind]
    found = function(Observation(exposure, UV), *rest, **named)
    same(vars_of(found), vars_of(function(*parts, UV, *rest, **named, **moment)))


def vars_of(found: object) -> object:
    """Fields of a result that is a plain dataclass, whose leaves JAX does not know."""
    return vars(found) if dataclasses.is_dataclass(found) else found


@pytest.mark.costly
@pytest.mark.parametrize("kind", ["shot", "shot in air", pytest.param("trajectory", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", OF_EXPOSURE)
def test_an_exposure_stands_for_sensor_and_shot(name: str, kind: str) -> None:
    function, rest, named = OF_EXPOSURE[name]
    exposure, parts, moment = EXPOSURES[kind]
    same(function(exposure, *rest, **named), function(*parts, *rest, **named, **moment))


@pytest.mark.costly
@pytest.mark.parametrize("name", AIMING)
def test_an_exposure_is_pointed_as_its_shot(name: str) -> None:
    function, named = AIMING[name]
    same(function(Exposure(SENSOR, SHOT), **named), function(SENSOR, SHOT, **named))
    with pytest.raises(TypeError, match=f"{name} has no time; give an exposure without one"):
        function(EXPOSURES["trajectory"][0], **named)


@pytest.mark.costly
def test_locate_and_project_are_inverse() -> None:
    exposure = EXPOSURES["shot in air"][0]
    fix = jaxgeo.locate(Observation(exposure, UV), GROUND)
    np.testing.assert_allclose(jaxgeo.project(exposure, fix.position).uv, UV, atol=1e-6)


@pytest.mark.slow
def test_a_batch_of_observations_under_vmap() -> None:
    pixels = jnp.array([[1200.0, 1600.0], [100.0, 3100.0], [2399.0, 0.0]])
    headings = jnp.array([0.0, 0.1, 0.2])
    shots = jax.vmap(lambda h: dataclasses.replace(SHOT, pose=dataclasses.replace(POSE, heading=h)))(headings)
    sensors = jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x), (3, *jnp.shape(x))), SENSOR)
    batch = Observation(Exposure(sensors, shots), pixels)
    many = jax.vmap(lambda one: jaxgeo.locate(one, GROUND).ecef)(batch)
    for k in range(3):
        shot = jax.tree.map(lambda x, k=k: x[k], shots)
        np.testing.assert_allclose(many[k], jaxgeo.locate(SENSOR, shot, pixels[k], GROUND).ecef, atol=1e-6)


@pytest.mark.slow
def test_a_derivative_by_the_exposure() -> None:
    def north(exposure: Exposure) -> jax.Array:
        return jnp.asarray(jaxgeo.locate(Observation(exposure, UV), GROUND).position.lat)

    slope = jax.grad(lambda heading: north(Exposure(SENSOR, with_heading(heading))))(0.0)
    step = 1e-5
    numeric = (north(Exposure(SENSOR, with_heading(step))) - north(Exposure(SENSOR, with_heading(-step)))) / (2 * step)
    np.testing.assert_allclose(slope, numeric, rtol=1e-6, atol=1e-12)


def with_heading(heading: object) -> jaxgeo.Shot:
    nadir = jaxgeo.Pose(POSE.position, heading, 0.2, 0.1)
    return jaxgeo.Shot(nadir, SHOT.gimbal_readings)


def test_observations_pass_between_processes() -> None:
    observation = Observation(EXPOSURES["trajectory"][0], UV)
    same(observation, pickle.loads(pickle.dumps(observation)))


WRONG = {
    "time twice": (
        lambda: jaxgeo.locate(Observation(EXPOSURES["trajectory"][0], UV), GROUND, time=1.0),
        "locate: time is part of the exposure; leave out time=",
    ),
    "air twice": (
        lambda: jaxgeo.project(EXPOSURES["shot in air"][0], POINT, atmosphere=AIR),
        "project: atmosphere is part of the exposure; leave out atmosphere=",
    ),
    "no pixel": (lambda: jaxgeo.locate(Exposure(SENSOR, SHOT), GROUND), "give Observation\\(exposure, uv\\)"),
    "a pixel": (
        lambda: jaxgeo.project(Observation(Exposure(SENSOR, SHOT), UV), POINT),
        "takes an Exposure.*`exposure`",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes(name: str) -> None:
    call, words = WRONG[name]
    with pytest.raises(TypeError, match=words):
        call()


def test_a_shot_with_a_time_is_refused() -> None:
    with pytest.raises(ValueError, match="time goes with a Trajectory"):
        jaxgeo.locate(Observation(Exposure(SENSOR, SHOT, 3.0), UV), GROUND)


def decorated() -> list[tuple[str, str, str]]:
    """(module, function, decorator) of every function that takes an exposure or an observation."""
    root = pathlib.Path(jaxgeo.__file__).parent
    found = []
    for path in root.rglob("*.py"):
        module = ".".join(("jaxgeo", *path.relative_to(root).with_suffix("").parts))
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef):
                names = {one.id for one in node.decorator_list if isinstance(one, ast.Name)}
                found += [(module, node.name, name) for name in names & {"accepts_exposure", "accepts_observation"}]
    return sorted(found)


@pytest.mark.parametrize("module, name, decorator", decorated())
def test_a_forgotten_argument_is_named_with_both_forms(module: str, name: str, decorator: str) -> None:
    function = getattr(importlib.import_module(module), name)
    of_observation = decorator == "accepts_observation"
    start = ["sensor", "shot", "uv"] if of_observation else ["sensor", "shot"]
    parameters = inspect.signature(function).parameters.values()
    rest = [one.name for one in parameters if one.default is one.empty][len(start) :]
    with pytest.raises(TypeError) as classic:
        function()
    assert str(classic.value).startswith(f"{name} needs {', '.join([*start, *rest])}: call {name}(sensor, shot")
    exposure = EXPOSURES["shot"][0]
    given, kind = (Observation(exposure, UV), "observation") if of_observation else (exposure, "exposure")
    if rest:
        with pytest.raises(TypeError) as short:
            function(given)
        assert str(short.value).startswith(f"{name} needs {', '.join(rest)}: call ")
        assert f" or {name}({kind}, {rest[0]}" in str(short.value)


def test_arguments_given_by_name_are_not_missing() -> None:
    same(jaxgeo.locate(SENSOR, shot=SHOT, uv=UV, terrain=GROUND), jaxgeo.locate(SENSOR, SHOT, UV, GROUND))
    with pytest.raises(TypeError, match=r"^locate needs uv, terrain: call locate\(sensor, shot, uv, terrain\) or "):
        jaxgeo.locate(SENSOR, SHOT)
    with pytest.raises(
        TypeError, match=r"^point_gimbal needs target: call .* or point_gimbal\(exposure, target=\.\.\."
    ):
        jaxgeo.coverage.point_gimbal(EXPOSURES["shot"][0])
