"""Observations of files, scenes and tables of shots, their fixes and their accuracy."""

from __future__ import annotations

import dataclasses
import pathlib

import jax
import numpy as np
import pytest
from support.command_files import SHOTS, prepare

import jaxgeo
from jaxgeo import ConstantHeight, Observation, Status, locate
from jaxgeo.earth import Atmosphere
from jaxgeo.io import (
    ObservationBatch,
    Observations,
    TableError,
    accuracy_of_observations,
    locate_observations,
    observations_of,
    read_acquisition,
    read_observations,
)
from jaxgeo.io.acquisitions import Unread, for_each
from jaxgeo.io.located import SAMPLES_OF_MANY, fixes_in_parts
from jaxgeo.io.observation_reader import reasons_by_count
from jaxgeo.io.scene import SceneError, read_scene
from jaxgeo.uncertainty import accuracy
from jaxgeo.uncertainty.sources import Attitude, GimbalAngles, InteriorOrientation, Position, TerrainHeight

PIXELS = [(10.0, 20.0), (3000.0, 2000.0)]
HOW = {"height_datum": "ellipsoid"}
GROUND = ConstantHeight(np.asarray(300.0))


@pytest.fixture
def folder(tmp_path: pathlib.Path, monkeypatch) -> pathlib.Path:
    """Two images of one camera, telemetry, navigation, tables, a damaged image; the working folder."""
    prepare(tmp_path, "images DJI_0042.JPG flight.klv mission.sbet opk.csv scene.toml shots.csv reconstruction.json")
    (tmp_path / "broken.JPG").write_bytes((tmp_path / "DJI_0042.JPG").read_bytes()[:500])
    monkeypatch.chdir(tmp_path)
    return tmp_path


CENTRE = ["centre_lat_deg", "centre_lon_deg", "centre_height_m"]


def test_rows_have_the_reported_centre_of_their_frame(tmp_path: pathlib.Path) -> None:
    """Beside an image, which reports none; files that report none at all have no such columns."""
    prepare(tmp_path, "flight.klv DJI_0042.JPG")
    files = [tmp_path / "DJI_0042.JPG", tmp_path / "flight.klv"]
    image, *frames = read_observations(files, height_datum="ellipsoid").columns
    assert [image[name] for name in CENTRE] == [None] * 3
    reported = read_acquisition(files[1], height_datum="ellipsoid").reported
    assert reported is not None
    for k, row in enumerate(frames):
        assert row["centre_lat_deg"] == pytest.approx(np.rad2deg(reported.centre.lat[k]), abs=1e-9)
        assert row["centre_lon_deg"] == pytest.approx(np.rad2deg(reported.centre.lon[k]), abs=1e-9)
        assert row["centre_height_m"] == pytest.approx(reported.centre.height[k], abs=1e-4)
    alone = read_observations(files[:1], height_datum="ellipsoid").columns[0]
    assert not set(CENTRE) & set(alone)


def test_rows_are_in_the_order_of_files_exposures_and_pixels(folder) -> None:
    observed = read_observations(["flight.klv", "images"], PIXELS, **HOW)
    names = ["flight.klv/0", "flight.klv/1", "DJI_0042.JPG", "DJI_0043.JPG"]
    assert [row["name"] for row in observed.columns] == [name for name in names for _ in PIXELS]
    assert [(row["u"], row["v"]) for row in observed.columns] == PIXELS * len(names)
    assert all(list(row) == ["name", "time_s", "time_utc", "u", "v", *CENTRE] for row in observed.columns)
    assert observed.columns[0]["time_s"] > 0.0
    assert observed.columns[4]["time_s"] is None
    assert len(observed) == 8
    assert sorted(np.concatenate([batch.rows for batch in observed.batches])) == list(range(8))
    assert observed.read_rows.tolist() == list(range(8))
    assert [len(batch) for batch in observed.batches] == [4, 4]


def test_the_centre_is_observed_by_default(folder) -> None:
    observed = read_observations("DJI_0042.JPG", **HOW)
    camera = observed.batches[0].camera
    centre = [0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]
    np.testing.assert_array_equal(observed.batches[0].observation.uv, [centre])
    assert observed.batches[0].is_on_image.all()


