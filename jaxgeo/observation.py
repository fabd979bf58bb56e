"""Exposures and observations: one image with its orientation, and one pixel measured in it."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Mapping
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeAlias, TypeVar, overload, runtime_checkable

from jaxgeo._record import Record
from jaxgeo._typing import PixelField, ScalarField
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory

P = ParamSpec("P")
R = TypeVar("R", covariant=True)
Parameters: TypeAlias = Mapping[str, inspect.Parameter]


class Exposure(Record):
    """One image: interior orientation (`sensor`), exterior orientation (`motion`), and atmosphere.

    `motion` is a `Shot`, or a `Trajectory` with the `time` of the image in s (None means 0; not allowed with a shot).
    Without an `atmosphere` lines of sight are straight. For many exposures, give every leaf a leading axis and use
    `jax.vmap`. Functions of (sensor, shot, ...) take an exposure in place of `sensor`, `shot`, `time`, `atmosphere`.

    >>> sensor = jaxgeo.Sensor(jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000))
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> exposure = jaxgeo.Exposure(sensor, jaxgeo.Shot(pose))
    >>> seen = jaxgeo.project(exposure, jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0))
    >>> print(np.round(seen.uv, 1))
    [1999.5 1499.5]
    """

    sensor: Sensor
    motion: Shot | Trajectory
    time: ScalarField | None = None
    atmosphere: Atmosphere | None = None


class Observation(Record):
    """One pixel `uv` = (column, row) measured in an `exposure`; pixel centres are at integers.

    For many pixels of one exposure: `jax.vmap(lambda uv: locate(Observation(exposure, uv), terrain))(pixels)`, or an
    observation whose leaves all have a leading axis under `jax.vmap`. Functions of (sensor, shot, uv, ...) take an
    observation in place of these three arguments, `time` and `atmosphere`.

    >>> sensor = jaxgeo.Sensor(jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000))
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> observation = jaxgeo.Observation(jaxgeo.Exposure(sensor, jaxgeo.Shot(pose)), np.array([1999.5, 1499.5]))
    >>> print(f"{jaxgeo.locate(observation, jaxgeo.ConstantHeight(600.0)).slant_range:.3f} m")
    120.000 m
    """

    exposure: Exposure
    uv: PixelField


@runtime_checkable
class OfExposure(Protocol, Generic[P, R]):
    """Function of a sensor and a shot, or of an `Exposure`."""

    @overload
    def __call__(self, sensor: Sensor, shot: Shot | Trajectory | Pose, /, *args: P.args, **kwargs: P.kwargs) -> R: ...
    @overload
    def __call__(self, exposure: Exposure, /, *args: P.args, **kwargs: P.kwargs) -> R: ...


@runtime_checkable
class OfObservation(Protocol, Generic[P, R]):
    """Function of a sensor, a shot and a pixel, or of an `Observation`."""

    @overload
    def __call__(self, sensor: Sensor, shot: Shot | Trajectory, uv: Any, /, *args: P.args, **kwargs: P.kwargs) -> R: ...
    @overload
    def __call__(self, observation: Observation, /, *args: P.args, **kwargs: P.kwargs) -> R: ...


def accepts_exposure(function: Callable[Concatenate[Sensor, Any, P], R]) -> OfExposure[P, R]:
    """Decorator: the function takes an `Exposure` in place of sensor, shot, time and atmosphere."""
    return _accepting(function, Exposure, "takes an Exposure; got an Observation: give its `exposure`")


def accepts_observation(function: Callable[Concatenate[Sensor, Any, Any, P], R]) -> OfObservation[P, R]:
    """Decorator: the function takes an `Observation` in place of sensor, shot, pixel, time and atmosphere."""
    return _accepting(function, Observation, "takes an Observation; got an Exposure: give Observation(exposure, uv)")


def _accepting(function: Callable[..., Any], kind: type[Exposure | Observation], otherwise: str) -> Any:
    """The function with a value of a kind in place of its first arguments; `otherwise` is said of the other kind."""
    parameters = inspect.signature(function).parameters
    replaced = 3 if kind is Observation else 2  # sensor, shot, and pixel

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if args and isinstance(args[0], Exposure | Observation):
            given, *rest = args
            if not isinstance(given, kind):
                raise TypeError(f"{function.__name__} {otherwise}.")
            exposure, uv = (given.exposure, [given.uv]) if isinstance(given, Observation) else (given, [])
            kwargs = _moment(function.__name__, parameters, exposure, kwargs)
            args = exposure.sensor, exposure.motion, *uv, *rest
        missing = _missing(parameters, len(args), kwargs)
        if missing:
            raise TypeError(_forms(function.__name__, parameters, kind.__name__.lower(), replaced, missing))
        return function(*args, **kwargs)

    return call


def _missing(parameters: Parameters, given: int, kwargs: Collection[str]) -> list[str]:
    """Names of required parameters that neither the first `given` arguments nor `kwargs` fill."""
    return [
        name
        for k, (name, one) in enumerate(parameters.items())
        if one.default is one.empty and name not in kwargs and (one.kind is one.KEYWORD_ONLY or k >= given)
    ]


def _forms(function: str, parameters: Parameters, kind: str, replaced: int, missing: list[str]) -> str:
    """Error message for missing arguments, with both ways to call the function."""
    required = [
        f"{n}=..." if one.kind is one.KEYWORD_ONLY else n for n, one in parameters.items() if one.default is one.empty
    ]
    forms = (", ".join(required), ", ".join([kind, *required[replaced:]]))
    return f"{function} needs {', '.join(missing)}: call {' or '.join(f'{function}({form})' for form in forms)}."


def _moment(function: str, names: Collection[str], exposure: Exposure, kwargs: dict[str, Any]) -> dict[str, Any]:
    """Keyword arguments for a function with parameters `names`, with time and atmosphere of the exposure added.

    Raises `TypeError` if one of the two is also given as a keyword, or is not a parameter of the function.
    """
    held = {name: value for name in ("time", "atmosphere") if (value := getattr(exposure, name)) is not None}
    for name in ("time", "atmosphere"):
        if kwargs.get(name) is not None:
            raise TypeError(f"{function}: {name} is part of the exposure; leave out {name}=.")
        if name in held and name not in names:
            raise TypeError(f"{function} has no {name}; give an exposure without one.")
    return {**kwargs, **held}
