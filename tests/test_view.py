"""The viewer's server and answers, without a browser."""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import pathlib
import sys
import urllib.request
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.command_files import FILES, SMALL_POSE, SMALL_SCENE
from support.command_runner import CliRunner

import jaxgeo
from jaxgeo.cli import app
from jaxgeo.io.errors import ImageError
from jaxgeo.io.pictures import read_picture
from jaxgeo.view import NoGround, ViewData, ViewServer, check_tiles, images_of, serve

GROUND = jaxgeo.ConstantHeight(300.0)  # 500 m below the camera


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[pathlib.Path]:
    folder = tmp_path_factory.mktemp("images")
    for name in ("DJI_0042.JPG", "DJI_0043.JPG"):
        FILES["DJI_0042.JPG"](folder / name)
    return [folder / "DJI_0042.JPG", folder / "DJI_0043.JPG"]


@pytest.fixture(scope="module")
def observed(files: list[pathlib.Path]) -> Any:
    return jaxgeo.io.read_observations(files, height_datum="ellipsoid")


@pytest.fixture(scope="module")
def data(observed, files) -> ViewData:
    return ViewData(observed, [GROUND], files, has_errors=False)


@pytest.fixture(scope="module")
def viewer(observed, files) -> Iterator[ViewServer]:
    """A server that knows its images; nothing is located."""
    with ViewServer(title="A <b>title</b>") as server:
        server.show_images(observed, [files[0], None])
        yield server


def ask(server: ViewServer, path: str, method: str = "GET", **headers: str) -> tuple[int, Any, Any]:
    """(status, content as text or from JSON, headers)."""
    host, _, port = server.address.removeprefix("http://").rstrip("/").partition(":")
    with contextlib.closing(http.client.HTTPConnection(host, int(port), timeout=20.0)) as connection:
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        content = response.read()
        kind = response.getheader("Content-Type", "")
        return response.status, json.loads(content) if kind == "application/json" else content, response.headers


def test_a_pixel_has_a_place_or_words(data: ViewData) -> None:
    fix = data.locate(1, 1200.5, 700.0)
    assert (fix["status"], fix["is_fix"]) == ("hit", True)
    assert fix["fix_height_m"] == pytest.approx(300.0, abs=1e-6)
    assert fix["lat_text"] == f"{fix['fix_lat_deg']:.7f}° N"
    outside = data.locate(0, -5.0, 10.0)
    assert (outside["is_fix"], outside["label"], outside["fix_lat_deg"]) == (False, "No fix", None)
    assert outside["status_text"] == jaxgeo.Status.outside_image.message


def test_a_place_has_the_pixel_that_it_is_the_place_of(data: ViewData) -> None:
    fix = data.locate(1, 1200.5, 700.0)
    seen = data.project(1, fix["fix_lat_deg"], fix["fix_lon_deg"])
    assert (seen["u"], seen["v"]) == pytest.approx((1200.5, 700.0), abs=1e-3)  # of rounding the degrees
    assert sorted(one["image"] for one in seen["seen"]) == [0, 1]
    behind = data.project(0, 37.0, -84.1)
    assert (behind["label"], behind["seen"]) == ("Not visible", [])


def test_only_this_machine_by_its_own_name_and_for_reading(viewer: ViewServer) -> None:
    assert viewer.address.startswith("http://127.0.0.1:")
    status, page, headers = ask(viewer, "/")
    assert status == 200
    assert b"jaxgeo" in page
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    for host in ("evil.example", "evil.example:80", "127.0.0.1.evil.example:1", ""):
        assert ask(viewer, "/api/scene", Host=host)[0] == 403, host
    assert ask(viewer, "/api/scene", Host="localhost:9")[0] == 200  # through a tunnel
    assert ask(viewer, "/api/scene", **{"Sec-Fetch-Site": "cross-site"})[0] == 403
    for method in ("POST", "PUT", "DELETE"):
        assert ask(viewer, "/api/scene", method)[0] == 405
    assert ask(viewer, "/../../etc/passwd")[0] == 404
    assert ask(viewer, "/" + 5000 * "a")[0] == 403


def test_images_are_shown_before_their_ground_is_known(viewer: ViewServer) -> None:
    _, scene, _ = ask(viewer, "/api/scene")
    assert scene["title"] == "A <b>title</b>"
    assert [one["name"] for one in scene["images"]] == ["DJI_0042.JPG", "DJI_0043.JPG"]
    assert (scene["images"][0]["width"], scene["images"][0]["reason"]) == (4000, None)
    assert "grid" in scene["images"][1]["reason"]
    status, content, headers = ask(viewer, "/image?image=0&across=400")
    assert (status, headers["Content-Type"]) == (200, "image/jpeg")
    picture = Image.open(io.BytesIO(content))
    assert picture.size == (400, 300)
    assert np.abs(np.asarray(picture)[0, 0] - np.array([90.0, 120.0, 60.0])).max() < 6.0  # of the file, beside JPEG's
    assert Image.open(io.BytesIO(ask(viewer, "/image?image=0&box=100,100,140,120")[1])).size == (40, 20)
    wrong = {
        "image=1": "grid", "image=2": "from 0 to 1", "image=-1": "from 0 to 1", "image=0&box=1,2": "four",
        "image=0&across=wide": "number", "image=0&box=5000,0,6000,9": "outside",
    }  # fmt: skip
    for query, words in wrong.items():
        status, told, _ = ask(viewer, f"/image?{query}")
        assert 400 <= status < 500
        assert words in told["error"], query
    state = ask(viewer, "/api/state")[1]
    assert (state["has_images"], state["has_map"], state["is_ready"]) == (True, False, False)
    assert ask(viewer, "/api/map")[0] == 503


