"""Closed-form overlap of oblique strips over level ground.

Li et al. (2020), "Effect and compensation of overlap influenced by flight parameter of oblique aerial camera". A strip
is a sweep across the flight; two strips overlap least at their near end, and all overlaps here are for that end. Units
are rad, m and s; `field_of_view` is the full angle along the flight, `off_nadir` that of the line of sight at the near
end. An overlap is a share of the frame's length: 1 is the same ground again, below 0 is a gap.

The paper uses theta for the angle off nadir up to Eq 28, and for the angle from the horizontal, sin(theta) for
cos(theta), from Eq 29 on; there it also uses omega for 2 tan(omega/2). Here all formulas use the angle off nadir and
the tangent. Every function takes numbers or arrays, element by element; traced values are not checked.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxgeo._typing import Numbers
from jaxgeo.coverage._checks import (
    checked_field_of_view,
    checked_finite,
    checked_off_nadir,
    checked_overlap,
    checked_positive,
)


def frame_length(*, height_above_ground: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Length in m of one frame along the flight: 2 H tan(omega/2) / cos(theta) (Eq 1).

    `height_above_ground` in m is that of the camera over the ground it sees. Raises `ValueError` as `overlap_at`.
    """
    height = checked_positive(height_above_ground, "height_above_ground", "m")
    return height * _relative_length(off_nadir, field_of_view)


def overlap_of_step(step: Any, length: Any) -> Numbers:
    """Overlap of two frames of one `length` in m, a `step` in m apart (Eq 2).

    Raises `ValueError` for a length that is not positive, or a step that is not finite.
    """
    return 1.0 - checked_finite(step, "step", "m") / checked_positive(length, "length", "m")


def step_of_overlap(overlap: Any, length: Any) -> Numbers:
    """Step in m between frames of one `length` in m for an overlap; the inverse of `overlap_of_step`.

    Raises `ValueError` for an overlap outside [0, 1), or a length that is not positive.
    """
    return (1.0 - checked_overlap(overlap)) * checked_positive(length, "length", "m")


