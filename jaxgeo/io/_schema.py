"""Schema of scene files: fields with units and ranges."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from jaxgeo.sensor.camera import LONGEST, PITCHES


class Unit(str):
    """The unit of a value, or its expected form, for messages."""

    __slots__ = ()


_strict = Field(strict=True)
Coefficient = Annotated[float, _strict, Unit("1")]
Angle = Annotated[float, Field(strict=True, ge=-360.0, le=360.0), Unit("deg")]
SmallAngle = Annotated[float, Field(strict=True, ge=-90.0, le=90.0), Unit("deg")]
HalfTurn = Annotated[float, Field(strict=True, ge=-180.0, le=180.0), Unit("deg")]
Millimetres = Annotated[float, Field(strict=True, gt=0.0, le=1e3 * LONGEST), Unit("mm")]
Micrometres = Annotated[float, Field(strict=True, ge=1e6 * PITCHES[0], le=1e6 * PITCHES[1]), Unit("um")]
Pixels = Annotated[float, Field(strict=True, gt=0.0), Unit("pixels")]
OnMap = Annotated[float, Field(strict=True, ge=-1e8, le=1e8), Unit("m")]
_Pixels = Annotated[float, Field(strict=True, gt=0.0)]
PixelsOfAxes = Annotated[
    _Pixels | Annotated[list[_Pixels], Field(min_length=2, max_length=2)],
    Unit("pixels, or a list: along columns, along rows"),
]
Count = Annotated[int, Field(strict=True, gt=0, le=10_000_000), Unit("whole pixels")]
Seconds = Annotated[float, _strict, Unit("s")]
Height = Annotated[float, Field(strict=True, ge=-2000.0, le=2_000_000.0), Unit("m")]
Hectopascals = Annotated[float, Field(strict=True, ge=100.0, le=1200.0), Unit("hPa")]
Celsius = Annotated[float, Field(strict=True, ge=-100.0, le=70.0), Unit("degrees Celsius")]
HeightInAir = Annotated[float, Field(strict=True, ge=-500.0, le=15_000.0), Unit("m above mean sea level")]
Undulation = Annotated[float, Field(strict=True, ge=-120.0, le=120.0), Unit("m")]
_Number = Annotated[float, _strict]
_Sigma = Annotated[float, Field(strict=True, ge=0.0, le=1e6)]
_SIGMA = "a standard deviation"
Sigma = Annotated[_Sigma, Unit(f"{_SIGMA} in m")]
SigmaPixels = Annotated[_Sigma, Unit(f"{_SIGMA} in pixels")]
Length = Annotated[float, Field(strict=True, gt=0.0, le=1e6), Unit("m")]
Triple = Annotated[list[_Number], Field(min_length=3, max_length=3), Unit("a list of 3 numbers in m")]
PairMillimetres = Annotated[list[_Number], Field(min_length=2, max_length=2), Unit("a list of 2 numbers in mm")]
PairPixels = Annotated[list[_Number], Field(min_length=2, max_length=2), Unit("a list of 2 numbers in pixels")]
Datum = Annotated[
    Annotated[str, _strict] | _Number,
    Unit('a vertical datum: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), or an undulation in m'),
]
Text = Annotated[str, _strict, Unit("a text")]


_Two = Annotated[list[_Sigma], Field(min_length=2, max_length=2)]
_Numbers = Annotated[list[_Number], Field(min_length=2, max_length=100_000)]
_Three = Annotated[list[_Sigma], Field(min_length=3, max_length=3)]
_Some = Annotated[list[_Sigma], Field(min_length=1)]
SigmasNed = Annotated[_Sigma | _Three, Unit(f"{_SIGMA} in m, or a list: north, east, down")]
SigmasAttitude = Annotated[_Sigma | _Three, Unit(f"{_SIGMA} in deg, or a list: heading, pitch, roll")]
SigmasReadings = Annotated[_Sigma | _Some, Unit(f"{_SIGMA} in deg, or a list: one for each reading of the gimbal")]
SigmasLever = Annotated[_Sigma | _Three, Unit(f"{_SIGMA} in m, or a list: forward, right, down")]
SigmasPixel = Annotated[_Sigma | _Two, Unit(f"{_SIGMA} in pixels, or a list: column, row")]

_Limits = Annotated[list[Annotated[float, Field(strict=True, ge=-720.0, le=720.0)]], Field(min_length=2, max_length=2)]
Limits = Annotated[
    list[_Limits], Field(min_length=1), Unit("a list of [least, largest] in deg, one for each reading of the gimbal")
]

# Reading names of each kind of gimbal, from base to head; keys and columns are these with _deg.
READINGS = {
    "two_axis": ("outer", "inner"),
    "mirror": ("depression", "azimuth"),
    "level": ("yaw", "pitch", "roll"),
    "three_axis": ("yaw", "pitch", "roll"),
    "fixed": (),
}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PartTable(_Table):
    """A part of a mixture of normal distributions."""

    share: Annotated[_Number, Unit("the share of a part, such as 0.9")]
    sigma: Annotated[_Sigma, Unit(_SIGMA)]
    mean: Annotated[_Number, Unit("the mean of a part")] = 0.0


class StatedTable(_Table):
    """An error as a data sheet states it, or one that is not normal; numbers are in the unit of the key."""

    sigma: Annotated[_Sigma | _Some, Unit(f"{_SIGMA}, or a list: one for each")] | None = None
    plus_minus: Annotated[_Sigma | _Some, Unit("a half-width, or a list: one for each")] | None = None
    rms: Annotated[_Sigma, Unit("a root mean square error")] | None = None
    ce: Annotated[_Sigma, Unit("a circular error in m")] | None = None
    le: Annotated[_Sigma, Unit("a linear error in m")] | None = None
    se: Annotated[_Sigma, Unit("a spherical error in m")] | None = None
    distribution: Annotated[str, _strict, Unit("a text")] | None = None
    sigmas: Annotated[_Number, Unit("how many sigmas plus_minus is, such as 2")] | None = None
    coverage: Annotated[_Number, Unit("the probability of plus_minus, such as 0.95")] | None = None
    probability: Annotated[_Number, Unit("the probability of ce, le or se, such as 0.9")] | None = None
    axes: Annotated[int, _strict, Unit("1, 2 or 3: of how many axes rms is")] | None = None
    df: Annotated[_Number, Unit("degrees of freedom")] | None = None
    share: Annotated[_Number, Unit("the share of outliers")] | None = None
    times: Annotated[_Number, Unit("the sigma of outliers in sigmas of the others")] | None = None
    low: Annotated[_Number, Unit("the lower limit in sigmas before the cut, such as -2")] | None = None
    high: Annotated[_Number, Unit("the upper limit in sigmas before the cut, such as 2")] | None = None
    residuals: Annotated[_Numbers, Unit("a list of measured errors")] | None = None
    probabilities: Annotated[_Numbers, Unit("a list of probabilities from 0 to 1")] | None = None
    values: Annotated[_Numbers, Unit("a list of errors, one for each of the probabilities")] | None = None
    parts: Annotated[list[PartTable], Field(min_length=1, max_length=100)] | None = None
    raster: Annotated[str, Field(strict=True, min_length=1), Unit("the path of a raster")] | None = None
    scale: Annotated[float, Field(strict=True, gt=0.0, le=1e6), Unit("a factor on the raster's values")] | None = None


class DistortionTable(_Table):
    """Brown-Conrady coefficients in the formula of OpenCV, for normalised image coordinates."""

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    k4: Coefficient = 0.0
    k5: Coefficient = 0.0
    k6: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0


class CameraTable(_Table):
    """A frame camera, in metric terms (focal_length_mm, pixel_pitch_um) or in pixels (focal_px)."""

    width: Count
    height: Count
    focal_length_mm: Millimetres | None = None
    pixel_pitch_um: Micrometres | None = None
    principal_point_mm: PairMillimetres | None = None
    focal_px: PixelsOfAxes | None = None
    principal_px: PairPixels | None = None
    distortion: DistortionTable | None = None

    @model_validator(mode="after")
    def _one_way_of_saying_it(self) -> CameraTable:
        metric = [self.focal_length_mm, self.pixel_pitch_um]
        if self.focal_px is not None:
            if any(value is not None for value in [*metric, self.principal_point_mm]):
                raise ValueError("give either focal_px (pixels) or focal_length_mm and pixel_pitch_um, not both")
        elif any(value is None for value in metric):
            raise ValueError("give focal_length_mm (mm) and pixel_pitch_um (um), or focal_px (pixels)")
        elif self.principal_px is not None:
            raise ValueError("principal_px (pixels) goes with focal_px; here it is principal_point_mm (mm)")
        return self


class CameraFile(BaseModel):
    """A file of which only the table [camera] is used."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    camera: CameraTable