@pytest.mark.costly
def test_fixes_are_those_of_locate_exposure_by_exposure(folder) -> None:
    """Over one terrain per batch, which may have a height per pixel."""
    observed = read_observations(["flight.klv", "images"], PIXELS[:1], **HOW)
    reported = [batch.centre_heights for batch in observed.batches]
    assert reported[1] is None
    assert np.isfinite(reported[0]).all()
    heights = reported[0] + np.arange(2.0)
    grounds = [ConstantHeight(heights), GROUND]
    fixes = locate_observations(observed, grounds)
    np.testing.assert_allclose(fixes.position.height, [*heights, 300.0, 300.0], rtol=0.0, atol=1e-6)
    for row, height in enumerate([*heights, 300.0, 300.0]):
        observation, _ = observed.at(row)
        assert isinstance(observation, Observation)
        one = locate(observation, ConstantHeight(np.asarray(height)))
        np.testing.assert_allclose(fixes.ecef[row], one.ecef, rtol=0.0, atol=1e-6)
        assert fixes.status[row] == one.status
        np.testing.assert_allclose(observed.position.lat[row], observation.exposure.motion.pose.position.lat)
    with pytest.raises(ValueError, match="zip"):
        locate_observations(observed, grounds[:1])


def test_axes_are_those_of_vmap(folder) -> None:
    for observed in (read_observations("scene.toml", PIXELS), read_observations("images", **HOW)):
        (batch,) = observed.batches
        leaves = jax.vmap(jax.tree.leaves, in_axes=(batch.in_axes,))(batch.observation)
        for index in range(len(batch)):
            alone = jax.tree.leaves(batch.at(index)[0])
            assert len(leaves) == len(alone)
            for one, other in zip(leaves, alone, strict=True):
                np.testing.assert_array_equal(one[index], other)


@pytest.mark.slow
def test_locate_is_mapped_over_the_axes(folder) -> None:
    for observed in (read_observations("scene.toml", PIXELS), read_observations("images", **HOW)):
        (batch,) = observed.batches
        fixes = jax.vmap(locate, in_axes=(batch.in_axes, None))(batch.observation, GROUND)
        np.testing.assert_allclose(fixes.ecef, locate_observations(observed, GROUND).ecef, rtol=0.0, atol=1e-6)


def test_unread_files_keep_a_row(folder) -> None:
    progress = []
    read = []
    observed = read_observations(["broken.JPG", "images"], progress=lambda *done: read.append(done), **HOW)
    assert read[-1] == (3, 3)
    assert list(observed.unread) == [0]
    assert observed.columns[0] == {"name": "broken.JPG", "u": None, "v": None}
    assert "broken.JPG" in observed.reasons[0]
    assert observed.reasons[1:] == [None, None]
    assert np.isnan(observed.position.lat[0])
    with pytest.raises(KeyError, match=r"broken\.JPG"):
        observed.at(0)
    fixes = locate_observations(observed, GROUND, progress=lambda *done: progress.append(done))
    assert progress[-1] == (2, 2)
    assert fixes.status.tolist() == [Status.file_not_read, Status.hit, Status.hit]
    rows = observed.table(fixes)
    assert [row["status"] for row in rows] == ["file_not_read", "hit", "hit"]
    assert rows[0]["status_text"] == observed.reasons[0]
    assert "index" not in rows[0]
    assert list(rows[1])[:3] == ["name", "u", "v"]


def test_pixels_outside_the_image_need_no_program(folder) -> None:
    observed = read_observations("scene.toml", [(-10.0, 5.0), (5.0, 99999.0)])
    assert not observed.batches[0].is_on_image.any()
    (fixes,) = fixes_in_parts(observed.batches[0], GROUND)
    assert fixes.status.tolist() == [Status.outside_image] * 2
    assert np.isnan(fixes.slant_range).all()


@pytest.mark.costly
def test_parts_of_a_batch_are_the_whole(folder) -> None:
    pixels = np.stack([np.linspace(10.0, 2000.0, 1500), np.full(1500, 2000.0)], axis=-1)
    observed = read_observations("scene.toml", pixels)
    parts = list(fixes_in_parts(observed.batches[0], GROUND))
    assert [len(part.status) for part in parts] == [1024, 476]
    whole = locate_observations(observed, GROUND)
    np.testing.assert_array_equal(np.concatenate([part.slant_range for part in parts]), whole.slant_range)
    alone = locate_observations(read_observations("scene.toml", pixels[1499]), GROUND)
    np.testing.assert_allclose(alone.ecef[0], whole.ecef[1499], rtol=0.0, atol=1e-6)


