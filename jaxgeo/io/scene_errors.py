"""Error model from the table [errors] of a scene file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jaxgeo.io._schema import ErrorsTable
from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty import sources
from jaxgeo.uncertainty.model import ErrorModel

Given = float | list[float]


def model_of_table(table: ErrorsTable, gimbal: Gimbal) -> ErrorModel:
    """The error model of a table; raises `ValueError` if it does not match the gimbal."""
    found: list[Any] = []
    if table.position_m is not None:
        north, east, down = _each(table.position_m, 3)
        found.append(sources.Position.from_ned(north=north, east=east, down=down))
    if table.attitude_deg is not None:
        heading, pitch, roll = _each(table.attitude_deg, 3)
        found.append(sources.Attitude.from_degrees(heading=heading, pitch=pitch, roll=roll))
    if table.gimbal_deg is not None:
        found.append(_of_axes(sources.GimbalAngles, "gimbal_deg", table.gimbal_deg, gimbal))
    if table.gimbal_mounting_deg is not None:
        found.append(_of_axes(sources.GimbalMounting, "gimbal_mounting_deg", table.gimbal_mounting_deg, gimbal))
    if table.boresight_deg is not None:
        found.append(_boresight(table.boresight_deg, gimbal))
    if table.lever_body_m is not None:
        forward, right, down = _each(table.lever_body_m, 3)
        found.append(sources.LeverArm.from_metres(forward=forward, right=right, down=down))
    return ErrorModel((*found, *_of_image(table), *_of_ground(table)))


def _of_image(table: ErrorsTable) -> list[Any]:
    found: list[Any] = []
    if table.focal_px is not None or table.principal_px is not None:
        column, row = _each(0.0 if table.principal_px is None else table.principal_px, 2)
        focal = table.focal_px or 0.0
        found.append(sources.InteriorOrientation.from_pixels(focal=focal, principal_column=column, principal_row=row))
    if table.pixel_px is not None:
        column, row = _each(table.pixel_px, 2)
        found.append(sources.PixelMeasurement.from_pixels(column=column, row=row))
    return found


def _of_ground(table: ErrorsTable) -> list[Any]:
    if table.terrain_m is None:
        return []
    if table.terrain_correlation_m is None:
        return [sources.TerrainHeight.from_metres(table.terrain_m)]
    return [sources.TerrainField.of_variograms(gaussian=[(table.terrain_m, table.terrain_correlation_m)])]


def _of_axes(kind: Any, key: str, given: Given, gimbal: Gimbal) -> Any:
    if not gimbal.names:
        raise ValueError(f"[errors] {key}: the gimbal is fixed, so its readings have no error.")
    return kind.from_degrees(**dict(zip(gimbal.names, _each(given, len(gimbal.names), key), strict=True)))


def _boresight(given: Given, gimbal: Gimbal) -> Any:
    if gimbal.reference == "level":
        raise ValueError(
            "[errors] boresight_deg: this gimbal reports its angles against the level, so that how its base is mounted "
            "does not matter; give gimbal_mounting_deg."
        )
    heading, pitch, roll = _each(given, 3)
    return sources.Boresight.from_degrees(heading=heading, pitch=pitch, roll=roll)


def _each(given: Given, count: int, key: str = "") -> Sequence[float]:
    """One number per axis."""
    values = [given] * count if isinstance(given, float | int) else list(given)
    if len(values) != count:
        raise ValueError(f"[errors] {key} = {given!r}: expected {count} numbers, one for each reading, or one for all.")
    return [float(value) for value in values]
