"""Eqs 1 to 36 of Li et al. (2020) as they are printed, in NumPy, beside this package's functions at the same inputs.

Where the print is wrong, the formula put right is set against an independent computation. Angles in rad, lengths in m.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgeo.coverage import geometry, transform
from jaxgeo.coverage.compensation_formulas import compensation_of_eqs_25_26, line_of_sight_head
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.earth.classical import GaussKruegerSeries, meridian_arc, to_geodetic_successive
from jaxgeo.locate import locate
from jaxgeo.rotations import R_from_heading_pitch_roll
from jaxgeo.sensor import Gimbal, Pose, Shot, Trajectory
from jaxgeo.sensor.conventions import li_2020_uv
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2020 import printed

PAPER = "Li 2020"
EXACT = 1e-9  # relative, of formulas that are the same
A, B = WGS84.a, WGS84.b
E2 = WGS84.e2

HEIGHTS, THETAS, OMEGAS = (8143.0, 3000.0), (math.radians(74.0), math.radians(50.0)), (math.radians(0.88), 0.1)
LOOKS = list(zip(THETAS, OMEGAS, strict=True))
SCENES = list(zip(HEIGHTS, THETAS, OMEGAS, strict=True))
TURNS = (math.radians(1.0), -math.radians(0.6))
WISHES = (0.15, 0.6)
ATTITUDES = ((2.776, 0.0634, 0.0377), (0.5, -0.1, 0.2))  # heading, pitch, roll
ANGLES = ((-math.radians(74.0), -0.02), (0.4, -0.3))  # theta, phi
PLACES = ((0.6085, 1.9113, 8143.0), (-0.9, -2.5, 300.0), (0.2, -0.7, 0.0))  # lat, lon, height
MERIDIAN = math.radians(printed.CENTRAL_MERIDIAN)
MAP_PLACES = ((0.6085, MERIDIAN - 0.026), (1.2, MERIDIAN + 0.02))  # lat, lon, to 1.5 deg
ROUNDS = 4  # of Eq 8
SPEED, SWING, PERIOD = 172.0, 8.6, 20.0  # m/s, m/s and s, of the flight of Eqs 32, 35
FLOWN = (3.0, 5.3)  # s, from and to


def equations() -> list[Claim]:
    """A claim for every numbered equation, in their order; those with no number follow the one they come after."""
    return [*_overlap(), *_frames(), *_earth(), *_map(), *_rays(), *_attitude(), *_compensation(), *_timing()]


def _claim(
    number: int | str,
    statement: str,
    wanted: Any,
    obtained: Any,
    function: str,
    *,
    unit: str = "",
    tolerance: float | Sequence[float] | None = None,
    cause: str = "",
    right: Any = None,
    independent: Any = None,
    reason: str = "",
    digits: str = ".5g",
) -> Claim:
    """Numbers, or arrays of them, by the printed formula and by the function at the same inputs.

    A misprint has a `cause`, and the values of the formula put `right`, which are to be those of the function, and the
    `independent` ones where there are such.
    """
    shown, found = (_listed(values) for values in (wanted, obtained))
    bounds = _bounds(found, tolerance)
    explanation = None
    if right is not None:
        others = [] if independent is None else [_listed(independent)]
        expected = [value for values in (found, *others) for value in values]
        times = 1 + len(others)
        explanation = Explanation(cause, _listed(right) * times, expected, bounds * times)
    return Claim(
        PAPER,
        number if isinstance(number, str) else f"Eq. {number}",
        statement,
        shown,
        found,
        bounds,
        unit,
        f"jaxgeo.{function}",
        explanation,
        reason,
        digits,
    )


def _listed(values: Any) -> list[float]:
    return [float(value) for value in np.asarray(values, float).ravel()]


def _bounds(values: list[float], tolerance: float | Sequence[float] | None) -> list[float]:
    """One tolerance for each value: as given, or relative to the value."""
    if tolerance is None:
        return [EXACT * max(abs(value), 1e-3) for value in values]
    return [tolerance] * len(values) if isinstance(tolerance, (int, float)) else list(tolerance)


def _overlap() -> list[Claim]:
    # Eq 1: L_single = 2 H / cos(theta) tan(omega / 2).  Eq 2: rho = (L_single - L_step) / L_single.
    lengths = [_length(*scene) for scene in SCENES]
    ours = [
        geometry.frame_length(height_above_ground=height, off_nadir=theta, field_of_view=omega)
        for height, theta, omega in SCENES
    ]
    steps = [(step, length) for step in (385.0, -40.0) for length in (455.6, 900.0)]
    return [
        _claim(1, "length of a frame", lengths, ours, "coverage.geometry.frame_length", unit="m"),
        _claim(
            2,
            "overlap of a step",
            [(length - step) / length for step, length in steps],
            [geometry.overlap_of_step(*case) for case in steps],
            "coverage.geometry.overlap_of_step",
        ),
    ]


def _length(height: float, theta: float, omega: float) -> float:
    return 2.0 * height / math.cos(theta) * math.tan(0.5 * omega)


def _frames() -> list[Claim]:
    gimbal = Gimbal.two_axis()
    theta, phi = ANGLES[1]
    ours = gimbal.R_base_from_head(jnp.array([-theta, phi])).T
    turned = _R_ned_from_body(ATTITUDES[1]).T
    return [
        _claim(
            3,
            "aircraft to camera, entries of the matrix",
            C_camera_from_aircraft(*ANGLES[1]),
            ours,
            "sensor.Gimbal.R_base_from_head",
        ),
        _claim(
            4,
            "north-east-down to aircraft, entries of the matrix",
            C_aircraft_from_ned(*ATTITUDES[1]),
            turned,
            "rotations.R_from_heading_pitch_roll",
        ),
    ]


def C_camera_from_aircraft(theta: float, phi: float) -> np.ndarray:
    """Eq 3 as printed: a product of two matrices."""
    inner = np.array([[math.cos(phi), 0.0, -math.sin(phi)], [0.0, 1.0, 0.0], [math.sin(phi), 0.0, math.cos(phi)]])
    outer = np.array(
        [[1.0, 0.0, 0.0], [0.0, math.cos(theta), math.sin(theta)], [0.0, -math.sin(theta), math.cos(theta)]]
    )
    return inner @ outer


def C_aircraft_from_ned(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Eq 4 as printed: by roll alpha, pitch beta and heading lambda."""
    (ca, sa), (cb, sb), (cl, sl) = ((math.cos(x), math.sin(x)) for x in (roll, pitch, heading))
    by_roll = np.array([[1.0, 0.0, 0.0], [0.0, ca, sa], [0.0, -sa, ca]])
    by_pitch = np.array([[cb, 0.0, -sb], [0.0, 1.0, 0.0], [sb, 0.0, cb]])
    by_heading = np.array([[cl, sl, 0.0], [-sl, cl, 0.0], [0.0, 0.0, 1.0]])
    return by_roll @ by_pitch @ by_heading


