"""Standard-deviation options and the error sources built from them."""

from __future__ import annotations

import dataclasses
import math
import pathlib
import tomllib
from typing import Annotated, Any, ClassVar

import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import numbers_in
from jaxgeo.cli._options import SURE, OptionGroup

DEM_SIGMA = 5.0  # m, default for elevation models
GROUND_SIGMA = 10.0  # m, default for level ground


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sigmas(OptionGroup):
    """Standard deviations as typed; None if not given."""

    panel: ClassVar[str | None] = SURE

    position: Annotated[
        str | None,
        typer.Option(
            "--position-sigma", metavar="SIGMA", help="Position standard deviation, m: one number, or NORTH,EAST,DOWN."
        ),
    ] = None
    attitude: Annotated[
        str | None,
        typer.Option(
            "--attitude-sigma",
            metavar="SIGMA",
            help="Attitude standard deviation, deg: one number, or HEADING,PITCH,ROLL.",
        ),
    ] = None
    gimbal: Annotated[
        str | None,
        typer.Option(
            "--gimbal-sigma",
            metavar="SIGMA",
            help="Standard deviation of gimbal readings, deg: one number, or one per axis.",
        ),
    ] = None
    focal: Annotated[
        str | None,
        typer.Option(
            "--focal-sigma",
            metavar="SIGMA",
            help="Standard deviation of the focal length alone: 5px or 0.05mm; 0 for exact.",
        ),
    ] = None
    principal: Annotated[
        str | None,
        typer.Option(
            "--principal-sigma",
            metavar="SIGMA",
            help="Standard deviation of the principal point: 5px or 0.05mm; or COLUMN,ROWpx; 0 for exact.",
        ),
    ] = None
    dem: Annotated[
        float | None, typer.Option("--dem-sigma", metavar="SIGMA", help="DEM height standard deviation, m.")
    ] = None
    dem_correlation: Annotated[
        float | None,
        typer.Option(
            "--dem-correlation",
            metavar="DISTANCE",
            help="Correlation length of DEM errors, m (default: fully correlated).",
        ),
    ] = None

    @property
    def given(self) -> dict[str, str | float]:
        """The given ones by name, the principal point last."""
        names = sorted((field.name for field in dataclasses.fields(self)), key=lambda name: name == "principal")
        return {name: value for name in names if (value := getattr(self, name)) is not None}


def errors_given(
    stated: tuple[Any, ...], sigmas: Sigmas, gimbal: Any, where: pathlib.Path | str, pixel_pitch: float | None
) -> tuple[Any, ...]:
    """Stated error sources, with typed ones replacing them; a typed zero removes a source.

    `where` is the file they belong to, `pixel_pitch` is in mm if known. Typed ground errors are not added here
    (`ground_errors` does that). Raises `UserError`.
    """
    from jaxgeo.uncertainty import sources

    typed: dict[Any, Any] = {}
    if sigmas.position is not None:
        typed[sources.Position] = position_errors(sigmas.position, zero=True)
    if sigmas.attitude is not None:
        if gimbal.reference == "level":
            raise UserError(
                f"--attitude-sigma {sigmas.attitude}: the camera angles of {where} are relative to the horizon and "
                f"north, so the aircraft attitude does not affect the fix; give --gimbal-sigma."
            )
        typed[sources.Attitude] = attitude_errors(sigmas.attitude, zero=True)
    if sigmas.gimbal is not None:
        typed[sources.GimbalAngles] = gimbal_errors(sigmas.gimbal, gimbal, where, zero=True)
    if sigmas.focal is not None or sigmas.principal is not None:
        known = next((one for one in stated if isinstance(one, sources.InteriorOrientation)), None)
        lens = interior_errors(sigmas.focal, sigmas.principal, where, pixel_pitch, known)
        typed[sources.InteriorOrientation] = lens
    kept = [one for one in stated if type(one) not in typed]
    return (*kept, *(one for one in typed.values() if one is not None))


def ground_errors(stated: tuple[Any, ...], sigmas: Sigmas, *, level: bool) -> tuple[tuple[Any, ...], list[str]]:
    """(error sources of the ground height, assumptions); the stated ones without options. Raises `UserError`."""
    from jaxgeo.uncertainty import sources
    from jaxgeo.uncertainty.sources.height_raster import OF_TERRAIN

    own = tuple(one for one in stated if isinstance(one, OF_TERRAIN))
    if own and sigmas.dem is None and sigmas.dem_correlation is None:
        return own, []
    assumed = []
    usual = GROUND_SIGMA if level else DEM_SIGMA
    if sigmas.dem is None:
        assumed.append(f"{'Ground' if level else 'DEM'} height sigma: {usual:g} m (default). (--dem-sigma)")
    sigma = checked_sigma("--dem-sigma", usual if sigmas.dem is None else sigmas.dem)
    if sigmas.dem_correlation is None:
        return ((sources.TerrainHeight.from_metres(sigma),) if sigma else ()), assumed
    length = checked_sigma("--dem-correlation", sigmas.dem_correlation, "a distance")
    if level:
        raise UserError(f"--dem-correlation {length:g}: level ground has one common height error; use it with --dem.")
    if not length:
        raise UserError(
            "--dem-correlation 0: the correlation length must be above 0; leave it out for full correlation."
        )
    field = sources.TerrainField.of_variograms(gaussian=[(sigma, length)])
    return ((field,) if sigma else ()), assumed


