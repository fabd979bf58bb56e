"""Records for plot tests, synthetic where possible, each built once."""

from __future__ import annotations

import math
from functools import cache

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxgeo import ConstantHeight, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot, propagate
from jaxgeo.adjust import Adjustment, Reliability, adjust
from jaxgeo.coverage import Footprint, Overlap
from jaxgeo.earth import WGS84, Geodetic, TransverseMercator
from jaxgeo.fix import Fix
from jaxgeo.ortho import Orthoimage
from jaxgeo.plot import Section, style
from jaxgeo.register import BlockOutcome, Chosen, Matches, Outcome, Pass, Registration, TieErrors, TiePoints
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.prediction import Shifts
from jaxgeo.status import Status
from jaxgeo.terrain import Dem, GeographicGrid, TangentGrid
from jaxgeo.uncertainty import Accuracy, AccuracyMap, Budget, Comparison, Propagation, Sampled, sources
from jaxgeo.uncertainty._budget import SigmaShare, SourceShare, Variance
from jaxgeo.uncertainty._compare import Row
from jaxgeo.uncertainty.method_selection import Diagnostics
from tests.support.simulated_block import SIGMA_UV, simulated

SHAPE = (41, 61)


def new_axes(width: float = style.COLUMN, tall: float = 1.0) -> Axes:
    """The only axes of a figure in the package's style, `width` inches wide."""
    with mpl.rc_context(style.style(width)):
        figure = Figure(figsize=(width, tall * width), layout="constrained")
        FigureCanvasAgg(figure)
        return figure.add_subplot()


def words(axes: Axes) -> list[str]:
    """Lines of the legend."""
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def said(axes: Axes) -> str:
    """Text above the legend."""
    legend = axes.get_legend()
    assert legend is not None
    return legend.get_title().get_text().replace("\n", " ")


def labels(axes: Axes) -> list[str]:
    """Labels of a potential legend."""
    return axes.get_legend_handles_labels()[1]


def line(axes: Axes, label: str) -> np.ndarray:
    """Points (n, 2) of the line with a label."""
    (found,) = [one for one in axes.lines if one.get_label() == label]
    return np.asarray(found.get_xydata())


# Terrain and fixes.


def hill(shape: tuple[int, int] = SHAPE) -> np.ndarray:
    row, col = np.indices(shape)
    return 500.0 + 300.0 * np.exp(-((row - 20.0) ** 2 + (col - 30.0) ** 2) / 80.0)


def north_up() -> Dem:
    affine = (0.001, 0.0, 5.0, 0.0, -0.001, 44.04)
    return Dem.from_array(hill(), GeographicGrid.from_affine(affine, SHAPE))


def turned() -> Dem:
    centre = Geodetic.from_degrees(lat=44.02, lon=5.03, height=500.0)
    grid = TangentGrid.centred(centre, spacing=(90.0, 90.0), shape=SHAPE, heading=2.0)
    return Dem.from_array(hill(), grid)


def fixes() -> Fix:
    lat = np.deg2rad([44.01, 44.02, np.nan])
    lon = np.deg2rad([5.01, 5.02, np.nan])
    number = np.array([1.0, 1.0, np.nan])
    status = np.array([Status.hit, Status.enters_from_side, Status.rises_away], np.int8)
    position = Geodetic(lat=lat, lon=lon, height=number)
    return Fix(position, np.zeros((3, 3)), number, number, number, number, jnp.asarray(status))


def on_the_hill() -> Fix:
    """A fix at the post in row 20 and column 30."""
    position = Geodetic.from_degrees(lat=44.02, lon=5.03, height=800.0)
    number = jnp.asarray(1.0)
    return Fix(position, WGS84.to_ecef(position), number, number, number, number, jnp.asarray(0, jnp.int8))


# Errors.


