"""Comparison tables of Li et al. (2023): printed values and those obtained here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from jaxgeo.studies.li2023 import misprints, printed
from jaxgeo.studies.li2023.causes import Cause
from jaxgeo.studies.li2023.equations import angle_deg, sight_ned
from jaxgeo.studies.li2023.inclination import Inclination
from jaxgeo.studies.li2023.pointing import Pointing
from jaxgeo.studies.li2023.positions import Accuracy, Judged
from jaxgeo.studies.li2023.targets import Target
from jaxgeo.studies.li2023.tilts import Tilt, printed_rms
from jaxgeo.studies.sheet import Cell, Sheet

SHOWN_FRAMES = (60.0, 65.0, 70.0, 74.0, 78.0)  # deg
SHOWN_MISPRINTS = 3  # per row
SHOWN_SIGMAS = (10.0, 20.0, 50.0, 100.0, 150.0, 190.0)  # m


def pointing_sheet(found: Sequence[Pointing]) -> Sheet:
    """Section 5.1: pointing errors of the line of sight."""
    rows: list[list[Cell]] = []
    low, high = printed.LOS_BAND
    for one in found:
        name = one.setting
        rows.append([name, "RMS, °", printed.LOS_RMS, one.linear_rms, one.sampled_rms, one.standard_error])
        shares: list[tuple[str, float, float, float]] = [
            (f"below {limit:.2f}°", share, one.linear_within[limit], one.sampled_within[limit])
            for limit, share in printed.LOS_WITHIN.items()
        ]
        shares.append((f"{low}° to {high}°", 0.5, *one.in_band))
        for text, claimed, linear, sampled in shares:
            error = float(np.sqrt(sampled * (1.0 - sampled) / one.angles.size))
            rows.append([name, f"{text}, share", claimed, linear, sampled, error])
    off = {
        limit: (share - found[0].linear_within[limit])
        / float(np.sqrt(found[0].linear_within[limit] * (1.0 - found[0].linear_within[limit]) / printed.DRAWS))
        for limit, share in printed.LOS_WITHIN.items()
    }
    shares_off = ", ".join(f"{off_by:+.1f} standard errors below {limit:.2f}°" for limit, off_by in off.items())
    note = (
        f"The printed shares lie off the linear ones, in standard errors of the paper's {printed.DRAWS} draws: "
        f'{shares_off}. Printed for the band {low}° to {high}° is "more than 50 %"; it holds less. Sampled: '
        f"{found[0].angles.size} draws of the ten angles of Table 1; the RMS of the paper's has a standard "
        f"error of {found[0].standard_error * np.sqrt(found[0].angles.size / printed.DRAWS):.4f}°."
    )
    columns = {
        "line of sight": "",
        "figure": "",
        "printed": ".4f",
        "linear": ".4f",
        "sampled": ".4f",
        "± 1 s.e.": ".4f",
    }
    return Sheet("pointing", "Pointing error of the line of sight (section 5.1)", columns, rows, note)


def inclination_sheet(found: Inclination) -> Sheet:
    """Fig. 5: at a few frame angles and heights, the error of height alone and with the ten angles."""
    frames = [frame for frame in SHOWN_FRAMES if frame in found.frames]
    columns = {"σ of height, m": ".0f"}
    for frame in frames:
        columns |= {f"{frame:.0f}°: height": ".1f", f"{frame:.0f}°: all": ".1f"}
    rows: list[list[Cell]] = []
    for i, sigma in enumerate(found.sigmas):
        if sigma in SHOWN_SIGMAS:
            at = [int(np.argmax(found.frames == frame)) for frame in frames]
            pairs = [(float(found.height_only[i, j]), float(found.full[i, j])) for j in at]
            rows.append([float(sigma), *(value for pair in pairs for value in pair)])
    note = (
        "RMS in space in m over the outer frame angle: of the height's error alone, and with the ten angles of Table 1."
    )
    return Sheet("inclination", "Frame angle and height error (Fig. 5)", columns, rows, note)


def targets_sheet(found: Sequence[Target]) -> Sheet:
    """Table 2: the targets obtained, and their offsets from the printed ones."""
    rows = []
    for one in found:
        lat, lon, height = (float(x) for x in one.position.to_degrees())
        rows.append([one.terrain, one.inner_deg, lat, lon, height, one.north, one.east])
    columns = {"terrain": "", "inner, °": ".4f", "lat, °": ".7f", "lon, °": ".7f", "height, m": ".4f"}
    columns |= {"north, m": "+.2f", "east, m": "+.2f"}
    note = (
        f"Met at the printed heights; north and east: obtained minus printed. With an inner angle of "
        f"{printed.MOUNTAIN_INNER}° for the printed {printed.TERRAINS['mountain'].inner}° the mountain's target falls "
        f"in with the others (see the misprints)."
    )
    return Sheet("targets", "Targets from the frame angles of Table 2", columns, rows, note)


def positions_sheet(found: Sequence[Accuracy]) -> Sheet:
    """Table 3: RMS of each target's position; over several places the median, with the extremes of the RMS."""
    rows: list[list[Cell]] = []
    for name, row in printed.TERRAINS.items():
        east, north, _ = printed_rms(row).tolist()
        ours = [(*key, group) for key, group in groups(found).items() if key[0] == name]
        rows.append(
            [name, "real tile", "printed", row.lat_rms, row.lon_rms, north, east, row.height_rms, row.rms, None, None]
        )
        for _, ground, method, group in ours:
            names = ("lat_deg", "lon_deg", "north", "east", "height", "rms")
            all_rms = [one.rms for one in group]
            ends = (min(all_rms), max(all_rms)) if len(group) > 1 else (None, None)
            rows.append([name, ground, method, *(median(group, field) for field in names), *ends])
    columns = {"terrain": "", "ground": "", "method": "", "lat, °": ".6f", "lon, °": ".6f", "north, m": ".2f"}
    columns |= {"east, m": ".2f", "height, m": ".2f", "RMS, m": ".2f", "least, m": ".1f", "most, m": ".1f"}
    return Sheet("positions", "RMS of the target's position (Table 3)", columns, rows, _ground_note(found))


