"""Long strips without control or navigation: they converge from drifting starts, and bend without a misfit."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from jaxgeo import FrameCamera
from jaxgeo.adjust import Adjustment, Block, Cartesian, ImagePoints, Images, InnerConstraints, LeastSquares, adjust
from jaxgeo.adjust.equations import cost_of
from jaxgeo.adjust.problem import prepared
from jaxgeo.adjust.solve import _with_points
from jaxgeo.adjust.unknowns import Unknowns

HEIGHT, FOCAL, SIDE, SIGMA = 1000.0, 5000.0, 4000, 0.3  # m, px, px, px
REACH = HEIGHT * SIDE / FOCAL  # m on the ground
BASE = 0.4 * REACH  # 60 % overlap: few points are in three images
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Strip:
    """Nadir images on a line, tilted by half a degree, with 60 points for each base, as seen with noise of `SIGMA`."""

    centre: np.ndarray
    R: np.ndarray
    seen: ImagePoints

    @classmethod
    def of(cls, images: int, seed: int) -> Strip:
        rng = np.random.default_rng(seed)
        offsets = rng.normal(0.0, 3.0, (images, 2))
        centre = np.stack([BASE * np.arange(images), offsets[:, 0], HEIGHT + offsets[:, 1]], axis=1)
        R = DOWN @ turned(np.deg2rad(rng.normal(0.0, 0.5, (images, 3))))
        count, last = 60 * images, BASE * (images - 1)
        east, north = rng.uniform(-0.5 * REACH, last + 0.5 * REACH, count), rng.uniform(-0.5, 0.5, count) * REACH
        ground = np.stack([east, north, rng.normal(0.0, 30.0, count)], axis=1)
        image, point, uv = [], [], []
        for k in range(images):
            ray = (ground - centre[k]) @ R[k]
            pixel = FOCAL * ray[:, :2] / ray[:, 2:] + 0.5 * SIDE
            there = np.flatnonzero(np.all((pixel > 0.0) & (pixel < SIDE - 1.0), axis=1))
            image += [k] * len(there)
            point += there.tolist()
            uv.append(pixel[there])
        often = np.bincount(point, minlength=count)[point] > 1
        names = [np.char.add(letter, np.array(x)[often].astype(str)) for letter, x in (("i", image), ("p", point))]
        measured = np.concatenate(uv)[often]
        return cls(centre, R, ImagePoints(*names, measured + rng.normal(0.0, SIGMA, measured.shape), SIGMA))

    def block(self, centre: np.ndarray, R: np.ndarray) -> Block:
        """The strip with these orientations to start from."""
        names = np.char.add("i", np.arange(len(centre)).astype(str))
        camera = FrameCamera.from_pixels(focal_px=FOCAL, width=SIDE, height=SIDE)
        return Block(Cartesian(), {"c": camera}, Images(names, np.full(len(centre), "c"), centre, R), self.seen)

    def drifting(self, metres: float, degrees: float, seed: int) -> Block:
        """From dead reckoning: errors of position and attitude that add up from image to image."""
        rng = np.random.default_rng(seed)
        position, angle = (np.cumsum(rng.normal(0.0, x, self.centre.shape), axis=0) for x in (metres, degrees))
        return self.block(self.centre + position, self.R @ turned(np.deg2rad(angle)))


def turned(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of rotation vectors in rad."""
    return scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix()


def free_network(block: Block) -> Adjustment:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of what stays set aside
        return adjust(block, datum=InnerConstraints())


def check_noise(found: Adjustment) -> None:
    """The squared residuals are those of the noise, within the 99.99 % bounds of chi-square."""
    low, high = scipy.stats.chi2.interval(0.9999, found.redundancy)
    assert low < found.sigma0**2 * found.redundancy < high


@pytest.mark.costly
def test_points_that_are_taken_back_start_where_adjusted_rays_meet() -> None:
    """A start so poor that all measurements of some points are set aside at first."""
    strip = Strip.of(40, 1)
    found = free_network(strip.drifting(2.0, 0.2, 2))
    costs = np.array([one.cost for one in found.log])
    from_truth = free_network(strip.block(strip.centre, strip.R))
    check_noise(found)
    assert len(found.screened) == len(from_truth.screened) == 0
    np.testing.assert_allclose(found.cost, from_truth.cost, rtol=1e-9)
    settled = int(np.argmax(costs < 2.0 * found.cost))
    assert np.all(costs[settled:] < 2.0 * found.cost)  # also where the others are taken back


def test_bent_images_keep_their_points_where_rays_meet() -> None:
    """A strip turned along an arc, with points moved along tangents, misfits by the square of the turn; placing the
    points anew takes that away, and never raises the cost."""
    strip = Strip.of(20, 3)
    ready = prepared(strip.block(strip.centre, strip.R), Unknowns())
    problem, values, loss = ready.problem, ready.problem.start, LeastSquares()
    before = float(cost_of(problem, values, loss))
    middle = strip.centre.mean(axis=0)

    def by(place: np.ndarray) -> np.ndarray:
        """Angle in rad about north: a bend of 2 deg over the strip."""
        return np.deg2rad(2.0) * (place[:, 0] - middle[0]) / np.ptp(strip.centre[:, 0])

    def shifted(place: np.ndarray) -> np.ndarray:
        """Places moved along the tangent of the arc: by the turn times the distance along, and times the height."""
        along = place[:, 0] - middle[0]
        up = -0.5 * by(place) * along
        return place + np.stack([by(place) * (place[:, 2] - HEIGHT), 0.0 * up, up], axis=1)

    turn = by(strip.centre)
    about_north = turned(turn[:, None] * np.array([0.0, 1.0, 0.0]))
    points = shifted(np.asarray(values.points))
    changed = jnp.asarray(shifted(strip.centre)), jnp.asarray(about_north @ strip.R), jnp.asarray(points)
    bent = eqx.tree_at(lambda v: (v.centre, v.R_frame_from_camera, v.points), values, changed)
    cost = float(cost_of(problem, bent, loss))
    placed, after = _with_points(problem, bent, cost, loss)
    assert after < 0.5 * (cost + before)
    np.testing.assert_allclose(float(cost_of(problem, placed, loss)), after, rtol=1e-12)
    assert np.array_equal(placed.centre, bent.centre)
    same, least = _with_points(problem, placed, 0.0, loss)
    assert same is placed
    assert least == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("metres, degrees, seed", [(2.0, 0.05, 4), (1.0, 0.1, 6)])
def test_free_strips_of_600_images_converge(metres: float, degrees: float, seed: int) -> None:
    check_noise(free_network(Strip.of(600, seed).drifting(metres, degrees, seed)))
