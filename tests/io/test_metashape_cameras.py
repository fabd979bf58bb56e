"""Cameras of Metashape in XML: transforms to the Earth, calibrations, and what is not read.

Held against: Agisoft's published rules: a camera's transform takes (right, down, forward) into the chunk, chunk and
component take that to geocentric coordinates; the lens formula of the manual's appendix ("Frame cameras"), here in
NumPy (`pixel_by_the_manual`), with cx and cy from the middle and pixels counted from the corner.
"""

from __future__ import annotations

import pathlib
import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation
from support.simulated_block import simulated

from jaxgeo import WGS84
from jaxgeo.adjust import Adjustment, adjust
from jaxgeo.earth import Geodetic
from jaxgeo.io import TableError, read_acquisition, write_metashape_cameras
from jaxgeo.io.errors import UnwritableLens
from jaxgeo.sensor.distortion import BrownConrady, Fisheye

TERMS = {
    "f": 277.0,
    "cx": 1.5,
    "cy": -2.25,
    "k1": -0.05,
    "k2": 0.02,
    "k3": -0.003,
    "p1": 0.0012,
    "p2": -0.0007,
    "b1": 1.25,
}
WIDTH, HEIGHT = 400, 300
LAT, LON, TALL = 36.3, -84.2, 900.0
SCALE = 3.5