def _earth() -> list[Claim]:
    places = [Geodetic(lat=lat, lon=lon, height=height) for lat, lon, height in PLACES]
    two = PLACES[:2]
    ecef = [np.asarray(WGS84.to_ecef(place)) for place in places]
    on_it = [np.asarray(WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=0.0))) for lat, lon, _ in PLACES]
    points = [p + np.array([1000.0, -2000.0, 500.0]) for p in ecef[:2]]
    exact = [WGS84.to_geodetic(jnp.asarray(p)) for p in ecef]
    degrees_and_metres = [3e-9, 1e-3] * 2
    return [
        _claim(  # Eq 5: x^2 / RE^2 + y^2 / RE^2 + z^2 / RP^2 = 1
            5,
            "left side at points of height 0",
            [1.0] * len(PLACES),
            [x**2 / A**2 + y**2 / A**2 + z**2 / B**2 for x, y, z in on_it],
            "earth.WGS84.to_ecef",
            tolerance=1e-12,
        ),
        _claim(
            6,
            "ECEF to north-east-down, of points 2 km away",
            [_ned_of_eq_6(p, *place) for p, place in zip(points, two, strict=True)],
            [R_ecef_from_ned(place).T @ (p - q) for p, q, place in zip(points, ecef[:2], places[:2], strict=True)],
            "earth.R_ecef_from_ned",
            unit="m",
            tolerance=1e-6,
            cause="sin B in the first row lacks its minus, and the last shift is R_N e1^2 sin B, not of H",
            right=[_ned_of_eq_6(p, *place, put_right=True) for p, place in zip(points, two, strict=True)],
        ),
        _claim(
            7,
            "geodetic to ECEF",
            [_ecef_of_eq_7(*place, sine_of=place[1]) for place in two],
            ecef[:2],
            "earth.WGS84.to_ecef",
            unit="m",
            tolerance=1e-6,
            cause="z has the sine of the latitude B, not of the longitude L",
            right=[_ecef_of_eq_7(*place, sine_of=place[0]) for place in two],
        ),
        _claim(
            8,
            f"latitude in deg and height after {ROUNDS} rounds",
            [_geodetic_of_eq_8(p, 0.5) for p in ecef[:2]],
            [
                [np.rad2deg(found.lat), found.height]
                for found in (to_geodetic_successive(WGS84, jnp.asarray(p), iterations=ROUNDS) for p in ecef[:2])
            ],
            "earth.classical.to_geodetic_successive",
            unit="°, m",
            tolerance=degrees_and_metres,
            digits=".11g",
            cause="the exponent of the radius N is -1/2",
            right=[_geodetic_of_eq_8(p, -0.5) for p in ecef[:2]],
            independent=[[np.rad2deg(found.lat), found.height] for found in exact[:2]],
        ),
        _claim(
            9,
            "longitude",
            [_longitude_of_eq_9(x, y) for x, y, _ in ecef],
            [found.lon for found in exact],
            "earth.WGS84.to_geodetic",
            unit="rad",
            tolerance=1e-12,
        ),
    ]


