"""Unknown keyword arguments of constructors: refusals that name the argument meant, by what the field calls it."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

# Names of one quantity; the first ones are those of this package.
SAME = (
    ("heading", "azimuth", "outer", "yaw", "course", "bearing", "hdg"),
    ("yaw", "heading"),
    ("pitch", "depression", "tilt", "elevation_angle"),
    ("roll", "bank"),
    ("lat", "latitude"),
    ("lon", "lng", "long", "longitude"),
    ("height", "alt", "altitude", "elevation", "elev", "z", "h"),
    ("focal_length", "focal_px", "f", "fx", "focal", "focal_length_px", "focal_length_mm", "flen"),
    ("principal_point", "principal_px", "principal", "pp", "cx", "cy"),
    ("pixel_pitch", "pixel_size", "pitch_um", "pixel_pitch_um", "pixel_size_um"),
    ("width", "columns", "cols", "image_width", "w"),
    ("height", "rows", "image_height"),
    ("distortion", "dist", "dist_coeffs", "distortion_coefficients", "k1"),
    ("sigma", "std", "stdev", "stddev", "sd", "sigmas"),
    ("north", "n", "northing", "sigma_north"),
    ("east", "e", "easting", "sigma_east"),
    ("down", "d", "up", "vertical", "sigma_down"),
    ("omega", "w"),
    ("phi", "p"),
    ("kappa", "k"),
    ("camera", "cam", "intrinsics"),
    ("position", "location", "pos"),
    ("gimbal_readings", "gimbal", "readings"),
    ("time", "t", "timestamp"),
)


def check_keywords(function: Any, owner: type, name: str, given: Mapping[str, Any]) -> None:
    """Raise `TypeError` for the first keyword argument that a constructor of a class does not take."""
    known = keywords_of(function, owner)
    if known is None or given.keys() <= known:
        return
    wrong = next(one for one in given if one not in known)
    called = f"{owner.__name__}.{name}" if name else owner.__name__
    raise TypeError(f"{called}() got an unexpected keyword argument {wrong!r}{_advice(owner, name, wrong, known)}")


def hinted(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function under a classmethod, with `check_keywords`."""

    @functools.wraps(function)
    def call(cls: type, /, *args: Any, **kwargs: Any) -> Any:
        if kwargs:
            check_keywords(function, cls, function.__name__, kwargs)
        return function(cls, *args, **kwargs)

    return call


@functools.cache
def keywords_of(function: Any, owner: type) -> frozenset[str] | None:
    """Names of the keyword arguments of a constructor of a class; None if it takes any.

    Further `**options` are those of the class.
    """
    parameters = inspect.signature(function).parameters.values()
    named = frozenset(one.name for one in parameters if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY))
    more = next((one.name for one in parameters if one.kind is one.VAR_KEYWORD), None)
    if more is not None:
        own = keywords_of(owner.__init__, owner) if more == "options" and function is not owner.__init__ else None
        return None if own is None else (named | own) - {"self", "cls"}
    return named - {"self", "cls"}


def _advice(owner: type, name: str, wrong: str, known: frozenset[str]) -> str:
    """End of the sentence: the argument meant, of this constructor or of another of the class, or those it takes."""
    others = {one: keywords_of(getattr(owner, one), owner) for one in _constructors(owner) if one != name}
    others |= {} if not name else {"": keywords_of(owner.__init__, owner)}
    exact = {other: wrong for other, names in others.items() if names is not None and wrong in names}
    alike = {other: word for other, names in others.items() if names and (word := _meant(wrong, names)) is not None}
    meant = _meant(wrong, known)
    if not exact and meant is not None:
        return f"; did you mean {meant!r}?"
    for other, word in (exact or alike).items():
        return f"; call {owner.__name__}{f'.{other}' if other else ''}({word}=...)."
    taken = ", ".join(one for one in inspect.signature(getattr(owner, name or "__init__")).parameters if one in known)
    more = [f"{owner.__name__}.{one}" for one in others if one]
    return f"; it takes {taken}." + (f" There is also {', '.join(more)}." if more and not name else "")


def _constructors(owner: type) -> list[str]:
    """Names of the public constructors of a class besides the class itself."""
    return [one for one in dir(owner) if one.startswith("from_") and inspect.ismethod(getattr(owner, one))]


def _meant(wrong: str, known: Iterable[str]) -> str | None:
    """The known name of the quantity that an unknown one is for, or one that is spelt nearly so."""
    names = sorted(known)
    word = wrong.lower().removesuffix("_deg").removesuffix("_rad").removesuffix("_m")
    if word in names:
        return word
    for group in SAME:
        if word in group:
            found = next((one for one in group if one in names), None)
            if found is not None:
                return found
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.75)
    return close[0] if close else None
