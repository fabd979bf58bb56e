"""Eqs 1, 2 and 17 to 22: overlap, and its change by an attitude change."""

from __future__ import annotations

import math

import numpy as np

from jaxgeo.coverage import geometry
from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020.equations.common import (
    HEIGHTS,
    LOOKS,
    REQUIRED,
    SCENES,
    THETAS,
    TURNS,
    C_aircraft_from_ned,
    C_camera_from_aircraft,
    claim,
)


def overlap() -> list[Claim]:
    """Eqs 1 and 2."""
    # Eq 1: L_single = 2 H / cos(theta) tan(omega / 2).  Eq 2: rho = (L_single - L_step) / L_single.
    lengths = [length_of_eq_1(*scene) for scene in SCENES]
    ours = [
        geometry.frame_length(height_above_ground=height, off_nadir=theta, field_of_view=omega)
        for height, theta, omega in SCENES
    ]
    steps = [(step, length) for step in (385.0, -40.0) for length in (455.6, 900.0)]
    return [
        claim(1, "length of a frame", lengths, ours, "coverage.geometry.frame_length", unit="m"),
        claim(
            2,
            "overlap of a step",
            [(length - step) / length for step, length in steps],
            [geometry.overlap_of_step(*case) for case in steps],
            "coverage.geometry.overlap_of_step",
        ),
    ]


def length_of_eq_1(height: float, theta: float, omega: float) -> float:
    """Eq 1: 2 H / cos(theta) tan(omega / 2)."""
    return 2.0 * height / math.cos(theta) * math.tan(0.5 * omega)


def attitude() -> list[Claim]:
    """Eqs 17 to 22."""
    heading = [(turn, *one) for turn in TURNS for one in zip(HEIGHTS, THETAS, strict=True)]
    views = [(turn, *one) for turn in TURNS for one in LOOKS]
    rolls = [(turn, *one) for turn in TURNS for one in zip(THETAS, REQUIRED, strict=True)]
    stepped = [(step, *scene) for step in (385.0, 120.0) for scene in SCENES]
    by_pitch = [math.cos(theta) * math.tan(turn) / (2.0 * math.tan(0.5 * omega)) for turn, theta, omega in views]
    by_roll = [
        geometry.overlap_change_by_roll(off_nadir_change=turn, off_nadir=theta, overlap=required)
        for turn, theta, required in rolls
    ]
    return [
        claim(  # Eq 17: L_O3O4 = H tan(theta) sin(dlambda)
            17,
            "offset along the flight by heading",
            [height * math.tan(theta) * math.sin(turn) for turn, height, theta in heading],
            [
                geometry.along_offset_by_heading(heading_change=turn, height_above_ground=height, off_nadir=theta)
                for turn, height, theta in heading
            ],
            "coverage.geometry.along_offset_by_heading",
            unit="m",
        ),
        claim(  # after Eq 17: H tan(theta) (1 - cos(dlambda))
            "after Eq. 17",
            "offset across the flight by heading",
            [height * math.tan(theta) * (1.0 - math.cos(turn)) for turn, height, theta in heading],
            [
                geometry.across_offset_by_heading(heading_change=turn, height_above_ground=height, off_nadir=theta)
                for turn, height, theta in heading
            ],
            "coverage.geometry.across_offset_by_heading",
            unit="m",
            tolerance=1e-9,
        ),
        claim(  # Eq 18: sin(theta) sin(dlambda) / (2 tan(omega / 2))
            18,
            "change of overlap by heading",
            [math.sin(theta) * math.sin(turn) / (2.0 * math.tan(0.5 * omega)) for turn, theta, omega in views],
            [
                geometry.overlap_change_by_heading(heading_change=turn, off_nadir=theta, field_of_view=omega)
                for turn, theta, omega in views
            ],
            "coverage.geometry.overlap_change_by_heading",
        ),
        claim(  # Eq 19: cos(theta) tan(dbeta) / (2 tan(omega / 2))
            19,
            "change of overlap by pitch",
            by_pitch,
            [
                geometry.overlap_change_by_pitch(pitch_change=turn, off_nadir=theta, field_of_view=omega)
                for turn, theta, omega in views
            ],
            "coverage.geometry.overlap_change_by_pitch",
            cause="the sign of Table 2 is missing: nose up moves the frame on",
            right=[-change for change in by_pitch],
            independent=[_pitched(*one) for one in views],
        ),
        claim(  # Eq 20: 1 - L_step cos(theta) / (2 H tan(omega / 2))
            20,
            "overlap of a step of the aircraft",
            [1.0 - step * math.cos(t) / (2.0 * height * math.tan(0.5 * omega)) for step, height, t, omega in stepped],
            [
                geometry.overlap_at(step=step, height_above_ground=height, off_nadir=theta, field_of_view=omega)
                for step, height, theta, omega in stepped
            ],
            "coverage.geometry.overlap_at",
        ),
        claim(  # Eq 21: L_step / (2 H tan(omega / 2)) (cos(theta) - cos(theta + dalpha)), L_step of the nominal overlap
            21,
            "change of overlap by roll, by the step",
            [_eq_21(*one) for one in rolls],
            by_roll,
            "coverage.geometry.overlap_change_by_roll",
        ),
        claim(  # Eq 22: (1 - rho0) (1 - cos(theta + dalpha) / cos(theta))
            22,
            "change of overlap by roll",
            [(1.0 - required) * (1.0 - math.cos(theta + turn) / math.cos(theta)) for turn, theta, required in rolls],
            by_roll,
            "coverage.geometry.overlap_change_by_roll",
        ),
    ]


def _pitched(turn: float, theta: float, omega: float) -> float:
    """Change of the overlap by pitch: lines of sight by Eqs 3 and 4 intersected with a plane."""
    sight = C_aircraft_from_ned(0.0, turn, 0.0).T @ C_camera_from_aircraft(-theta, 0.0).T @ np.array([0.0, 0.0, 1.0])
    return float(-sight[0] / sight[2] / length_of_eq_1(1.0, theta, omega))


def _eq_21(
    turn: float, theta: float, required: float, height: float = 8143.0, omega: float = math.radians(0.88)
) -> float:
    step = 2.0 * height * math.tan(0.5 * omega) / math.cos(theta) * (1.0 - required)
    return step / (2.0 * height * math.tan(0.5 * omega)) * (math.cos(theta) - math.cos(theta + turn))