def circles_sheet(found: Sequence[Accuracy]) -> Sheet:
    """The printed CEP beside the true radii, and the errors that the paper found against a map."""
    rows: list[list[Cell]] = []
    for name, row in printed.TERRAINS.items():
        rows.append([name, "real tile", "printed", row.cep, None, None, None, row.actual, None, None])
        for (terrain, ground, method), group in groups(found).items():
            if terrain == name:
                fields = ("rms_over_1_2", "held", "ce50", "ce90")
                figures = [median(group, field) for field in fields]
                mean = float(np.mean([one.beyond for one in group]))
                rows.append(
                    [name, ground, method, *figures, row.actual, mean, float(np.mean([o.found for o in group]))]
                )
    columns = {"terrain": "", "ground": "", "method": "", "RMS / 1.2, m": ".2f", "held": ".1%", "CE50, m": ".1f"}
    columns |= {"CE90, m": ".1f", "actual, m": ".1f", "beyond it": ".2%", "fixes": ".1%"}
    note = (
        'What the paper prints as "circular error probable" is its RMS in space divided by 1.2; held: the share of '
        "errors on the level plane that its circle truly holds. CE50 and CE90 are the true radii; actual: the error "
        "found against a map; beyond it: the chance of a larger one. Over several places: medians, and means "
        "of the chances."
    )
    return Sheet("circles", "Circles that hold half (Table 3)", columns, rows, note)


def tilts_sheet(found: Sequence[Tilt]) -> Sheet:
    """Tilted plane closest to each row of Table 3."""
    rows: list[list[Cell]] = []
    for one in found:
        pairs = zip(one.printed_enu[[1, 0, 2]].tolist(), one.rms_enu[[1, 0, 2]].tolist(), strict=True)
        rows.append([one.terrain, one.along_deg, one.across_deg, *(value for pair in pairs for value in pair)])
    columns = {"terrain": "", "along, °": "+.1f", "across, °": "+.1f"}
    for axis in ("north", "east", "height"):
        columns |= {f"{axis}, printed": ".2f", f"{axis}, fitted": ".2f"}
    note = (
        "The plane under the target on which linear propagation comes nearest to the printed RMS (m): its slope along "
        "the line of sight (+ rises away from the camera) and across (+ rises to its left)."
    )
    return Sheet("tilts", "Which ground the printed errors imply", columns, rows, note)


def places_sheet(found: Sequence[Accuracy]) -> Sheet:
    """Every place separately, for a file."""
    fields = ("lat_deg", "lon_deg", "north", "east", "height", "rms", "rms_over_1_2", "held", "ce50", "ce90", "beyond")
    rows = [
        [one.terrain, one.ground, one.method, one.place, *(getattr(one, field) for field in fields), one.found]
        for one in found
    ]
    columns = {"terrain": "", "ground": "", "method": "", "place": "d"} | dict.fromkeys((*fields, "found"), ".6f")
    return Sheet("places", "Every place", columns, rows)


def groups(found: Sequence[Accuracy]) -> dict[tuple[str, str, str], list[Accuracy]]:
    """Records grouped by terrain, ground and method, in order."""
    together: dict[tuple[str, str, str], list[Accuracy]] = {}
    for one in found:
        together.setdefault((one.terrain, one.ground, one.method), []).append(one)
    return together


def median(group: Sequence[Accuracy], field: str) -> float:
    """Median of a field over the places."""
    return float(np.median([getattr(one, field) for one in group]))