def sampled(count: int = 2000, failed: int = 0, keep: bool = True) -> Sampled:
    """Errors of 20 m east and 10 m north, the last of which have no fix."""
    errors = np.random.default_rng(0).standard_normal((count, 3)) * [20.0, 10.0, 5.0]
    errors[count - failed :] = np.nan
    radii = {"CE": np.nan_to_num(np.hypot(errors[:, 0], errors[:, 1]), nan=np.inf)}
    kept = errors if keep else None
    zero = np.zeros(3)
    return Sampled(
        on_the_hill(), count, count - failed, {}, zero, np.diag([400.0, 100.0, 25.0]), zero, radii, 0, 0.95, kept
    )


@cache
def level() -> Propagation:
    """Errors of a nadir camera 2 km above level ground."""
    sensor = Sensor(FrameCamera.from_pixels(focal_px=300.0, width=256, height=192), Gimbal.fixed(), Mount.nadir())
    shot = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=2000.0))
    errors = [sources.Position.from_ned(north=8.0, east=4.0, down=2.0)]
    return propagate(sensor, shot, np.array([127.5, 95.5]), ConstantHeight(0.0), errors)


def compared(*, jumps: int = 0, failed: int = 0, keep: bool = True) -> Comparison:
    """The propagation against samples of its own covariance; some jump 800 m to the east, and some fail."""
    count = 3000
    errors = np.random.default_rng(2).multivariate_normal(np.zeros(3), np.asarray(level().cov_enu) + np.eye(3), count)
    errors[:jumps, 0] += 800.0
    errors[count - failed :] = np.nan
    found = errors[: count - failed]
    radii = {name: np.nan_to_num(np.hypot(errors[:, 0], errors[:, 1]), nan=np.inf) for name in ("CE", "LE", "SE")}
    mean, cov, kept = found.mean(axis=0), np.cov(found.T), errors if keep else None
    drawn = Sampled(level().fix, count, count - failed, {}, mean, cov, np.zeros(3), radii, 0, 0.95, kept)
    figures = (
        drawn.circular_error(0.5),
        drawn.circular_error(0.9),
        drawn.linear_error(0.9),
        drawn.spherical_error(0.9),
    )
    rows = (Row("linear, facet", (1.0, 2.0, 3.0, 4.0), ("valid", "not valid", "valid", "valid")),)
    beyond = np.arange(count) < jumps
    shares = (jumps / count, failed / count)
    return Comparison(level().fix, rows, figures, 2, *shares, drawn, {"linear, facet": level()}, beyond)


def a_budget() -> Budget:
    """A budget of a block and three errors, with 50 to 5 % of the horizontal, 60 to 0 % of the vertical variance."""
    parts = ((6.0, 0.2, "rad", 0.01), (3.0, 0.6, "m", 2.5), (1.0, 0.0, "m", 0.5))
    lines = tuple(
        SigmaShare(f"source: {k}", sigma, unit, Variance(across, up), 5.0 + k, 0.1)
        for k, (across, up, unit, sigma) in enumerate(parts)
    )
    source = SourceShare("source", Variance(10.0, 0.8), 0.0, False, lines)
    hidden = SigmaShare("block: a", 1.0, "m", None, 3.0, 0.1)
    block = SourceShare("block", Variance(10.0, 0.2), 4.0, True, (hidden,))
    return Budget((source, block), Variance(20.0, 1.0), 9.0, 0.9, Status.hit)


@cache
def adjusted() -> Adjustment:
    return adjust(simulated().noisy(8).block())


def judged(wrong: tuple[int, ...] = ()) -> Reliability:
    """A constructed reliability result: equal redundancies, some beyond the test, the last one uncontrolled."""
    redundancy = np.full(adjusted().residuals.shape, 0.64)
    standardised = adjusted().residuals / SIGMA_UV / 0.8
    standardised = np.clip(standardised, -3.0, 3.0)
    standardised[list(wrong), 0] = 7.0
    standardised[-1] = np.nan
    return Reliability(redundancy, standardised, np.ones_like(redundancy), 0.001)


UV = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
ERROR = np.array([[1.0, 2.0, 4.0, 8.0], [1.0, 2.0, np.nan, 8.0], [1.0, 2.0, 4.0, np.inf]])
METHOD = np.array([[0, 0, 1, 2], [0, 0, -1, 2], [0, 0, 1, 2]], np.int8)


