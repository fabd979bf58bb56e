"""Density of sampled ground points on the cells of a grid, calibrated so that its level sets hold what they state."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

PAIRS = 8192  # of samples, from which the shape of the kernel is found
NEAR = 0.25  # of the pairs: those within one mode
MOST_ELONGATED = 50.0  # ratio of the axes of the kernel
TREE = 2000  # samples among which neighbours are counted
NEIGHBOURS = 16  # of them: their distance gives the density of the pilot
SMOOTHING = 0.65  # times n^(-1/6) standard deviations at the peak of a normal cloud
WIDEST = 4.0  # bandwidth over the median one
REACH = 3.5  # bandwidths around a sample that have a probability
PER_CELL = 1.25  # narrowest bandwidth in cells
MOST_CELLS = 2**20
KNOTS = (*np.arange(0.05, 0.951, 0.05), 0.975, 0.99, 0.995, 0.998, 0.999)  # shares at whose levels it is calibrated


class Cells(NamedTuple):
    """Probability of square or rectangular cells, from the densest to the thinnest.

    Cells are rows and columns of a lattice with a `corner` (row, col) and a `size` (rows, cols) in posts of the DEM's
    grid. An array has those numbered `lines`, a row of numbers for its rows and one for its columns: the lattice
    without gaps between samples far apart. `index` (m,) are flat positions in the array, `density` (m,) is falling,
    `probability` (m,) sums to one. `density_at` (n,) is the density at each sample without its own part.
    """

    corner: np.ndarray
    size: np.ndarray
    lines: tuple[np.ndarray, np.ndarray]
    index: np.ndarray
    density: np.ndarray
    probability: np.ndarray
    density_at: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the array."""
        return len(self.lines[0]), len(self.lines[1])

    def rowcol(self, place: np.ndarray) -> np.ndarray:
        """(row, col) (n, 2) on the grid of places in the array, where centres of cells are at whole numbers."""
        first = np.clip(np.floor(place).astype(int), 0, np.array(self.shape) - 1)
        lines = np.stack([line[one] for line, one in zip(self.lines, first.T, strict=True)], axis=1)
        return self.corner + (lines + (place - first) + 0.5) * self.size

    def place(self, rowcol: np.ndarray) -> np.ndarray:
        """Places (n, 2) in the array of (row, col) on the grid; far outside of it in a gap."""
        lattice = (rowcol - self.corner) / self.size - 0.5
        return _in_array(lattice, self.lines)


def ground_density(rowcol: np.ndarray, post: np.ndarray) -> Cells:
    """Calibrated density of samples at (row, col) (n, 2) on cells; `post` is the size of the grid's post spacing in m.

    A Gaussian kernel of variable bandwidth at each sample, in proportion to the square root of the area per sample
    (Abramson 1982, "On bandwidth variation in kernel estimates") by the distance of a neighbour (Breiman, Meisel and
    Purcell 1977, "Variable kernel estimates of multivariate densities"). The bandwidth is 0.65 n^(-1/6) of the standard
    deviation that a normal cloud with this density would have, at most four times the median. All kernels have the
    shape of the covariance of near pairs of samples. Cells are the grid's own, divided so that the kernels span them.

    The probability of a level set is the share of samples whose density, without their own kernel, is above the level
    (leave one out): the mass of the kernels is scaled between 24 levels to agree with it.
    """
    points = rowcol * post
    shape = _kernel_shape(points)
    width = _bandwidths(points, shape)
    corner, size, lines = _lattice(rowcol, post, shape, width)
    place = _in_array((rowcol - corner) / size - 0.5, lines)
    side, extent = size * post, (len(lines[0]), len(lines[1]))
    mass, variance = _smoothed(place, extent, side, shape, width)
    return _calibrated(mass, *_at_samples(mass, place, side, shape, variance), corner, size, lines)


