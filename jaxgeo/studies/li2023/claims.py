"""Claims of Li et al. (2023) with the results obtained here: equations, tables, figures and statements."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2023 import printed
from jaxgeo.studies.li2023.claims_on_searches import search_claims
from jaxgeo.studies.li2023.equations import PAPER, angle_deg, equations, sight_ned
from jaxgeo.studies.li2023.misprints import one_digit
from jaxgeo.studies.li2023.positions import LEVEL_GROUND, Accuracy
from jaxgeo.studies.li2023.targets import metres_per_radian
from jaxgeo.studies.li2023.tilts import Tilt, printed_rms
from jaxgeo.uncertainty import presets

if TYPE_CHECKING:
    from jaxgeo.studies.li2023.report import Report

ERRORS = 3.0  # standard errors of the paper's own draws within which a random result counts as reproduced
LAST_DIGIT = 5e-5  # angles and lines of sight have four decimals
LENGTHS = {"lat_rms": 0.002, "lon_rms": 0.001}  # deg, from the conclusions
WORDS = {"lat": "latitude", "lon": "longitude", "outer": "outer angle", "inner": "inner angle"}
CEP_MOUNTAIN = 200.0  # m, from the abstract
SKETCHES = {
    "Fig. 1": "a sketch of the camera in its frame",
    "Fig. 2": "a sketch of an image being taken",
    "Fig. 3": "a sketch of the image plane",
    "Fig. 4": "a sketch of the Earth's frame",
    "Fig. 13": "images of the flight; neither they nor the elevation model are published",
}


def claims_of(report: Report) -> list[Claim]:
    """Claims for every numbered equation, table and figure, and the numbers and statements of text and abstract."""
    return [*claims_besides_searches(report), *search_claims(report.searches)]


def claims_besides_searches(report: Report) -> list[Claim]:
    """All claims except those on the searches: Figs 6 to 11, Table 4, and the statements on them."""
    return [*equations(), *_tables(report), *_figures(report), *_section_5_1(report), *_conclusions(report)]


def claim(item: str, statement: str, wanted: object, obtained: object, function: str, **more: object) -> Claim:
    """A claim of this paper; `function` is given without the package's name."""
    name = f"jaxgeo.{function}" if function else ""
    return Claim(PAPER, item, statement, wanted, obtained, function=name, **more)  # type: ignore[arg-type]


def _tables(report: Report) -> Iterator[Claim]:
    sigmas = np.rad2deg(np.sqrt(np.diag(np.asarray(presets.li_2023().covariance()))))
    yield claim(
        "Table 1",
        "standard deviations of attitude, frame, calibration and mounting",
        printed.ANGLE_SIGMAS,
        tuple(sigmas.tolist()),
        "uncertainty.presets.li_2023",
        tolerance=1e-12,
        unit="°",
    )
    yield from _table_2(report)
    yield from table_3(report.positions, report.tilts)


def _table_2(report: Report) -> Iterator[Claim]:
    """Compared with the print's rounding: 1e-4 deg in the aircraft's position and in the angles. The closest
    one-digit change is the explanation, if it agrees within that."""
    for one in report.targets[: len(printed.TERRAINS)]:
        row = printed.TERRAINS[one.terrain]
        along_meridian, along_parallel = metres_per_radian(printed.target_of(row))
        half = 0.5e-4 * math.radians(1.0)
        turned = half * _range(row) * (1.0 / math.cos(math.radians(row.outer)) + 1.0)
        rounding = (half * along_meridian + turned, half * along_parallel + turned)
        best = one_digit(one.terrain)[0]
        yield claim(
            f"Table 2, {one.terrain}",
            "target at the printed height, north and east of the printed one",
            (0.0, 0.0),
            (one.north, one.east),
            "locate",
            tolerance=rounding,
            unit="m",
            explanation=Explanation(
                f"{WORDS[best.quantity]} {best.changed:.4f}° for {best.printed:.4f}°: so far off it is then, in m",
                best.miss,
                0.0,
                math.hypot(*rounding),
            ),
            digits="+.2f",
            reason=f"It lies {math.hypot(one.north, one.east):.1f} m off; the print's rounding is {rounding[0]:.1f} m "
            f"north and {rounding[1]:.1f} m east.",
        )