def overlap_at(*, step: Any, height_above_ground: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Overlap after a `step` in m of the aircraft: 1 - L cos(theta) / (2 H tan(omega/2)) (Eq 20).

    Raises `ValueError` for a height that is not positive, a field of view outside (0, pi), or an angle off nadir
    outside [0, pi/2).
    """
    length = frame_length(height_above_ground=height_above_ground, off_nadir=off_nadir, field_of_view=field_of_view)
    return overlap_of_step(step, length)


def along_offset_by_heading(*, heading_change: Any, height_above_ground: Any, off_nadir: Any) -> Numbers:
    """Backward shift in m of the line of sight's ground point by a heading change: H tan(theta) sin(dlambda) (Eq 17).

    A positive `heading_change` (to the right) moves the footprint of a right-looking camera backwards along the flight,
    and of a left-looking one forwards. Raises `ValueError` for a height that is not positive or an angle off nadir
    outside [0, pi/2).
    """
    return _ground_range(height_above_ground, off_nadir) * jnp.sin(_angle(heading_change, "heading_change"))


def across_offset_by_heading(*, heading_change: Any, height_above_ground: Any, off_nadir: Any) -> Numbers:
    """Shift in m of the ground point towards the track by a heading change: H tan(theta) (1 - cos(dlambda)).

    The equation after Eq 17, which has no number. Raises `ValueError` as `along_offset_by_heading`.
    """
    half = 0.5 * _angle(heading_change, "heading_change")
    return _ground_range(height_above_ground, off_nadir) * 2.0 * jnp.sin(half) ** 2


def overlap_change_by_heading(*, heading_change: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Change of the overlap by a heading change before the second strip (Eq 18).

    sin(theta) sin(dlambda) / (2 tan(omega/2)) for a right-looking camera; the opposite sign for a left-looking one. It
    counts the step along the flight: beyond some angle the second frame is behind the first, and the "overlap" exceeds
    1. The height cancels. Table 1 has 0.6553 and 1.0920 for 0.6554 and 1.0923. Raises `ValueError` as `overlap_at`.
    """
    theta, change = checked_off_nadir(off_nadir), _angle(heading_change, "heading_change")
    return jnp.sin(theta) * jnp.sin(change) / _opening(field_of_view)


def overlap_change_by_pitch(*, pitch_change: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Change of the overlap by a pitch change before the second strip (Eq 19).

    -cos(theta) tan(dbeta) / (2 tan(omega/2)). Eq 19 is printed without the sign that Table 2 has: nose up moves the
    second frame forward. The entries of Table 2 are 2.155 % larger than the formula gives, for no known reason. Raises
    `ValueError` as `overlap_at`.
    """
    theta, change = checked_off_nadir(off_nadir), _angle(pitch_change, "pitch_change")
    return -jnp.cos(theta) * jnp.tan(change) / _opening(field_of_view)


def overlap_change_by_roll(*, off_nadir_change: Any, off_nadir: Any, overlap: Any) -> Numbers:
    """Change of a target overlap if a roll increases the second strip's angle off nadir by `off_nadir_change` (Eq 22).

    (1 - rho0) (1 - cos(theta + dalpha) / cos(theta)): the step stays, the frame grows. In the paper a roll that raises
    the line of sight is positive; a right-looking camera is raised by the left wing going down. Raises `ValueError` for
    an overlap outside [0, 1) or an angle off nadir outside [0, pi/2).
    """
    theta, change = checked_off_nadir(off_nadir), _angle(off_nadir_change, "off_nadir_change")
    return (1.0 - checked_overlap(overlap)) * (1.0 - jnp.cos(theta + change) / jnp.cos(theta))


def height_change(*, aircraft: Any, ground: Any) -> Numbers:
    """Change in m of the height above ground, from height changes of aircraft and ground (Eq 27)."""
    return checked_finite(aircraft, "aircraft", "m") - checked_finite(ground, "ground", "m")


def overlap_change_by_height(*, height_change: Any, height_above_ground: Any) -> Numbers:
    """Change of the overlap by a change of the height above ground: dH / H (Eq 28).

    It compares the frame's growth with its old length, as if without overlap: `overlap_after_height_change` is the
    overlap itself. Raises `ValueError` for a height that is not positive.
    """
    change = checked_finite(height_change, "height_change", "m")
    return change / checked_positive(height_above_ground, "height_above_ground", "m")


def overlap_after_height_change(*, height_change: Any, height_above_ground: Any, overlap: Any) -> Numbers:
    """Overlap at a changed height, of frames a step apart that was planned for `overlap`: Eqs 1, 2 and 27.

    1 - (1 - rho0) H / (H + dH), exact on level ground. Raises `ValueError` for a height that is not positive, before
    or after the change, or an overlap outside [0, 1).
    """
    before = checked_positive(height_above_ground, "height_above_ground", "m")
    changed = before + checked_finite(height_change, "height_change", "m")
    after = checked_positive(changed, "height_above_ground + height_change", "m")
    return 1.0 - (1.0 - checked_overlap(overlap)) * before / after


def period_of_overlap(
    *, overlap: Any, speed: Any, height_above_ground: Any, off_nadir: Any, field_of_view: Any
) -> Numbers:
    """Time in s from strip to strip for an overlap at a constant `speed` over the ground in m/s (Eq 29).

    2 tan(omega/2) (1 - rho) H / (V cos(theta)). Raises `ValueError` for a speed that is not positive, and as
    `path_of_overlap`.
    """
    path = path_of_overlap(
        overlap=overlap, height_above_ground=height_above_ground, off_nadir=off_nadir, field_of_view=field_of_view
    )
    return path / checked_positive(speed, "speed", "m/s")


def overlap_of_period(
    *, period: Any, speed: Any, height_above_ground: Any, off_nadir: Any, field_of_view: Any
) -> Numbers:
    """Overlap of strips every `period` in s at a constant `speed` over the ground in m/s (Eq 30).

    Raises `ValueError` for a period or speed that is not positive, and as `overlap_at`.
    """
    path = checked_positive(period, "period", "s") * checked_positive(speed, "speed", "m/s")
    return overlap_of_path(
        path=path, height_above_ground=height_above_ground, off_nadir=off_nadir, field_of_view=field_of_view
    )


def overlap_change_by_speed(
    *, speed_change: Any, period: Any, height_above_ground: Any, off_nadir: Any, field_of_view: Any
) -> Numbers:
    """Change of the overlap if the mean speed between strips changes by `speed_change` in m/s (Eq 31).

    -T (dV / H) cos(theta) / (2 tan(omega/2)); the denominator is printed as alpha and is the field of view, omega.
    Raises `ValueError` for a period that is not positive, and as `overlap_at`.
    """
    length = frame_length(height_above_ground=height_above_ground, off_nadir=off_nadir, field_of_view=field_of_view)
    return -checked_positive(period, "period", "s") * checked_finite(speed_change, "speed_change", "m/s") / length


def overlap_of_path(*, path: Any, height_above_ground: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Overlap of strips with a flight `path` in m between them (Eq 33), at any speed (Eq 32).

    Raises `ValueError` as `overlap_at`.
    """
    return overlap_at(
        step=path, height_above_ground=height_above_ground, off_nadir=off_nadir, field_of_view=field_of_view
    )


def path_of_overlap(*, overlap: Any, height_above_ground: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Path in m to fly between strips for an overlap (Eq 34).

    Raises `ValueError` for an overlap outside [0, 1), and as `overlap_at`.

    >>> from jaxgeo.coverage import geometry
    >>> setting = {"height_above_ground": 1000.0, "off_nadir": 0.0, "field_of_view": np.deg2rad(50.0)}
    >>> step = geometry.path_of_overlap(overlap=0.6, **setting)
    >>> print(f"an exposure every {step:.0f} m")
    an exposure every 373 m
    """
    length = frame_length(height_above_ground=height_above_ground, off_nadir=off_nadir, field_of_view=field_of_view)
    return step_of_overlap(overlap, length)


def overlap_of_velocity_height(*, integral: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Overlap of strips from the time integral of speed over height above ground between them (Eq 35).

    Speed and height may vary. Raises `ValueError` for an integral that is not finite, a field of view outside (0, pi),
    or an angle off nadir outside [0, pi/2).
    """
    return 1.0 - checked_finite(integral, "integral", "m/m") / _relative_length(off_nadir, field_of_view)


def velocity_height_of_overlap(*, overlap: Any, off_nadir: Any, field_of_view: Any) -> Numbers:
    """Time integral of speed over height above ground (m/m) at which the next strip is due (Eq 36).

    2 tan(omega/2) (1 - rho) / cos(theta). Raises `ValueError` for an overlap outside [0, 1), a field of view outside
    (0, pi), or an angle off nadir outside [0, pi/2).
    """
    return (1.0 - checked_overlap(overlap)) * _relative_length(off_nadir, field_of_view)


def _relative_length(off_nadir: Any, field_of_view: Any) -> Numbers:
    """Frame length divided by the height above ground."""
    return _opening(field_of_view) / jnp.cos(checked_off_nadir(off_nadir))


def _opening(field_of_view: Any) -> Numbers:
    """Width of the field at unit distance, 2 tan(omega/2)."""
    return 2.0 * jnp.tan(0.5 * checked_field_of_view(field_of_view))


def _ground_range(height_above_ground: Any, off_nadir: Any) -> Numbers:
    """Distance in m from the aircraft's foot to the line of sight's intersection with level ground."""
    height = checked_positive(height_above_ground, "height_above_ground", "m")
    return height * jnp.tan(checked_off_nadir(off_nadir))


def _angle(value: Any, name: str) -> Numbers:
    return checked_finite(value, name, "rad")