def _ned_of_eq_6(p: np.ndarray, lat: float, lon: float, height: float, *, put_right: bool = False) -> np.ndarray:
    """Eq 6: shift, turn by L, turn by B, shift. Printed is sin B at the upper left, and a shift of R_N e1 sin H."""
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    shift = N * E2 * math.sin(lat) if put_right else N * math.sqrt(E2) * math.sin(height)
    sine = -math.sin(lat) if put_right else math.sin(lat)
    by_lon = np.array([[math.cos(lon), math.sin(lon), 0.0], [-math.sin(lon), math.cos(lon), 0.0], [0.0, 0.0, 1.0]])
    by_lat = np.array([[sine, 0.0, math.cos(lat)], [0.0, 1.0, 0.0], [-math.cos(lat), 0.0, -math.sin(lat)]])
    return by_lat @ by_lon @ (p + np.array([0.0, 0.0, shift])) + np.array([0.0, 0.0, N + height])


def _ecef_of_eq_7(lat: float, lon: float, height: float, *, sine_of: float) -> list[float]:
    """Eq 7: [(N + H) cos B cos L, (N + H) cos B sin L, (N (1 - e^2) + H) sin L]."""
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    across = (N + height) * math.cos(lat)
    return [across * math.cos(lon), across * math.sin(lon), (N * (1.0 - E2) + height) * math.sin(sine_of)]


def _geodetic_of_eq_8(p: np.ndarray, exponent: float) -> tuple[float, float]:
    """Eq 8: start, then N = RE (1 - e^2 sin^2 B)^(1/2), h = p / cos B - N, tan(lat) = z / p / (1 - e^2 N / (N + h))."""
    x, y, z = p
    across = math.hypot(x, y)
    N, height = A, math.sqrt(x * x + y * y + z * z) - math.sqrt(A * B)
    lat = math.atan(z / across / (1.0 - E2 * N / (N + height)))
    for _ in range(ROUNDS):
        N = A * (1.0 - E2 * math.sin(lat) ** 2) ** exponent
        height = across / math.cos(lat) - N
        lat = math.atan(z / across / (1.0 - E2 * N / (N + height)))
    return math.degrees(lat), height


def _longitude_of_eq_9(x: float, y: float) -> float:
    """Eq 9: arctan(y / x), and pi added or taken away where x < 0, by the sign of that."""
    lon = math.atan(y / x)
    if x > 0.0:
        return lon
    return lon + math.pi if lon < 0.0 else lon - math.pi


