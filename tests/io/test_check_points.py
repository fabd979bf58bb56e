"""Files of check points, their images, and error models written as a scene's table.

Held against: `read_gcp_list` for the file of OpenDroneMap, and `read_scene` for the table [errors].
"""

from __future__ import annotations

import pathlib
import tomllib
from typing import Any

import equinox as eqx
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Gimbal
from jaxgeo.io import (
    ObservationBatch,
    Observations,
    SurveyedPixels,
    TableError,
    check_points_of,
    control_of,
    errors_table,
    read_check_points,
    read_gcp_list,
    write_errors,
)
from jaxgeo.io._schema import ErrorsTable
from jaxgeo.io.scene import SceneError
from jaxgeo.io.scene_errors import model_of_table
from jaxgeo.uncertainty import PerMeasurement, sources
from jaxgeo.uncertainty.datasheet import Stated
from jaxgeo.uncertainty.distributions import StudentT, Uniform
from tests.support.check_points import block
from tests.support.command_files import FILES

HEADER = "image,point,u,v,lat_deg,lon_deg,height_m"


def read(path: pathlib.Path, text: str) -> SurveyedPixels:
    path.write_text(text)
    return read_check_points(path, height_datum="ellipsoid")


def test_the_list_of_opendronemap_is_that_of_its_reader(tmp_path) -> None:
    path = tmp_path / "gcp_list.txt"
    FILES["gcp_list.txt"](path)
    found, other = read_check_points(path, height_datum=10.0), read_gcp_list(path, height_datum=10.0)
    assert found.point.tolist() == other.points.point.tolist() == [f"P{k}" for k in range(1, 7)]
    np.testing.assert_array_equal(found.uv, other.points.uv)
    np.testing.assert_array_equal(found.position.height, np.asarray(other.position.height))
    assert found.sigma_enu is found.sigma_px is found.flight is None


def test_both_forms_hold_the_same(tmp_path) -> None:
    for name in ("gcp_list.txt", "points.csv"):
        FILES[name](tmp_path / name)
    a, b = (read_check_points(tmp_path / name, height_datum="ellipsoid") for name in ("gcp_list.txt", "points.csv"))
    assert a.image.tolist() == b.image.tolist()
    np.testing.assert_allclose(a.uv, b.uv, atol=1e-12)  # px
    for name in ("lat", "lon"):
        np.testing.assert_allclose(getattr(a.position, name), getattr(b.position, name), atol=1e-14)  # rad


def test_sigmas_and_flights_of_a_table(tmp_path) -> None:
    header = f"{HEADER},sigma_east_m,sigma_north_m,sigma_up_m,sigma_u_px,sigma_v_px,flight"
    found = read(tmp_path / "a.csv", f"{header}\na,P,1,2,47,11,500,.1,.2,.3,.5,.7,day 1\n")
    assert found.sigma_enu is not None
    assert found.sigma_px is not None
    assert found.flight is not None
    assert (found.sigma_enu.tolist(), found.sigma_px.tolist()) == ([[0.1, 0.2, 0.3]], [[0.5, 0.7]])
    assert found.flight.tolist() == ["day 1"]
    same = read(tmp_path / "b.csv", f"{HEADER},sigma_px\na,P,1,2,47,11,500,0.6\n")
    assert same.sigma_px is not None
    assert same.sigma_px.tolist() == [[0.6, 0.6]]
    corner = read_check_points(tmp_path / "a.csv", height_datum="ellipsoid", pixel_origin="corner")
    assert corner.uv.tolist() == [[0.5, 1.5]]


def test_check_points_are_marked_by_role_or_prefix(tmp_path) -> None:
    """As OpenDroneMap's lists mark them: names that begin with CHK-."""
    table = read(tmp_path / "a.csv", f"{HEADER},role\na,P,1,2,47,11,5,control\na,Q,1,2,47,11,5,Check\n")
    assert table.is_check is not None
    assert table.is_check.tolist() == [False, True]
    path = tmp_path / "gcp_list.txt"
    path.write_text("EPSG:32632\n600000 5200000 9 1 2 a.jpg P\n600001 5200000 9 1 2 b.jpg CHK-1\n")
    listed = read_check_points(path, height_datum="ellipsoid")
    assert listed.is_check is not None
    assert listed.is_check.tolist() == [False, True]