class GimbalTable(_Table):
    """The kind of gimbal, and its readings; these may come from a table of shots instead."""

    kind: Literal["two_axis", "mirror", "level", "three_axis", "fixed"]
    outer_deg: Angle | None = None
    inner_deg: Angle | None = None
    depression_deg: Angle | None = None
    azimuth_deg: Angle | None = None
    yaw_deg: Angle | None = None
    pitch_deg: Angle | None = None
    roll_deg: Angle | None = None
    limits_deg: Limits | None = None

    @property
    def readings(self) -> dict[str, float]:
        """The readings given, by name, deg."""
        values = {name: getattr(self, f"{name}_deg") for names in READINGS.values() for name in names}
        return {name: value for name, value in values.items() if value is not None}

    @model_validator(mode="after")
    def _readings_of_its_kind(self) -> GimbalTable:
        wanted, given = READINGS[self.kind], self.readings
        if self.limits_deg is not None and len(self.limits_deg) != len(wanted):
            raise ValueError(
                f"limits_deg has one pair for each reading of a gimbal of kind {self.kind!r}, {len(wanted)}; got "
                f"{len(self.limits_deg)}"
            )
        if given and set(given) != set(wanted):
            keys = ", ".join(f"{name}_deg" for name in wanted) or "none"
            got = ", ".join(f"{name}_deg" for name in given)
            raise ValueError(f"the readings of a gimbal of kind {self.kind!r} are {keys} (deg); got {got}")
        return self


