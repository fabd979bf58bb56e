"""Unknown ground beside a line of sight: counted where perturbed lines meet it, and only there."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import ndtr

from jaxgeo import Dem, Fix, Geodetic, Mount, Pose, Sensor, Shot
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.terrain import Bisection, ConstantHeight, TangentGrid
from jaxgeo.terrain.interface import along_path
from jaxgeo.uncertainty import ErrorModel, Method, sources
from jaxgeo.uncertainty.method_selection import diagnose, explain_method, select_method
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.profile import FEW, _normal_levels
from jaxgeo.uncertainty.sight_plane import SightPlane
from jaxgeo.uncertainty.unknown_ground import LinesOfSight, lost_beside
from tests.uncertainty.test_verdict import CENTRE, SENSOR, UV, shot_at

SIZE, SPACING, MIDDLE = 97, 30.0, 48  # posts; m
GROUND, TOP = 100.0, 350.0  # m: level ground, and the highest possible ground in voids
FALL = 0.2  # m per m: descent of a line of sight northwards to the middle of the terrain
LIFT, ASIDE = 8.0, 60.0  # m: standard deviations of its height over the ground and of its place aside


def level_ground(rows: Any = slice(0), cols: Any = slice(0), *, width: int = SIZE, top: float = TOP) -> Dem:
    """Level posts with a void; rows go south. Columns from `width` on are outside."""
    void = np.zeros((SIZE, SIZE), bool)
    void[rows, cols] = True
    grid = TangentGrid.centred(CENTRE, spacing=(SPACING, SPACING), shape=void.shape)
    return Dem.from_array(np.full(void.shape, GROUND), grid, void=void, void_ceiling=top, extent=(SIZE, width))


def to_the_middle(direction_enu) -> NominalFix:
    """A line of sight to the middle from 5 km away."""
    position = Geodetic(lat=CENTRE.lat, lon=CENTRE.lon, height=GROUND)
    p_ecef, away = WGS84.to_ecef(position), 5000.0
    fix = Fix(position, p_ecef, away, 0.0, 0.0, 0.0, np.int8(0))
    return NominalFix(fix, p_ecef, jnp.asarray(away), jnp.zeros(2, int), direction_enu, R_ecef_from_enu(position))


NORTHWARDS = np.array([0.0, 1.0, -FALL]) / np.hypot(1.0, FALL)
PLUMB = np.array([0.0, 0.0, -1.0])


@jax.jit
def lost(terrain, direction_enu=NORTHWARDS, ahead=LIFT / FALL):
    """The share of lines, and sigmas; `ahead` is the standard deviation of their place along the line of sight, m."""
    nominal, levels = to_the_middle(jnp.asarray(direction_enu)), _normal_levels()[FEW]
    plane, same = SightPlane.of(nominal.direction_enu), lambda sigma: lambda place: jnp.full_like(place, sigma)
    lines = LinesOfSight(plane, same(ahead * plane.fall), same(ASIDE))
    return lost_beside(terrain, nominal, lines, levels, levels * ahead)


def drawn(rows: slice, cols: slice, width: int, top: float) -> float:
    """The share by random lines over a plane: they end in a void, or beyond the border, if they are below its top."""
    lift, east = np.random.default_rng(1).standard_normal((2, 100_000)) * [[LIFT], [ASIDE]]
    ground = lift / FALL  # m north
    outside = (east > SPACING * (width - 1 - MIDDLE)) if width < SIZE else np.zeros(east.shape, bool)
    if rows.stop == 0:
        return float(np.mean(outside))
    north, south = (SPACING * (MIDDLE - row) for row in (rows.start - 1, rows.stop))
    west, east_end = (SPACING * (col - MIDDLE) for col in (cols.start - 1, cols.stop))
    lowest = lift - FALL * np.minimum(north, ground)
    inside = (east > west) & (east < east_end) & (ground > south) & (lowest < top - GROUND)
    return float(np.mean(inside | outside))


NONE = slice(0)
CASES = {
    "beside": (slice(50, 57), slice(50, 54), SIZE, TOP),
    "on the other side": (slice(50, 57), slice(42, 47), SIZE, TOP),
    "long before the fix": (slice(80, 84), slice(50, 54), SIZE, TOP),
    "far aside": (slice(50, 57), slice(62, 70), SIZE, TOP),
    "behind the fix": (slice(10, 30), slice(50, 54), SIZE, TOP),
    "passed above": (slice(80, 84), slice(50, 54), SIZE, GROUND + 100.0),
    "border beside": (NONE, NONE, MIDDLE + 2, TOP),
    "border far aside": (NONE, NONE, MIDDLE + 15, TOP),
    "void at the border": (slice(50, 57), slice(50, MIDDLE + 15), MIDDLE + 15, TOP),
}
NOT_MET = ("far aside", "behind the fix", "passed above", "border far aside")


@pytest.mark.parametrize("case", CASES)
def test_lines_are_lost_where_they_meet_unknown_ground_first(case: str) -> None:
    rows, cols, width, top = CASES[case]
    share, sigmas = lost(level_ground(rows, cols, width=width, top=top))
    expected = drawn(rows, cols, width, top)
    assert float(share) == pytest.approx(expected, abs=0.08)  # eight lines stand for all
    assert (float(share) == 0.0) == (expected < 1e-3) == (case in NOT_MET) == np.isinf(float(sigmas))


@pytest.mark.parametrize("cols", [slice(49, 52), slice(45, 48), slice(70, 72)], ids=["before", "behind", "far"])
def test_plumb_lines_are_lost_on_both_sides_of_the_nadir(cols: slice) -> None:
    """Such lines go eastwards; a void of all rows, which those meet that errors move there."""
    share, _ = lost(level_ground(slice(0, SIZE), cols), PLUMB, ASIDE)
    west, east = (SPACING * (col - MIDDLE) / ASIDE for col in (cols.start - 1, cols.stop))
    assert float(share) == pytest.approx(float(ndtr(east) - ndtr(west)), abs=0.08)


def test_ground_without_voids_stops_no_line() -> None:
    share, sigmas = lost(ConstantHeight(GROUND))
    assert (float(share), float(sigmas)) == (0.0, np.inf)


def test_no_void_is_passed_between_two_places() -> None:
    """Cells that a path crosses, against heights at many more places."""
    rng = np.random.default_rng(2)
    void = rng.uniform(size=(SIZE, SIZE)) < 0.05
    terrain = level_ground(*np.nonzero(void))
    ends = rng.uniform(-1300.0, 1300.0, (16, 2, 2))
    middle = WGS84.to_ecef(CENTRE)
    at = lambda ends: middle + np.asarray(R_ecef_from_enu(CENTRE))[:, :2] @ ends  # noqa: E731
    paths = jnp.array([[at(a), at(0.5 * (a + b)), at(b)] for a, b in ends])
    few, many = np.arange(128) / 128.0, np.arange(128 * 40) / (128.0 * 40.0)  # of 20 m, and 0.5 m at most
    found = jax.jit(jax.vmap(terrain.known_along, in_axes=(0, None)))(paths, few)

    @jax.jit
    @jax.vmap
    def looked_at(path):
        return jax.vmap(lambda place: terrain.ground_above(place)[1])(along_path(path, jnp.asarray(many)))

    expected, found = np.all(np.asarray(looked_at(paths)).reshape(16, 128, 40), axis=2), np.asarray(found)
    assert 0.2 < np.mean(expected) < 0.95
    assert not np.any(found[:, :-1] & found[:, 1:] & ~expected[:, :-1])
    assert np.mean(~found & expected) < 0.001  # corners crossed by less than 0.7 m


ERRORS = ErrorModel(
    (
        sources.Attitude.from_degrees(heading=0.2, pitch=0.03, roll=0.03),
        sources.Position.from_ned(north=2.0, east=2.0, down=3.0),
        sources.TerrainHeight.from_metres(3.0),
    )
)


@pytest.mark.costly
def test_a_void_beside_the_line_of_sight_asks_for_samples_and_one_far_from_it_does_not() -> None:
    methods = []
    for cols in (slice(50, 54), slice(70, 74)):
        terrain = level_ground(slice(75, 85), cols)  # 800 to 1100 m before the fix, 160 to 220 m below the line
        inputs = ModelInputs.of(SENSOR, shot_at(0.0), UV, terrain)
        found = diagnose(inputs, inputs.nominal_fix(Bisection()), ERRORS).diagnostics
        methods.append(Method(int(select_method(found))))
        if methods[-1] is Method.samples:
            assert float(found.known) == 1.0  # not a void of the footprint
            assert "of the perturbed lines of sight meet no known ground" in explain_method(found, methods[-1])
    assert methods == [Method.samples, Method.facet]


WIDE = ErrorModel(
    (
        sources.Attitude.from_degrees(heading=1.0, pitch=3.0, roll=2.0),
        sources.Position.from_ned(north=4.0, east=4.0, down=5.0),
        sources.TerrainHeight.from_metres(5.0),
    )
)


@pytest.mark.costly
@pytest.mark.parametrize("off_nadir", [0.0, 2.0], ids=["plumb", "two degrees east"])
def test_errors_that_reach_beyond_the_nadir_need_no_samples(off_nadir: float) -> None:
    """Over a slope, against plain random lines from 600 m above it."""
    slope, above, away = 0.4, 600.0, 600.0 * math.tan(math.radians(off_nadir))
    east = SPACING * (np.arange(SIZE) - MIDDLE)
    terrain = level_ground().with_posts(np.broadcast_to(GROUND + slope * east, (SIZE, SIZE)))
    heading, camera = math.radians(90.0), Geodetic(lat=CENTRE.lat, lon=CENTRE.lon, height=GROUND + above)
    shot = Shot(Pose(camera, heading, math.radians(off_nadir), 0.0))
    inputs = ModelInputs.of(Sensor(SENSOR.camera, SENSOR.gimbal, Mount.nadir()), shot, UV, terrain)
    found = diagnose(inputs, inputs.nominal_fix(Bisection()), WIDE)

    turn, aside, *at, up, raised = np.random.default_rng(3).standard_normal((6, 400_000))
    tangent = np.tan(np.radians(off_nadir + 3.0 * turn)), np.tan(np.radians(2.0 * aside))
    height = above + 5.0 * up - 5.0 * raised
    fall = (height - slope * 4.0 * at[0]) / (1.0 + slope * tangent[0])  # to the slope raised by the terrain's error
    middle = above * math.tan(math.radians(off_nadir)) / (1.0 + slope * math.tan(math.radians(off_nadir)))
    miss = np.hypot(4.0 * at[0] + fall * tangent[0] - middle, 4.0 * at[1] + fall * tangent[1])
    assert Method(int(select_method(found.diagnostics))) is Method.facet
    assert float(found.diagnostics.fails) == 0.0
    assert float(found.profile.circular_error(0.9)) == pytest.approx(np.quantile(miss, 0.9), rel=0.02)
    assert away < 2.0 * np.quantile(np.abs(4.0 * at[0] + fall * tangent[0] - middle), 0.683)  # two sigmas to the nadir