def test_pixels_as_control_of_a_block(tmp_path) -> None:
    text = f"{HEADER},role\ntwo,P,1,2,47,11,5,control\none,P,3,4,47,11,5,control\none.JPG,Q,5,6,47,11.1,5,check\n"
    surveyed = read(tmp_path / "a.csv", text)
    control = control_of(surveyed, ["one.JPG", "two.JPG"], sigma_enu=[0.1, 0.1, 0.2], sigma_px=0.4)
    assert control.name.tolist() == ["P", "Q"]
    assert control.check == ("Q",)
    assert control.marks.image.tolist() == ["two.JPG", "one.JPG", "one.JPG"]
    assert control.sigma_enu.tolist() == [[0.1, 0.1, 0.2]] * 2
    assert np.rad2deg(control.position.lon).tolist() == pytest.approx([11.0, 11.1])
    other = text.replace("one,P,3,4,47,11,5", "one,P,3,4,47.001,11,5")
    with pytest.raises(TableError, match="point P has another position with its pixel in image one than before"):
        control_of(read(tmp_path / "b.csv", other), ["one.JPG", "two.JPG"], sigma_enu=0.1, sigma_px=0.4)
    with pytest.raises(TableError, match=r"image two of point P is not among the images: one\.JPG"):
        control_of(surveyed, ["one.JPG"], sigma_enu=0.1, sigma_px=0.4)


@pytest.mark.parametrize(
    "text, words",
    [
        (f"{HEADER},role\na,P,1,2,47,11,5,tie\n", r"row 2, column role: 'tie' is none of control, check"),
        (f"{HEADER},role\na,P,1,2,47,11,5,check\nb,P,1,2,47,11,5,control\n", r"row 3, .* P is a check point above"),
        (f"{HEADER}\n", r"no rows below the header"),
        (f"{HEADER}\na,P,1,2,47,11,nan\n", r"row 2, column height_m: unknown"),
        (f"{HEADER},sigma_px\na,P,1,2,47,11,5,0\n", r"row 2, column sigma_px: 0 is outside \[1e-09, .*\] pixels\."),
        (f"{HEADER},sigma_east_m\na,P,1,2,47,11,5,1\n", r"no column sigma_north_m, but sigma_east_m; give all of"),
        (f"{HEADER},sigma_px,sigma_u_px\na,P,1,2,47,11,5,1,1\n", r"columns sigma_px and sigma_u_px say the same"),
        (f"{HEADER}\na,P,1,2,47,11,5\na,P,1,3,47,11,5\n", r"rows 2 and 3: image a, point P: measured twice"),
        ("image,point,u,v\na,P,1,2\n", r"no column lat_deg"),
    ],
)
def test_mistakes_in_a_table(tmp_path, text: str, words: str) -> None:
    with pytest.raises(TableError, match=words):
        read(tmp_path / "a.csv", text)


def images(names: list[str]) -> Observations:
    """Images of these names, without reading files."""
    made, _, _ = block(flights=1, images=len(names), pixels=1)
    sources_ = (sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1),)
    sources_ += (sources.PixelMeasurement.from_pixels(column=2.0, row=2.0),)
    batch = ObservationBatch(made, sources_, np.arange(len(names)), is_one_camera=True)
    return Observations((batch,), [{"name": name} for name in names])


def test_pixels_find_their_images(tmp_path) -> None:
    observed = images(["one.JPG", "two.JPG"])
    surveyed = read(tmp_path / "a.csv", f"{HEADER}\ntwo,P,1,2,47,11,5\none.JPG,Q,3,4,47,11,5\nTWO,Q,5,6,47,11,5\n")
    points, errors, rows = check_points_of(observed, surveyed, sigma_enu=0.1, sigma_px=0.4)
    assert rows.tolist() == [1, 0, 1]
    assert points.points.tolist() == ["P", "Q", "Q"]
    np.testing.assert_array_equal(points.observation.uv, [[1, 2], [3, 4], [5, 6]])
    heights = np.asarray(observed.batches[0].shots.pose.position.height)
    np.testing.assert_array_equal(points.observation.exposure.motion.pose.position.height, heights[[1, 0, 1]])
    assert [one.label for one in errors.sources] == ["attitude"]  # the pixels' errors are stated with the points
    _, errors, _ = check_points_of(observed, surveyed, sigma_enu=0.1)
    assert [one.label for one in errors.sources] == ["attitude", "pixel measurement"]


