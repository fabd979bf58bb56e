"""Control points of `jaxgeo adjust`: options, reading, and results."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import typer

from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import checked_sigma
from jaxgeo.cli._inputs import as_datum, numbers_in
from jaxgeo.cli._options import OptionGroup
from jaxgeo.cli._screen import print_note

if TYPE_CHECKING:
    from jaxgeo.io import SurveyedPixels
    from jaxgeo.ties import Control, ControlResiduals, Views

USUAL_SURVEY, USUAL_PIXEL = 0.05, 1.0  # m, pixels
COLUMNS = {
    "point": ("point", ""),
    "role": ("role", ""),
    "images": ("images", "d"),
    "east_m": ("east, m", ".3f"),
    "north_m": ("north, m", ".3f"),
    "up_m": ("up, m", ".3f"),
    "sigma_east_m": ("sigma E", ".3f"),
    "sigma_north_m": ("sigma N", ".3f"),
    "sigma_up_m": ("sigma U", ".3f"),
    "px": ("px", ".2f"),
    "sigma_px": ("sigma px", ".2f"),
}
CAPTION = (
    "east, north, up: place by the adjusted images less the surveyed one, with its predicted sigma (of check points in "
    "one image unknown); px: RMS residual of its pixels per axis, with its predicted sigma"
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ControlOptions(OptionGroup):
    """Surveyed points, and how accurate they are."""

    panel: ClassVar[str | None] = "Control points"

    gcp: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--gcp",
            metavar="FILE",
            help="Surveyed points with their pixels: gcp_list.txt of OpenDroneMap, or CSV (image, point, u, v, "
            "lat_deg, lon_deg, height_m).",
        ),
    ] = None
    gcp_datum: Annotated[
        str | None,
        typer.Option(
            "--gcp-datum",
            metavar="DATUM",
            help='Vertical datum of --gcp: "EPSG:5773", "ellipsoid", an undulation in m.',
        ),
    ] = None
    gcp_sigma: Annotated[
        str | None,
        typer.Option(
            "--gcp-sigma",
            metavar="SIGMA",
            help="Standard deviation of the survey, m: one number, or EAST,NORTH,UP (default 0.05).",
        ),
    ] = None
    pixel_sigma: Annotated[
        float | None,
        typer.Option(
            "--pixel-sigma", metavar="SIGMA", help="Standard deviation of the pixels of --gcp, px (default 1)."
        ),
    ] = None
    pixel_origin: Annotated[
        str,
        typer.Option(
            "--pixel-origin", metavar="ORIGIN", help="Pixel (0, 0) of --gcp: the centre or corner of the first."
        ),
    ] = "centre"
    check: Annotated[
        list[str] | None,
        typer.Option(
            "--check",
            metavar="POINT",
            help="Point of --gcp to hold back as a check of the result (repeatable); so are those that the file marks "
            "as such.",
        ),
    ] = None

    def check_options(self) -> None:
        """Raises `UserError` for options that need --gcp, and for wrong values."""
        if self.gcp is None:
            given = {"--gcp-datum": self.gcp_datum, "--gcp-sigma": self.gcp_sigma, "--pixel-sigma": self.pixel_sigma}
            for option, value in (given | {"--check": self.check or None}).items():
                if value is not None:
                    raise UserError(f"{option} is for control points; give --gcp FILE too.")
            return
        if self.gcp_datum is None:
            raise UserError(
                f"--gcp {self.gcp}: state the vertical datum of its heights with --gcp-datum: EPSG:5773, ellipsoid, "
                f"or an undulation in m."
            )
        if self.pixel_origin not in ("centre", "corner"):
            raise UserError(f"--pixel-origin {self.pixel_origin}: expected centre or corner.")
        for option, value in (("--gcp-sigma", self._survey), ("--pixel-sigma", self.pixel_sigma)):
            for one in np.atleast_1d([] if value is None else value):
                if checked_sigma(option, float(one)) == 0.0:
                    raise UserError(f"{option} {one:g}: must be above 0; nothing is measured without an error.")

    @property
    def files(self) -> list[pathlib.Path]:
        """The files named by the options."""
        return [] if self.gcp is None else [self.gcp]

    @property
    def _survey(self) -> list[float] | None:
        if self.gcp_sigma is None:
            return None
        found = numbers_in("--gcp-sigma", self.gcp_sigma, (1, 3), "one number in m, or EAST,NORTH,UP")
        return found * 3 if len(found) == 1 else found

    def read(self) -> SurveyedPixels | None:
        """The file. Raises `UserError`, and as its reader."""
        from jaxgeo.io import VerticalDatumError, read_check_points

        if self.gcp is None or self.gcp_datum is None:
            return None
        try:
            found = read_check_points(self.gcp, height_datum=as_datum(self.gcp_datum), pixel_origin=self.pixel_origin)
        except VerticalDatumError as error:
            raise UserError(f"{error}".replace("height_datum=", "--gcp-datum ")) from error
        for one in found.unread:
            print_note(f"{self.gcp}: {one}")
        return found

    def control(self, surveyed: SurveyedPixels, views: Views, assumed: list[str]) -> Control:
        """Control of these images. Assumptions are printed and appended. Raises `UserError` if it does not belong to
        them."""
        from jaxgeo.io import control_of
        from jaxgeo.ties import check_control

        survey, pixel = self._survey, self.pixel_sigma
        if surveyed.sigma_enu is None and survey is None:
            survey = [USUAL_SURVEY] * 3
            assumed.append(f"Survey sigma: {USUAL_SURVEY:g} m (default). (--gcp-sigma)")
            print_assumed(assumed[-1:])
        if surveyed.sigma_px is None and pixel is None:
            pixel = USUAL_PIXEL
            assumed.append(f"Pixel sigma: {USUAL_PIXEL:g} (default). (--pixel-sigma)")
            print_assumed(assumed[-1:])
        names = [str(name) for name in views.name]
        given = {"sigma_enu": survey or USUAL_SURVEY, "sigma_px": pixel or USUAL_PIXEL, "check": self.check or ()}
        try:
            found = control_of(surveyed, names, **given)
            check_control(views, found)
        except ValueError as error:
            words = f"{error}".replace("check point", "--check", 1) if f"{error}".startswith("check") else f"{error}"
            raise UserError(f"--gcp {self.gcp}: {words}") from error
        return found


def rows_of_points(residuals: ControlResiduals) -> list[dict[str, Any]]:
    """A row for each point, for tables and --json; None where unknown."""
    rows = []
    for k, name in enumerate(residuals.name.tolist()):
        own = residuals.point == name
        row: dict[str, Any] = {"point": name, "role": str(residuals.role[k]), "images": int(residuals.images[k])}
        for axis, label in enumerate(("east", "north", "up")):
            row[f"{label}_m"] = _known(residuals.enu[k, axis])
            row[f"sigma_{label}_m"] = _known(residuals.sigma_enu[k, axis])
        row["px"], row["sigma_px"] = (
            _known(np.sqrt(np.mean(x[own] ** 2))) if np.any(own) else None for x in (residuals.px, residuals.sigma_px)
        )
        pixels = zip(residuals.image[own], residuals.px[own], residuals.sigma_px[own], strict=True)
        row["pixels"] = [
            {"image": str(image), "px": [_known(x) for x in px], "sigma_px": [_known(x) for x in sigma]}
            for image, px, sigma in pixels
        ]
        rows.append(row)
    return rows


def _known(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