def _ground_note(found: Sequence[Accuracy]) -> str:
    places = 1 + max(one.place for one in found)
    return (
        "RMS = (north² + east² + height²)^½, as in the paper: the ten angles of Table 1, terrain heights to 20 m, the "
        "aircraft's position without error. The paper's tile is not published: level is ground of the printed height, "
        f"synthetic is fractal terrain of that rms slope, each place on another, real the elevation model that comes "
        f"with the package, seen from as high above it; medians over {places} places, and the least and most RMS."
    )


def judged_sheet(found: Sequence[Judged]) -> Sheet:
    """Method and result that `jaxgeo.accuracy` selects at the places of Table 3's sheets."""
    rows: list[list[Cell]] = []
    for terrain, ground in dict.fromkeys((one.terrain, one.ground) for one in found):
        group = [one for one in found if (one.terrain, one.ground) == (terrain, ground)]
        ratios = [one.ce90 / one.sampled_ce90 for one in group]
        methods = Counter(one.method for one in group)
        counts = ", ".join(f"{method} {count}" for method, count in methods.most_common())
        medians = [float(np.median([getattr(one, name) for one in group])) for name in ("ce90", "sampled_ce90")]
        rows.append([terrain, ground, *medians, float(np.median(ratios)), min(ratios), max(ratios), counts])
    columns = {"terrain": "", "ground": "", "CE90, m": ".1f", "sampled, m": ".1f", "ratio": ".3f", "least": ".3f"}
    columns |= {"most": ".3f", "chosen, places": ""}
    note = "The method that jaxgeo.accuracy takes by itself at each place, and its CE90 beside that of other samples."
    return Sheet("judged", "The verdict of accuracy", columns, rows, note)


def causes_sheet(found: Sequence[Cause]) -> Sheet:
    """Single causes of the errors against a map, the best fit first."""
    actual = [row.actual for row in printed.TERRAINS.values()]
    rows: list[list[Cell]] = [["as printed", "", None, *actual, None, None, None, None]]
    for one in found:
        rows.append(
            [one.name, one.unit, one.amount, *one.errors.tolist(), one.left, one.left_chance, one.sigmas, one.chance]
        )
    columns = {"single cause": "", "unit": "", "amount": ".3f", **{f"{name}, m": ".1f" for name in printed.TERRAINS}}
    columns |= {"left (RMS), m": ".1f", "chance of as much left": ".2f", "in σ": ".1f", "chance": ".1e"}
    best, likely = found[0], [one for one in found if one.chance is not None and one.chance > 0.05]
    names = ", ".join(one.name for one in likely)
    others = (
        f"the likely ones ({names}) leave {min(one.left for one in likely):.0f} m or more"
        if likely
        else "none of those with a stated standard deviation is likelier than 5 %"
    )
    note = (
        f"Each quantity by itself in error by the same amount at all three targets, fitted by least squares to the "
        f"errors against a map; σ as in Table 1 and {printed.DEM_SIGMA:.0f} m of the elevation model. What is left "
        f"is held against the other errors of Table 1. The best, {best.name}, leaves {best.left:.0f} m; {others}."
    )
    return Sheet("causes", "Single causes of the actual errors (section 5.2)", columns, rows, note)


def misprints_sheet() -> Sheet:
    """One-digit changes of Table 2 that bring each target closest to the printed one."""
    rows: list[list[Cell]] = []
    counts = []
    for name, off in misprints.misses().items():
        tried = misprints.one_digit(name)
        near = sum(one.miss < misprints.NEAR for one in tried)
        counts.append(f"{name} {near} of {len(tried)}")
        for one in tried[:SHOWN_MISPRINTS]:
            rows.append([name, off, one.quantity, f"{one.printed:.4f}", f"{one.changed:.4f}", one.miss])
    columns = {"terrain": "", "off as printed, m": ".1f", "quantity": "", "printed": "", "changed": ""}
    note = (
        f"One digit, or the sign, of latitude, longitude, outer or inner angle of a row changed; below "
        f"{misprints.NEAR:.0f} m: {', '.join(counts)}. Where none is, one misprint in Table 2 does not "
        f"explain the print; where several are, the last digits among them, the print cannot tell which."
    )
    return Sheet("misprints", "One digit of Table 2 changed", columns | {"then off, m": ".2f"}, rows, note)


def sight_sheet() -> Sheet:
    """The nominal line of sight of section 5.1 beside those of Table 2."""
    nominal = np.array(printed.LOS_NOMINAL)
    rows: list[list[Cell]] = [["printed, section 5.1", *printed.LOS_NOMINAL, None]]
    for name, row in printed.TERRAINS.items():
        ned = sight_ned(row)
        rows.append([name, *ned.tolist(), angle_deg(nominal, ned)])
    columns = {"line of sight": "", "north": ".4f", "east": ".4f", "down": ".4f", "off the printed, °": ".3f"}
    note = "No row of Table 2 gives the printed one to its last digit."
    return Sheet("sight", "Nominal line of sight (section 5.1)", columns, rows, note)