def accuracies(error: np.ndarray = ERROR) -> AccuracyMap:
    """An accuracy map of positions 0.01 degrees apart, one of them hidden."""
    lon, lat = np.deg2rad(5.0 + 0.01 * UV[..., 0]), np.deg2rad(44.0 + 0.01 * UV[..., 1])
    status = np.where(METHOD < 0, np.int8(Status.hidden_by_terrain), np.int8(Status.hit))
    position = Geodetic(lat=lat, lon=lon, height=np.zeros_like(lat))
    diagnostics = Diagnostics(*[jnp.asarray(1.0)] * len(Diagnostics._fields))  # not drawn
    unknown = np.full(error.shape, np.nan)
    fix = Fix(position, np.zeros((*error.shape, 3)), *[unknown] * 4, status)
    cov, bias = np.full((*error.shape, 3, 3), np.nan), np.full((*error.shape, 3), np.nan)
    figures = (np.full(error.shape, 0.9), error, 2.0 * error, error, METHOD, cov, bias, error)
    return AccuracyMap(Accuracy(fix, *figures, diagnostics, count=100), position, UV)


# Footprints.


PLACE = Geodetic.from_degrees(lat=44.02, lon=5.03, height=500.0)
RING = np.array([[0.0, 0.0], [900.0, 0.0], [1800.0, 0.0], [1800.0, 900.0], [0.0, 900.0]])  # m east and north


def outlined(*, lost: tuple[int, ...] = (), hidden: tuple[int, ...] = ()) -> Footprint:
    """The footprint of a ring of points, some without ground, and some next to a discontinuity."""
    count = len(RING)
    metres = math.radians(1.0) * 6.37e6
    lat = np.deg2rad(44.02 + RING[:, 1] / metres)
    lon = np.deg2rad(5.03 + RING[:, 0] / metres / math.cos(math.radians(44.02)))
    status = np.full(count, Status.hit, np.int8)
    status[list(lost)] = Status.rises_away
    lat, lon = (np.where(status == Status.hit, x, np.nan) for x in (lat, lon))
    number = np.ones(count)
    position = Geodetic(lat=lat, lon=lon, height=np.full(count, 500.0))
    fix = Fix(position, np.zeros((count, 3)), number, number, number, number, jnp.asarray(status))
    jumps = np.isin(np.arange(count), hidden)
    whole = np.asarray(Status.crosses_horizon if lost else Status.hit, np.int8)
    outline = np.where((status == Status.hit)[:, None], RING, np.nan)
    return Footprint(RING, fix, jumps, outline, whole, TransverseMercator.gauss_krueger(PLACE.lon))


def overlaps(along: list[list[float]], status: Status = Status.hit) -> Overlap:
    values = jnp.array(along)
    count, stations = values.shape
    across = jnp.broadcast_to(jnp.linspace(1000.0, 3000.0, stations), values.shape)
    number, codes = np.zeros(count), np.full(count, status, np.int8)
    least, sideways = values.min(axis=1), np.zeros((count, 2))
    return Overlap(values[:, 0], values[:, -1], least, values, across, number, sideways, number, number, codes)


def a_section(**changes) -> Section:
    """A synthetic line of sight that passes through two ridges."""
    distance = np.linspace(0.0, 4000.0, 401)
    ground = 100.0 + 300.0 * np.exp(-(((distance - 2000.0) / 150.0) ** 2))
    void = (distance > 500.0) & (distance < 800.0)
    hits = np.array([[1900.0, 330.0], [3100.0, 100.0]])
    given = {
        "distance": distance,
        "sight": 700.0 - 0.2 * distance,
        "ground": np.where(void, np.nan, ground),
        "flat": 698.0 - 0.2 * distance,
        "void": void,
        "hits": hits,
        "status": Status.hit,
    }
    return Section(**{**given, **changes})


# A registration.

