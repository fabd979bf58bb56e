"""Options of Monte Carlo sampling, common to all functions that draw samples."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import jax
import numpy as np

from jaxgeo._checks import check_countable, is_known
from jaxgeo._record import portable
from jaxgeo.uncertainty.draws import MORE, AbstractDraws, Sobol, first_key

F = TypeVar("F", bound=Callable[..., Any])

CHUNK = 2**20  # samples: no bound beside those of the programs
SOBOL = Sobol()


@portable
@dataclasses.dataclass(frozen=True)
class Sampling:
    """Options of Monte Carlo sampling; None is the default of the function that takes them.

    `count` is the number of samples per fix and `key` a `jax.random.key`, by default `jax.random.key(0)`; a sample
    depends on the key and its number only, up to rounding (1e-8 m) between numbers of devices. `draws` is `Sobol()` by
    default, whose points fill space evenly, or `Random()` for independent samples. Sobol points cut the variance of
    CE90 from 10 000 samples 5 to 20 times, for about 5 % more time; figures have intervals from their scrambles. About
    `chunk` samples are drawn at a time, which bounds the memory, on `devices` (default: all of this process); neither
    changes the samples. With a `half_width`, sampling stops when the interval with this `confidence` of the first
    figure at 90 % is within that fraction of it on either side (JCGM 101:2008, 7.9), or at `count` samples. `progress`
    shows progress bars.

    >>> import jax
    >>> from jaxgeo.uncertainty import Sampling
    >>> print(Sampling(count=2000, key=jax.random.key(1)).count)
    2000
    """

    count: int | None = None
    key: Any = None
    draws: AbstractDraws | None = None
    half_width: float | None = None
    confidence: float = 0.95
    chunk: int | None = None
    devices: Sequence[Any] | None = None
    progress: bool = False

    @property
    def scrambles(self) -> int:
        """Number of Sobol scrambles; 0 for independent draws."""
        return self.draws.scrambles if isinstance(self.draws, Sobol) else 0

    @property
    def random_key(self) -> Any:
        """The key, or its default."""
        return first_key() if self.key is None else self.key


def resolve_sampling(
    sampling: Any, count: int, *, least: int = 1, draws: AbstractDraws = SOBOL, chunk: int = CHUNK
) -> Sampling:
    """Checked options with the defaults of a function; None draws nothing where `least`, the smallest count, is 0.

    Raises `TypeError` for anything but a `Sampling`, and `ValueError` or `TypeError` for invalid options.
    """
    if sampling is None and least == 0:
        sampling = Sampling(count=0)
    if not isinstance(sampling, Sampling):
        raise TypeError(f"sampling must be a jaxgeo Sampling, such as Sampling(count=2000); got {sampling!r}.")
    usual = {"count": count, "draws": draws, "chunk": chunk}
    unset = {name: value for name, value in usual.items() if getattr(sampling, name) is None}
    options = dataclasses.replace(sampling, **unset)
    _check(options, least)
    return options


def _check(options: Any, least: int) -> None:
    """Raise `ValueError` or `TypeError` for invalid options; `least` is the smallest `count`."""
    for value, name, low in ((options.count, "count", least), (options.chunk, "chunk", 1)):
        if not isinstance(value, int | np.integer) or value < low:
            raise ValueError(f"{name} must be a whole number of samples, {low} or more; got {value!r}.")
    check_countable(int(options.count), f"{options.count} samples", MORE)
    if options.key is not None:
        check_key(options.key)
    _check_devices(options.devices)
    checked_draws(options.draws)
    if not 0.0 < options.confidence < 1.0:
        raise ValueError(f"confidence must lie between 0 and 1, such as 0.95; got {options.confidence!r}.")
    if options.half_width is not None and not options.half_width > 0.0:
        raise ValueError(f"half_width must be a positive share of the first figure; got {options.half_width!r}.")


def check_key(key: Any) -> None:
    """Raise `TypeError` for anything but a JAX array."""
    if not isinstance(key, jax.Array):
        raise TypeError(f"key must be one of jax.random.key(seed); got {key!r}.")


def checked_draws(draws: Any) -> AbstractDraws:
    """The kind of draws; raises `TypeError` for anything else."""
    if not isinstance(draws, AbstractDraws):
        raise TypeError(f"draws must be Random() or Sobol(); got {type(draws).__name__}.")
    return draws


def _check_devices(devices: Any) -> None:
    if devices is None:
        return
    if not (len(devices) and all(isinstance(one, jax.Device) for one in devices)):
        raise ValueError(f"devices must be some of jax.devices(), or None for all of them; got {devices!r}.")
    others = sorted({one.process_index for one in devices} - {jax.process_index()})
    if others:
        raise ValueError(
            f"devices must be of this process ({jax.process_index()}), as jax.local_devices() are; got some of process "
            f"{', '.join(map(str, others))}. Leave devices out, and `sample` divides its samples among all processes."
        )


def check_numbers(first: Any, sampling: Any) -> int:
    """The number of the first sample; raises `ValueError` unless all can be drawn from `first` on."""
    if not isinstance(first, int | np.integer) or first < 0:
        raise ValueError(f"first must be the number of a sample, a whole number from 0 on; got {first!r}.")
    most = sampling.draws.most
    if int(first) + int(sampling.count) > most:
        raise ValueError(
            f"a key has {most} samples; got first {first} and count {sampling.count}. Draw the others with another key."
        )
    return int(first)


def refuse_traced(function: str, arguments: Any) -> None:
    """Raise `TypeError` for traced arguments, or results of constant arguments inside of `jit`."""
    if is_known(arguments):
        return
    raise TypeError(
        f"{function} draws samples in parts and returns plain numbers, which jit, vmap and derivatives do not allow: "
        "call it outside of them, or use jaxgeo.uncertainty.error_samples there."
    )


def merge_sampling(function: str, sampling: Any, given: Mapping[str, Any]) -> Any:
    """`sampling`, or one of the separate keywords that are given; raises `TypeError` for both."""
    if given and sampling is not None:
        raise TypeError(f"{function}: give {', '.join(given)} within sampling=Sampling(...), not beside it.")
    return Sampling(**given) if sampling is None else sampling


def accepts_sampling_options(function: F) -> F:
    """Decorator: the options of `Sampling` are deprecated keywords of a function with a parameter `sampling`."""
    own = inspect.signature(function).parameters
    options = [one.name for one in dataclasses.fields(Sampling) if one.name not in own]

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        given = {name: kwargs.pop(name) for name in options if name in kwargs}
        if given:
            kwargs["sampling"] = merge_sampling(function.__name__, kwargs.get("sampling"), given)
            warnings.warn(
                f"{function.__name__}: give sampling=Sampling({', '.join(f'{name}=...' for name in given)}); the "
                "separate keywords go with version 0.3.",
                DeprecationWarning,
                stacklevel=2,
            )
        return function(*args, **kwargs)

    return call  # pyright: ignore[reportReturnType]