def _kernel_shape(points: np.ndarray) -> np.ndarray:
    """Covariance (2, 2), up to a factor, of near pairs; the smaller variance is one.

    A quarter of random pairs is kept, those nearest to each other in units of their own covariance: pairs of two modes
    far apart do not count. As the minimum covariance determinant (Rousseeuw 1985) of differences.
    """
    rng = np.random.default_rng(0)
    count = len(points)
    first = rng.integers(0, count, PAIRS)
    apart = points[first] - points[(first + rng.integers(1, max(count, 2), PAIRS)) % count]
    keep, shape = int(NEAR * PAIRS), np.eye(2)
    for _ in range(8):
        far = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(shape), apart)
        near = apart[np.argpartition(far, keep)[:keep]]
        shape = _bounded(near.T @ near)
    return shape


def _bounded(cov: np.ndarray) -> np.ndarray:
    """A covariance over its smaller variance, of limited elongation."""
    values, vectors = np.linalg.eigh(cov)
    if not values[1] > 0.0:
        return np.eye(2)
    ratio = min(values[1] / max(values[0], values[1] / MOST_ELONGATED**2), MOST_ELONGATED**2)
    return vectors * np.array([1.0, ratio]) @ vectors.T


def _bandwidths(points: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Bandwidth (n,) of each sample in m along the narrow axis."""
    scaled = points @ np.linalg.inv(np.linalg.cholesky(shape)).T
    count = len(points)
    members = np.arange(0, count, -(-count // TREE))
    neighbours = min(NEIGHBOURS, len(members) - 1)
    tree = scipy.spatial.cKDTree(scaled[members])
    distance = tree.query(scaled, k=[neighbours])[0][:, 0]
    distance[members] = tree.query(scaled[members], k=[neighbours + 1])[0][:, 0]
    # k of m samples within a distance: the density is k / (m pi d^2); a normal one of this peak has sigma:
    sigma = distance * math.sqrt(len(members) / (2.0 * neighbours))
    width = SMOOTHING * count ** (-1.0 / 6.0) * sigma
    middle = float(np.median(width))
    floor = middle / 64.0 if middle > 0.0 else max(float(width.max()) / 64.0, 1e-3)
    return np.clip(width, floor, WIDEST * max(middle, floor))


def _narrowest(shape: np.ndarray, side: np.ndarray) -> float:
    """Largest squared length of a cell's side over the kernel's axis in its direction."""
    return float(np.max(np.linalg.eigvalsh(np.diag(side) @ np.linalg.inv(shape) @ np.diag(side))))


def _lattice(
    rowcol: np.ndarray, post: np.ndarray, shape: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """(corner, size, lines) of the cells about all samples: posts divided, or joined, by whole numbers.

    As small as the narrower kernels need, or larger so that an array holds at most `MOST_CELLS`.
    """
    target = float(np.quantile(width, 0.1)) / PER_CELL
    low = rowcol.min(axis=0)
    while True:
        parts = post / target
        size = np.where(parts >= 1.0, 1.0 / np.ceil(parts), np.floor(1.0 / np.minimum(parts, 1.0)))
        widest = max(float(width.max()), PER_CELL * math.sqrt(_narrowest(shape, size * post)))
        margin = np.ceil(REACH * widest * np.sqrt(np.diag(shape)) / (size * post)).astype(int)
        corner = np.floor(low / size) * size
        cell = np.floor((rowcol - corner) / size).astype(int)
        first, second = (_lines(numbers, int(more)) for numbers, more in zip(cell.T, margin, strict=True))
        cells = float(len(first)) * len(second)
        if cells <= MOST_CELLS:
            return corner, size, (first, second)
        target *= max(math.sqrt(cells / MOST_CELLS), 1.05)


def _lines(numbers: np.ndarray, margin: int) -> np.ndarray:
    """All numbers within a margin of given ones, and some more, so that Fourier transforms are quick."""
    own = np.unique(numbers)
    breaks = np.flatnonzero(np.diff(own) > 2 * margin + 1)
    starts, ends = own[np.append(0, breaks + 1)] - margin, own[np.append(breaks, len(own) - 1)] + margin
    lines = np.concatenate([np.arange(start, end + 1) for start, end in zip(starts, ends, strict=True)])
    more = scipy.fft.next_fast_len(len(lines), real=True) - len(lines)
    return np.concatenate([lines, lines[-1] + 1 + np.arange(more)])


def _in_array(lattice: np.ndarray, lines: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Places in an array of some lines of a lattice; far outside of it in a gap."""
    first = np.floor(lattice).astype(int)
    places = []
    for line, number, at in zip(lines, first.T, lattice.T, strict=True):
        index = np.minimum(np.searchsorted(line, number), len(line) - 1)
        places.append(np.where(line[index] == number, index + (at - number), -10.0))
    return np.stack(places, axis=1)


def _smoothed(
    place: np.ndarray, extent: tuple[int, int], side: np.ndarray, shape: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(mass of the kernels in each cell (rows, cols), squared bandwidth (n,) used for each sample).

    `place` (n, 2) are the (row, col) of the samples, with centres of cells at whole numbers.
    """
    cell = np.round(place).astype(int)
    flat = cell[:, 0] * extent[1] + cell[:, 1]
    row = scipy.fft.fftfreq(extent[0], side[0])[:, None]
    col = scipy.fft.rfftfreq(extent[1], side[1])[None, :]
    power = -2.0 * math.pi**2 * (shape[0, 0] * row**2 + 2.0 * shape[0, 1] * row * col + shape[1, 1] * col**2)
    least = PER_CELL * math.sqrt(_narrowest(shape, side))
    group = np.round(2.0 * np.log2(np.maximum(width, least))).astype(int)  # two for a factor of two
    total = np.zeros(power.shape, complex)
    for number in np.unique(group):
        counts = np.bincount(flat[group == number], minlength=math.prod(extent)).reshape(extent)
        total += scipy.fft.rfft2(counts.astype(np.float64)) * np.exp(2.0**number * power)
    return scipy.fft.irfft2(total, extent, overwrite_x=True) / len(place), 2.0**group


def _at_samples(
    mass: np.ndarray, place: np.ndarray, side: np.ndarray, shape: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(density at each sample (n,) without its own kernel, interpolated as the outlines are; height of that kernel)."""
    first = np.floor(place).astype(int)
    share = place - first
    centre = np.round(place) - first
    inverse = np.linalg.inv(shape)
    peak = math.prod(side.tolist()) / (2.0 * math.pi * math.sqrt(float(np.linalg.det(shape))) * len(place)) / variance
    at = np.zeros(len(place))
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        away = (np.array(corner) - centre) * side
        own = peak * np.exp(-0.5 * np.einsum("ni,ij,nj->n", away, inverse, away) / variance)
        weight = np.prod(np.where(corner, share, 1.0 - share), axis=1)
        at += weight * (mass[first[:, 0] + corner[0], first[:, 1] + corner[1]] - own)
    return at, peak


def _calibrated(
    mass: np.ndarray,
    at: np.ndarray,
    peak: np.ndarray,
    corner: np.ndarray,
    size: np.ndarray,
    lines: tuple[np.ndarray, np.ndarray],
) -> Cells:
    """Cells with a probability: the mass of the kernels, scaled between levels to the share of samples above them."""
    flat = mass.ravel()
    index = np.flatnonzero(flat > float(peak.min()) * math.exp(-0.5 * (REACH - 0.5) ** 2))
    index = index[np.argsort(flat[index])[::-1]]
    density = flat[index]
    inside = np.cumsum(density)
    share = np.array(KNOTS)
    above = np.searchsorted(-density, -np.quantile(at, 1.0 - share), side="right")  # cells at or above the level
    kept = (above > 0) & (above < len(index))
    knot = np.concatenate([[0.0], inside[above[kept] - 1], inside[-1:]])
    at_knot = np.concatenate([[0.0], share[kept], [1.0]])
    knot, first = np.unique(knot, return_index=True)
    held = np.interp(inside, knot, at_knot[first])
    return Cells(corner, size, lines, index, density, np.diff(held, prepend=0.0), at)
