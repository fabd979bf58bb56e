"""Exposures as table rows in degrees and metres, with named columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

import jaxgeo
from jaxgeo.sensor import Shot


def pose_columns(shots: Shot, names: tuple[str, ...] | None) -> dict[str, Any]:
    """Time, position, attitude and, for axes with `names`, gimbal readings of n shots: an array (n,) per column."""
    from jaxgeo.io._csv import POSE_COLUMNS, gimbal_columns

    pose, position = shots.pose, shots.pose.position
    places = [np.rad2deg(position.lat), np.rad2deg(position.lon), position.height]
    attitude = [np.rad2deg(angle) for angle in (pose.heading, pose.pitch, pose.roll)]
    columns = {"time_s": shots.time} | dict(zip(POSE_COLUMNS, [*places, *attitude], strict=True))
    if names is not None:
        readings = np.rad2deg(np.asarray(shots.gimbal_readings)).T
        columns |= dict(zip(gimbal_columns(names), readings, strict=True))
    return columns


def as_rows(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One row per entry of the columns; None for unknown values."""
    found = {name: np.asarray(values).tolist() for name, values in columns.items()}
    count = len(next(iter(found.values())))
    return [{name: _known(values[i]) for name, values in found.items()} for i in range(count)]


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def rows_of(found: jaxgeo.io.AcquisitionSet) -> list[dict[str, Any]]:
    """One row per exposure, in file order; None for unknown values and for columns its camera does not have."""
    by_place = {
        int(place): row
        for part, places in zip(found.parts, found.places, strict=True)
        for place, row in zip(places, _rows_of_part(part), strict=True)
    }
    names = dict.fromkeys(name for row in by_place.values() for name in row)
    return [{name: by_place[place].get(name) for name in names} for place in sorted(by_place)]


def _rows_of_part(found: jaxgeo.io.Acquisition) -> list[dict[str, Any]]:
    """One row per exposure, in degrees and metres; None for unknown values."""
    from jaxgeo.io.acquisitions import compare_reported
    from jaxgeo.io.observations import frame_camera_of

    names = [str(name) for name in found.names]
    columns = {"name": names} | pose_columns(found.shots, None if found.sensor is None else found.sensor.gimbal.names)
    if found.sensor is not None:
        focal = np.asarray(frame_camera_of(found.sensor).focal_px)
        columns |= {"focal_u_px": focal[:, 0], "focal_v_px": focal[:, 1]}
    if found.reported is not None:
        centre = found.reported.centre
        columns |= {"centre_lat_deg": np.rad2deg(centre.lat), "centre_lon_deg": np.rad2deg(centre.lon)}
        columns |= {"centre_height_m": centre.height, "centre_range_m": found.reported.slant_range}
        if found.sensor is not None:
            off = compare_reported(found)
            columns |= {"range_off_m": off.slant_range, "axis_off_east_m": off.east, "axis_off_north_m": off.north}
            columns |= {"axis_off_azimuth_mrad": 1e3 * off.azimuth, "axis_off_elevation_mrad": 1e3 * off.elevation}
            columns |= {"image_off_turn_deg": np.rad2deg(off.turn)}
    return as_rows(columns)


def centre_pixels(found: jaxgeo.io.AcquisitionSet) -> list[dict[str, Any]]:
    """Centre pixel of each image and the reference of its gimbal angles, in file order."""
    from jaxgeo.io.observations import frame_camera_of
    from jaxgeo.io.tables import GIMBAL_REFERENCE

    by_place: dict[int, dict[str, Any]] = {}
    for part, places in zip(found.parts, found.places, strict=True):
        own: dict[str, Any] = {}
        if part.sensor is not None:
            camera = frame_camera_of(part.sensor)
            own = {"u": 0.5 * (camera.width - 1), "v": 0.5 * (camera.height - 1)}
            own |= {GIMBAL_REFERENCE: part.sensor.gimbal.reference}
        by_place |= dict.fromkeys(map(int, places), own)
    names = dict.fromkeys(name for own in by_place.values() for name in own)
    return [{name: by_place[place].get(name) for name in names} for place in sorted(by_place)]


def tags_of(found: jaxgeo.io.AcquisitionSet) -> list[dict[str, Any]]:
    """All tags of each exposure, in file order."""
    by_place = {
        int(place): dict(tags)
        for part, places in zip(found.parts, found.places, strict=True)
        for place, tags in zip(places, part.tags or [{}] * len(part), strict=True)
    }
    return [by_place[place] for place in sorted(by_place)]