class MountTable(_Table):
    """Mounting of gimbal and camera: rotations of the gimbal's base in the body, the camera's position, lever arms."""

    base_heading_deg: Angle = 0.0
    base_pitch_deg: Angle = 0.0
    base_roll_deg: Angle = 0.0
    camera_looks: Literal["down", "forward"] | None = None
    lever_body_m: Triple = [0.0, 0.0, 0.0]
    lever_head_m: Triple = [0.0, 0.0, 0.0]


class PoseTable(_Table):
    """Position and attitude of the aircraft.

    The position is latitude and longitude, or easting and northing in `map_crs`. The attitude is true heading, pitch
    and roll, or omega, phi and kappa in the grid of `map_crs`.
    """

    lat_deg: SmallAngle | None = None
    lon_deg: Angle | None = None
    easting_m: OnMap | None = None
    northing_m: OnMap | None = None
    height_m: Height
    height_datum: Datum
    heading_deg: Angle | None = None
    pitch_deg: SmallAngle | None = None
    roll_deg: HalfTurn | None = None
    omega_deg: Angle | None = None
    phi_deg: Angle | None = None
    kappa_deg: Angle | None = None
    map_crs: Text | None = None
    time_s: Seconds = 0.0

    @property
    def is_on_map(self) -> bool:
        """Whether the position is in `map_crs`."""
        return self.easting_m is not None

    @model_validator(mode="after")
    def _one_position(self) -> PoseTable:
        angles, lengths = [self.lat_deg, self.lon_deg], [self.easting_m, self.northing_m]
        one = (None not in angles and lengths == [None] * 2) or (None not in lengths and angles == [None] * 2)
        if not one or (self.is_on_map and self.map_crs is None):
            raise ValueError("the position is lat_deg and lon_deg (deg), or easting_m and northing_m (m) with map_crs")
        return self

    @model_validator(mode="after")
    def _one_attitude(self) -> PoseTable:
        body = [self.heading_deg, self.pitch_deg, self.roll_deg]
        grid = [self.omega_deg, self.phi_deg, self.kappa_deg]
        complete = (None not in body and grid == [None] * 3) or (None not in grid and body == [None] * 3)
        if not complete or (grid[0] is not None) > (self.map_crs is not None):
            raise ValueError(
                "the attitude is heading_deg, pitch_deg and roll_deg (deg), all three; "
                "or omega_deg, phi_deg and kappa_deg (deg) with map_crs"
            )
        if self.map_crs is not None and grid[0] is None and not self.is_on_map:
            raise ValueError("map_crs goes with easting_m and northing_m (m), or with omega_deg, phi_deg and kappa_deg")
        return self


