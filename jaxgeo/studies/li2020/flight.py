"""The strips of Table 4 of Li et al. (2020): lines of sight, drives required for compensation, and overlaps."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._locate import locate
from jaxgeo._typing import Vector3
from jaxgeo.coverage import geometry, transform
from jaxgeo.coverage.compensation_formulas import angles_towards
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.sensor import Shot
from jaxgeo.studies.li2020 import printed


@dataclass(frozen=True)
class Sighting:
    """A strip's line of sight and its drives, all in deg.

    `azimuth` from true north and `depression` from the horizontal are those of the line of sight by the printed
    attitude and drives; `swapped_azimuth` takes roll and pitch by the Greek letters of the table. The predicted drives
    put the line of sight on the mean of all strips.
    """

    strip: int
    azimuth: float
    depression: float
    swapped_azimuth: float
    azimuth_drive: float
    predicted_azimuth_drive: float
    depression_drive: float
    predicted_depression_drive: float


@dataclass(frozen=True)
class StripPair:
    """Overlap of a strip with the previous one: printed, by the step of Eq 16, and by the step along three directions.

    `along_track` uses the direction between the first and last aircraft position, `along_ground` that between the first
    and last located point, `across_sight` the normal to the mean line of sight. `held` is along the track with every
    line of sight on the mean: the contribution of the aircraft positions. The frame length in m, by the slant range,
    and the `speed` in m/s are those of the previous strip. `flown` in m is the chord between the aircraft positions.
    `turned` is the change in deg of the line of sight's azimuth between the two strips.
    """

    strips: str
    printed: float
    by_eq_16: float
    along_track: float
    along_ground: float
    across_sight: float
    held: float
    length: float
    flown: float
    speed: float
    turned: float

    depression: float

    @property
    def off_deg(self) -> float:
        """Change of the line of sight's azimuth, deg, equivalent to the difference from the printed overlap."""
        return (self.by_eq_16 - self.printed) / overlap_of_azimuth_error(1.0, self.depression)


class _Seen(NamedTuple):
    """Per strip: ground point, slant range in m, line of sight in north-east-down, and the aircraft in ECEF m."""

    point: Geodetic
    slant_range: Float[Array, " n"]
    sight_ned: Float[Array, "n 3"]
    aircraft: Float[Array, "n 3"]


def sightings() -> list[Sighting]:
    """Lines of sight of Table 4, and the drives that would have kept them on their mean."""
    azimuth, depression = _azimuth_and_depression(_seen(_shots()).sight_ned)
    swapped = [strip._replace(roll=strip.pitch, pitch=strip.roll) for strip in printed.TABLE_4]
    swapped_azimuth, _ = _azimuth_and_depression(_seen(_shots(swapped)).sight_ned)
    aim = _direction(azimuth.mean(), depression.mean())
    drives = np.degrees(np.asarray(_held(_shots(), aim).gimbal_readings))
    return [
        Sighting(
            strip=k + 1,
            azimuth=float(azimuth[k]),
            depression=float(depression[k]),
            swapped_azimuth=float(swapped_azimuth[k]),
            azimuth_drive=row.azimuth_drive,
            predicted_azimuth_drive=float(drives[k, 1]),
            depression_drive=row.depression_drive,
            predicted_depression_drive=float(drives[k, 0]),
        )
        for k, row in enumerate(printed.TABLE_4)
    ]


