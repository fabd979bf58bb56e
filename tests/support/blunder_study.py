"""Simulated blocks with blunders of many kinds and sizes, their detectability, and the detected ones.

Blocks of one layout have one shape and share the compiled programs. Detectability of a blunder is computed
independently of the library, by dense textbook algebra at the true values (Baarda 1968, Foerstner 1983):

- it is detectable if its test, at the level of the study, fails with a probability of at least `POWER`, with all other
  blunders of the block in the model;
- it is separable if noise confuses it with any other measurement with a probability of at most 1 - `POWER`; by
  derivatives at the true values, and for a ray also by the point's position with another ray left out instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pyproj
from scipy import optimize, special, stats
from scipy.spatial.transform import Rotation

from jaxgeo import FrameCamera, Geodetic, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import Block, Blunder, ControlElsewhere, GroundPoints, ImagePoints, Images, LocalFrame

POWER = 0.999
FOCAL, WIDTH, HEIGHT = 4000.0, 4000, 3000  # px
FLYING = 400.0  # m above ground, where a pixel is 0.1 m
CANDIDATES = 10  # points that may be control
KINDS = (
    "image measurement",
    "control coordinate",
    "image measurements exchanged",
    "control points exchanged",
    "control of a wrong zone",
)
LAT, LON = 47.0, 11.0


@dataclass(frozen=True)
class Layout:
    """Strips of images with overlaps along and across, and points on hills; with navigation or without."""

    name: str
    strips: int
    each: int
    forward: float
    side: float
    points: int
    navigation: bool = True
    seed: int = 0


LAYOUTS = (
    Layout("8 images, 60/40 %", 2, 4, 0.6, 0.4, 60, seed=1),
    Layout("12 images, 70/50 %", 3, 4, 0.7, 0.5, 70, seed=2),
    Layout("15 images, 80/60 %", 3, 5, 0.8, 0.6, 70, seed=3),
    Layout("20 images, 60/30 %", 4, 5, 0.6, 0.3, 110, seed=4),
    Layout("12 images, 80/60 %, without navigation", 3, 4, 0.8, 0.6, 60, navigation=False, seed=5),
)


@dataclass(frozen=True)
class Truth:
    """The true layout: perspective centres, orientations, positions; visible points per image; a block."""

    centre: np.ndarray
    R: np.ndarray
    places: np.ndarray
    image: np.ndarray
    point: np.ndarray
    uv: np.ndarray
    block: Block


@cache
def truth(layout: Layout) -> Truth:
    """The true values of a layout, always the same."""
    rng = np.random.default_rng(layout.seed)
    along, across = FLYING * HEIGHT / FOCAL * (1.0 - layout.forward), FLYING * WIDTH / FOCAL * (1.0 - layout.side)
    strip, number = (x.ravel() for x in np.meshgrid(np.arange(layout.strips), np.arange(layout.each), indexing="ij"))
    n = len(strip)
    centre = np.stack([strip * across, number * along, np.full(n, FLYING)], axis=1) + rng.normal(0.0, 5.0, (n, 3))
    centre[:, :2] -= centre[:, :2].mean(axis=0)
    heading = np.where(strip % 2 == 0, 0.0, np.pi) + rng.normal(0.0, 0.03, n)
    tilt = rng.normal(0.0, 0.03, (2, n))
    frame = LocalFrame(Geodetic.from_degrees(lat=LAT, lon=LON, height=0.0))
    camera = FrameCamera.from_pixels(focal_px=FOCAL, width=WIDTH, height=HEIGHT)
    sensor = Sensor(camera, mount=Mount.nadir())
    shots = Shot(Pose(frame.to_geodetic(centre), heading, *tilt), np.zeros((n, 0)), np.zeros(n))
    half = np.abs(centre[:, :2]).max(axis=0) + 0.35 * FLYING
    ground = rng.uniform(-half, half, (40 * layout.points, 2))
    hills = 25.0 * np.sin(ground[:, 0] / 90.0) * np.cos(ground[:, 1] / 70.0)
    ground = np.column_stack([ground, hills])
    names = [f"i{k:02d}" for k in range(n)]
    start = _placed(sensor, names, shots, frame)
    R = start[1]
    uv, ahead = _pixels(start[0][:, None], R[:, None], ground[None])
    there = ahead & np.all((uv > 30.0) & (uv < [WIDTH - 31.0, HEIGHT - 31.0]), axis=2)
    rays = there.sum(axis=0)
    keep = np.flatnonzero(rays >= 2)
    # Control points are in at least three images, spread over the block; tie points are arbitrary.
    good = keep[rays[keep] >= 3]
    control = good[np.argsort(np.linalg.norm(ground[good, :2], axis=1))[:: max(len(good) // CANDIDATES, 1)]][
        :CANDIDATES
    ]
    ties = keep[~np.isin(keep, control)][: layout.points - CANDIDATES]
    chosen = np.concatenate([control, ties])
    image, point = np.nonzero(there[:, chosen])
    seen = ImagePoints(np.array(names)[image], point_names(len(chosen))[point], uv[:, chosen][image, point], 1.0)
    block = Block.from_shots(sensor, names, shots, seen, sigma_position=1.0, sigma_attitude=0.01, frame=frame)
    places = ground[chosen]
    return Truth(start[0], R, places, image, point, seen.uv, block)


def point_names(count: int) -> np.ndarray:
    """Point names; the first `CANDIDATES` may be control."""
    return np.array([f"gcp{k:02d}" if k < CANDIDATES else f"tie{k:03d}" for k in range(count)])


def _placed(sensor: Sensor, names: list[str], shots: Shot, frame: LocalFrame) -> tuple[np.ndarray, np.ndarray]:
    every = ImagePoints(names * 2, [f"x{k}" for k in range(2) for _ in names], np.zeros((2 * len(names), 2)))
    block = Block.from_shots(sensor, names, shots, every, sigma_position=1.0, sigma_attitude=1.0, frame=frame)
    return block.images.centre, block.images.R_frame_from_camera


def _pixels(centre: np.ndarray, R: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    d = np.einsum("...ji,...j->...i", R, places - centre)
    principal = np.array([(WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0])
    return principal + FOCAL * d[..., :2] / d[..., 2:], d[..., 2] > 0.0


@dataclass(frozen=True)
class Wrong:
    """A simulated blunder: its kind, the measurement (`image point` or `control point`, and its row), its error in
    px or m, and whether it is detectable."""

    kind: str
    of: str
    row: int
    error: np.ndarray
    detectable: bool = False
    separable: bool = False

    @property
    def can_be_told(self) -> bool:
        return self.detectable and self.separable


@dataclass(frozen=True)
class Case:
    """A block, its blunders, and all parameters needed to repeat it."""

    layout: Layout
    seed: int
    block: Block
    wrong: list[Wrong] = field(default_factory=list)
    sigma_px: float = 0.5


def clean(layout: Layout, seed: int) -> Case:
    """A block with noise and no blunders: 6, 8 or 10 control points of 0.02, 0.1 or 0.5 m, image points of 0.5 or 1
    px, navigation of 0.1 m and 0.02 degrees, 1 m and 0.2 degrees, or 3 m and 1 degree, which gives the starting
    values."""
    of, rng = truth(layout), np.random.default_rng(1000 * layout.seed + seed)
    n, names = len(of.centre), point_names(len(of.places))
    sigma_px, sigma_control = float(rng.choice([0.5, 1.0])), float(rng.choice([0.02, 0.1, 0.5]))
    count = int(rng.choice([6, 8, 10]))
    sigma_position, degrees = [(0.1, 0.02), (1.0, 0.2), (3.0, 1.0)][rng.integers(3)]
    chosen = np.sort(rng.permutation(CANDIDATES)[:count])
    places = of.places[chosen] + rng.normal(0.0, sigma_control, (count, 3))
    control = GroundPoints(names[chosen], places, sigma_control)
    seen = of.block.observations
    uv = seen.uv + rng.normal(0.0, sigma_px, seen.uv.shape)
    observations = ImagePoints(seen.image, seen.point, uv, sigma_px)
    centre = of.centre + rng.normal(0.0, sigma_position, (n, 3))
    nav = of.block.navigation
    assert nav is not None
    turn = Rotation.from_rotvec(rng.normal(0.0, np.deg2rad(degrees), (n, 3))).as_matrix()
    body = nav.R_frame_from_body @ turn
    mount = np.swapaxes(nav.R_frame_from_body, 1, 2) @ of.R
    eye = np.broadcast_to(np.eye(3), (n, 3, 3))
    told = replace(
        nav,
        position=centre,
        R_frame_from_body=body,
        R_frame_from_reference=body,
        information_position=eye / sigma_position,
        information_attitude=eye / np.deg2rad(degrees),
    )
    images = Images(of.block.images.name, of.block.images.camera, centre, body @ mount)
    block = replace(
        of.block,
        images=images,
        observations=observations,
        control=control,
        navigation=told if layout.navigation else None,
    )
    return Case(layout, seed, block, [], sigma_px)


def spoiled(layout: Layout, seed: int, kinds: tuple[str, ...], alpha: float | None = None) -> Case:
    """The block of `clean` with blunders of the given kinds, each in different measurements."""
    case = clean(layout, seed)
    rng = np.random.default_rng([7, layout.seed, seed])
    block, taken, wrong = case.block, set(), []
    for kind in kinds:
        for _ in range(100):
            made = _made(kind, block, rng)
            points = {_point_of(case.block, one) for one in made}
            if made and not points & taken:
                break
        else:
            raise AssertionError(f"no {kind} could be made")
        taken |= points
        block = _with(block, made)
        wrong += made
    level = familywise(case.block) if alpha is None else alpha
    return replace(case, block=block, wrong=_judged(case, wrong, level))


def familywise(block: Block, chance: float = 0.05) -> float:
    """Level of each test that limits the false alarm probability of a whole block to `chance` (Bonferroni)."""
    return chance / (len(block.observations) + len(block.control))


def _point_of(block: Block, one: Wrong) -> str:
    return str(block.observations.point[one.row] if one.of == "image point" else block.control.name[one.row])


def _made(kind: str, block: Block, rng: np.random.Generator) -> list[Wrong]:
    seen, control = block.observations, block.control
    size = float(np.exp(rng.uniform(np.log(5.0), np.log(10_000.0))))  # px
    if kind == "image measurement":
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return [
            Wrong(kind, "image point", int(rng.integers(len(seen))), size * np.array([np.cos(angle), np.sin(angle)]))
        ]
    if kind == "control coordinate":
        direction = rng.normal(size=3)
        error = size * FLYING / FOCAL * direction / np.linalg.norm(direction)
        return [Wrong(kind, "control point", int(rng.integers(len(control))), error)]
    if kind == "image measurements exchanged":
        image = rng.choice(block.images.name)
        a, b = rng.permutation(np.flatnonzero(seen.image == image))[:2].tolist()
        d = seen.uv[b] - seen.uv[a]
        return [Wrong(kind, "image point", a, d), Wrong(kind, "image point", b, -d)]
    if kind == "control points exchanged":
        a, b = rng.permutation(len(control))[:2].tolist()
        d = control.place[b] - control.place[a]
        return [Wrong(kind, "control point", a, d), Wrong(kind, "control point", b, -d)]
    row = int(rng.integers(len(control)))
    return [Wrong(kind, "control point", row, in_wrong_zone(block, control.place[row], rng.random() < 0.5))]


def in_wrong_zone(block: Block, place: np.ndarray, neighbour: bool) -> np.ndarray:
    """Error in m of a position (3,) when its UTM zone 32 coordinates are read in zone 33, or without 500 km."""
    position = block.frame.to_geodetic(place)
    lon, lat = np.rad2deg(float(position.lon)), np.rad2deg(float(position.lat))
    east, north = pyproj.Transformer.from_crs(4326, 32632, always_xy=True).transform(lon, lat)
    zone, shift = (32633, 0.0) if neighbour else (32632, 500_000.0)
    lon, lat = pyproj.Transformer.from_crs(zone, 4326, always_xy=True).transform(east + shift, north)
    there = Geodetic.from_degrees(lat=lat, lon=lon, height=float(position.height))
    return np.asarray(block.frame.from_geodetic(there)).reshape(3) - place


def _with(block: Block, made: list[Wrong]) -> Block:
    uv, place = block.observations.uv.copy(), block.control.place.copy()
    for one in made:
        if one.of == "image point":
            uv[one.row] += one.error
        else:
            place[one.row] += one.error
    seen, control = block.observations, block.control
    return replace(
        block,
        observations=ImagePoints(seen.image, seen.point, uv, seen.sigma),
        control=GroundPoints(control.name, place, control.sigma),
    )


def all_in_wrong_zone(layout: Layout, seed: int, neighbour: bool) -> tuple[Case, np.ndarray]:
    """A block whose control is all in a wrong zone, and its offset, m."""
    case = clean(layout, seed)
    control = case.block.control
    off = np.array([in_wrong_zone(case.block, place, neighbour) for place in control.place])
    moved = GroundPoints(control.name, control.place + off, control.sigma)
    return replace(case, block=replace(case.block, control=moved)), off.mean(axis=0)


# Detectability, by dense algebra.


def _design(case: Case) -> np.ndarray:
    """Derivatives of all weighted observations (2k + 3c + 6n) by all unknowns (6n + 3m) at the true values."""
    of, block = truth(case.layout), case.block
    n, m, k, c = len(of.centre), len(of.places), len(of.image), len(block.control)
    d = np.einsum("kji,kj->ki", of.R[of.image], of.places[of.point] - of.centre[of.image])
    zero = np.zeros(k)
    by_d = FOCAL * np.stack(
        [
            np.stack([1.0 / d[:, 2], zero, -d[:, 0] / d[:, 2] ** 2], axis=1),
            np.stack([zero, 1.0 / d[:, 2], -d[:, 1] / d[:, 2] ** 2], axis=1),
        ],
        axis=1,
    )
    by_point = by_d @ np.swapaxes(of.R[of.image], 1, 2) / case.sigma_px
    cross = np.zeros((k, 3, 3))
    for axis in range(3):  # derivative of d for a camera rotated by t: d - t x d
        cross[:, :, axis] = -np.cross(np.eye(3)[axis], d)
    by_turn = by_d @ cross / case.sigma_px
    A = np.zeros((2 * k + 3 * c + 6 * n, 6 * n + 3 * m))
    rows = np.arange(2 * k).reshape(k, 2, 1)
    axes = np.arange(3)
    A[rows, 6 * of.image[:, None, None] + axes] = -by_point
    A[rows, 6 * of.image[:, None, None] + 3 + axes] = by_turn
    A[rows, 6 * n + 3 * of.point[:, None, None] + axes] = by_point
    known = np.searchsorted(point_names(m)[:CANDIDATES], block.control.name)
    A[2 * k + np.arange(3 * c), (6 * n + 3 * known[:, None] + axes).ravel()] = 1.0 / block.control.sigma.ravel()
    if block.navigation is not None:
        W = (block.navigation.information_position, block.navigation.information_attitude)
        weights = np.concatenate([np.diagonal(w, axis1=1, axis2=2) for w in W], axis=1).ravel()
        A[2 * k + 3 * c + np.arange(6 * n), np.arange(6 * n)] = weights
    return A


def _judged(case: Case, wrong: list[Wrong], alpha: float) -> list[Wrong]:
    """The blunders with their detectability at a level `alpha` of each test."""
    A = _design(case)
    scale = 1.0 / np.linalg.norm(A, axis=0)
    Q, _ = np.linalg.qr(A * scale)
    k = len(case.block.observations)

    def axes(of: str, row: int) -> np.ndarray:
        return np.arange(2 * row, 2 * row + 2) if of == "image point" else 2 * k + np.arange(3 * row, 3 * row + 3)

    measured = [("image point", row) for row in range(k)]
    measured += [("control point", row) for row in range(len(case.block.control))]
    sigma = {"image point": case.sigma_px, "control point": float(case.block.control.sigma[0, 0])}
    judged = []
    for number, one in enumerate(wrong):
        others = [axes(other.of, other.row) for i, other in enumerate(wrong) if i != number]
        E = np.zeros((len(A), sum(map(len, others))))
        if others:
            E[np.concatenate(others), np.arange(E.shape[1])] = 1.0
        basis = np.linalg.svd(E - Q @ (Q.T @ E), full_matrices=False)
        taken = basis[0][:, basis[1] > 1e-6]

        def left(x: np.ndarray, taken: np.ndarray = taken) -> np.ndarray:
            x = x - Q @ (Q.T @ x)
            return x - taken @ (taken.T @ x)

        b = np.zeros(len(A))
        b[axes(one.of, one.row)] = one.error / sigma[one.of]
        r = left(b)
        own = float(r @ r)
        limit = special.chdtri(2.0, alpha)
        power = stats.ncx2.sf(limit, 2 if one.of == "image point" else 3, min(own, 1e6))
        rival = 0.0
        for of, row in measured:
            if (of, row) == (one.of, one.row) or any((of, row) == (o.of, o.row) for o in wrong):
                continue
            at = axes(of, row)
            size = np.linalg.norm(r[at])
            if size**2 < 1e-3 * own / len(at):  # its residual hardly changes
                continue
            B = np.zeros((len(A), len(at)))
            B[at, np.arange(len(at))] = 1.0
            U, s, _ = np.linalg.svd(left(B), full_matrices=False)
            rival = max(rival, float(np.sum((U[:, s > 1e-3].T @ r) ** 2)))
        apart = min(np.sqrt(max(own - rival, 0.0)), _apart_in_space(case, one))
        needed = 2.0 * special.ndtri(POWER)
        judged.append(replace(one, detectable=bool(power >= POWER), separable=bool(apart >= needed)))
    return judged


def _apart_in_space(case: Case, one: Wrong) -> float:
    """Misfit (length of all residuals, in sigmas) of a point's rays with the wrong image point included and one of
    the others left out instead, at the true orientations and without noise: a large error may move a point so far
    that derivatives at its true position do not apply. Infinite for control."""
    of = truth(case.layout)
    names = point_names(len(of.places))
    if one.of != "image point" or names[of.point[one.row]] in case.block.control.name:
        return np.inf
    rows = np.flatnonzero(of.point == of.point[one.row])
    uv = of.uv[rows] + np.where(rows[:, None] == one.row, one.error, 0.0)
    centre, R = of.centre[of.image[rows]], of.R[of.image[rows]]
    least = np.inf
    for out in np.flatnonzero(rows != one.row):
        left = np.delete(np.arange(len(rows)), out)

        def off(place: np.ndarray, left: np.ndarray = left) -> np.ndarray:
            return ((_pixels(centre[left], R[left], place)[0] - uv[left]) / case.sigma_px).ravel()

        if len(left) < 2:
            return 0.0
        principal = np.array([(WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0])
        d = np.concatenate([(uv[left] - principal) / FOCAL, np.ones((len(left), 1))], axis=1)
        d = np.einsum("kij,kj->ki", R[left], d / np.linalg.norm(d, axis=1)[:, None])
        across = np.eye(3) - d[:, :, None] * d[:, None, :]
        start = np.linalg.lstsq(across.sum(0), np.einsum("kij,kj->i", across, centre[left]), rcond=None)[0]
        for begin in (start, of.places[of.point[one.row]]):
            found = optimize.least_squares(off, begin, method="lm", x_scale=[100.0] * 3)
            least = min(least, float(np.sqrt(2.0 * found.cost)))
    return least


# Detected blunders.


@dataclass(frozen=True)
class Outcome:
    """Result of a case: each blunder with whether it was detected, and the false alarms."""

    case: Case
    named: list[tuple[Wrong, bool]]
    false: list[Blunder]


def outcome(case: Case, found: list[Blunder]) -> Outcome:
    """Detected blunders, alone or as one of two equally likely ones."""
    seen, control = case.block.observations, case.block.control

    def names(one: Wrong, blunder: Blunder) -> bool:
        if one.of == blunder.kind and one.row == blunder.row:
            return True
        if one.of == "image point":
            return blunder.point == seen.point[one.row] and seen.image[one.row] in blunder.instead
        return blunder.or_control and blunder.point == control.name[one.row]

    named = [(one, any(names(one, blunder) for blunder in found)) for one in case.wrong]
    false = [blunder for blunder in found if not any(names(one, blunder) for one in case.wrong)]
    return Outcome(case, named, false)


def drawn(count: int, layouts: tuple[Layout, ...] = LAYOUTS) -> Iterator[tuple[Layout, int, tuple[str, ...]]]:
    """(layout, seed, kinds): layouts in rotation, one to three blunders in rotation, kinds in rotation."""
    at = 0
    for number in range(count):
        many = 1 + number // len(layouts) % 3
        kinds = tuple(KINDS[(at + i) % len(KINDS)] for i in range(many))
        at += many
        yield layouts[number % len(layouts)], number, kinds


def refusal(run: Callable[[Block], Any], case: Case) -> ControlElsewhere | None:
    """The error that a run raises for control that lies elsewhere."""
    try:
        run(case.block)
    except ControlElsewhere as error:
        return error
    return None