def _map() -> list[Claim]:
    series, exact = GaussKruegerSeries(lon0=MERIDIAN), printed.gauss_krueger()
    wanted = [_map_of_eq_10(lat, lon) for lat, lon in MAP_PLACES]
    ours = [_xy(series, lat, lon) for lat, lon in MAP_PLACES]
    lats = (0.6085, 0.5 * math.pi)
    arcs, rights = [meridian_arc(lat) for lat in lats], [_arc(lat) for lat in lats]
    return [
        _claim(
            10,
            "x (north) and y (east), to 1.5° from the meridian",
            wanted,
            ours,
            "earth.classical.GaussKruegerSeries",
            unit="m",
            tolerance=1e-6,
            reason="With the meridian's arc by quadrature.",
        ),
        _claim(
            10,
            "the same beside the exact map",
            wanted,
            [_xy(exact, lat, lon) for lat, lon in MAP_PLACES],
            "earth.TransverseMercator",
            unit="m",
            tolerance=2e-6,
        ),
        _claim(
            11,
            "arc of the meridian",
            [_arc_of_eq_11(lat, second=0, last=693_693) for lat in lats],
            arcs,
            "earth.classical.meridian_arc",
            unit="m",
            tolerance=1e-6,
            digits=".10g",
            cause="the second term is -B1 sin 2B, not -A1 sin 2B",
            right=[_arc_of_eq_11(lat, second=1, last=693_693) for lat in lats],
            independent=rights,
        ),
        _claim(
            12,
            "arc of the meridian with the printed coefficients",
            [_arc_of_eq_11(lat, second=1, last=6_936_933) for lat in lats],
            arcs,
            "earth.classical.meridian_arc",
            unit="m",
            tolerance=1e-7,
            digits=".15g",
            cause="the last term of A1 is 693693/1048576, not 6936933/1048576",
            right=[_arc_of_eq_11(lat, second=1, last=693_693) for lat in lats],
            independent=rights,
        ),
    ]


def _xy(projection: Any, lat: float, lon: float) -> tuple[float, float]:
    east, north = projection.forward(lat, lon)
    return float(north), float(east) - 500_000.0


def _map_of_eq_10(lat: float, lon: float) -> tuple[float, float]:
    """Eq 10 as printed: powers of the longitude difference l to the sixth."""
    dlon, t, eta2 = lon - MERIDIAN, math.tan(lat), E2 / (1.0 - E2) * math.cos(lat) ** 2
    N = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    c2l2 = math.cos(lat) ** 2 * dlon**2
    x = _arc(lat) + N * t * c2l2 * (
        0.5
        + 1.0 / 24.0 * (5.0 - t**2 + 9.0 * eta2 + 4.0 * eta2**2) * c2l2
        + 1.0 / 720.0 * (61.0 - 58.0 * t**2 + t**4) * c2l2**2
    )
    y = (
        N
        * math.cos(lat)
        * dlon
        * (
            1.0
            + 1.0 / 6.0 * (1.0 - t**2 + eta2) * c2l2
            + 1.0 / 120.0 * (5.0 - 18.0 * t**2 + t**4 + 14.0 * eta2 - 58.0 * t**2 * eta2) * c2l2**2
        )
    )
    return x, y


