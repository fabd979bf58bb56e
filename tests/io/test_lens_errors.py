"""What is assumed of a lens is in the error budget: CE90 at a corner of the image holds the truth."""

from __future__ import annotations

import pathlib
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import FrameCamera
from jaxgeo.io import TableError, given_camera, read_acquisition, with_usual_errors
from jaxgeo.io.acquisitions import _calibrations, read_drone_images
from jaxgeo.io.acquisitions.telemetry import read_telemetry
from jaxgeo.uncertainty import ErrorModel, accuracy
from jaxgeo.uncertainty.sources import InteriorOrientation
from tests.io.test_flight_logs import subtitles
from tests.support.drone_image_files import packet, write_image
from tests.support.klv_packets import local_set, usual, whole

TAGS: dict[str, Any] = {
    "drone-dji:AbsoluteAltitude": "+900.0",
    "drone-dji:GpsLatitude": "+36.3",
    "drone-dji:GpsLongitude": "-84.2",
    "drone-dji:GimbalYawDegree": "+30.00",
    "drone-dji:GimbalPitchDegree": "-90.00",
    "drone-dji:GimbalRollDegree": "+0.00",
}
RTK = {"drone-dji:RtkFlag": "50"} | dict.fromkeys((f"drone-dji:RtkStd{axis}" for axis in ("Lat", "Lon", "Hgt")), "0.02")
GROUND = 300.0  # m, 600 m below the camera
CORNER = jnp.zeros(2)
# Size, 35 mm equivalent, and a true focal length as a share of what the rule makes of it.
FILM = {
    "whole, the worst of 15 models": ((400, 300), 24, 1.0 / 0.90),
    "whole, the worst to the other side": ((400, 300), 24, 1.0 / 1.02),
    "cut to 16:9 (Mavic Pro, 2994 px of 4000)": ((400, 225), 26, 299.4 / 275.788),
    "cut to 16:9, of a sensor of 4:3 whose rule is wrong too": ((400, 225), 24, 1.0 / 0.86),
}


def image(tmp_path: pathlib.Path, size: tuple[int, int], film: int) -> Any:
    path = write_image(
        tmp_path / "a.jpg", packet(TAGS | RTK), make="DJI", model="FC9999", exif={0xA405: film}, size=size
    )
    return read_drone_images(path, height_datum="ellipsoid")


@eqx.filter_jit
def ground_point(camera: FrameCamera, sensor: Any, shot: Any) -> Any:
    """East and north of where the corner looks, in m from under the camera, over a plane."""
    direction, _ = camera.ray(CORNER)
    n, e, d = sensor.R_ned_from_camera(shot) @ direction
    return jnp.stack([e, n]) * (900.0 - GROUND) / d


@pytest.mark.parametrize("case", FILM)
def test_the_worst_focal_lengths_lie_within_two_standard_deviations(tmp_path: pathlib.Path, case: str) -> None:
    size, film, truth = FILM[case]
    found = image(tmp_path, size, film)
    assert found.sensor is not None
    camera: Any = found.sensor.camera
    (sigma,) = [float(one.sigma[0, 0]) for one in found.sources if one.label == "interior orientation"]
    assert abs(truth - 1.0) * float(camera.focal_px[0, 0]) < 2.0 * sigma


@pytest.mark.parametrize("name", ["a.jpg", "b.srt", "c.klv"])
def test_a_film_equivalent_that_is_given_is_that_of_images(tmp_path: pathlib.Path, name: str) -> None:
    """One rule, by the diagonals, with one standard deviation, for all kinds of files."""
    size = (400, 225)
    write_image(tmp_path / "a.jpg", packet(TAGS | RTK), make="DJI", model="FC9999", exif={0xA405: 24}, size=size)
    (tmp_path / "b.srt").write_text(subtitles())
    (tmp_path / "c.klv").write_bytes(local_set(usual()))
    datum = None if name == "c.klv" else "ellipsoid"
    found = read_acquisition(tmp_path / name, height_datum=datum, camera="film=24mm,size=400x225")
    assert found.sensor is not None
    camera: Any = found.sensor.camera
    focal = 24.0 * np.hypot(*size) / np.hypot(36.0, 24.0)
    np.testing.assert_allclose(camera.focal_px, focal, rtol=1e-12)
    (source,) = [one for one in found.sources if isinstance(one, InteriorOrientation)]
    np.testing.assert_allclose(source.sigma, [[0.09 * focal, 0.0, 0.0]] * len(found), rtol=1e-12)
    said = " ".join(found.assumed)
    assert "Focal length sigma: 9 %, 22.9 pixels" in said
    assert "without error" not in said
    assert "has no error." not in said
    with pytest.raises(TableError, match="film=, goes with size= alone"):
        read_acquisition(tmp_path / name, height_datum=datum, camera="film=24mm,sensor=36mm,size=400x225")


