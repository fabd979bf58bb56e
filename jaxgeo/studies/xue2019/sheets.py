"""Comparison tables of Xue et al. (2019): printed values and those obtained here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxgeo.studies.sheet import Cell, Sheet
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.cases import FIELD_GROUND, FIELD_IMAGE, Case, Cases
from jaxgeo.studies.xue2019.free_net import FreeNet
from jaxgeo.studies.xue2019.limits import Limits
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

# Effect of a focal length error alone on heights, m.
BY_FOCAL = (printed.CALIBRATED.f / printed.INTERIORS["Brown"].f - 1.0) * printed.HEIGHT


def block_sheet(block: Simulated) -> Sheet:
    """Flight and simulation parameters."""
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
        "maker's. xp and yp have y up (towards the image's top), x right. The true lens differs by up to 8 um in the "
        "corners and 0.3 um by a ripple of the chip, of which no model knows; it has no decentring, which could not "
        "be separated from boresight. The angles are those of the body against the camera (roll, pitch, heading)."
    )
    return Sheet("block", "The block (Tables 1 and 2)", {"": "", "printed": "", "simulated": ""}, rows, note)


def cases_sheet(found: Cases) -> Sheet:
    """All cases at check points."""
    rows: list[list[Cell]] = []
    for case in found.cases:
        shown = (None, None, None) if case.printed is None else case.printed
        ours = [float(value) for value in case.rms]
        rows.append([case.title, len(case.checks), *shown, *ours, case.remark])
    columns = {"case": "", "points": "d"}
    columns |= {f"printed {axis}": ".3f" for axis in "xyz"}
    columns |= dict.fromkeys("xyz", ".3f")
    columns["remark"] = ""
    note = (
        "Root mean square of found less surveyed, m; x east, y north, strips flown north and south. The paper does not "
        "say of which rays its direct georeferencing is: its numbers stand beside those of all rays and of a pair. By "
        f"itself the error of the focal length is {BY_FOCAL:.2f} m in height."
    )
    return Sheet("cases", "Residuals at check points (section 2, Table 3)", columns, rows, note)


def pairs_sheet(found: Cases, pairs: dict[str, np.ndarray]) -> Sheet:
    """Direct georeferencing from pairs, over draws of the noise, beside all rays and the print."""
    rows: list[list[Cell]] = []
    for name, draws in pairs.items():
        shown = printed.RMS[name]
        every = np.vstack([found.of(f"{name} pair").rms, draws])
        mean, spread = every.mean(axis=0), every.std(axis=0, ddof=1)
        rows += [
            [name, "printed", *shown, None],
            [name, "all rays", *map(float, found.of(name).rms), _off(found.of(name).rms, shown)],
            [name, f"adjacent pair, mean of {len(every)} draws", *map(float, mean), _off(mean, shown)],
            [name, "their standard deviation", *map(float, spread), None],
        ]
    columns = {"": "", "rays": "", **dict.fromkeys("xyz", ".3f"), "off the print": ".0%"}
    note = (
        "m. Off the print: root mean square over x, y, z of the differences from the printed numbers, each over the "
        "printed number. Draws differ in the noise of navigation, image points and survey."
    )
    return Sheet("pairs", "Of which rays direct georeferencing is (sections 2.2 and 2.5)", columns, rows, note)


def free_net_sheet(nets: Sequence[FreeNet]) -> Sheet:
    """Assumptions tested to explain the printed free network."""
    shown = printed.RMS["free net"]
    rows: list[list[Cell]] = [["printed", *shown, None, None, None, None, None, ""]]
    for net in nets:
        means = [float(value) for value in net.mean]
        rows.append([net.name, *map(float, net.rms), *means, _off(net.rms, shown), net.sigma0, net.assumption])
    columns = {"free net": "", **dict.fromkeys("xyz", ".3f"), **{f"mean {axis}": ".3f" for axis in "xyz"}}
    columns |= {"off the print": ".0%", "sigma0": ".2f", "assumption": ""}
    note = (
        "m, at the 21 surveyed points. Off the print as for pairs. A block whose strips share tie points evens out "
        "boresight and principal point, as strips flown to and fro are pulled to opposite sides: its plan is better "
        "than the print's by a factor of ten. Strips that share no points keep these errors. The shift to the south is "
        "what the printed row of compensated georeferencing has in y beyond the noise of a pair."
    )
    return Sheet("free_net", "The free network (section 2.3) under other assumptions", columns, rows, note)


def field_sheet(found: Cases, field: Sequence[Case]) -> Sheet:
    """Cases with control, by measurement noise."""
    rows: list[list[Cell]] = []
    for case in field:
        assert case.printed is not None
        rows += [
            [case.title, "printed", *case.printed],
            [case.title, "ours", *map(float, found.of(case.name).rms)],
            [case.title, "ours, more noise", *map(float, case.rms)],
        ]
    ground = " ".join(f"{sigma:.3f}" for sigma in SIGMA_GROUND)
    worse = " ".join(f"{sigma:.2f}" for sigma in FIELD_GROUND)
    note = (
        f"m, at 12 check points. Ours: image points of {SIGMA_IMAGE} px, targets surveyed to {ground} m. More noise: "
        f"{FIELD_IMAGE} px and {worse} m, of control and check points both, known to the adjustment."
    )
    columns = {"case": "", "noise": "", **dict.fromkeys("xyz", ".3f")}
    return Sheet("field", "With control, by the noise of measuring (Table 3)", columns, rows, note)


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
    """Improvement of direct georeferencing by compensation."""
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
        "by 0.015° is 1.3 m in height, and ten rays from two strips have a tenth of that."
    )
    return Sheet("improvement", "Direct georeferencing after compensation (section 2.5)", columns, rows, note)


def mapping_sheet(found: Cases, limits: Limits) -> Sheet:
    """Whether the accuracy meets a standard's limits for maps at 1:500."""
    rows: list[list[Cell]] = []
    for case in found.cases:
        ours = case.plane, float(case.rms[2])
        shown, verdict = (None, None), "–"
        if case.printed is not None:
            shown = float(np.hypot(*case.printed[:2])), case.printed[2]
            verdict = _yes(limits.hold(*shown))
        rows.append([case.title, *shown, verdict, *ours, _yes(limits.hold(*ours))])
    columns = {"case": "", "printed plane": ".3f", "printed height": ".3f", "printed within": ""}
    columns |= {"plane": ".3f", "height": ".3f", "within": ""}
    note = (
        f"m. Limits: {limits.plane:.3f} m in plan and {limits.height:.3f} m in height ({limits.source}). The paper "
        "refers to CH/Z 3003-2010 and GB/T 23236-2009 and quotes neither."
    )
    return Sheet("mapping", "Maps at 1:500 (section 2.4)", columns, rows, note)


def trials_sheet(found: Trials) -> Sheet:
    """Actual errors against the covariances of the adjustments."""
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


def _off(rms: np.ndarray, shown: Sequence[float]) -> float:
    """Root mean square of relative differences."""
    return float(np.sqrt(np.mean((np.asarray(rms) / np.asarray(shown) - 1.0) ** 2)))


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _joined(interior: printed.Interior) -> str:
    return " ".join(f"{value:.4f}" for value in interior)