def _arc(lat: float) -> float:
    """Arc of the meridian by Gauss-Legendre quadrature of its radius."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    at = 0.5 * lat * (nodes + 1.0)
    return float(0.5 * lat * np.sum(weights * A * (1.0 - E2) / (1.0 - E2 * np.sin(at) ** 2) ** 1.5))


def _arc_of_eq_11(lat: float, *, second: int, last: int) -> float:
    """Eq 11 by the coefficients of Eq 12: which of A1 and B1 stands before sin 2B, and the last numerator of A1."""
    e = E2
    A1 = (
        1
        + 3 / 4 * e
        + 45 / 64 * e**2
        + 175 / 256 * e**3
        + 11025 / 16384 * e**4
        + 43659 / 65536 * e**5
        + last / 1048576 * e**6
    )
    B1 = (
        3 / 8 * e
        + 15 / 32 * e**2
        + 525 / 1024 * e**3
        + 2205 / 4096 * e**4
        + 72765 / 131072 * e**5
        + 297297 / 524288 * e**6
    )
    C1 = 15 / 256 * e**2 + 105 / 1024 * e**3 + 2205 / 16384 * e**4 + 10395 / 65536 * e**5 + 1486485 / 8388608 * e**6
    D1 = 35 / 3072 * e**3 + 105 / 4096 * e**4 + 10395 / 262144 * e**5 + 55055 / 1048576 * e**6
    E1 = 315 / 131072 * e**4 + 3465 / 524288 * e**5 + 99099 / 8388608 * e**6
    F1 = 693 / 1310720 * e**5 + 9009 / 5242880 * e**6
    G1 = 1001 / 8388608 * e**6
    waves = -(A1, B1)[second] * math.sin(2 * lat) + C1 * math.sin(4 * lat) - D1 * math.sin(6 * lat)
    waves += E1 * math.sin(8 * lat) - F1 * math.sin(10 * lat) + G1 * math.sin(12 * lat)
    return A * (1.0 - E2) * (A1 * lat + waves)


def _rays() -> list[Claim]:
    sensor, ground = printed.sensor(mirror=False), printed.ground()
    camera, f, pitch = sensor.camera, printed.FOCAL_LENGTH, printed.PIXEL_PITCH
    pixels = ((1, 1), (1000, 3000))
    detector = [  # Eq 13: T' = [a ((M + 1) / 2 - i), a (j - (N + 1) / 2), -f]
        np.array([pitch * (0.5 * (printed.ALONG + 1) - i), pitch * (j - 0.5 * (printed.ACROSS + 1)), -f])
        for i, j in pixels
    ]
    R_head_from_camera = np.asarray(sensor.mount.R_head_from_camera)
    rays = [R_head_from_camera @ np.asarray(camera.ray(li_2020_uv(i, j))[0]) for i, j in pixels]
    shot = Shot(printed.pose_of(printed.TABLE_4[0]), jnp.array([math.radians(74.0), 0.05]))
    fixes = [locate(sensor, shot, li_2020_uv(i, j), ground) for i, j in pixels]
    centre = np.asarray(sensor.perspective_centre(shot))
    R_ecef_from_head = np.asarray(sensor.R_ecef_from_camera(shot)) @ R_head_from_camera.T
    images = [R_ecef_from_head @ one for one in detector]
    sights = [np.asarray(fix.ecef) - centre for fix in fixes]
    ratio = [-float(fix.slant_range) / float(np.linalg.norm(one)) for fix, one in zip(fixes, detector, strict=True)]
    ranges = [
        float(fix.slant_range) for fix in (locate(sensor, shot, li_2020_uv(i, j), _raised(500.0)) for i, j in pixels)
    ]
    points = [(strip.lat, strip.lon) for strip in printed.TABLE_4[:3]]
    pairs = list(itertools.pairwise(points))
    gauss_krueger = printed.gauss_krueger()
    return [
        _claim(
            13,
            "line of sight of pixels, -T' / |T'|",
            [-one / np.linalg.norm(one) for one in detector],
            rays,
            "sensor.conventions.li_2020_sensor",
        ),
        _claim(
            14,
            "the three ratios of a target and its image",
            [[sight[0] / sight[1], 1.0, 1.0] for sight in sights],
            [[one] * 3 for one in ratio],
            "locate.locate",
            tolerance=[1e-7 * abs(one) for one in ratio for _ in range(3)],
            cause="every denominator is the same coordinate of T' - S",
            right=[sight / image for sight, image in zip(sights, images, strict=True)],
            reason="The print has the target's coordinates over the target's.",
        ),
        _claim(
            15,
            "range to the ground at 500 m",
            [_range_of_eq_15(centre, sight, 500.0) for sight in sights],
            ranges,
            "locate.locate",
            unit="m",
            tolerance=0.03,
            reason="The axes lengthened by the height are good to 6 mm of height, here some 2 cm of range.",
        ),
        _claim(
            16,
            "step of two places on the map",
            [
                math.dist(_map_of_eq_10(*np.radians(before)), _map_of_eq_10(*np.radians(after)))
                for before, after in pairs
            ],
            [transform.euclidean_step(gauss_krueger, *(_place(*np.radians(one)) for one in pair)) for pair in pairs],
            "coverage.transform.euclidean_step",
            unit="m",
            tolerance=1e-5,
        ),
    ]


def _raised(height: float) -> Any:
    return type(printed.ground())(jnp.asarray(height))


def _place(lat: float, lon: float) -> Geodetic:
    return Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.zeros(()))


def _range_of_eq_15(centre: np.ndarray, sight: np.ndarray, height: float) -> float:
    """Eq 15: the ellipsoid with axes RE + h and RP + h, met by a line (Eq 14)."""
    axes = np.array([A + height, A + height, B + height])
    o, d = centre / axes, sight / np.linalg.norm(sight) / axes
    aa, bb, cc = d @ d, o @ d, o @ o - 1.0
    return float((-bb - math.sqrt(bb * bb - aa * cc)) / aa)


def _attitude() -> list[Claim]:
    heading = [(turn, *one) for turn in TURNS for one in zip(HEIGHTS, THETAS, strict=True)]
    look = [(turn, *one) for turn in TURNS for one in LOOKS]
    rolls = [(turn, *one) for turn in TURNS for one in zip(THETAS, WISHES, strict=True)]
    stepped = [(step, *scene) for step in (385.0, 120.0) for scene in SCENES]
    by_pitch = [math.cos(theta) * math.tan(turn) / (2.0 * math.tan(0.5 * omega)) for turn, theta, omega in look]
    by_roll = [
        geometry.overlap_change_by_roll(off_nadir_change=turn, off_nadir=theta, overlap=wish)
        for turn, theta, wish in rolls
    ]
    return [
        _claim(  # Eq 17: L_O3O4 = H tan(theta) sin(dlambda)
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
        _claim(  # after Eq 17: H tan(theta) (1 - cos(dlambda))
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
        _claim(  # Eq 18: sin(theta) sin(dlambda) / (2 tan(omega / 2))
            18,
            "change of overlap by heading",
            [math.sin(theta) * math.sin(turn) / (2.0 * math.tan(0.5 * omega)) for turn, theta, omega in look],
            [
                geometry.overlap_change_by_heading(heading_change=turn, off_nadir=theta, field_of_view=omega)
                for turn, theta, omega in look
            ],
            "coverage.geometry.overlap_change_by_heading",
        ),
        _claim(  # Eq 19: cos(theta) tan(dbeta) / (2 tan(omega / 2))
            19,
            "change of overlap by pitch",
            by_pitch,
            [
                geometry.overlap_change_by_pitch(pitch_change=turn, off_nadir=theta, field_of_view=omega)
                for turn, theta, omega in look
            ],
            "coverage.geometry.overlap_change_by_pitch",
            cause="the sign of Table 2 is missing: nose up moves the frame on",
            right=[-change for change in by_pitch],
            independent=[_pitched(*one) for one in look],
        ),
        _claim(  # Eq 20: 1 - L_step cos(theta) / (2 H tan(omega / 2))
            20,
            "overlap of a step of the aircraft",
            [1.0 - step * math.cos(t) / (2.0 * height * math.tan(0.5 * omega)) for step, height, t, omega in stepped],
            [
                geometry.overlap_at(step=step, height_above_ground=height, off_nadir=theta, field_of_view=omega)
                for step, height, theta, omega in stepped
            ],
            "coverage.geometry.overlap_at",
        ),
        _claim(  # Eq 21: L_step / (2 H tan(omega / 2)) (cos(theta) - cos(theta + dalpha)), L_step of the wish
            21,
            "change of overlap by roll, by the step",
            [_eq_21(*one) for one in rolls],
            by_roll,
            "coverage.geometry.overlap_change_by_roll",
        ),
        _claim(  # Eq 22: (1 - rho0) (1 - cos(theta + dalpha) / cos(theta))
            22,
            "change of overlap by roll",
            [(1.0 - wish) * (1.0 - math.cos(theta + turn) / math.cos(theta)) for turn, theta, wish in rolls],
            by_roll,
            "coverage.geometry.overlap_change_by_roll",
        ),
    ]


def _pitched(turn: float, theta: float, omega: float) -> float:
    """Change of the overlap by pitch: lines of sight by Eqs 3 and 4 brought down on a plane."""
    sight = C_aircraft_from_ned(0.0, turn, 0.0).T @ C_camera_from_aircraft(-theta, 0.0).T @ np.array([0.0, 0.0, 1.0])
    return float(-sight[0] / sight[2] / _length(1.0, theta, omega))


def _eq_21(turn: float, theta: float, wish: float, height: float = 8143.0, omega: float = math.radians(0.88)) -> float:
    step = 2.0 * height * math.tan(0.5 * omega) / math.cos(theta) * (1.0 - wish)
    return step / (2.0 * height * math.tan(0.5 * omega)) * (math.cos(theta) - math.cos(theta + turn))


def _compensation() -> list[Claim]:
    sensor = printed.sensor(mirror=False)
    cases = list(zip(ATTITUDES, ANGLES, strict=True))
    sights = [_sight_of_eq_23(attitude, angles) for attitude, angles in cases]
    engine = [
        sensor.R_ned_from_camera(Shot(_pose(attitude), jnp.array([-theta, phi])))[:, 2]
        for attitude, (theta, phi) in cases
    ]
    changed = [(heading - 0.0175, pitch + 0.0175, roll + 0.0175) for heading, pitch, roll in ATTITUDES]
    straight = [(theta, 0.0) for theta, _ in ANGLES]  # Eqs 25 and 26 are exact for an inner angle of 0
    aims = [_sight_of_eq_23(attitude, angles) for attitude, angles in zip(ATTITUDES, straight, strict=True)]
    heads = [_sight_of_eq_24(*one) for one in zip(changed, straight, aims, strict=True)]
    ours = [
        compensation_of_eqs_25_26(_R_ned_from_body(attitude), *angles, jnp.asarray(aim))
        for attitude, angles, aim in zip(changed, straight, aims, strict=True)
    ]
    by_eq_25 = [-math.atan(x / math.sqrt(y**2 + z**2)) for x, y, z in heads]
    return [
        _claim(
            23,
            "line of sight in north-east-down",
            sights,
            engine,
            "sensor.Sensor.R_ned_from_camera",
            tolerance=1e-9,
        ),
        _claim(
            24,
            "line of sight in the camera after a change of attitude",
            heads,
            [
                line_of_sight_head(_R_ned_from_body(attitude), *angles, jnp.asarray(aim))
                for attitude, angles, aim in zip(changed, straight, aims, strict=True)
            ],
            "coverage.compensation_formulas.line_of_sight_head",
            tolerance=1e-12,
        ),
        _claim(  # Eq 25: dphi = -arctan(x / sqrt(y^2 + z^2))
            25,
            "change of the inner angle",
            by_eq_25,
            [one.phi for one in ours],
            "coverage.compensation_formulas.compensation_of_eqs_25_26",
            unit="rad",
            cause="the minus is that of the mirror's drive; of the angle of Eq 3 it is a plus",
            right=[-change for change in by_eq_25],
            independent=[_needed(*one)[1] for one in zip(changed, straight, aims, strict=True)],
        ),
        _claim(  # Eq 26: dtheta = -arctan(y / z)
            26,
            "change of the outer angle",
            [-math.atan(y / z) for _, y, z in heads],
            [one.theta for one in ours],
            "coverage.compensation_formulas.compensation_of_eqs_25_26",
            unit="rad",
        ),
    ]


def _R_ned_from_body(attitude: tuple[float, ...]) -> Any:
    return R_from_heading_pitch_roll(*(jnp.asarray(angle) for angle in attitude))


def _pose(attitude: tuple[float, float, float]) -> Pose:
    return Pose(Geodetic(lat=0.6, lon=1.9, height=8143.0), *attitude)


def _sight_of_eq_23(attitude: tuple[float, float, float], angles: tuple[float, float]) -> np.ndarray:
    """Eq 23: C_AC^NED C_S^AC [0, 0, 1]."""
    return C_aircraft_from_ned(*attitude).T @ C_camera_from_aircraft(*angles).T @ np.array([0.0, 0.0, 1.0])


def _sight_of_eq_24(attitude: Any, angles: tuple[float, float], sight: np.ndarray) -> np.ndarray:
    """Eq 24: C_AC^S C_NED^AC LOS."""
    return C_camera_from_aircraft(*angles) @ C_aircraft_from_ned(*attitude) @ sight


def _needed(attitude: Any, angles: tuple[float, float], aim: np.ndarray) -> tuple[float, float]:
    """Changes (theta, phi) from `angles` that put the line of sight on the aim: Rx(theta) Ry(phi) [0, 0, 1] in the
    body is (sin phi, -sin theta cos phi, cos theta cos phi)."""
    x, y, z = C_aircraft_from_ned(*attitude) @ aim
    return math.atan2(-y, z) - angles[0], math.asin(x) - angles[1]


def _timing() -> list[Claim]:
    planned = [(*scene, wish) for scene, wish in zip(SCENES, WISHES, strict=True)]
    speed, period, roll = 172.25, 2.3, math.radians(printed.TABLE_4[0].roll)
    changes = (5.0, -8.0)
    heights = [(ground, aircraft) for ground in (100.0, -250.0) for aircraft in (0.0, 60.0)]
    by_height = [(change, height) for change in (-620.0, 150.0) for height in HEIGHTS]
    integral = period * speed / 8143.0
    stands = "omega stands for 2 tan(omega/2)"

    def opening(omega: float) -> float:
        return 2.0 * math.tan(0.5 * omega)

    def look(height: float, theta: float, omega: float) -> dict[str, float]:
        return {"height_above_ground": height, "off_nadir": theta, "field_of_view": omega}

    def with_omega(number: int, what: str, formula: Callable[..., float], ours: Any, name: str, **more: Any) -> Claim:
        """Printed with omega, put right with the tangent; the angle from the horizontal is that of the inputs."""
        return _claim(
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
        _claim(  # Eq 27: dH = dH_P = -dh_T, the change of the aircraft's height or that of the ground with a minus
            27,
            "change of the height above the ground",
            [aircraft - ground for ground, aircraft in heights],
            [geometry.height_change(aircraft=aircraft, ground=ground) for ground, aircraft in heights],
            "coverage.geometry.height_change",
            unit="m",
        ),
        _claim(  # Eq 28: -dh_T / H = dH_P / H
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
            lambda height, theta, w, wish: w * (1.0 - wish) * height / (speed * math.cos(theta)),
            [geometry.period_of_overlap(overlap=one[3], speed=speed, **look(*one[:3])) for one in planned],
            "period_of_overlap",
            cases=planned,
            unit="s",
        ),
        with_omega(  # Eq 30: rho = 1 - T V sin(theta) / (H omega)
            30,
            "overlap of a period",
            lambda height, theta, w: 1.0 - period * speed * math.cos(theta) / (height * w),
            [geometry.overlap_of_period(period=period, speed=speed, **look(*one)) for one in SCENES],
            "overlap_of_period",
            cases=SCENES,
        ),
        with_omega(  # Eq 31: drho = -T (dV / H) sin(theta) / alpha
            31,
            "change of overlap by speed",
            lambda height, theta, w, change: -period * change / height * math.cos(theta) / roll,
            [
                geometry.overlap_change_by_speed(speed_change=one[3], period=period, **look(*one[:3]))
                for one in [(*scene, change) for scene in SCENES for change in changes]
            ],
            "overlap_change_by_speed",
            cases=[(*scene, change) for scene in SCENES for change in changes],
            cause="alpha, the roll of Eq 4 and so taken here, stands for 2 tan(omega/2)",
            right=lambda height, theta, w, change: -period * change / height * math.cos(theta) / w,
        ),
        _claim(  # Eq 32: P = integral of V over the time
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
            [geometry.overlap_of_path(path=385.0, **look(*one)) for one in SCENES],
            "overlap_of_path",
            cases=SCENES,
        ),
        with_omega(  # Eq 34: P = H omega (1 - rho) / sin(theta)
            34,
            "path of an overlap",
            lambda height, theta, w, wish: height * w * (1.0 - wish) / math.cos(theta),
            [geometry.path_of_overlap(overlap=one[3], **look(*one[:3])) for one in planned],
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
            lambda height, theta, w, wish: w * (1.0 - wish) / math.cos(theta),
            [
                geometry.velocity_height_of_overlap(overlap=wish, off_nadir=theta, field_of_view=omega)
                for _, theta, omega, wish in planned
            ],
            "velocity_height_of_overlap",
            cases=planned,
        ),
    ]


def _way(time: float) -> float:
    """Integral of the speed SPEED + SWING sin(2 pi t / PERIOD) from 0 on, m."""
    turn = 2.0 * math.pi / PERIOD
    return SPEED * time + SWING / turn * (1.0 - math.cos(turn * time))


def _flown_way() -> float:
    """Way of a trajectory with that speed to the north, by its positions at the two times, at its height."""
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
