"""Error models from published tables."""

from __future__ import annotations

from jax.typing import ArrayLike

from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sources import (
    Attitude,
    Boresight,
    GimbalAngles,
    GimbalMounting,
    Position,
    TerrainHeight,
    Velocity,
)
from jaxgeo.uncertainty.sources.base import AbstractSource

# Xue et al. (2019), Table 1: horizontal and vertical position (m), velocity (m/s), roll and pitch, heading (deg).
POS_AV_310 = {
    "SPS": (1.5, 3.0, 0.05, 0.03, 0.10),
    "RTX": (0.1, 0.2, 0.05, 0.02, 0.08),
    "RTX post-processed": (0.1, 0.2, 0.010, 0.015, 0.035),
    "SmartBase post-processed": (0.05, 0.1, 0.010, 0.015, 0.035),
}


def li_2023(*, terrain_height: ArrayLike | None = None) -> ErrorModel:
    """Table 1 of Li et al. (2023), "A target location method for aerial images through fast iteration of elevation
    based on DEM": ten independent angles of a two-axis gimbal, optionally the terrain's standard deviation in m.

    The paper uses 20 m for the latter.
    """
    sources: list[AbstractSource] = [
        Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.02),
        GimbalAngles.from_degrees(outer=0.02, inner=0.02),
        Boresight.from_degrees(heading=0.03, pitch=0.01, roll=0.01),
        GimbalMounting.from_degrees(outer=0.01, inner=0.01),
    ]
    if terrain_height is not None:
        sources.append(TerrainHeight.from_metres(terrain_height))
    return ErrorModel(tuple(sources))


def pos_av_310(solution: str, *, latency: ArrayLike = 0.005) -> ErrorModel:
    """POS AV 310 accuracies of Table 1 of Xue et al. (2019), on the geolocation accuracy of an unmanned helicopter.

    `solution` is one of `POS_AV_310`: "SPS", "RTX", "RTX post-processed", "SmartBase post-processed". Standard
    deviations apply to each axis. The velocity error acts over a `latency` in s, from the position record to the
    exposure (half an interval of 100 Hz). Raises `ValueError` for a solution that is not in the table.
    """
    if solution not in POS_AV_310:
        raise ValueError(f"solution must be one of {', '.join(POS_AV_310)}; got {solution!r}.")
    plane, height, velocity, level, heading = POS_AV_310[solution]
    return ErrorModel(
        (
            Position.from_ned(north=plane, east=plane, down=height),
            Velocity.from_ned(north=velocity, east=velocity, down=velocity, latency=latency),
            Attitude.from_degrees(heading=heading, pitch=level, roll=level),
        )
    )