def _range(row: printed.Terrain) -> float:
    return (printed.ALTITUDE - row.target[2]) / math.cos(math.radians(row.outer))


def table_3(positions: list[Accuracy], tilts: list[Tilt]) -> Iterator[Claim]:
    """Over level ground, and on the plane whose tilt fits best: the paper's own tile is not published."""
    planes = {one.terrain: one for one in tilts}
    for name, row in printed.TERRAINS.items():
        linear = _one(positions, name, "linear")
        wanted = printed_rms(row)[[1, 0, 2]]
        spread = ERRORS / math.sqrt(2.0 * printed.DRAWS)
        tilted = planes[name]
        yield claim(
            f"Table 3, {name}",
            "RMS of the target north, east and in height, over level ground",
            tuple(wanted.tolist()),
            (linear.north, linear.east, linear.height),
            "propagate",
            tolerance=tuple((spread * wanted).tolist()),
            unit="m",
            explanation=Explanation(
                f"ground tilted by {tilted.along_deg:+.1f}° along the line of sight and "
                f"{tilted.across_deg:+.1f}° across it",
                tuple(tilted.rms_enu[[1, 0, 2]].tolist()),
                tuple(wanted.tolist()),
                tuple((spread * wanted).tolist()),
            ),
            digits=".1f",
        )
        yield claim(
            f"Table 3, {name}",
            "RMS of the target in space, over level ground",
            row.rms,
            linear.rms,
            "propagate",
            tolerance=spread * row.rms,
            unit="m",
            explanation=Explanation(
                f"ground tilted by {tilted.along_deg:+.1f}° along the line of sight and "
                f"{tilted.across_deg:+.1f}° across it",
                float(np.linalg.norm(tilted.rms_enu)),
                row.rms,
                spread * row.rms,
            ),
            digits=".1f",
        )
        yield claim(
            f"Table 3, {name}",
            "circle that holds half of the errors (CEP, 50 %), for errors with the printed RMS along each axis",
            row.cep,
            _cep_of(linear, wanted),
            "uncertainty.metrics.circular_error",
            tolerance=spread * row.cep,
            unit="m",
            explanation=Explanation("it is the RMS in space divided by 1.2", row.rms / 1.2, row.cep, 0.005),
            digits=".2f",
        )
        yield claim(
            f"Section 5.2, {name}",
            "error against a map",
            None,
            None,
            "studies.li2023.causes.causes",
            reason=f"{row.actual} m; neither the map's point nor the tile is published. A larger error has a chance of "
            f"{linear.beyond:.1%} over level ground; single causes are in the sheet of causes.",
        )


def _cep_of(linear: Accuracy, rms_ned: np.ndarray) -> float:
    """CE50 from the correlation over level ground and the printed RMS north and east."""
    from jaxgeo.uncertainty.metrics import circular_error

    scale = np.array([rms_ned[1] / linear.east, rms_ned[0] / linear.north])
    return float(circular_error(linear.cov_enu[:2, :2] * np.outer(scale, scale), 0.5))


def _figures(report: Report) -> Iterator[Claim]:
    for item, what in SKETCHES.items():
        yield claim(item, what, None, None, "", reason="There are no numbers to hold a result against.")
    found = report.inclination
    grows = bool(np.all(np.diff(found.full, axis=0) > 0.0) and np.all(np.diff(found.full, axis=1) > 0.0))
    low, high = (float(found.full[k, k]) for k in (0, -1))
    yield claim(
        "Fig. 5",
        "the error grows with the error of height and with the frame angle, everywhere",
        True,
        grows,
        "propagate",
        reason=f"From {low:.0f} to {high:.0f} m over the figure.",
    )
    yield _fig_5_and_table_3(report)
    yield claim(
        "Fig. 12",
        "share of pointing errors below 0.15°",
        printed.LOS_WITHIN[0.15],
        report.pointing[0].linear_within[0.15],
        "studies.li2023.pointing.pointing_errors",
        tolerance=ERRORS * _share_error(printed.LOS_WITHIN[0.15]),
        digits=".2%",
    )


