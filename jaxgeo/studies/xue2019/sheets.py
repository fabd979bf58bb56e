"""The printed numbers of Xue et al. (2019) and ours, side by side."""

from __future__ import annotations

import numpy as np

from jaxgeo.studies.sheet import Cell, Sheet
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.cases import Case, Cases
from jaxgeo.studies.xue2019.simulation import (
    RELIEF,
    SIGMA_GROUND,
    SIGMA_IMAGE,
    Simulated,
    boresight_of,
    interior_of,
    spacing,
)
from jaxgeo.studies.xue2019.trials import NAMES, Trials

# What an error of the focal length does to heights by itself, m.
BY_FOCAL = (printed.CALIBRATED.f / printed.INTERIORS["Brown"].f - 1.0) * printed.HEIGHT


def block_sheet(block: Simulated) -> Sheet:
    """What was flown and what was simulated."""
    images, seen, ties = len(block.image), len(block.observations), len(np.unique(block.observations.point))
    sample = printed.HEIGHT * printed.PIXEL_PITCH / printed.INTERIORS["Brown"].f
    true, given = block.true.camera, block.given.camera
    rows: list[list[Cell]] = [
        ["area, m", f"{printed.AREA:.0f}", f"{block.size:.0f}"],
        ["images", "–", f"{images} in {len(np.unique(block.strip))} strips"],
        ["image, px", "–", f"{printed.COLUMNS} x {printed.ROWS} of {1e3 * printed.PIXEL_PITCH:.1f} um"],
        ["height above ground, m", f"{printed.HEIGHT:.0f}", f"{printed.HEIGHT:.0f}, hills of +-{RELIEF:.0f}"],
        ["ground sample, m", f"{printed.GROUND_SAMPLE:.2f}", f"{sample:.4f}"],
        ["overlap", "80 %, 50 %", f"80 %, 50 %: a step of {spacing()[0]:.0f} m, strips {spacing()[1]:.0f} m apart"],
        ["control, check points", f"{printed.CONTROL}, {printed.CHECKS}", f"{len(block.control)}, {len(block.checks)}"],
        ["their sigma, m", "–", " ".join(f"{sigma:.3f}" for sigma in SIGMA_GROUND)],
        ["sigma of position, m", "0.05 0.05 0.10", " ".join(f"{sigma:.2f}" for sigma in printed.SIGMA_POSITION)],
        ["sigma of heading, pitch, roll, deg", "0.035 0.015 0.015", " ".join(map(str, printed.SIGMA_ATTITUDE))],
        ["image points", "–", f"{seen}, of {ties} points: {seen / images:.0f} in an image, {SIGMA_IMAGE} px"],
    ]
    for name, camera in (("calibrated", given), ("true", true)):
        shown = printed.CALIBRATED if name == "calibrated" else printed.INTERIORS["Brown"]
        rows.append([f"{name} f, xp, yp, mm", _joined(shown), _joined(interior_of(camera))])
    angles = " ".join(f"{angle:.3f}" for angle in boresight_of(block.true.mount))
    rows.append(["boresight about x, y, z, '", " ".join(f"{angle:.3f}" for angle in printed.BORESIGHT), angles])
    note = (
        "The truth of the simulation is what the paper's Brown model found; size and number of pixels are the camera "
        "maker's. xp and yp have y up (towards the image's top), x right. The true lens errs by up to 8 um in the "
        "corners and 0.3 um by a ripple of the chip, of which no model knows; it has no decentring, which could not "
        "be told from boresight. The angles are those of the body against the camera (roll, pitch, heading)."
    )
    return Sheet("block", "The block (Tables 1 and 2)", {"": "", "printed": "", "simulated": ""}, rows, note)


def cases_sheet(found: Cases) -> Sheet:
    """All cases at check points."""
    rows: list[list[Cell]] = []
    for case in found.cases:
        shown = (None, None, None) if case.printed is None else case.printed
        ours = [float(value) for value in case.rms]
        rows.append([case.title, len(case.checks), *shown, *ours, *case.earlier, case.remark])
    columns = {"case": "", "points": "d"}
    columns |= {f"printed {axis}": ".3f" for axis in "xyz"}
    columns |= dict.fromkeys("xyz", ".3f")
    columns |= {f"earlier {axis}": ".3f" for axis in "xyz"}
    columns["remark"] = ""
    note = (
        "Root mean square of found less surveyed, m; x east, y north, strips flown north and south. Earlier: another "
        "program's simulation of 6 strips of 19 images, whose conventions are not known in all parts. The paper's "
        f"field is real: its targets, image points and navigation may err by more than is assumed here. By itself the "
        f"error of the focal length is {BY_FOCAL:.2f} m in height."
    )
    return Sheet("cases", "Residuals at check points (section 2, Table 3)", columns, rows, note)


def interior_sheet(found: Cases) -> Sheet:
    """Table 4."""
    rows: list[list[Cell]] = []
    for one in found.recovered:
        shown = printed.INTERIORS.get(one.model)
        for what, value, sigma, place in zip(
            ("f", "xp", "yp"), one.interior, one.sigma_interior, range(3), strict=True
        ):
            true = printed.INTERIORS["Brown"][place]
            rows.append([one.model, what, None if shown is None else shown[place], value, sigma, value - true])
    columns = {"model": "", "": "", "printed": ".4f", "found": ".4f", "sigma": ".4f", "off the truth": ".4f"}
    note = (
        f"mm, y up; the calibrated values are {_joined(printed.CALIBRATED)}, the truth is that printed for Brown. "
        "Sigma is of unit weight, of the model: what the lens has beyond it comes on top: the three differ by more "
        "(in print by 0.006 mm in f). In two steps the navigation's heights have no part, and control alone holds f."
    )
    return Sheet("interior", "Interior orientation (Table 4)", columns, rows, note)


