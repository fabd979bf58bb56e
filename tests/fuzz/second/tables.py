"""Second readings of tables, by the module `csv`, under every separator that the bytes may be read with."""

from __future__ import annotations

import csv
import io
import itertools
import pathlib
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from tests.fuzz.second.compared import (
    DEGREES,
    METRES,
    R_NED_FROM_ENU,
    decoded,
    egm96,
    in_map,
    number,
    of_json,
    of_opk,
    same,
    same_attitude,
    same_names,
    same_places,
    same_turn,
    turn,
)

Rows = list[dict[str, str]]
SEPARATORS = (",", ";", "\t", "|", " ")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
UNIT = re.compile(r"\s*[\[(](?:deg|degrees?|°|m|met(?:er|re)s?)[\])]$")
NAMES = {  # of other programs, by the words of this package
    "image": ("filename", "nom", "imagename", "photoid", "bildname", "bild", "f=n", "name", "label"),
    "x_m": ("x", "x/east", "x/easting", "easting"),
    "y_m": ("y", "y/north", "y/northing", "northing"),
    "z_m": ("z", "altitude", "alt", "z/altitude", "height", "höhe", "hoehe", "height_m"),
    "height_m": ("altitude", "alt", "z/altitude", "height", "höhe", "hoehe", "z", "z_m"),
    "omega_deg": ("omega", "o", "w"),
    "phi_deg": ("phi", "p"),
    "kappa_deg": ("kappa", "k"),
    "lat_deg": ("latitude", "lat", "y/latitude", "breite"),
    "lon_deg": ("longitude", "lon", "long", "lng", "x/longitude", "länge", "laenge"),
    "heading_deg": ("yaw_deg", "yaw", "heading", "gier"),
    "pitch_deg": ("pitch", "nick"),
    "roll_deg": ("roll",),
} | {f"{name}_gon": (f"{name}[gon]", f"{name} [gon]", f"{name}(gon)") for name in ("omega", "phi", "kappa")}


def any_of(readings: Iterator[Any], check: Callable[[Any], None]) -> None:
    """Passes where one of the readings that a text allows is the answer; raises the error of the nearest else."""
    errors = []
    for reading in readings:
        try:
            check(reading)
        except (AssertionError, ValueError, KeyError) as error:
            errors.append(error)
        else:
            return
    wrong = [error for error in errors if isinstance(error, AssertionError)]
    raise AssertionError(str((wrong or errors or ["no second reading of it is a table"])[0]))


def tables(path: pathlib.Path) -> Iterator[Rows]:
    """Every reading of a file as rows by column: each separator, quotes, header in a comment or not, decimal commas."""
    lines = re.split(r"\r\n|\r|\n", decoded(path.read_bytes()))
    lines = ["" if re.fullmatch(r'"?sep=."?', line.strip(" "), re.IGNORECASE) else line for line in lines]
    headers = [line.lstrip().lstrip("#").strip() for line in lines if line.lstrip().startswith("#")]
    body = ["" if line.lstrip().startswith("#") else line for line in lines]
    for separator, quote in itertools.product(SEPARATORS, "\"'"):
        rows = _split("\n".join(body), separator, quote)
        if not rows:
            continue
        of_comments = [_split(line, other, quote)[:1] for line in headers for other in SEPARATORS]
        of_first = [_split(line, other, quote)[:1] for line in body[:40] if line.strip() for other in SEPARATORS][:5]
        above = [(found[0], rows) for found in of_comments if found]
        below = [(found[0], rows[1:]) for found in of_first if found]
        for header, cells in (*below, *above):
            whole = [dict(zip(header, row, strict=False)) for row in cells if len(row) == len(header)]
            if cells and len(whole) == len(cells) and len(set(header)) == len(header):
                yield whole
                if separator != ",":
                    yield [{name: _with_point(cell) for name, cell in row.items()} for row in whole]


def _split(text: str, separator: str, quote: str) -> list[list[str]]:
    if separator == " ":
        text = "\n".join(line.strip().replace("\t", " ") for line in text.split("\n"))
    how = {"delimiter": separator, "quotechar": quote, "skipinitialspace": separator == " "}
    reader = csv.reader(io.StringIO(text, newline=""), **how)
    try:
        return [[_plain(cell.strip()) for cell in row] for row in reader if any(cell.strip() for cell in row)]
    except csv.Error:
        return []


def _plain(cell: str) -> str:
    """A cell without the apostrophe by which a spreadsheet takes `'-84.1` as a text and does not run it."""
    return cell[1:] if re.match(r"'+[=+\-@]", cell) else cell


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell


def column(rows: Rows, name: str) -> list[str]:
    """The cells of a column under any of its names. Raises `KeyError`."""
    wanted = (name, *NAMES.get(name, ()))
    for one in wanted:
        for key in rows[0]:
            if one in (key, key.lower(), UNIT.sub("", key.lower())):
                return [row[key] for row in rows]
    raise KeyError(name)


def numbers(rows: Rows, *names: str) -> np.ndarray:
    return np.array([[number(cell) for cell in column(rows, name)] for name in names])


def on_earth(path: pathlib.Path, pose: Any, *, above: Callable[..., Any] = egm96) -> None:
    """Orientations on the Earth, with heights above EGM96 or another surface."""
    names = ("lat_deg", "lon_deg", "height_m", "heading_deg", "pitch_deg", "roll_deg")

    def check(rows: Rows) -> None:
        lat, lon, height, *angles = numbers(rows, *names)
        same("latitude", np.rad2deg(pose.position.lat), lat, DEGREES)
        same("height", pose.position.height, height + above(lat, lon), 1e-3)
        same_turn("longitude", np.rad2deg(pose.position.lon), lon)
        same_turn("angles", np.rad2deg([pose.heading, pose.pitch, pose.roll]), angles)

    any_of(tables(path), check)


def on_earth_ellipsoidal(path: pathlib.Path, pose: Any) -> None:
    on_earth(path, pose, above=lambda lat, lon: 0.0)


def map_of(crs: str, undulation: float) -> Callable[[pathlib.Path, Any], None]:
    """Orientations in a map: x, y, z and omega, phi, kappa in deg or gon, or headings from its north."""

    def second(path: pathlib.Path, pose: Any) -> None:
        def check(rows: Rows) -> None:
            x, y, z = numbers(rows, "x_m", "y_m", "z_m")
            lat, lon, azimuth = in_map(crs, x, y)
            same_places(pose.position, lat, lon, z + undulation)
            same_attitude(pose, _turned(rows, azimuth))

        any_of(tables(path), check)

    return second


def _turned(rows: Rows, azimuth: np.ndarray) -> np.ndarray:
    from tests.fuzz.second.compared import R_BODY_FROM_CAMERA

    for unit, factor in (("deg", 1.0), ("gon", 0.9)):
        try:
            angles = numbers(rows, *(f"{name}_{unit}" for name in ("omega", "phi", "kappa")))
        except KeyError:
            continue
        return of_opk(*np.deg2rad(factor * angles), azimuth)
    heading, pitch, roll = np.deg2rad(numbers(rows, "heading_deg", "pitch_deg", "roll_deg"))
    heading = heading + np.deg2rad(azimuth)
    return turn("z", heading) @ turn("y", pitch) @ turn("x", roll) @ R_BODY_FROM_CAMERA


def triangulation(crs: str, undulation: float) -> Callable[[pathlib.Path, Any], None]:
    """Orientations of BINGO (lines ORIA) or PAT-B (an image with 12 or 13 numbers), each as one run of words."""

    def second(path: pathlib.Path, pose: Any) -> None:
        lines = [re.split(r"[ \t\f\v]+", line.strip(" \t\f\v")) for line in decoded(path.read_bytes()).splitlines()]
        of_bingo = [line[2:8] for line in lines if line[0].upper() == "ORIA"]
        if of_bingo:
            x, y, z, *angles = np.array([[number(cell) for cell in row] for row in of_bingo]).T
            phi, omega, kappa = np.pi / 200.0 * np.array(angles)
            R = turn("y", phi) @ turn("x", omega) @ turn("z", kappa)
        else:
            x, y, z, R = _patb([line for line in lines if line != [""]])
        lat, lon, azimuth = in_map(crs, x, y)
        same_places(pose.position, lat, lon, z + undulation)
        R_enu_from_map = turn("z", -np.deg2rad(azimuth))
        same_attitude(pose, R_NED_FROM_ENU @ R_enu_from_map @ R @ np.diag([1.0, -1.0, -1.0]))

    return second