class ShotsTable(_Table):
    """Properties of a table of shots that are not in its columns: the datum of its heights."""

    height_datum: Datum


class AirTable(_Table):
    """Atmosphere for refraction: the standard atmosphere, or measurements at a height."""

    pressure_hpa: Hectopascals | None = None
    temperature_c: Celsius | None = None
    height_msl_m: HeightInAir | None = None
    sea_level_m: Undulation | None = None

    @model_validator(mode="after")
    def _a_whole_measurement(self) -> AirTable:
        measured = [self.pressure_hpa, self.temperature_c, self.height_msl_m]
        if None in measured and measured != [None] * 3:
            raise ValueError(
                "a measurement is pressure_hpa (hPa), temperature_c (degrees Celsius) and height_msl_m (m), all three; "
                "leave all out for the standard atmosphere"
            )
        return self


class ErrorsTable(_Table):
    """Independent errors of a scene, each optional: standard deviations, or tables of what a data sheet states."""

    position_m: SigmasNed | StatedTable | None = None
    attitude_deg: SigmasAttitude | StatedTable | None = None
    gimbal_deg: SigmasReadings | StatedTable | None = None
    gimbal_mounting_deg: SigmasReadings | StatedTable | None = None
    boresight_deg: SigmasAttitude | StatedTable | None = None
    lever_body_m: SigmasLever | StatedTable | None = None
    focal_px: SigmaPixels | StatedTable | None = None
    principal_px: SigmasPixel | StatedTable | None = None
    pixel_px: SigmasPixel | StatedTable | None = None
    terrain_m: Sigma | StatedTable | None = None
    terrain_correlation_m: Length | None = None

    @model_validator(mode="after")
    def _something(self) -> ErrorsTable:
        if self.terrain_correlation_m is not None and self.terrain_m is None:
            raise ValueError("terrain_correlation_m (m) goes with terrain_m (m), the sigma of the heights")
        if all(value is None for value in self.model_dump().values()):
            raise ValueError(f"an empty table says nothing; known here: {', '.join(type(self).model_fields)}")
        return self


class SceneTable(_Table):
    """A whole scene file: `pose` for one shot, `shots` if poses and readings come from a table of shots."""

    title: Text = ""
    camera: CameraTable
    gimbal: GimbalTable = GimbalTable(kind="fixed")
    mount: MountTable = MountTable()
    pose: PoseTable | None = None
    shots: ShotsTable | None = None
    air: AirTable | None = None
    errors: ErrorsTable | None = None
