"""Writer of an error model as the table [errors] of a scene file."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.io.scene import SceneError
from jaxgeo.io.scene_errors import PLAIN
from jaxgeo.uncertainty import ErrorModel, sources
from jaxgeo.uncertainty.distributions import Empirical, Mixture, StudentT, TruncatedNormal

DEGREES = 180.0 / np.pi
DIGITS = (6, 9, 12, 15, 16)  # significant ones: the fewest that give the number
ROUNDING = 4e-16  # relative, of the change from rad to deg
KEYS: dict[type, tuple[str, float]] = {
    sources.Position: ("position_m", 1.0),
    sources.Attitude: ("attitude_deg", DEGREES),
    sources.GimbalAngles: ("gimbal_deg", DEGREES),
    sources.GimbalMounting: ("gimbal_mounting_deg", DEGREES),
    sources.Boresight: ("boresight_deg", DEGREES),
    sources.LeverArm: ("lever_body_m", 1.0),
    sources.PixelMeasurement: ("pixel_px", 1.0),
    sources.TerrainHeight: ("terrain_m", 1.0),
}


def errors_table(model: ErrorModel) -> dict[str, Any]:
    """An error model as the values of the table [errors] of a scene file, which `read_scene` reads.

    Sigmas that differ between images (a leading axis) become their root mean square. Raises `SceneError` for sources
    that a scene file cannot hold: other classes, correlated axes, another sharing than the usual one, several
    variograms, or some distributions.
    """
    check_is(model, ErrorModel, "model")
    table: dict[str, Any] = {}
    for source in model.sources:
        for key, value in _entries(source):
            if key in table:
                raise SceneError(f"[errors] {key}: the model has two such sources; a scene file holds one.")
            table[key] = value
    return table


def write_errors(path: str | os.PathLike[str], model: ErrorModel, *, comment: str = "") -> None:
    """Write an error model as the table [errors] of a scene file, to copy into one; `comment` lines come first.

    The file appears only when complete. Raises as `errors_table`, and `ValueError` for a path that cannot be written.
    """
    import tomlkit  # only needed for writing scenes

    document = tomlkit.document()
    for line in comment.splitlines():
        document.add(tomlkit.comment(line))
    document["errors"] = errors_table(model)
    with destination("path", pathlib.Path(path)) as stream:
        stream.write(tomlkit.dumps(document))


def _entries(source: Any) -> Iterator[tuple[str, Any]]:
    kind = type(source)
    usual = kind.__dataclass_fields__["sharing"].default
    if source.correlation is not None:
        raise SceneError(f"[errors]: a scene file has independent axes; those of {source.label} are correlated.")
    if usual is not None and type(source.sharing) is not type(usual):
        raise SceneError(f"[errors]: a scene file has no sharing; that of {source.label} is not the usual one.")
    sigma = np.asarray(source.sigma, np.float64)
    sigma = np.sqrt(np.mean(sigma.reshape(-1, sigma.shape[-1]) ** 2, axis=0))
    shape = _shape(source)
    if kind is sources.InteriorOrientation:
        yield "focal_px", _value(sigma[:1], shape)
        yield "principal_px", _value(sigma[1:], shape)
    elif kind is sources.TerrainField:
        if np.shape(source.gaussian_lengths)[-1] != 1 or len(sigma) != 1:
            raise SceneError("[errors]: a scene file has one Gaussian variogram of terrain heights.")
        yield "terrain_m", _value(sigma, shape)
        yield "terrain_correlation_m", float(np.asarray(source.gaussian_lengths).reshape(-1)[0])
    elif kind in KEYS and getattr(source, "frame", "ned") == "ned":
        key, unit = KEYS[kind]
        yield key, _value(unit * sigma, shape)
    else:
        raise SceneError(f"[errors]: a scene file has no key for {source.label}.")


def _shape(source: Any) -> dict[str, Any]:
    """Keys of the distribution, none for normal errors."""
    kinds = {type(shape) for shape in source.shapes}
    if kinds == {type(None)}:
        return {}
    shape = source.shapes[0]
    if len(kinds) == 1:
        for name, kind in PLAIN.items():
            if type(shape) is kind:
                return {"distribution": name}
        found = [_parameters(one) for one in source.shapes]
        if found[0] is not None and all(one == found[0] for one in found):
            return found[0]
    raise SceneError(f"[errors]: the distribution of {source.label} has no form in a scene file.")


def _parameters(shape: Any) -> dict[str, Any] | None:
    """Keys of a distribution with parameters."""
    if isinstance(shape, StudentT):
        degrees = np.unique(np.asarray(shape.df, np.float64))
        return {"distribution": "student-t", "df": float(degrees[0])} if degrees.size == 1 else None
    if isinstance(shape, TruncatedNormal):
        limits = {name: np.asarray(getattr(shape, name), np.float64) for name in ("low", "high")}
        if any(limit.ndim for limit in limits.values()):
            return None
        known = {name: float(limit) for name, limit in limits.items() if np.isfinite(limit)}
        return {"distribution": "truncated-normal", **known} if known else None
    if isinstance(shape, Empirical):
        knots = {name: np.asarray(getattr(shape, name), np.float64) for name in ("probabilities", "values")}
        if any(values.ndim != 1 for values in knots.values()):
            return None
        return {"distribution": "empirical", **{name: values.tolist() for name, values in knots.items()}}
    if isinstance(shape, Mixture) and np.ndim(shape.shares) == 1:
        columns = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (shape.shares, shape.sigmas, shape.means)))
        parts = [dict(zip(("share", "sigma", "mean"), row, strict=True)) for row in np.stack(columns, 1).tolist()]
        return {"distribution": "mixture", "parts": parts}
    return None


def _value(sigma: np.ndarray, shape: dict[str, Any]) -> Any:
    numbers = [_written(float(x)) for x in sigma]
    value = numbers[0] if len(numbers) == 1 else numbers
    return {"sigma": value, **shape} if shape else value


def _written(number: float) -> float:
    """The number with the fewest digits that give it."""
    shorter = (float(f"{number:.{digits}g}") for digits in DIGITS)
    return next((one for one in shorter if abs(one - number) <= ROUNDING * abs(number)), number)
