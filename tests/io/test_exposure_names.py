"""Names of exposures of several files: the file of each is known, and a name asks for the same exposure again."""

from __future__ import annotations

import pathlib
import shutil

import numpy as np
import pytest
from support.drone_image_files import packet, write_image
from support.klv_packets import local_set, usual
from test_sbet import flight

from jaxgeo.io import TableError, read_acquisitions, read_observations
from jaxgeo.io.observation_reader import _other_name

DJI = {
    "drone-dji:GpsLatitude": "+47.1",
    "drone-dji:GpsLongitude": "+8.2",
    "drone-dji:AbsoluteAltitude": "+700.0",
    "drone-dji:GimbalYawDegree": "+160.00",
    "drone-dji:GimbalPitchDegree": "-60.00",
    "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:CalibratedFocalLength": "3666.67",
}


@pytest.fixture
def files(tmp_path: pathlib.Path) -> dict[str, pathlib.Path]:
    """A video of three packets and a copy in another folder, a trajectory, an image."""
    video, track = tmp_path / "a.ts", tmp_path / "b.out"
    video.write_bytes(local_set(usual()) * 3)
    track.write_bytes(flight()[:4].astype("<f8").tobytes())
    (tmp_path / "other").mkdir()
    other = pathlib.Path(shutil.copy(video, tmp_path / "other" / "a.ts"))
    image = write_image(tmp_path / "c.jpg", packet(DJI), make="DJI")
    return {"video": video, "track": track, "image": image, "other": other}


def names_of(*paths: pathlib.Path) -> list[str]:
    found = read_acquisitions(paths, height_datum="ellipsoid")
    placed = [
        (int(place), str(name))
        for part, places in zip(found.parts, found.places, strict=True)
        for place, name in zip(places, part.names, strict=True)
    ]
    return [name for _, name in sorted(placed)]


def test_records_are_named_with_their_file(files) -> None:
    names = names_of(files["video"], files["track"], files["image"])
    assert names == [*(f"a.ts/{k}" for k in range(3)), *(f"b.out/{k}" for k in range(4)), "c.jpg"]


def test_names_do_not_depend_on_the_other_files(files, tmp_path: pathlib.Path) -> None:
    damaged = tmp_path / "d.jpg"
    damaged.write_bytes(files["image"].read_bytes()[:500])
    own = names_of(files["video"], files["image"])[:3]
    for others in ([files["track"]], [damaged], [files["track"], files["image"], damaged]):
        assert names_of(files["video"], *others)[:3] == own
        assert names_of(*others, files["video"])[-3:] == own


def test_files_of_one_name_are_named_by_their_paths(files) -> None:
    names = names_of(files["video"], files["other"], files["image"])
    assert names == [*(f"{files[one]}/{k}" for one in ("video", "other") for k in range(3)), "c.jpg"]


def test_a_file_alone_has_the_names_of_its_records(files) -> None:
    assert names_of(files["video"]) == ["0", "1", "2"]


def rows_of(paths: list[pathlib.Path], *exposures: str) -> list[dict]:
    return read_observations(paths, exposures=exposures, height_datum="ellipsoid").columns


@pytest.mark.parametrize("kinds", [("video", "image"), ("video", "other", "image"), ("video",)], ids=str)
def test_every_name_asks_for_its_own_exposure(files, kinds: tuple[str, ...]) -> None:
    paths = [files[kind] for kind in kinds]
    rows = rows_of(paths)
    assert len({row["name"] for row in rows}) == len(rows)
    for row in rows:
        (again,) = rows_of(paths, row["name"])
        assert again == row


def test_a_name_among_several_files_serves_for_its_file_alone(files) -> None:
    for name in ("a.ts/2", f"{files['video']}/2", "2"):
        (row,) = rows_of([files["video"]], name)
        assert row["name"] == "2"
    for name in ("b.ts/2", "a.ts/7", "a.ts/"):
        with pytest.raises(TableError, match=f'exposures="{name}": no exposure has this name; known: 0, 1, 2'):
            rows_of([files["video"]], name)


@pytest.mark.parametrize(
    "given, known, found",
    [
        ("a", ["a.jpg", "b.jpg"], "a.jpg"),
        ("a.tif", ["a", "b"], "a"),
        ("a.tif", ["a.jpg"], None),
        ("a", ["a.jpg", "a.tif"], None),
        ("1.5", ["1", "2"], None),
        ("2", ["2.5"], None),
    ],
)
def test_an_image_may_be_named_without_its_suffix_or_with_one(given: str, known: list[str], found: str | None) -> None:
    """If that is no other one; numbers of records have none."""
    assert _other_name(given, known) == found


def test_the_suffix_of_an_image_may_be_left_out(files) -> None:
    (row,) = rows_of([files["image"], files["video"]], "c")
    assert row["name"] == "c.jpg"


def test_positions_of_a_file_are_those_of_its_own_rows(files) -> None:
    found = read_acquisitions([files["image"], files["video"]], height_datum="ellipsoid")
    alone = read_acquisitions([files["video"]], height_datum="ellipsoid").parts[0]
    part = next(one for one in found.parts if one.names[0].startswith("a.ts"))
    np.testing.assert_array_equal(part.shots.pose.position.lat, alone.shots.pose.position.lat)