def pairs() -> list[StripPair]:
    """Overlaps of Table 4 over level ground, from the printed positions, heights, attitudes and drives."""
    seen, projection = _seen(_shots()), printed.gauss_krueger()
    points = _points(seen)
    places = [printed.pose_of(strip).position for strip in printed.TABLE_4]
    convergence, _ = projection.convergence_and_scale(points[0].lat, points[0].lon)
    azimuth, depression = _azimuth_and_depression(seen.sight_ned)
    steady = _points(_seen(_held(_shots(), _direction(azimuth.mean(), depression.mean()))))
    bearings = [
        transform.bearing_on_map(projection, places[0], places[-1]),
        transform.bearing_on_map(projection, points[0], points[-1]),
        jnp.deg2rad(azimuth.mean() - 90.0) - convergence,  # the camera looks to the right
    ]
    lengths = 2.0 * np.asarray(seen.slant_range) * math.tan(math.radians(0.5 * printed.FIELD_OF_VIEW))
    flown = np.linalg.norm(np.diff(np.asarray(seen.aircraft), axis=0), axis=1)
    found = []
    for k, (before, after) in enumerate(itertools.pairwise(points)):
        length = float(lengths[k])
        track, on_ground, across = (
            float(transform.overlap_along(projection, before, after, bearing=bearing, length=length))
            for bearing in bearings
        )
        found.append(
            StripPair(
                strips=f"{k + 1}–{k + 2}",
                printed=printed.TABLE_4[k + 1].overlap or math.nan,
                by_eq_16=float(transform.overlap_of_eq_16(projection, before, after, length=length)),
                along_track=track,
                along_ground=on_ground,
                across_sight=across,
                held=float(
                    transform.overlap_along(projection, steady[k], steady[k + 1], bearing=bearings[0], length=length)
                ),
                length=length,
                flown=float(flown[k]),
                speed=printed.TABLE_4[k].speed_kmh / 3.6,
                turned=float(azimuth[k + 1] - azimuth[k]),
                depression=float(depression.mean()),
            )
        )
    return found


def mean_depression(found: list[Sighting]) -> float:
    """Mean depression of the lines of sight, deg."""
    return float(np.mean([one.depression for one in found]))


def overlap_of_azimuth_error(error_deg: float, depression_deg: float) -> float:
    """Effect of an azimuth error of the line of sight on the overlap; an error of the mirror's drive counts twice."""
    change = geometry.overlap_change_by_heading(
        heading_change=math.radians(error_deg),
        off_nadir=math.radians(90.0 - depression_deg),
        field_of_view=math.radians(printed.FIELD_OF_VIEW),
    )
    return float(change)


def _shots(strips: list[printed.Strip] | tuple[printed.Strip, ...] = printed.TABLE_4) -> Shot:
    """The exposures as one batch."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *[printed.shot_of(strip) for strip in strips])


@jax.jit
def _seen(shots: Shot) -> _Seen:
    sensor, ground = printed.sensor(mirror=True), printed.ground()

    def seen(shot: Shot) -> _Seen:
        fix = locate(sensor, shot, printed.MIDDLE, ground)
        return _Seen(
            fix.position,
            fix.slant_range,
            sensor.R_ned_from_camera(shot)[:, 2],
            WGS84.to_ecef(shot.pose.position),
        )

    return jax.vmap(seen)(shots)


def _points(seen: _Seen) -> list[Geodetic]:
    """The ground points as a list."""
    return [jax.tree.map(lambda leaf, k=k: leaf[k], seen.point) for k in range(len(printed.TABLE_4))]


def _held(shots: Shot, sight_ned: Vector3) -> Shot:
    """The exposures with drives that put every line of sight on a direction."""
    readings = jax.vmap(_drives_towards, in_axes=(0, None))(shots, sight_ned)
    return eqx.tree_at(lambda shot: shot.gimbal_readings, shots, readings)


def _drives_towards(shot: Shot, sight_ned: Vector3) -> Float[Array, "2"]:
    """Readings (depression, azimuth drive) in rad that put the line of sight on a direction."""
    gimbal = printed.sensor(mirror=True).gimbal
    angles = jnp.stack(angles_towards(shot.pose.R_ned_from_body, sight_ned))
    return angles / (gimbal.sign * gimbal.gain) + gimbal.offset


def _azimuth_and_depression(sight_ned: Float[Array, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """In deg, the azimuth in [0, 360)."""
    north, east, down = np.asarray(sight_ned).T
    return np.degrees(np.arctan2(east, north)) % 360.0, np.degrees(np.arcsin(down))


def _direction(azimuth_deg: float, depression_deg: float) -> Vector3:
    azimuth, depression = math.radians(azimuth_deg), math.radians(depression_deg)
    level = math.cos(depression)
    return jnp.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(depression)])