def test_errors_are_of_the_file_then_usual_ones(folder) -> None:
    observed = read_observations("images", **HOW)
    (batch,) = observed.batches
    kinds = [type(source) for source in batch.sources]
    assert {InteriorOrientation, Position, GimbalAngles} <= set(kinds)
    assert [kind for kind, _ in observed.assumed_errors] == [Position, GimbalAngles]
    assert all("sigma" in sentence or "err by" in sentence for _, sentence in observed.assumed_errors)
    assert all(np.shape(source.sigma)[0] == 2 for source in batch.sources)
    more = observed.add_sources(Position.from_ned(north=1.0, east=1.0, down=1.0), TerrainHeight.from_metres(5.0))
    (own,) = [source for source in more.batches[0].sources if isinstance(source, Position)]
    np.testing.assert_array_equal(own.sigma, np.ones((2, 3)))
    assert len(more.batches[0].sources) == len(batch.sources) + 1


@pytest.mark.costly
def test_accuracy_is_that_of_each_observation(folder) -> None:
    """In two batches of one form, so that one program is compiled; the last row comes first."""
    observed = read_observations(["broken.JPG", "DJI_0042.JPG"], PIXELS, **HOW)
    observed = observed.add_sources(TerrainHeight.from_metres(5.0))
    (batch,) = observed.batches
    halves = tuple(ObservationBatch(*batch.at(np.array([k])), batch.rows[[k]]) for k in (1, 0))
    is_accuracy_of_each(dataclasses.replace(observed, batches=halves), rows=(1, 2))


@pytest.mark.slow
def test_accuracy_of_images_and_telemetry_is_that_of_each(folder) -> None:
    observed = read_observations(["broken.JPG", "images", "flight.klv"], **HOW)
    is_accuracy_of_each(observed.add_sources(TerrainHeight.from_metres(5.0)), rows=(1, 3))


def is_accuracy_of_each(observed: Observations, rows: tuple[int, ...]) -> None:
    """Assert that some rows have the accuracy of their observation alone; the first file could not be read."""
    fixes = locate_observations(observed, GROUND)
    found = accuracy_of_observations(observed, GROUND, fixes, probability=0.5)
    assert found is not None
    assert np.isnan(found.circular[0])
    for row in rows:
        observation, sources = observed.at(row)
        one = accuracy(observation, GROUND, sources, probability=0.5)
        np.testing.assert_allclose(found.circular[row], float(one.circular), rtol=1e-9)
    assert {"ce50_m", "le50_m", "accuracy_method"} <= set(observed.table(fixes, found)[1])
    assert SAMPLES_OF_MANY < 20_000


def test_without_a_fix_there_is_no_accuracy(folder) -> None:
    observed = read_observations("scene.toml", [(-10.0, 5.0)])
    fixes = locate_observations(observed, GROUND)
    assert accuracy_of_observations(observed, GROUND, fixes) is None


def test_a_scene_is_shared_by_its_pixels(folder) -> None:
    scene = read_scene("scene.toml")
    for observed in (read_observations("scene.toml", PIXELS), read_observations(scene="scene.toml", pixels=PIXELS)):
        (batch,) = observed.batches
        assert batch.is_one_camera
        assert np.ndim(batch.camera.focal_px) == 1
        assert observed.columns == [{"u": u, "v": v} for u, v in PIXELS]
        assert observed.gimbal_names == ("outer", "inner")
        assert len(batch.sources) == len(scene.errors.sources)
        np.testing.assert_array_equal(batch.shots.time, np.zeros(2))


def test_a_table_of_shots_carries_its_columns(folder) -> None:
    observed = read_observations("scene.toml", shots="shots.csv")
    assert [row["name"] for row in observed.columns] == ["0", "1", "2"]
    lat = [float(place.split(",")[0]) for place in SHOTS]
    np.testing.assert_allclose(np.rad2deg(observed.position.lat), lat)


def test_exposures_by_name(folder) -> None:
    observed = read_observations(["images", "flight.klv"], exposures=["flight.klv/1", "DJI_0043.JPG"], **HOW)
    assert [row["name"] for row in observed.columns] == ["flight.klv/1", "DJI_0043.JPG"]


def test_a_scene_gives_its_camera(folder) -> None:
    observed = read_observations("mission.sbet", scene="scene.toml", **HOW)
    scene = read_scene("scene.toml")
    np.testing.assert_array_equal(observed.batches[0].camera.focal_px, np.tile(scene.sensor.camera.focal_px, (3, 1)))
    assert observed.assumed[-1] == "Gimbal readings are held at those in scene.toml."
    assert observed.assumed_errors == ()
    assert {Attitude, Position} <= {type(source) for source in observed.batches[0].sources}