def test_a_port_is_taken_by_one(viewer: ViewServer, tmp_path, monkeypatch) -> None:
    port = int(viewer.address.rstrip("/").rpartition(":")[2])
    with pytest.raises(OSError, match="in use"):
        ViewServer(port=port)
    monkeypatch.chdir(tmp_path)
    FILES["DJI_0042.JPG"](tmp_path / "DJI_0042.JPG")
    line = "view DJI_0042.JPG --camera-datum ellipsoid --ground 300 --no-browser"
    for more, words in {
        f"--port {port}": f"--port {port}: Address already in use",
        "--port 70000": "--port 70000: must be from 1 to 65535",
        "--images none": "--images none: there is no such folder",
        "--tiles https://host/z/x/y.png": "expected the address of web-map tiles",
        "--probability 1": "--probability 1: must be between",
    }.items():
        result = CliRunner().invoke(app, [*line.split(), *more.split()], prog_name="jaxgeo")
        assert result.exit_code == 2
        (told,) = result.stderr.splitlines()
        assert words in told
        assert result.stdout == ""


@pytest.mark.costly
def test_the_command_serves_until_it_is_stopped(tmp_path, monkeypatch) -> None:
    """What the page gets of a scene with pixels; one JSON object; the image of a scene by --images."""
    monkeypatch.chdir(tmp_path)
    pathlib.Path("scene.toml").write_text(SMALL_SCENE.format(**SMALL_POSE))
    Image.new("L", (128, 96)).save("image.png")
    asked: list[Any] = []

    def stopped() -> None:
        address = json.loads(sys.stdout.buffer.getvalue())["address"]  # pyright: ignore[reportAttributeAccessIssue]
        for path in ("api/scene", "api/map", "api/state", "image?image=0", "api/locate?image=0&u=12&v=24"):
            with urllib.request.urlopen(address + path, timeout=60.0) as answer:
                asked.append(answer.read())

    monkeypatch.setattr("jaxgeo.cli.view._wait", stopped)
    line = "view --scene scene.toml --ground 300 --pixel 12,24 --images image.png --no-browser --json"
    result = CliRunner().invoke(app, line.split(), prog_name="jaxgeo")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["command"], told["images"]) == ("view", ["scene.toml"])
    scene, drawn, state, picture, fix = (one if one[:1] == b"\xff" else json.loads(one) for one in asked)
    assert scene["images"][0]["marks"] == [[12.0, 24.0]]
    assert scene["notes"] == told["assumed"]
    assert (drawn["percent"], drawn["between"], len(drawn["outlines"])) == ("90", None, 1)
    assert state["is_warm"]
    assert Image.open(io.BytesIO(picture)).size == (128, 96)
    assert fix["fix_height_m"] == pytest.approx(300.0, abs=1e-6)
    assert "circular_m" not in fix  # the scene states no errors


def test_tiles_of_one_host_may_be_asked_for(observed) -> None:
    with ViewServer(tiles="https://tiles.example:8/{z}/{x}/{y}.png") as server:
        policy = ask(server, "/")[2]["Content-Security-Policy"]
        assert "img-src 'self' data: blob: https://tiles.example:8;" in policy
    for wrong in ("https://host/{z}/{x}.png", "file:///{z}/{x}/{y}", "https://a;b/{z}/{x}/{y}", "{z}{x}{y}"):
        with pytest.raises(ValueError, match="web-map tiles"):
            check_tiles(wrong)


@pytest.mark.costly
def test_no_ground_is_said(observed) -> None:
    with pytest.raises(NoGround, match=r"DJI_0042\.JPG, its middle: .*camera is below"):
        serve(observed, jaxgeo.ConstantHeight(3000.0), accuracy=False)


def test_pixels_of_one_exposure_are_of_one_image(files) -> None:
    found = images_of(jaxgeo.io.read_observations(files, [(1, 2), (3, 4)], height_datum="ellipsoid"))
    assert [one.name for one in found] == ["DJI_0042.JPG", "DJI_0043.JPG"]
    assert found[1].rows == (2, 3)
    assert found[1].pixels == ((1.0, 2.0), (3.0, 4.0))


def test_pictures_of_other_types_are_stretched_and_of_other_shapes_refused(tmp_path) -> None:
    path = tmp_path / "deep.tif"
    Image.fromarray(np.linspace(1000, 3000, 600).astype(np.uint16).reshape(20, 30)).save(path)
    picture = read_picture(path, (60, 40))  # the camera's image, at half its size
    assert picture.shape == (20, 30, 3)
    assert (picture.min(), picture.max()) == (0, 255)
    assert read_picture(path, (60, 40), box=(0.0, 0.0, 60.0, 2.0)).max() < 30  # by the values of the whole image
    with pytest.raises(ImageError, match="turned, cut"):
        read_picture(path, (40, 60))
