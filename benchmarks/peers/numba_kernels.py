"""Compiled float64 kernels: tracks of rays over the grid, a walk over every cell, and a test of every triangle.

Positions are (row, col, height) with posts at integers, height in m. A track is a polynomial of degree 5 in tau in [-1,
1], `coefficients` (power, quantity), exact to about 1e-11 of a cell over 20 km. The walk steps through the cells along
straight pieces of at most `PIECE` cells, and settles every cell not cleared by `MARGIN` with the polynomial itself:
borders by Newton, the bilinear patch by a parabola, the root by bisection and Newton.
"""

from __future__ import annotations

import math

import numba  # pyright: ignore[reportMissingImports]
import numpy as np

A, F = 6378137.0, 1.0 / 298.257223563
B, E2 = A * (1.0 - F), F * (2.0 - F)
EP2 = E2 / (1.0 - E2)
NODES = 6
TAU = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
FIT = np.linalg.inv(np.vander(TAU, increasing=True))
PIECE = 24.0  # cells; a piece of 720 m deviates from its chord by 1 cm
MARGIN = 0.05  # m


@numba.njit
def normal_and_height(x, y, z):
    """Ellipsoid normal and height by two steps of Bowring's iteration (1976)."""
    p = math.sqrt(x * x + y * y)
    c, s = B * p, A * z
    norm = math.sqrt(c * c + s * s)
    c, s = c / norm, s / norm
    cos, sin = 1.0, 0.0
    for _ in range(2):
        sin = z + EP2 * B * s * s * s
        cos = p - E2 * A * c * c * c
        norm = math.sqrt(cos * cos + sin * sin)
        cos, sin = cos / norm, sin / norm
        c, s = cos, (1.0 - F) * sin
        norm = math.sqrt(c * c + s * s)
        c, s = c / norm, s / norm
    height = p * cos + z * sin - A * math.sqrt(1.0 - E2 * sin * sin)
    return cos * x / p, cos * y / p, sin, height


@numba.njit
def _range_at(o, d, height, guess):
    """Range at which a descending ray passes a height, by Newton from `guess`."""
    at = guess
    for _ in range(6):
        nx, ny, nz, h = normal_and_height(o[0] + at * d[0], o[1] + at * d[1], o[2] + at * d[2])
        step = (height - h) / (nx * d[0] + ny * d[1] + nz * d[2])
        at += step
        if abs(step) < 1e-3:
            break
    return at


@numba.njit(parallel=True)
def tracks(origin, direction, axes, scale, middle, top, bottom):
    """Tracks of rays between two heights: (coefficients (n, 6, 3), middle range, half length)."""
    count = origin.shape[0]
    coefficients, centre, half = np.empty((count, NODES, 3)), np.empty(count), np.empty(count)
    for k in numba.prange(count):
        o, d = origin[k], direction[k]
        _, _, _, h = normal_and_height(o[0], o[1], o[2])
        start = _range_at(o, d, top, 0.0) if h > top else 0.0
        end = _range_at(o, d, bottom, start)
        centre[k], half[k] = 0.5 * (start + end), 0.5 * (end - start)
        coefficients[k] = 0.0
        for node in range(NODES):
            at = centre[k] + half[k] * TAU[node]
            nx, ny, nz, h = normal_and_height(o[0] + at * d[0], o[1] + at * d[1], o[2] + at * d[2])
            east = axes[0, 0] * nx + axes[0, 1] * ny + axes[0, 2] * nz
            north = axes[1, 0] * nx + axes[1, 1] * ny + axes[1, 2] * nz
            up = axes[2, 0] * nx + axes[2, 1] * ny + axes[2, 2] * nz
            row, col = middle[0] - north / up * scale[0], middle[1] + east / up * scale[1]
            for power in range(NODES):
                coefficients[k, power, 0] += FIT[power, node] * row
                coefficients[k, power, 1] += FIT[power, node] * col
                coefficients[k, power, 2] += FIT[power, node] * h
    return coefficients, centre, half


@numba.njit
def value(c, q, tau):
    v = c[NODES - 1, q]
    for power in range(NODES - 2, -1, -1):
        v = v * tau + c[power, q]
    return v


@numba.njit
def _slope(c, q, tau):
    v = (NODES - 1.0) * c[NODES - 1, q]
    for power in range(NODES - 2, 0, -1):
        v = v * tau + power * c[power, q]
    return v


@numba.njit
def _clearance(posts, i, j, c, tau):
    u, v = value(c, 0, tau) - i, value(c, 1, tau) - j
    low = posts[i, j] * (1.0 - v) + posts[i, j + 1] * v
    high = posts[i + 1, j] * (1.0 - v) + posts[i + 1, j + 1] * v
    return value(c, 2, tau) - (low * (1.0 - u) + high * u)


@numba.njit
def _on_border(c, tau, axis, line):
    if axis < 0:
        return tau
    for _ in range(2):
        tau -= (value(c, axis, tau) - line) / _slope(c, axis, tau)
    return tau