def _fig_5_and_table_3(report: Report) -> Claim:
    """Section 2.2 and conclusion (1): over the DEM the error equals that of Fig. 5 at 20 m."""
    found, row = report.inclination, printed.TERRAINS["plain"]
    sigma = int(np.argmin(np.abs(found.sigmas - printed.DEM_SIGMA)))
    at = float(np.interp(row.outer, found.frames, found.full[sigma]))
    return claim(
        "Fig. 5",
        "at 20 m of height it agrees with Table 3 (plain), to a tenth",
        row.rms,
        at,
        "propagate",
        tolerance=0.1 * row.rms,
        unit="m",
        reason=f"At the frame angle of the plain, {row.outer:.2f}°, and a standard deviation of "
        f"{found.sigmas[sigma]:.0f} m.",
        digits=".1f",
    )


def _section_5_1(report: Report) -> Iterator[Claim]:
    found = report.pointing[0]
    yield claim(
        "Section 5.1",
        "nominal line of sight, north, east, down, beside the plain of Table 2",
        printed.LOS_NOMINAL,
        tuple(sight_ned(printed.TERRAINS["plain"]).tolist()),
        "sensor.exposure.line_of_sight",
        tolerance=LAST_DIGIT,
        digits=".4f",
        reason=f"They are {angle_deg(np.array(printed.LOS_NOMINAL), sight_ned(printed.TERRAINS['plain'])):.3f}° apart.",
    )
    yield claim(
        "Section 5.1",
        "RMS of the pointing error",
        printed.LOS_RMS,
        found.linear_rms,
        "studies.li2023.pointing.pointing_errors",
        tolerance=ERRORS * found.standard_error * math.sqrt(found.angles.size / printed.DRAWS),
        unit="°",
        digits=".4f",
    )
    share, error = printed.LOS_WITHIN[0.10], _share_error(printed.LOS_WITHIN[0.10])
    yield claim(
        "Section 5.1",
        "share of pointing errors below 0.10°",
        share,
        found.linear_within[0.10],
        "studies.li2023.pointing.pointing_errors",
        tolerance=ERRORS * error,
        digits=".2%",
        reason=f"The print lies {(share - found.linear_within[0.10]) / error:+.1f} standard errors of "
        f"{printed.DRAWS} draws off.",
    )
    low, high = printed.LOS_BAND
    yield claim(
        "Section 5.1",
        f"more than half of the pointing errors lie from {low}° to {high}°",
        True,
        found.in_band[0] > 0.5,
        "studies.li2023.pointing.pointing_errors",
        reason=f"{found.in_band[0]:.1%} by the Gaussian, {found.in_band[1]:.1%} of the samples.",
    )


def _conclusions(report: Report) -> Iterator[Claim]:
    rows = [one for one in report.positions if one.method == "sampled" and one.ground == LEVEL_GROUND]
    lat, lon = max(one.lat_deg for one in rows), max(one.lon_deg for one in rows)
    yield claim(
        "Conclusions",
        "RMS below 0.002° of latitude and 0.001° of longitude, over level ground",
        True,
        lat < LENGTHS["lat_rms"] and lon < LENGTHS["lon_rms"],
        "sample",
        reason=f"At most {lat:.4f}° and {lon:.4f}°.",
    )
    mountain = [one for one in report.positions if one.terrain == "mountain" and one.method == "sampled"]
    ce50 = {ground: float(np.median([o.ce50 for o in mountain if o.ground == ground])) for ground in _grounds(mountain)}
    yield claim(
        "Abstract",
        "circle that holds half of the errors below 200 m in mountains",
        True,
        max(ce50.values()) < CEP_MOUNTAIN,
        "sample",
        reason="; ".join(f"{ground}: {radius:.0f} m" for ground, radius in ce50.items()) + ".",
    )


def _grounds(found: list[Accuracy]) -> list[str]:
    return list(dict.fromkeys(one.ground for one in found))


def _one(found: list[Accuracy], terrain: str, method: str) -> Accuracy:
    """The row over level ground."""
    return next(one for one in found if (one.terrain, one.ground, one.method) == (terrain, LEVEL_GROUND, method))


def _share_error(share: float) -> float:
    """Standard error of a share in the paper's draws."""
    return math.sqrt(share * (1.0 - share) / printed.DRAWS)
