"""Flight logs of Litchi and of Flight Reader: positions, angles of the camera, times, and what is refused.

Held against: the header that Litchi writes (LITCHI_HEADER, as published tools write it for Litchi's readers; heights
above the take-off, raw angles in tenths of a degree, by several of these readers), and Flight Reader's field
descriptions (PhantomHelp forum, topic 10579) with the columns that published readers of its CSV take. The pixel of a
ground point is computed in NumPy and SciPy from DJI's convention: Rz(yaw) Ry(pitch) Rx(roll) from level and true north.
"""

from __future__ import annotations

import calendar
import pathlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import FrameCamera
from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, undulation, with_usual_errors
from jaxgeo.io.acquisitions.detect import form_of

LITCHI_HEADER = (
    "latitude,longitude,altitude(m),ultrasonicHeight(m),speed(mps),distance(m),max_altitude(m),max_ascent(m),"
    "max_speed(mps),max_distance(m),time(millisecond),datetime(utc),datetime(local),satellites,pressure(Pa),"
    "temperature(F),voltage(v),home_latitude,home_longitude,velocityX(mps),velocityY(mps),velocityZ(mps),pitch(deg),"
    "roll(deg),yaw(deg),powerlevel,isflying,istakingphoto,remainPowerPercent,remainLifePercent,currentCurrent,"
    "currentElectricity,currentVoltage,batteryTemperature,dischargeCount,flightmode,isMotorsOn,isTakingVideo,"
    "Rc_elevator,Rc_aileron,Rc_throttle,Rc_rudder,Rc_gyro,timestamp,Battery_Cell1,Battery_Cell2,Battery_Cell3,"
    "Battery_Cell4,Battery_Cell5,Battery_Cell6,Dronetype,AppVersion,Planename,FlyControllerSerialNumber,"
    "RemoteSerialNumber,BatterySerialNumber,CENTER_BATTERY.productDate,CENTER_BATTERY.serialNo,"
    "CENTER_BATTERY.fullCapacity,CENTER_BATTERY.productDateRaw,pitchRaw,rollRaw,yawRaw,gimbalPitchRaw,gimbalRollRaw,"
    "gimbalYawRaw,flyState,altitudeRaw,speedRaw,distanceRaw"
)
LITCHI = {
    "latitude": "36.3",
    "longitude": "-84.2",
    "altitude(m)": "300.0",
    "time(millisecond)": "1500",
    "datetime(utc)": "2021-05-04 10:20:31.250",
    "datetime(local)": "2021-05-04 06:20:31.250",
    "istakingphoto": "0",
    "gimbalPitchRaw": "-600",
    "gimbalRollRaw": "20",
    "gimbalYawRaw": "305",
}
READER_HEADER = (
    "CUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime,OSD.flyTime [s],OSD.latitude,OSD.longitude,"
    "OSD.height [ft],OSD.heightMax [ft],OSD.vpsHeight [ft],OSD.altitude [ft],OSD.hSpeed [MPH],OSD.pitch,OSD.roll,"
    "OSD.yaw,OSD.yaw [360],OSD.flycState,OSD.gpsNum,OSD.gpsLevel,GIMBAL.mode,GIMBAL.pitch,GIMBAL.roll,GIMBAL.yaw,"
    "GIMBAL.yaw [360],CAMERA.isPhoto,CAMERA.isVideo"
)
READER = {
    "CUSTOM.date [local]": "5/4/2021",
    "CUSTOM.updateTime [local]": "6:20:31.25 AM",
    "OSD.flyTime": "0m 12.5s",
    "OSD.flyTime [s]": "12.5",
    "OSD.latitude": "36.3",
    "OSD.longitude": "-84.2",
    "OSD.height [ft]": "984.252",
    "OSD.altitude [ft]": "2952.756",
    "OSD.yaw": "28",
    "OSD.gpsLevel": "5",
    "GIMBAL.pitch": "-60",
    "GIMBAL.roll": "2",
    "GIMBAL.yaw": "30.5",
    "GIMBAL.yaw [360]": "30.5",
    "CAMERA.isPhoto": "False",
}
TAKEOFF = 600.0  # m above the ellipsoid
FOCAL, WIDTH, HEIGHT = 2600.0, 3840, 2160


def table(header: str, usual: dict[str, str], changes: tuple[dict[str, str], ...]) -> str:
    names = header.split(",")
    rows = [",".join((usual | change).get(name, "") for name in names) for change in changes or ({},)]
    return "\n".join([header, *rows, ""])