def boresight_sheet(found: Cases) -> Sheet:
    """Section 2.5."""
    rows: list[list[Cell]] = []
    for one in found.recovered:
        ways = zip("xyz", printed.BORESIGHT, one.boresight, one.sigma_boresight, strict=True)
        for axis, shown, value, sigma in ways:
            way = one.model if "steps" in one.model else f"{one.model}, one step"
            rows.append([way, axis, shown, float(value), float(sigma), float(value - shown) / float(sigma)])
    columns = {"way": "", "": "", "printed = true": ".3f", "found": ".3f", "sigma": ".3f", "off, sigmas": ".2f"}
    note = (
        "Minutes of arc. One step: unknown in the adjustment, attitudes with their weights. Two steps: an adjustment "
        "on control with the navigation 100 times looser, and then its orientations against the navigation's. The "
        "paper calls its angles standard errors (of the mounting); they are the angles themselves."
    )
    return Sheet("boresight", "Boresight (section 2.5)", columns, rows, note)


def improvement_sheet(found: Cases) -> Sheet:
    """What compensation makes of direct georeferencing."""
    before, after = printed.RMS["direct"], printed.RMS["compensated"]
    rows: list[list[Cell]] = [["printed", "", *_improvement(np.array(before), np.array(after))]]
    for rays, suffix in (("all rays", ""), ("adjacent pair", " pair")):
        first, last = found.of(f"direct{suffix}"), found.of(f"compensated{suffix}")
        rows.append(["ours", rays, *_improvement(first.rms, last.rms)])
    columns = {"": "", "rays": "", "plane before": ".3f", "after": ".3f", "better by": ".2%"}
    columns |= {"height before": ".3f", "after ": ".3f", "better by ": ".2%"}
    note = (
        f"m. Of the printed residuals the arithmetic is 46.38 % where the paper has {printed.IMPROVEMENT[0]:.2%}. What "
        "is left after compensation is the noise of the navigation: a pair has a base of 73 m, so that an attitude off "
        "by 0.015° is 1.3 m in height, and ten rays from two strips have a tenth of that. The printed figures "
        "lie nearer to those of a pair."
    )
    return Sheet("improvement", "Direct georeferencing after compensation (section 2.5)", columns, rows, note)


def mapping_sheet(found: Cases) -> Sheet:
    """Whether it is good enough for maps at 1:500."""
    rows: list[list[Cell]] = []
    for case in found.cases:
        shown = (None, None) if case.printed is None else (float(np.hypot(*case.printed[:2])), case.printed[2])
        rows.append([case.title, *shown, case.plane, float(case.rms[2]), "yes" if is_for_mapping(case) else "no"])
    columns = {"case": "", "printed plane": ".3f", "printed height": ".3f", "plane": ".3f", "height": ".3f"}
    columns["within"] = ""
    plane, height = printed.WITH_CONTROL
    note = (
        f"m. The paper: with control better than {plane} m in plan and {height} m in height, far better than CH/Z "
        "3003-2010 and GB/T 23236-2009 ask for maps at 1:500. It does not quote their limits, and so none are quoted "
        "here: within says whether ours keep to the paper's own figures."
    )
    return Sheet("mapping", "Maps at 1:500 (section 2.4)", columns, rows, note)


def is_for_mapping(case: Case) -> bool:
    """Whether a case keeps to what the paper has with control."""
    return case.plane < printed.WITH_CONTROL[0] and float(case.rms[2]) < printed.WITH_CONTROL[1]


def trials_sheet(found: Trials) -> Sheet:
    """Errors against what the adjustments say of them."""
    normalised = found.normalised
    rows: list[list[Cell]] = [
        [name, float(values.mean()), float(values.std(ddof=1)), float(np.mean(np.abs(values) < 1.96))]
        for name, values in zip(NAMES, normalised.T, strict=True)
    ]
    low, high = found.bounds()
    columns = {"parameter": "", "mean": ".2f", "standard deviation": ".2f", "within 1.96": ".0%"}
    note = (
        f"Errors over their standard deviations, of {len(normalised)} blocks with other noise. The sum of all squares, "
        f"with correlations, is {np.sum(found.squares):.1f}; chi-square with {found.degrees_of_freedom} degrees of "
        f"freedom lies between {low:.1f} and {high:.1f} with 99 %. Mean sigma0 {found.sigma0.mean():.4f}."
    )
    return Sheet("trials", "Are the standard deviations true?", columns, rows, note)


def _improvement(before: np.ndarray, after: np.ndarray) -> list[Cell]:
    planes = float(np.hypot(*before[:2])), float(np.hypot(*after[:2]))
    heights = float(before[2]), float(after[2])
    return [*planes, 1.0 - planes[1] / planes[0], *heights, 1.0 - heights[1] / heights[0]]


def _joined(interior: printed.Interior) -> str:
    return " ".join(f"{value:.4f}" for value in interior)
