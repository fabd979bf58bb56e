"""Eqs 27 to 36: height, speed and the time of the next strip."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgeo.coverage import geometry
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.sensor import Pose, Trajectory
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.equations.common import FLOWN, HEIGHTS, PERIOD, REQUIRED, SCENES, SPEED, SWING, claim


def timing() -> list[Claim]:
    """Eqs 27 to 36."""
    planned = [(*scene, required) for scene, required in zip(SCENES, REQUIRED, strict=True)]
    speed, period, roll = 172.25, 2.3, math.radians(printed.TABLE_4[0].roll)
    changes = (5.0, -8.0)
    heights = [(ground, aircraft) for ground in (100.0, -250.0) for aircraft in (0.0, 60.0)]
    by_height = [(change, height) for change in (-620.0, 150.0) for height in HEIGHTS]
    integral = period * speed / 8143.0
    stands = "omega stands for 2 tan(omega/2)"

    def opening(omega: float) -> float:
        return 2.0 * math.tan(0.5 * omega)

    def view(height: float, theta: float, omega: float) -> dict[str, float]:
        return {"height_above_ground": height, "off_nadir": theta, "field_of_view": omega}

    def with_omega(number: int, what: str, formula: Callable[..., float], ours: Any, name: str, **more: Any) -> Claim:
        """Printed with omega, corrected with the tangent; the angle from the horizontal is that of the inputs."""
        return claim(
            number,
            what,
            [formula(*one[:2], one[2], *one[3:]) for one in more["cases"]],
            ours,
            f"coverage.geometry.{name}",
            unit=more.get("unit", ""),
            digits=".8g",
            cause=more.get("cause", stands),
            right=[more.get("right", formula)(*one[:2], opening(one[2]), *one[3:]) for one in more["cases"]],
        )

    return [
        claim(  # Eq 27: dH = dH_P = -dh_T, the change of the aircraft's height or minus that of the ground
            27,
            "change of the height above the ground",
            [aircraft - ground for ground, aircraft in heights],
            [geometry.height_change(aircraft=aircraft, ground=ground) for ground, aircraft in heights],
            "coverage.geometry.height_change",
            unit="m",
        ),
        claim(  # Eq 28: -dh_T / H = dH_P / H
            28,
            "change of overlap by height",
            [change / height for change, height in by_height],
            [
                geometry.overlap_change_by_height(height_change=change, height_above_ground=height)
                for change, height in by_height
            ],
            "coverage.geometry.overlap_change_by_height",
        ),
        with_omega(  # Eq 29: T = omega (1 - rho) H / (V sin(theta)), theta from the horizontal
            29,
            "period from strip to strip",
            lambda height, theta, w, required: w * (1.0 - required) * height / (speed * math.cos(theta)),
            [geometry.period_of_overlap(overlap=one[3], speed=speed, **view(*one[:3])) for one in planned],
            "period_of_overlap",
            cases=planned,
            unit="s",
        ),
        with_omega(  # Eq 30: rho = 1 - T V sin(theta) / (H omega)
            30,
            "overlap of a period",
            lambda height, theta, w: 1.0 - period * speed * math.cos(theta) / (height * w),
            [geometry.overlap_of_period(period=period, speed=speed, **view(*one)) for one in SCENES],
            "overlap_of_period",
            cases=SCENES,
        ),
        with_omega(  # Eq 31: drho = -T (dV / H) sin(theta) / alpha
            31,
            "change of overlap by speed",
            lambda height, theta, w, change: -period * change / height * math.cos(theta) / roll,
            [
                geometry.overlap_change_by_speed(speed_change=one[3], period=period, **view(*one[:3]))
                for one in [(*scene, change) for scene in SCENES for change in changes]
            ],
            "overlap_change_by_speed",
            cases=[(*scene, change) for scene in SCENES for change in changes],
            cause="alpha, the roll of Eq 4 and so taken here, stands for 2 tan(omega/2)",
            right=lambda height, theta, w, change: -period * change / height * math.cos(theta) / w,
        ),
        claim(  # Eq 32: P = integral of V over the time
            32,
            "way between two strips at a speed that swings",
            [_way(FLOWN[1]) - _way(FLOWN[0])],
            [_flown_way()],
            "sensor.Trajectory",
            unit="m",
            tolerance=1e-3,
            reason="A flight to the north in knots 0.5 s apart, the way counted at the aircraft's height.",
        ),
        with_omega(  # Eq 33: rho = 1 - (P / H) sin(theta) / omega
            33,
            "overlap of a path",
            lambda height, theta, w: 1.0 - 385.0 / height * math.cos(theta) / w,
            [geometry.overlap_of_path(path=385.0, **view(*one)) for one in SCENES],
            "overlap_of_path",
            cases=SCENES,
        ),
        with_omega(  # Eq 34: P = H omega (1 - rho) / sin(theta)
            34,
            "path of an overlap",
            lambda height, theta, w, required: height * w * (1.0 - required) / math.cos(theta),
            [geometry.path_of_overlap(overlap=one[3], **view(*one[:3])) for one in planned],
            "path_of_overlap",
            cases=planned,
            unit="m",
        ),
        with_omega(  # Eq 35: rho = 1 - sin(theta) (integral of V / H) / omega
            35,
            "overlap of the integral of speed over height",
            lambda height, theta, w: 1.0 - math.cos(theta) * integral / w,
            [
                geometry.overlap_of_velocity_height(integral=integral, off_nadir=theta, field_of_view=omega)
                for _, theta, omega in SCENES
            ],
            "overlap_of_velocity_height",
            cases=SCENES,
        ),
        with_omega(  # Eq 36: integral of V / H = omega (1 - rho) / sin(theta)
            36,
            "integral of speed over height of an overlap",
            lambda height, theta, w, required: w * (1.0 - required) / math.cos(theta),
            [
                geometry.velocity_height_of_overlap(overlap=required, off_nadir=theta, field_of_view=omega)
                for _, theta, omega, required in planned
            ],
            "velocity_height_of_overlap",
            cases=planned,
        ),
    ]


def _way(time: float) -> float:
    """Integral of the speed SPEED + SWING sin(2 pi t / PERIOD) from 0, m."""
    turn = 2.0 * math.pi / PERIOD
    return SPEED * time + SWING / turn * (1.0 - math.cos(turn * time))


def _flown_way() -> float:
    """Distance along a northward trajectory with that speed, from its positions at the two times, at its height."""
    times = np.linspace(0.0, 10.0, 21)
    lat0, height = 0.6, 8143.0
    radius = float(WGS84.meridian_radius(jnp.asarray(lat0))) + height
    lats = [lat0 + _way(time) / radius for time in times]
    pose = Pose(
        Geodetic(lat=jnp.array(lats), lon=jnp.full(21, 1.9), height=jnp.full(21, height)),
        jnp.zeros(21),
        jnp.zeros(21),
        jnp.zeros(21),
    )
    flight = Trajectory.from_knots(times, pose, np.zeros((21, 2)))
    before, after = (float(flight.at(time).pose.position.lat) for time in FLOWN)
    return (after - before) * radius