@pytest.mark.parametrize(
    "names, words",
    [
        (["three.JPG"], r"image one of point P is not among the images: three\.JPG\."),
        (["a/one", "b/one"], r"image one of point P may be 2 of the images\."),
    ],
)
def test_images_that_are_not_there(tmp_path, names: list[str], words: str) -> None:
    surveyed = read(tmp_path / "a.csv", f"{HEADER}\none,P,1,2,47,11,5\n")
    with pytest.raises(TableError, match=words):
        check_points_of(images(names), surveyed, sigma_enu=0.1, sigma_px=0.4)


MODEL = jaxgeo.ErrorModel(
    (
        sources.Position.from_ned(north=1.0, east=2.0, down=3.0),
        sources.Attitude.from_degrees(heading=0.3, pitch=0.1, roll=0.2, distribution=Uniform()),
        sources.GimbalAngles.from_degrees(outer=0.1, inner=0.2),
        sources.GimbalMounting.from_degrees(outer=0.01, inner=0.02),
        sources.Boresight.from_degrees(heading=0.05, pitch=0.02, roll=0.03),
        sources.LeverArm.from_metres(forward=0.1, right=0.2, down=0.3),
        sources.InteriorOrientation.from_pixels(focal=4.0, principal_column=1.0, principal_row=2.0),
        sources.PixelMeasurement.from_pixels(column=0.5, row=0.7, distribution=StudentT(5.0)),
        sources.TerrainField.of_variograms(gaussian=[(5.0, 300.0)]),
    )
)


def test_an_error_model_comes_back(tmp_path) -> None:
    path = tmp_path / "errors.toml"
    write_errors(path, MODEL, comment="Sigmas\nfrom points")
    text = path.read_text()
    assert text.startswith("# Sigmas\n# from points\n")
    found = model_of_table(ErrorsTable.model_validate(tomllib.loads(text)["errors"]), Gimbal.two_axis())
    assert [type(one) for one in found.sources] == [type(one) for one in MODEL.sources]
    for one, other in zip(found.sources, MODEL.sources, strict=True):
        np.testing.assert_allclose(one.sigma, other.sigma, rtol=1e-5)
        assert [type(shape) for shape in one.shapes] == [type(shape) for shape in other.shapes]
    assert float(found.sources[-1].gaussian_lengths[0]) == 300.0


def test_sigmas_of_each_image_are_written_as_their_root_mean_square() -> None:
    each = eqx.tree_at(lambda one: one.sigma, MODEL.sources[0], np.array([[1.0, 1.0, 1.0], [7.0, 1.0, 1.0]]))
    assert errors_table(jaxgeo.ErrorModel((each,))) == {"position_m": [5.0, 1.0, 1.0]}


TWO_TAILS = sources.Position.from_ned(
    north=Stated(1.0, StudentT(3.0)), east=Stated(1.0, StudentT(30.0)), down=Stated(1.0, StudentT(3.0))
)


@pytest.mark.parametrize(
    "source, words",
    [
        (sources.Velocity.from_ned(north=1.0, east=1.0, down=1.0), r"no key for velocity"),
        (sources.Position.from_covariance(np.eye(3) + 0.1), r"those of position are correlated"),
        (sources.TerrainHeight.from_metres(1.0, sharing=PerMeasurement()), r"that of terrain height is not the usual"),
        (TWO_TAILS, r"the distribution of position has no form"),
        (sources.TerrainField.of_variograms(spherical=[(1.0, 10.0)]), r"one Gaussian variogram"),
    ],
)
def test_what_a_scene_cannot_hold(source: Any, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        errors_table(jaxgeo.ErrorModel((source,)))