def words(values: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def placed(scale: float = SCALE) -> tuple[str, np.ndarray, np.ndarray]:
    """(the XML of a chunk's transform, rotation and centre in ECEF of the camera with `LOCAL` as its transform)."""
    R = Rotation.from_euler("zyx", [0.3, -0.8, 2.0]).as_matrix()
    centre = np.array(pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(LON, LAT, TALL))
    shift = centre - scale * R @ LOCAL[:3, 3]
    text = (
        f"<transform><rotation>{words(R)}</rotation><translation>{words(shift)}</translation><scale>{scale!r}</scale>"
        f"</transform>"
    )
    return text, R @ LOCAL[:3, :3], centre


LOCAL = np.eye(4)
LOCAL[:3, :3] = Rotation.from_euler("xyz", [0.2, 0.4, -1.0]).as_matrix()
LOCAL[:3, 3] = [2.0, -3.0, 1.0]


def document(
    transform: str, terms: dict[str, float] | None = None, *, of_component: bool = False, more: str = ""
) -> str:
    inner = "".join(f"<{name}>{value!r}</{name}>" for name, value in (TERMS if terms is None else terms).items())
    component = f'<components><component id="0" label="c">{transform}</component></components>' if of_component else ""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="1.4.0"><chunk><sensors><sensor id="0" label="X" type="frame">
<resolution width="{WIDTH}" height="{HEIGHT}"/><calibration type="frame" class="adjusted">
<resolution width="{WIDTH}" height="{HEIGHT}"/>{inner}</calibration></sensor></sensors>{component}<cameras>
<camera id="0" sensor_id="0" component_id="0" label="DJI_0001"><transform>{words(LOCAL)}</transform></camera>
<camera id="1" sensor_id="0" label="DJI_0002"/>{more}</cameras>{"" if of_component else transform}</chunk></document>"""


def pixel_by_the_manual(
    p: np.ndarray, terms: dict[str, float] = TERMS, width: int = WIDTH, height: int = HEIGHT
) -> np.ndarray:
    """The manual's projection, and half a pixel from its corner to the centre of the first pixel."""
    x, y = p[:2] / p[2]
    r2 = x * x + y * y
    radial = 1.0 + terms["k1"] * r2 + terms["k2"] * r2**2 + terms["k3"] * r2**3
    xd = x * radial + terms["p1"] * (r2 + 2.0 * x * x) + 2.0 * terms["p2"] * x * y
    yd = y * radial + terms["p2"] * (r2 + 2.0 * y * y) + 2.0 * terms["p1"] * x * y
    u = 0.5 * width + terms["cx"] + xd * terms["f"] + xd * terms["b1"]
    return np.array([u, 0.5 * height + terms["cy"] + yd * terms["f"]]) - 0.5


@pytest.mark.costly
@pytest.mark.parametrize("of_component", [False, True])
def test_a_point_is_seen_where_metashape_projects_it(tmp_path: pathlib.Path, of_component: bool) -> None:
    transform, R_ecef_from_camera, centre = placed()
    path = tmp_path / "cameras.xml"
    path.write_text(document(transform, of_component=of_component), encoding="utf-8")
    found = read_acquisition(path)
    assert found.names.tolist() == ["DJI_0001"]
    assert any("1 cameras are not aligned" in one for one in found.assumed)
    at = found.shots.pose.position
    np.testing.assert_allclose(np.rad2deg([at.lat[0], at.lon[0]]), [LAT, LON], atol=1e-12)
    assert at.height[0] == pytest.approx(TALL, abs=1e-6)  # m
    sensor, shot, _ = found.exposure(0)
    p_camera = np.array([12.0, -7.0, 40.0])
    lon, lat, height = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(
        *(centre + R_ecef_from_camera @ p_camera)
    )
    point = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    seen = jax.jit(lambda: sensor.project_ecef(shot, WGS84.to_ecef(point))[0])()
    np.testing.assert_allclose(seen, pixel_by_the_manual(p_camera), atol=1e-6)  # pixels


def without(*names: str) -> dict[str, float]:
    return {name: value for name, value in TERMS.items() if name not in names}


REFUSED = {
    "no place": (document(""), "there is no transform to the Earth.*georeference the chunk"),
    "skew": (document(placed()[0], TERMS | {"b2": 0.5}), "sensor X: b2 is not zero"),
    "fourth": (document(placed()[0], TERMS | {"k4": 0.5}), "sensor X: k4 is not zero"),
    "no focal": (document(placed()[0], without("f")), "there is no focal length f"),
    "fisheye": (document(placed()[0]).replace('type="frame"', 'type="fisheye"'), "type fisheye; only frame"),
    "no sensor": (document(placed()[0],
                           more='<camera id="2" sensor_id="7" label="a"><transform>1</transform></camera>'),
                  "there is no sensor"),
    "cut": (document(placed()[0])[:900], "not an XML file, or cut off"),
    "matrix": (document(placed()[0]).replace(words(LOCAL), "1 2 3"), "camera DJI_0001: expected 16 numbers"),
    "no rotation": (document(placed()[0]).replace(words(LOCAL), words(np.diag([2.0, 1, 1, 1]))), "it is no rotation"),
    "nothing aligned": (document(placed()[0]).replace(f"<transform>{words(LOCAL)}</transform>", ""), "no camera"),
    "entities": (document(placed()[0]).replace("<document", "<!DOCTYPE a [<!ENTITY b 'c'>]><document"), "DOCTYPE"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_read_is_refused_in_a_line(tmp_path: pathlib.Path, case: str) -> None:
    text, words_of_it = REFUSED[case]
    path = tmp_path / "cameras.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(TableError, match=words_of_it) as refusal:
        read_acquisition(path)
    assert "\n" not in str(refusal.value)


def test_a_datum_is_not_taken(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "cameras.xml"
    path.write_text(document(placed()[0]), encoding="utf-8")
    with pytest.raises(TableError, match="leave height_datum= out"):
        read_acquisition(path, height_datum="EPSG:5773")


@pytest.fixture(scope="module")
def block() -> Adjustment:
    """An adjusted block, whose images have names of files."""
    given = simulated().noisy(1).block()
    names = {str(name): f"DJI_{k:04d}.JPG" for k, name in enumerate(given.images.name)}
    images = replace(given.images, name=np.array([*names.values()]))
    of_image = np.array([names[str(name)] for name in given.observations.image])
    return adjust(replace(given, images=images, observations=replace(given.observations, image=of_image)))


def chunk_of(path: pathlib.Path) -> tuple[ET.Element, dict[str, ET.Element]]:
    """(the chunk, its cameras by label)."""
    chunk = ET.parse(path).getroot().find("chunk")
    assert chunk is not None
    return chunk, {one.attrib["label"]: one for one in chunk.iter("camera")}


def numbers(element: ET.Element | None, *shape: int) -> np.ndarray:
    assert element is not None
    assert element.text is not None
    return np.array(element.text.split(), float).reshape(shape)


@pytest.mark.costly
def test_the_manual_projects_an_adjusted_block_as_the_adjustment_does(
    tmp_path: pathlib.Path, block: Adjustment
) -> None:
    path = tmp_path / "cameras.xml"
    write_metashape_cameras(path, block)
    chunk, cameras = chunk_of(path)
    calibration = chunk.find("sensors/sensor/calibration")
    assert calibration is not None
    terms = {one.tag: float(one.text or "") for one in calibration if one.tag != "resolution"}
    size = {key: int(value) for key, value in calibration.find("resolution").attrib.items()}  # pyright: ignore
    assert size == {"width": 4000, "height": 3000}
    places = dict(zip(block.points.name.tolist(), block.points.place, strict=True))
    observed = block.block.observations
    predicted = observed.uv + block.residuals
    for k in range(0, len(observed), 7):
        matrix = numbers(cameras[str(observed.image[k]).removesuffix(".JPG")].find("transform"), 4, 4)
        p_camera = matrix[:3, :3].T @ (places[str(observed.point[k])] - matrix[:3, 3])
        np.testing.assert_allclose(pixel_by_the_manual(p_camera, terms, **size), predicted[k], atol=1e-6)
    read = read_acquisition(path)
    assert read.names.tolist() == [str(name).removesuffix(".JPG") for name in block.images.name]
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    at, shift = read.shots.pose.position, numbers(chunk.find("transform/translation"), 3)
    R = numbers(chunk.find("transform/rotation"), 3, 3)
    centres = np.stack(to_ecef.transform(np.rad2deg(at.lon), np.rad2deg(at.lat), at.height), axis=1)
    np.testing.assert_allclose((centres - shift) @ R, block.images.centre, atol=1e-6)  # m


@pytest.mark.costly
@pytest.mark.parametrize("lens", [Fisheye(k1=0.01), BrownConrady(k1=0.01, k5=0.02)])
def test_lenses_that_metashape_lacks_are_not_written(tmp_path: pathlib.Path, block: Adjustment, lens: Any) -> None:
    cameras = {name: replace(camera, distortion=lens) for name, camera in block.cameras.items()}
    other = replace(block)
    object.__setattr__(other, "cameras", cameras)
    with pytest.raises(UnwritableLens, match="Metashape"):
        write_metashape_cameras(tmp_path / "cameras.xml", other)
    assert not (tmp_path / "cameras.xml").exists()