def _patb(lines: list[list[str]]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(x, y, z, R_map_from_image) of images whose nine elements follow a line that ends in a position."""
    from scipy.linalg import polar

    places, rotations = [], []
    while lines:
        places.append([number(cell) for cell in lines[0][-3:]])
        elements: list[float] = []
        taken = 1
        while len(elements) < 9:
            elements += map(number, lines[taken])
            taken += 1
        rotations.append(polar(np.reshape(elements, (3, 3)))[0])
        lines = lines[taken:]
    return (*np.array(places).T, np.array(rotations))


def shots(path: pathlib.Path, table: Any) -> None:
    """Shots with one reading of a gimbal and a pixel; what is not known is NaN."""
    names = ("height_m", "heading_deg", "pitch_deg", "roll_deg", "gimbal_outer_deg", "u", "v")

    def check(rows: Rows) -> None:
        lat, lon, *others = (np.array([_or_nan(row[name]) for row in rows]) for name in ("lat_deg", "lon_deg", *names))
        nowhere = (lat == 0.0) & (lon == 0.0)
        for name, stated in zip(("lat_deg", "lon_deg"), (lat, lon), strict=True):
            same(name, table.numbers[name], np.where(nowhere, np.nan, stated), 0.0)
        for name, stated in zip(names, others, strict=True):
            same(name, table.numbers[name], stated)
        if "name" in rows[0]:
            same_names("names of shots", [row["name"].strip() for row in table.rows], [row["name"] for row in rows])

    any_of(tables(path), check)


def _or_nan(cell: str) -> float:
    words = ("", "nan", "na", "n/a", "#n/a", "none", "null", "nil", "unknown", "-", "--", "?")
    found = np.nan if cell.lower() in words else number(cell)
    return np.nan if found in (-9999.0, -99999.0, -999999.0, -32767.0, -32768.0) else found


def navigation(path: pathlib.Path, flight: Any) -> None:
    """Records of navigation: the trajectory passes through each at its time."""
    names = ("time_s", "lat_deg", "lon_deg", "height_m", "heading_deg", "pitch_deg", "roll_deg")

    def check(rows: Rows) -> None:
        time, lat, lon, height, *angles = (np.array([number(row[name]) for row in rows]) for name in names)
        same("times", flight.times, time)
        same_places(flight.poses.position, lat, lon, height)
        same_turn("angles", np.rad2deg([flight.poses.heading, flight.poses.pitch, flight.poses.roll]), angles)

    any_of(tables(path), check)


def image_points(path: pathlib.Path, points: Any) -> None:
    def check(rows: Rows) -> None:
        same_names("images", points.image, [row["image"] for row in rows])
        same_names("points", points.point, [row["point"] for row in rows])
        same("pixels", points.uv, [[number(row["u"]), number(row["v"])] for row in rows])
        header = rows[0]
        each = ("sigma_u_px", "sigma_v_px") if "sigma_u_px" in header else ("sigma_px", "sigma_px")
        sigma = [[number(row[name]) if name in header else 1.0 for name in each] for row in rows]
        same("standard deviations", points.sigma, sigma)

    any_of(tables(path), check)


def flight_log(path: pathlib.Path, found: Any) -> None:
    """AirData: the records with a fix, lengths in feet or metres by the header."""

    def check(rows: Rows) -> None:
        keys = {re.sub(r"\s*\(.*", "", key.lower()): key for key in reversed(list(rows[0]))}
        height = keys.get("altitude_above_sealevel", keys.get("altitude", ""))
        factor = 0.3048 if re.search(r"\((feet|ft)\)", height.lower()) else 1.0
        wanted = ("latitude", "longitude", "gimbal_heading", "gimbal_pitch", "gimbal_roll")
        kept = [(k, row) for k, row in enumerate(rows) if _has_fix(row, keys, (*wanted, ""), height)]
        same_names("records", found.names, [k for k, _ in kept])
        lat, lon, *angles = ([number(row[keys[name]]) for _, row in kept] for name in wanted)
        same_places(found.shots.pose.position, lat, lon, [factor * number(row[height]) for _, row in kept])
        same_gimbal(found.shots.pose, *angles)

    any_of(tables(path), check)


def _has_fix(row: dict[str, str], keys: Mapping[str, str], wanted: tuple[str, ...], height: str) -> bool:
    cells = [row[keys[name]] if name else row[height] for name in wanted]
    if any(np.isnan(_or_nan(cell)) for cell in cells):
        return False
    lat, lon, *_ = map(number, cells)
    level = row.get(keys.get("gpslevel", ""), "").strip()
    return not (lat == 0.0 and lon == 0.0) and not re.fullmatch(r"[+-]?0*\.?0+", level)


def same_gimbal(pose: Any, yaw: Any, pitch: Any, roll: Any) -> None:
    """Attitudes of bodies whose camera looks down, against a gimbal's angles in deg of one that looks ahead."""
    from tests.fuzz.second.compared import turn

    ahead = np.array(
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    )  # forward, right, down of (right, down, ahead)
    R = turn("z", np.deg2rad(yaw)) @ turn("y", np.deg2rad(pitch)) @ turn("x", np.deg2rad(roll)) @ ahead
    same_attitude(pose, R)


def positions(path: pathlib.Path, table: Any) -> None:
    """OpenDroneMap's geo.txt and report, DJI's marks, a table with a header."""
    text = decoded(path.read_bytes())
    if table.form == "DJI marks of photos":
        _marks(text, table)
    elif table.form == "OpenDroneMap report":
        features = of_json(path.read_bytes())["features"]
        lon, lat, height = np.array([feature["geometry"]["coordinates"] for feature in features], np.float64).T
        same_names("images", table.names, [str(feature["properties"]["filename"]).strip() for feature in features])
        same_places(table.position, lat, lon, height)
    elif table.form == "OpenDroneMap geo.txt":
        _geo(text, table)
    else:
        any_of(tables(path), lambda rows: _of_header(rows, table))


def _marks(text: str, table: Any) -> None:
    rows = [
        re.findall(r"[-+.0-9eE]+(?=[\s\],]|$)", re.sub(r"[\[\]]|,[A-Z][a-z]*\b", " ", line))
        for line in text.splitlines()
        if line.strip()
    ]
    rows = [[number(word.rstrip(",")) for word in row if word.strip("+-.eE")] for row in rows]
    known = [row for row in rows if row[-1] != 0.0 and (row[6], row[7]) != (0.0, 0.0)]
    same("photos", table.numbers, [row[0] for row in known])
    same_places(table.position, *([row[k] for row in known] for k in (6, 7, 8)))


def _geo(text: str, table: Any) -> None:
    projection, *lines = [
        line.strip() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")
    ]
    words = [_words(line) for line in lines]
    same_names("images", table.names, [row[0] for row in words])
    x, y = ([number(row[k]) for row in words] for k in (1, 2))
    lat, lon, _ = in_map(crs_of(projection), x, y)
    height = [number(row[3]) for row in words] if table.has_heights else np.full(len(words), np.nan)
    same_places(table.position, lat, lon, height)


def _words(line: str) -> list[str]:
    """What blanks and tabs separate; other white space may be within the name of a file."""
    return re.findall(r"[^ \t]+", line)


def _of_header(rows: Rows, table: Any) -> None:
    same_names("images", table.names, column(rows, "image"))
    lat, lon = numbers(rows, "lat_deg", "lon_deg")
    height = numbers(rows, "height_m")[0] if table.has_heights else np.full(len(rows), np.nan)
    same_places(table.position, lat, lon, height)


def crs_of(projection: str) -> str:
    utm = re.fullmatch(r"WGS84\s+UTM\s+(\d+)\s*([NS]?)", projection, re.IGNORECASE)
    if utm:
        return f"EPSG:{'327' if utm[2].upper() == 'S' else '326'}{int(utm[1]):02d}"
    return "EPSG:4326" if projection.upper() == "WGS84" else projection


def ground_control(path: pathlib.Path, control: Any) -> None:
    """OpenDroneMap's gcp_list.txt: a projection, then x y z column row image [name]."""
    lines = [line.strip() for line in decoded(path.read_bytes()).splitlines()]
    projection, *rows = [line for line in lines if line and not line.startswith("#")]
    words = [_words(row) for row in rows]
    any_of(
        iter((words, [[_with_point(word) for word in row] for row in words])), lambda w: _gcp(projection, w, control)
    )


def _gcp(projection: str, words: list[list[str]], control: Any) -> None:
    places = [tuple(number(word) for word in row[:3]) for row in words]
    order = list(dict.fromkeys(places))
    same("pixels", control.points.uv, [[number(word) for word in row[3:5]] for row in words])
    same_names("images", control.points.image, [row[5] for row in words])
    stated = {place: row[6] for place, row in zip(places, words, strict=True) if len(row) > 6}
    for name, place in zip(control.names, order, strict=True):
        assert stated.get(place, name) == name, f"point {name!r}, by the second reading {stated[place]!r}"
    same_names("points", control.points.point, [control.names[order.index(place)] for place in places])
    x, y, z = np.array(order).T
    lat, lon, _ = in_map(crs_of(projection), x, y)
    same("latitude", np.rad2deg(control.position.lat), lat, DEGREES)
    same_turn("longitude", np.rad2deg(control.position.lon), lon)
    same("height", control.position.height, z, METRES)


def bal(path: pathlib.Path, problem: Any) -> None:
    """BAL, by words: counts, observations, cameras, points."""
    import bz2

    content = path.read_bytes()
    words = (bz2.decompress(content) if path.suffix == ".bz2" else content).decode("ascii").split()
    cameras, points, observations = map(int, words[:3])
    values = np.array([number(word) for word in words[3:]])
    seen = values[: 4 * observations].reshape(-1, 4)
    params = values[4 * observations : -3 * points].reshape(-1, 9)
    assert len(params) == cameras, f"{len(params)} cameras, by the header {cameras}"
    same("observations", np.column_stack([problem.image_index, problem.point_index, problem.uv]), seen)
    lens = np.column_stack([problem.focal_px, problem.k1, problem.k2])
    same("cameras", np.hstack([problem.rotation, problem.translation, lens]), params)
    same("points", problem.points.ravel(), values[-3 * points :])