def test_an_acquisition_in_memory_gives_the_same(folder) -> None:
    found = read_acquisition("flight.klv", **HOW)
    here, there = observations_of(found, PIXELS), read_observations("flight.klv", PIXELS, **HOW)
    assert here.columns == there.columns
    assert here.assumed == there.assumed
    pairs = (jax.tree.leaves(each.batches[0].observation) for each in (here, there))
    for one, other in zip(*pairs, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.costly
def test_an_atmosphere_for_all(folder) -> None:
    observed = read_observations("scene.toml", [(1199.5, 2399.5)])
    assert observed.atmosphere is None
    bent = observed.with_atmosphere(Atmosphere())
    assert bent.atmosphere is not None
    straight, curved = (locate_observations(one, GROUND) for one in (observed, bent))
    assert 0.1 < abs(float(straight.slant_range[0] - curved.slant_range[0])) < 100.0


def test_reasons_of_many_files_are_told_by_their_number() -> None:
    """What differs by the name and by numbers is one reason; the most frequent comes first, whatever came first."""
    zeros = Unread("images/a.jpg", TableError("images/a.jpg: angles all zero."), 0)
    unnamed = [
        Unread(f"images/{k}.jpg", TableError(f"images/{k}.jpg: geo.txt has no row {k} of this name"), k)
        for k in range(1, 34)
    ]
    assert reasons_by_count([zeros, *unnamed]) == (
        "33 of them: images/1.jpg: geo.txt has no row 1 of this name. 1 of them: images/a.jpg: angles all zero."
    )
    assert reasons_by_count(unnamed) == "images/1.jpg: geo.txt has no row 1 of this name."


@pytest.mark.costly
@pytest.mark.parametrize(
    "paths, given, words",
    [
        ([], {}, "give a file of exposures, or scene=FILE"),
        ("scene.toml", {"scene": "scene.toml"}, "is itself a scene file"),
        ("scene.toml", {"height_datum": "ellipsoid"}, "height_datum= does not apply to scene files"),
        ("scene.toml", {"exposures": ["a"]}, "a scene has only one"),
        ("scene.toml", {"pixels": PIXELS, "shots": "shots.csv"}, "either pixels= or shots="),
        ("DJI_0042.JPG", {"shots": "shots.csv", **HOW}, r'shots="shots\.csv": use it with scene='),
        (
            "DJI_0042.JPG",
            {"exposures": ["b"], **HOW},
            r'exposures="b": no exposure has this name; known: DJI_0042\.JPG',
        ),
        ("DJI_0042.JPG", {"scene": "scene.toml", "camera": "focal=9px", **HOW}, "both give a camera"),
        ("flight.klv", {"scene": "scene.toml", **HOW}, r"flight\.klv already has a camera"),
        ("mission.sbet", HOW, r'has no camera; give scene="SCENE\.toml"\.$'),
        (["mission.sbet", "DJI_0042.JPG"], {"scene": "scene.toml", **HOW}, "locate them separately"),
        (["broken.JPG", "broken2.JPG"], HOW, r"none of 2 files can be read\. 1 of them: broken\.JPG: "),
    ],
)
def test_contradictions_are_refused(folder, paths, given: dict, words: str) -> None:
    (folder / "broken2.JPG").write_bytes(b"x")
    with pytest.raises(TableError, match=words):
        read_observations(paths, **given)


def test_a_scene_without_a_pose_has_no_pixels(folder) -> None:
    text = (folder / "scene.toml").read_text()
    pose, errors = text.index("[pose]"), text.index("[errors]")
    (folder / "bare.toml").write_text(text[:pose].replace("outer_deg", "#").replace("inner_deg", "#") + text[errors:])
    with pytest.raises(SceneError, match=r"\[pose\] is missing"):
        read_observations("bare.toml")
    with pytest.raises(SceneError, match=r"the vertical datum of the heights in shots\.csv is unknown"):
        read_observations("bare.toml", shots="shots.csv")


@pytest.mark.parametrize(
    "pixels", [[1.0, 2.0, 3.0], np.zeros((0, 2)), np.zeros((2, 2, 2))], ids=["three", "none", "grid"]
)
def test_pixels_have_two_coordinates(folder, pixels) -> None:
    with pytest.raises(ValueError, match="pixels must be"):
        read_observations("scene.toml", pixels)


def test_sources_of_a_batch_have_its_axis(folder) -> None:
    observed = read_observations("images", **HOW)
    own = for_each((Position.from_ned(north=1.0, east=2.0, down=3.0),), 2)
    assert observed.with_sources([own]).batches[0].sources == own
    _, (source,) = observed.with_sources([own]).at(1)
    np.testing.assert_array_equal(source.sigma, [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="zip"):
        observed.with_sources([])


def test_names_are_public() -> None:
    assert {"Observations", "ObservationBatch", "read_observations", "observations_of"} <= set(jaxgeo.io.__all__)