def position_errors(text: str, *, zero: bool = False) -> Any:
    """Position error source; None for zero, if allowed. Raises `UserError`."""
    from jaxgeo.uncertainty.sources import Position

    north, east, down = sigmas_in("--position-sigma", text, 3, "one number in m, or NORTH,EAST,DOWN", zero=zero)
    return Position.from_ned(north=north, east=east, down=down) if north or east or down else None


def attitude_errors(text: str, *, zero: bool = False) -> Any:
    """Attitude error source; None for zero, if allowed. Raises `UserError`."""
    from jaxgeo.uncertainty.sources import Attitude

    form = "one number in deg, or HEADING,PITCH,ROLL"
    heading, pitch, roll = sigmas_in("--attitude-sigma", text, 3, form, zero=zero)
    return Attitude.from_degrees(heading=heading, pitch=pitch, roll=roll) if heading or pitch or roll else None


def gimbal_errors(text: str, gimbal: Any, where: pathlib.Path | str, *, zero: bool = False) -> Any:
    """Error source of the gimbal readings; None for zero, if allowed. Raises `UserError`."""
    from jaxgeo.uncertainty.sources import GimbalAngles

    names = gimbal.names
    if not names:
        raise UserError(f"--gimbal-sigma {text}: the gimbal of {where} is fixed and has no readings.")
    form = f"one number in deg, or {','.join(name.upper() for name in names)}"
    values = sigmas_in("--gimbal-sigma", text, len(names), form, zero=zero)
    axes: dict[str, Any] = dict(zip(names, values, strict=True))
    return GimbalAngles.from_degrees(**axes) if any(values) else None


def interior_errors(
    focal: str | None, principal: str | None, where: pathlib.Path | str, pixel_pitch: float | None, stated: Any = None
) -> Any:
    """Interior-orientation error source as typed; a part that is not typed is as `stated`, or zero.

    `pixel_pitch` in mm is that of the camera in the file `where`, None if unknown. Returns None if all parts are zero.
    Raises `UserError`.
    """
    import equinox as eqx
    import numpy as np

    from jaxgeo.uncertainty.sources import InteriorOrientation

    sigma = np.zeros(3) if stated is None else np.array(stated.sigma)
    if focal is not None:
        form = "a length with its unit, 5px or 0.05mm (the principal point has --principal-sigma)"
        sigma[..., :1] = _in_pixels("--focal-sigma", focal, 1, form, where, pixel_pitch)
    if principal is not None:
        form = "a length with its unit, 5px or 0.05mm, or two: COLUMN,ROW followed by the unit, 5,3px"
        sigma[..., 1:] = _in_pixels("--principal-sigma", principal, 2, form, where, pixel_pitch)
    if not np.any(sigma):
        return None
    if stated is None:
        return InteriorOrientation(sigma)
    return eqx.tree_at(lambda source: source.sigma, stated, sigma)  # may have an entry per image


def _in_pixels(
    option: str, text: str, count: int, form: str, where: pathlib.Path | str, pixel_pitch: float | None
) -> list[float]:
    """Detector lengths in pixels; zero needs no unit. Raises `UserError`."""
    if _is_zero(text, count):
        return [0.0] * count
    unit = text.strip()[-2:]
    if unit not in ("px", "mm"):
        raise UserError(f"{option} {text!r}: expected {form}.")
    values = sigmas_in(option, text.strip()[:-2], count, form, zero=True)
    if unit == "px":
        return values
    if pixel_pitch is None:
        raise UserError(f"{option} {text}: the camera of {where} is given in pixels; give this in px too.")
    return [value / pixel_pitch for value in values]


def _is_zero(text: str, count: int) -> bool:
    """Whether a text is one zero, or `count` zeros, without a unit."""
    parts = text.split(",")
    try:
        return len(parts) in (1, count) and all(float(part) == 0.0 for part in parts)
    except ValueError:
        return False


def pixel_pitch_of(scene: pathlib.Path) -> float | None:
    """Pixel pitch in mm from a scene file; None if absent."""
    pitch = tomllib.loads(scene.read_text(encoding="utf-8-sig"))["camera"].get("pixel_pitch_um")
    return None if pitch is None else 1e-3 * pitch


def sigmas_in(option: str, text: str, count: int, form: str, *, zero: bool = False) -> list[float]:
    """Comma-separated standard deviations, or one for all; all zero only if allowed.

    Raises `UserError`.
    """
    found = [checked_sigma(option, one) for one in numbers_in(option, text, (1, count), form)]
    found = found * count if len(found) == 1 else found
    if not any(found) and not zero:
        raise UserError(f"{option} {text}: give a standard deviation above zero.")
    return found


def checked_sigma(option: str, value: float, what: str = "a standard deviation") -> float:
    """The value, if zero or more and finite. Raises `UserError`."""
    if not 0.0 <= value < math.inf:
        raise UserError(f"{option} {value:g}: {what} must be zero or more, and finite.")
    return value