CENTRE = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
MAP_SHAPE, CELL = (200, 300), 10.0  # cells, m
GRID = TangentGrid.centred(CENTRE, spacing=(CELL, CELL), shape=MAP_SHAPE)
# Blocks: two that agree, one with a candidate elsewhere, one with too little texture.
CENTRES = np.array([[50.0, 60.0], [50.0, 240.0], [150.0, 60.0], [150.0, 240.0]])
SHIFTS = np.array(
    [[[2.0, 5.0], [9.0, -9.0]], [[2.0, 6.0], [np.nan] * 2], [[-8.0, 3.0], [np.nan] * 2], [[np.nan] * 2] * 2]
)
OUTCOMES = [BlockOutcome.matched, BlockOutcome.matched, BlockOutcome.matched, BlockOutcome.no_texture]
SENSOR = Sensor(FrameCamera.from_pixels(focal_px=300.0, width=256, height=192), Gimbal.fixed(), Mount.nadir())
SHOT = Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=2000.0))


def image(value: float, known: np.ndarray | None = None) -> Orthoimage:
    """Uniform image with some dark rows, so that there is a range of brightness."""
    values = np.full(MAP_SHAPE, value)
    values[:4] = 0.0
    return Orthoimage.of(values, GRID, known)


def a_pass(false_alarms: float = 1e-20, peak: tuple[int, ...] = (0, 0, -1, -1)) -> Pass:
    """Blocks whose shift is that of the map alone: 0.1 cells per m."""
    score = np.where(np.isfinite(SHIFTS[..., 0]), 0.8, np.nan)
    covariance = np.where(np.isfinite(score)[..., None, None], 0.01 * np.eye(2), np.nan)
    matches = Matches(CENTRES, SHIFTS, score, covariance, np.array(OUTCOMES, np.int8), np.array([99, 99, 99, 0]))
    by_error = np.broadcast_to(np.array([[0.0, -0.1], [0.1, 0.0]]), (4, 2, 2))  # north is up, rows go down
    ones = np.ones(4)
    shifts = Shifts(CENTRES[:, ::-1], by_error, by_error, CELL * ones, ones, ones > 0.0, 0.0 * ones, np.zeros((4, 2)))
    chosen = Chosen(np.array(peak), ones, 10, 2)
    agreeing = sum(one >= 0 for one in peak)
    return Pass(CELL, 64, matches, chosen, shifts, 3, agreeing, 0, false_alarms, 297)


def registration(outcome: Outcome = Outcome.few_agree, passes: tuple[Pass, ...] | None = None) -> Registration:
    ground = normals_of(CENTRES[:2])
    ties = TiePoints(CENTRES[:2, ::-1], ground, np.broadcast_to(np.eye(2), (2, 2, 2)))
    done = (a_pass(),) if passes is None else passes
    return Registration(outcome, SENSOR, SHOT, ConstantHeight(0.0), None, TieErrors(0.5, 5.0, 10.0), ties, done)


def normals_of(places: np.ndarray) -> Geodetic:
    """Ellipsoid positions of points (n, 2) = (row, col)."""
    normal = np.stack([np.asarray(GRID.normal(jnp.asarray(place))) for place in places])
    x, y, z = normal.T
    return Geodetic(lat=np.arctan2(z, np.hypot(x, y)), lon=np.arctan2(y, x), height=np.zeros(len(places)))


def block_places(residual: float = 1.0) -> BlockPlaces:
    """Residuals of the ties to the east; the last block is over unknown ground."""
    ground = normals_of(CENTRES)
    ground = Geodetic(lat=np.where(np.arange(4) < 3, ground.lat, np.nan), lon=ground.lon, height=ground.height)
    offsets = np.array([[residual, 0.0], [residual, 0.0], [np.nan] * 2, [np.nan] * 2])
    return BlockPlaces(CENTRES[:, ::-1], ground, np.array([0, 1, -1, -1]), offsets)


def a_fix(sigma: float, degrees: float = 0.0):
    """A fix of the image centre with errors of `sigma` m along north, twice that along east."""
    pose = Pose.from_degrees(lat=47.0, lon=11.0, height=2000.0, pitch=degrees)
    model = (sources.Position.from_ned(north=sigma, east=2.0 * sigma, down=0.0),)
    return propagate(SENSOR, Shot(pose), (127.5, 95.5), ConstantHeight(0.0), model)