def litchi(*changes: dict[str, str]) -> str:
    return table(LITCHI_HEADER, LITCHI, changes)


def reader(*changes: dict[str, str]) -> str:
    return "sep=,\n" + table(READER_HEADER, READER, changes)


@pytest.fixture
def log(tmp_path: pathlib.Path) -> Callable[..., Any]:
    def read(text: str, **how: Any) -> Any:
        path = tmp_path / "log.txt"
        path.write_text(text, encoding="utf-8")
        return read_acquisition(path, **how)

    return read


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


@pytest.mark.parametrize("text", [litchi(), reader()], ids=["Litchi", "Flight Reader"])
def test_a_ground_point_is_seen_where_the_gimbal_points_the_camera(log, text: str) -> None:
    camera = FrameCamera.from_pixels(focal_px=FOCAL, width=WIDTH, height=HEIGHT)
    found = log(text, takeoff_height=TAKEOFF, cameras=camera)
    sensor, shot, _ = found.exposure(0)
    R_ned_from_gimbal = Rotation.from_euler("ZYX", [30.5, -60.0, 2.0], degrees=True).as_matrix()
    ahead, right, down = R_ned_from_gimbal.T @ np.array([140.0, 110.0, 300.0])  # a point north, east and below
    expected = [(WIDTH - 1) / 2 + FOCAL * right / ahead, (HEIGHT - 1) / 2 + FOCAL * down / ahead]
    assert 0.0 < expected[0] < WIDTH
    assert 0.0 < expected[1] < HEIGHT
    lat, lon = np.radians([36.3, -84.2])
    axes = np.array([
        [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], [-np.sin(lon), np.cos(lon), 0.0],
        [-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat)],
    ])  # fmt: skip
    here = np.array(pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(-84.2, 36.3, TAKEOFF + 300.0))
    there = here + np.array([140.0, 110.0, 300.0]) @ axes
    np.testing.assert_allclose(projected(sensor, shot, there), expected, atol=0.01)  # pixels; 984.252 feet


def test_files_are_told_by_their_columns(tmp_path: pathlib.Path) -> None:
    for text, form in ((litchi(), "flight log of Litchi"), (reader(), "flight log of Flight Reader"),
                       (reader().removeprefix("sep=,\n"), "flight log of Flight Reader")):  # fmt: skip
        (tmp_path / "a.csv").write_text(text, encoding="utf-8")
        assert form_of(tmp_path / "a.csv").name == form


def test_times_and_photos(log) -> None:
    found = log(litchi({}, {"datetime(utc)": "2021-05-04 10:20:31.5", "istakingphoto": "1"}), takeoff_height=TAKEOFF)
    stamp = calendar.timegm((2021, 5, 4, 10, 20, 31))
    assert found.shots.time.tolist() == [stamp + 0.25, stamp + 0.5]
    assert found.time_is_utc
    assert found.facts["photos"] == "1 (1)"
    found = log(reader({}, {"OSD.flyTime [s]": "12.6", "CAMERA.isPhoto": "True"}), takeoff_height=TAKEOFF)
    assert found.shots.time.tolist() == [12.5, 12.6]
    assert not found.time_is_utc
    assert any("OSD.flyTime" in one for one in found.assumed)
    assert found.facts["photos"] == "1 (1)"
    utc = reader({"CUSTOM.date [local]": "2021-05-04", "CUSTOM.updateTime [local]": "10:20:31.25"})
    found = log(utc.replace("[local]", "[UTC]"), takeoff_height=TAKEOFF)
    assert found.shots.time.tolist() == [stamp + 0.25]
    assert found.time_is_utc


def test_an_unknown_time_is_told_and_the_order_of_records_is_free(log) -> None:
    rows = [{"datetime(utc)": f"2021-05-04 10:20:3{k}.000", "latitude": f"36.{k + 1}"} for k in range(3)]
    found = log(litchi(*rows[::-1]), takeoff_height=TAKEOFF, times=["00:00:00,500"])
    assert np.rad2deg(found.shots.pose.position.lat) == pytest.approx([36.15], abs=1e-9)
    found = log(litchi(rows[0], rows[1] | {"datetime(utc)": "4 May"}, rows[2]), takeoff_height=TAKEOFF)
    assert any("Times are unknown in 1 of 3 records (the first is row 3)" in one for one in found.assumed)
    assert not np.any(found.shots.time)