@numba.njit
def _settle(posts, i, j, c, begin, end):
    """tau of the first crossing of the patch of cell (i, j) in [begin, end], or NaN."""
    first, last = _clearance(posts, i, j, c, begin), _clearance(posts, i, j, c, end)
    if first <= 0.0:
        return begin
    half = _clearance(posts, i, j, c, 0.5 * (begin + end))
    bend = 2.0 * (first + last - 2.0 * half)
    at = 1.0
    if bend > 0.0:
        at = min(max(-(last - first - bend) / (2.0 * bend), 0.0), 1.0)
    low, low_value, high = begin, first, begin + at * (end - begin)
    high_value = _clearance(posts, i, j, c, high)
    if high_value > 0.0:
        if last > 0.0:
            return np.nan
        high, high_value = end, last
    for _ in range(60):  # false position with halved weights (Illinois)
        middle = (low * high_value - high * low_value) / (high_value - low_value)
        value_there = _clearance(posts, i, j, c, middle)
        if abs(value_there) < 1e-10 or high - low < 1e-15:
            return middle
        if value_there > 0.0:
            low, low_value, high_value = middle, value_there, 0.5 * high_value
        else:
            high, high_value, low_value = middle, value_there, 0.5 * low_value
    return 0.5 * (low + high)


@numba.njit
def _walk_piece(posts, tops, c, t0, t1, ends, verts, is_triangles, o, d, centre, half):
    """First crossing on one straight piece of the track: tau, or the range with triangles, or NaN.

    `ends` are (row, col, height) at tau t0 and t1, (2, 3). With triangles `verts` are the posts (rows, cols, 3) in the
    frame of the ray `o`, `d`, and `centre`, `half` convert tau to ranges.
    """
    r0, c0, h0 = ends[0, 0], ends[0, 1], ends[0, 2]
    dr, dc, dh = ends[1, 0] - r0, ends[1, 1] - c0, ends[1, 2] - h0
    i, j = np.int64(math.floor(r0)), np.int64(math.floor(c0))
    rows, cols = np.uint64(tops.shape[0]), np.uint64(tops.shape[1])
    step_i, step_j = (1 if dr > 0.0 else -1), (1 if dc > 0.0 else -1)
    per_row = 1.0 / abs(dr) if dr != 0.0 else np.inf
    per_col = 1.0 / abs(dc) if dc != 0.0 else np.inf
    next_row = ((i + 1 - r0) if dr > 0.0 else (r0 - i)) * per_row if dr != 0.0 else np.inf
    next_col = ((j + 1 - c0) if dc > 0.0 else (c0 - j)) * per_col if dc != 0.0 else np.inf
    here, axis_in, line_in = 0.0, -1, 0.0
    while True:
        by_row = next_row < next_col
        there = min(next_row if by_row else next_col, 1.0)
        lowest = h0 + dh * (there if dh < 0.0 else here) - MARGIN
        a, b = np.uint64(i), np.uint64(j)  # unsigned: one comparison per axis, and no wrapping of negative indices
        if a < rows and b < cols and lowest < tops[a, b]:
            if is_triangles:
                found = _nearest_triangle(verts, i, j, o, d)
            else:
                axis_out = -1 if there >= 1.0 else (0 if by_row else 1)
                line_out = (i + (step_i > 0)) if by_row else (j + (step_j > 0))
                begin = _on_border(c, t0 + here * (t1 - t0), axis_in, line_in)
                end = _on_border(c, t0 + there * (t1 - t0), axis_out, line_out)
                found = _settle(posts, i, j, c, begin, end)
            if not math.isnan(found):
                return found
        if there >= 1.0:
            return np.nan
        here = there
        if by_row:
            axis_in, line_in = 0, i + (step_i > 0)
            i += step_i
            next_row += per_row
        else:
            axis_in, line_in = 1, j + (step_j > 0)
            j += step_j
            next_col += per_col


@numba.njit
def _nearest_triangle(verts, i, j, o, d):
    """Range to the nearest triangle of the cells within one of (i, j), or NaN (Moeller and Trumbore 1997)."""
    nearest = np.inf
    for a in range(max(i - 1, 0), min(i + 2, verts.shape[0] - 1)):
        for b in range(max(j - 1, 0), min(j + 2, verts.shape[1] - 1)):
            for upper in range(2):
                p = verts[a, b]
                q = verts[a + 1, b + 1] if upper else verts[a + 1, b]
                r = verts[a, b + 1] if upper else verts[a + 1, b + 1]
                nearest = min(nearest, _triangle(p, q, r, o, d))
    return nearest if nearest < np.inf else np.nan


@numba.njit
def _triangle(p, q, r, o, d):
    ux, uy, uz = float(q[0]) - p[0], float(q[1]) - p[1], float(q[2]) - p[2]
    vx, vy, vz = float(r[0]) - p[0], float(r[1]) - p[1], float(r[2]) - p[2]
    wx, wy, wz = o[0] - p[0], o[1] - p[1], o[2] - p[2]
    cx, cy, cz = d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx
    volume = ux * cx + uy * cy + uz * cz
    if volume == 0.0:
        return np.inf
    first = (wx * cx + wy * cy + wz * cz) / volume
    ex, ey, ez = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
    second = (d[0] * ex + d[1] * ey + d[2] * ez) / volume
    if first < -1e-12 or second < -1e-12 or first + second > 1.0 + 1e-12:
        return np.inf
    return (vx * ex + vy * ey + vz * ez) / volume