@pytest.mark.slow
@pytest.mark.parametrize("case", FILM)
def test_ce90_of_a_corner_holds_the_truth_of_a_film_equivalent(tmp_path: pathlib.Path, case: str) -> None:
    size, film, truth = FILM[case]
    found = with_usual_errors(image(tmp_path, size, film))
    sensor, shot, sources = found.exposure(0)
    assert sensor is not None
    camera: Any = sensor.camera
    diagonal = float(np.hypot(*size))
    np.testing.assert_allclose(camera.focal_px, [film * diagonal / np.hypot(36.0, 24.0)] * 2, rtol=1e-9)
    true = FrameCamera(camera.focal_px * truth, camera.principal_px, camera.distortion, *size)
    off = float(np.linalg.norm(ground_point(camera, sensor, shot) - ground_point(true, sensor, shot)))
    how_sure = accuracy(sensor, shot, CORNER, jaxgeo.ConstantHeight(GROUND), ErrorModel(sources))
    assert off < how_sure.circular
    assert how_sure.circular < 0.25 * 0.5 * diagonal / float(camera.focal_px[0]) * 600.0 + 30.0  # m: nor is it anything
    lens = [one for one in sources if one.label == "interior orientation"]
    others = [one for one in sources if one.label != "interior orientation"]
    assert len(lens) == 1
    without = accuracy(sensor, shot, CORNER, jaxgeo.ConstantHeight(GROUND), ErrorModel(tuple(others))).circular
    if off > 30.0:
        assert without < off  # which is what it was before the lens had a part in it


WIDTHS = {"in whole steps of 10 m": 340.0, "7 % too small": 323.0, "7 % too large": 371.0}  # m; the true one is 347 m


@pytest.mark.slow
@pytest.mark.parametrize("case", WIDTHS)
def test_ce90_of_a_corner_holds_the_truth_of_a_target_width(tmp_path: pathlib.Path, case: str) -> None:
    """Telemetry without a field of view, whose target width is rounded or estimated."""
    true_focal = 640.0 / (0.5 * 347.0 / 1650.0)
    steep = {"tag_18": 0.0, "tag_19": -87.0, "tag_20": 0.0, "tag_21": 1650.0, "tag_6": 0.0, "tag_7": 0.0}
    items = usual(5, 13, 14, 75, **steep) | {22: whole(WIDTHS[case], 0.0, 10_000.0, ">H")}
    path = tmp_path / "a.klv"
    path.write_bytes(local_set(items))
    found = with_usual_errors(read_telemetry(path, image_size=(1280, 720)))
    sensor, shot, sources = found.exposure(0)
    camera: Any = sensor.camera  # pyright: ignore[reportOptionalMemberAccess]
    true = FrameCamera(jnp.full(2, true_focal), camera.principal_px, camera.distortion, 1280, 720)
    ground = jaxgeo.ConstantHeight(400.0)
    exact = tuple(one for one in sources if isinstance(one, InteriorOrientation))
    where = [
        np.asarray(jax.jit(jaxgeo.locate)(eqx.tree_at(lambda one: one.camera, sensor, one), shot, CORNER, ground).ecef)
        for one in (camera, true)
    ]
    off = float(np.linalg.norm(where[0] - where[1]))
    alone = accuracy(sensor, shot, CORNER, ground, ErrorModel(exact))  # pyright: ignore[reportArgumentType]
    assert off < alone.circular < 3.0 * 0.07 * 0.5 * 347.0 * np.hypot(1.0, 720.0 / 1280.0)


def test_every_way_to_a_focal_length_has_its_error(tmp_path: pathlib.Path) -> None:
    """The less is known, the larger; and none without."""
    lens = {"exif": {0xA405: 24, 0x920A: 8.8}, "model": "FC9999"}
    ways: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "DewarpData": (TAGS | {"drone-dji:DewarpData": "1;36,36,0,0,-0.1,0,0,0,0"}, lens),
        "designed": (TAGS | {"drone-dji:CalibratedFocalLength": "36"}, lens),
        "table": (TAGS, {"exif": {0x920A: 8.8}, "model": "FC6310", "size": (45, 30)}),
        "EXIF in mm": (TAGS, lens | {"exif": {0x920A: 8.8, 0xA20E: 40.0, 0xA210: 3}}),
        "film": (TAGS, lens),
        "film, cut": (TAGS, lens | {"size": (40, 22)}),
    }
    shares = {}
    for name, (tags, options) in ways.items():
        path = write_image(tmp_path / f"{name}.jpg", packet(tags), make="DJI", **options)
        found = read_drone_images(path, height_datum="ellipsoid")
        (source,) = found.sources
        sigma, sensor = jax.tree.map(lambda leaf: np.asarray(leaf)[0], (source.sigma, found.sensor))
        shares[name] = float(sigma[0] / sensor.camera.focal_px[0])
        assert sigma[1] > 0.0
        assert any(line.startswith("Focal length sigma: ") for line in found.assumed)
    assert list(shares) == sorted(shares, key=lambda name: shares[name])
    assert shares["DewarpData"] == pytest.approx(_calibrations.CALIBRATED)
    assert shares["film"] == pytest.approx(np.hypot(given_camera.FILM, _calibrations.BENT))