def test_altitudes_of_flight_reader_are_above_the_datum_of_the_caller(log) -> None:
    found = log(reader(), height_datum="EPSG:5773")
    expected = 2952.756 * 0.3048 + float(undulation(36.3, -84.2))
    assert found.shots.pose.position.height[0] == pytest.approx(expected, abs=2e-3)  # m
    found = log(reader().replace("[ft]", "[m]"), height_datum="ellipsoid")
    assert found.shots.pose.position.height[0] == 2952.756
    with pytest.raises(UnstatedDatum, match="the first is 900 m, 300 m above the take-off"):
        log(reader())


def test_records_without_a_fix_or_angles_are_left_out_and_said(log) -> None:
    zeros = {"gimbalPitchRaw": "0", "gimbalRollRaw": "0", "gimbalYawRaw": "0"}
    found = log(litchi({"latitude": "0", "longitude": "0"}, zeros, {}), takeoff_height=TAKEOFF)
    assert found.names.tolist() == ["2"]
    told = " ".join(found.assumed)
    assert "position unknown" in told
    assert "camera angles unknown" in told
    assert log(reader({"OSD.gpsLevel": "0"}, {}), height_datum=0.0).names.tolist() == ["1"]


def test_the_gimbals_angles_err_as_those_of_a_drone(log) -> None:
    for text in (litchi(), reader()):
        found = with_usual_errors(log(text, takeoff_height=TAKEOFF))
        sigma = {type(one).__name__: np.rad2deg(np.asarray(one.sigma)[0]) for one in found.sources}
        np.testing.assert_allclose(sigma["Attitude"], [1.0, 0.5, 0.5])


def test_a_take_off_is_above_the_datum_that_is_given(log) -> None:
    """Above mean sea level, the undulation of EGM96 is added; above the ellipsoid and a number, that number."""
    ellipsoidal = log(litchi(), takeoff_height=300.0).shots.pose.position
    lat, lon, height = (np.asarray(one) for one in ellipsoidal.to_degrees())
    shifts = {"ellipsoid": 0.0, 12.5: 12.5, "EPSG:5773": undulation(lat, lon)}
    for datum, shift in shifts.items():
        found = log(litchi(), takeoff_height=300.0, height_datum=datum)
        np.testing.assert_allclose(found.shots.pose.position.height, height + shift, atol=1e-6)
    assert any("take-off at 300 m above EPSG:5773" in one for one in found.assumed)


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "no take-off": (litchi(), {}, "its only heights are above the take-off: give takeoff_height="),
    "datum": (litchi(), {"height_datum": "EPSG:5773"}, "takeoff_height=.*above height_datum='EPSG:5773'"),
    "no number": (litchi({"gimbalPitchRaw": "down"}), {"takeoff_height": 0.0}, "row 2, column gimbalPitchRaw: 'down'"),
    "range": (litchi({"gimbalPitchRaw": "-6000"}), {"takeoff_height": 0.0}, "row 2: pitch -600 is outside"),
    "unit": (litchi().replace("altitude(m)", "altitude(rods)"), {"takeoff_height": 0.0}, "must be feet or meters"),
    "no yaw": (litchi().replace("gimbalYawRaw", "x"), {"takeoff_height": 0.0}, "no column gimbalyawraw"),
    "cut": (litchi() + "36.3,-84.2,30", {"takeoff_height": 0.0}, "row 3: 3 cells.*; the file ends within the row"),
    "two logs": (litchi() + litchi(), {"takeoff_height": 0.0}, "row 3: the header again: the file is several tables"),
    "minus": (
        litchi({"longitude": "\u221284.2"}),
        {"takeoff_height": 0.0},
        "its sign is the character U.2212; write -",
    ),
    "no angles": (
        "latitude,longitude,altitude(m),istakingphoto\n36.3,-84.2,300,1\n",
        {"takeoff_height": 0.0},
        "no column gimbalyawraw",
    ),
    "no gimbal": (reader().replace("GIMBAL.", "G."), {"height_datum": 0.0}, "no column gimbal.yaw"),
    "latitude": (reader({"OSD.latitude": "136.3"}), {"height_datum": 0.0}, "lat 136.3 is outside"),
    "no fix": (reader({"OSD.latitude": "", "OSD.longitude": ""}), {"height_datum": 0.0}, "no record has a position"),
    "named camera": (reader(), {"height_datum": 0.0, "camera": "X5"}, "the file names no cameras"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_logs_that_do_not_serve_are_refused_in_a_line(log, case: str) -> None:
    text, how, words = REFUSED[case]
    with pytest.raises(TableError, match=words) as refusal:
        log(text, **how)
    assert "\n" not in str(refusal.value)