@numba.njit(parallel=True)
def walk(posts, tops, coefficients, centre, half, verts, is_triangles, origin, direction):
    """Range in m to the first crossing of every track with the bilinear surface, or of every ray with the triangles."""
    count = coefficients.shape[0]
    ranges = np.full(count, np.nan)
    for k in numba.prange(count):
        c = coefficients[k]
        ends = np.empty((2, 3))
        length = max(abs(value(c, 0, 1.0) - value(c, 0, -1.0)), abs(value(c, 1, 1.0) - value(c, 1, -1.0)))
        pieces = int(length / PIECE) + 1
        for q in range(3):
            ends[1, q] = value(c, q, -1.0)
        for piece in range(pieces):
            t0, t1 = -1.0 + 2.0 * piece / pieces, -1.0 + 2.0 * (piece + 1) / pieces
            for q in range(3):
                ends[0, q] = ends[1, q]
                ends[1, q] = value(c, q, t1)
            found = _walk_piece(
                posts, tops, c, t0, t1, ends, verts, is_triangles, origin[k], direction[k], centre[k], half[k]
            )
            if not math.isnan(found):
                ranges[k] = found if is_triangles else centre[k] + half[k] * found
                break
    return ranges


@numba.njit(parallel=True)
def walk_polylines(posts, tops, polylines):
    """(row, col, height) of the first crossing of the bilinear surface and straight polylines (n, points, 3)."""
    count = polylines.shape[0]
    hits = np.full((count, 3), np.nan)
    nothing = np.zeros((1, 1, 3), np.float32)
    for k in numba.prange(count):
        c = np.zeros((NODES, 3))
        for piece in range(polylines.shape[1] - 1):
            ends = polylines[k, piece : piece + 2]
            for q in range(3):
                c[0, q] = 0.5 * (ends[0, q] + ends[1, q])
                c[1, q] = 0.5 * (ends[1, q] - ends[0, q])
            found = _walk_piece(posts, tops, c, -1.0, 1.0, ends, nothing, False, ends[0], ends[0], 0.0, 1.0)
            if not math.isnan(found):
                for q in range(3):
                    hits[k, q] = c[0, q] + found * c[1, q]
                break
    return hits


@numba.njit
def _over(p, axes, scale, middle):
    """(row, col, height) of an ECEF point, and its normal."""
    nx, ny, nz, h = normal_and_height(p[0], p[1], p[2])
    east = axes[0, 0] * nx + axes[0, 1] * ny + axes[0, 2] * nz
    north = axes[1, 0] * nx + axes[1, 1] * ny + axes[1, 2] * nz
    up = axes[2, 0] * nx + axes[2, 1] * ny + axes[2, 2] * nz
    return middle[0] - north / up * scale[0], middle[1] + east / up * scale[1], h, (nx, ny, nz)


@numba.njit(parallel=True)
def finish(posts, origin, direction, ranges, axes, scale, middle):
    """(n, 4) latitude, longitude in rad, height and range in m where rays meet the bilinear surface near `ranges`.

    By Newton steps; NaN for a miss.
    """
    count = origin.shape[0]
    found = np.full((count, 4), np.nan)
    rows, cols = posts.shape
    for k in numba.prange(count):
        at, o, d = ranges[k], origin[k], direction[k]
        if math.isnan(at):
            continue
        lat = lon = height = np.nan
        for _ in range(6):
            row, col, height, n = _over((o[0] + at * d[0], o[1] + at * d[1], o[2] + at * d[2]), axes, scale, middle)
            lat, lon = math.atan2(n[2], math.hypot(n[0], n[1])), math.atan2(n[1], n[0])
            if not (0.0 <= row < rows - 1 and 0.0 <= col < cols - 1):
                break
            i, j = int(row), int(col)
            u, v = row - i, col - j
            low, high = posts[i, j + 1] - posts[i, j], posts[i + 1, j + 1] - posts[i + 1, j]
            near, far = posts[i, j] + low * v, posts[i + 1, j] + high * v
            # the ray over the grid, as if the Earth were level here: 1e-3 of the slope at most
            east = axes[0, 0] * d[0] + axes[0, 1] * d[1] + axes[0, 2] * d[2]
            north = axes[1, 0] * d[0] + axes[1, 1] * d[1] + axes[1, 2] * d[2]
            by_row, by_col = far - near, low * (1.0 - u) + high * u
            climb = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
            slope = climb - (by_col * east * scale[1] - by_row * north * scale[0]) / A
            step = (height - near - (far - near) * u) / slope
            at -= step
            if abs(step) < 1e-4:
                found[k, 0], found[k, 1], found[k, 2], found[k, 3] = lat, lon, height - climb * step, at
                break
    return found
