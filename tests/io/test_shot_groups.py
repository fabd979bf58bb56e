"""Exposures of several cameras and flights by the names and times of images."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from jaxgeo.io import TableError, flights_by_time, shots_by_name, shots_by_time
from jaxgeo.io.shot_groups import stated_groups


@pytest.mark.parametrize(
    "names, shot, camera",
    [
        (["DJI_0001_T.JPG", "DJI_0001_W.JPG", "DJI_0002_T.JPG"], [0, 0, 1], ["T", "W", "T"]),
        (["DJI_0001_MS_NIR.TIF", "DJI_0001_D.JPG", "DJI_0001_MS_R.TIF"], [0, 0, 0], ["MS_NIR", "D", "MS_R"]),
        (["IMG_0001_1.tif", "IMG_0001_5.tif", "IMG_0002_10.tif"], [0, 0, 1], ["1", "5", "10"]),
        (["IMG_160908_142347_0001_GRE.TIF", "IMG_160908_142347_0001_RED.TIF"], [0, 0], ["GRE", "RED"]),
        (["a/IMG_1_1.tif", "b/IMG_1_2.tif"], [0, 1], ["1", "2"]),
        (["IMG_0001.jpg", "IMG_0002.jpg"], [0, 1], ["-", "-"]),
        (["left-0001-l.png", "left-0001-r.png", "left-0002.png"], [0, 0, 1], ["l", "r", "-"]),
        (
            [
                "DJI_20240510102031_0001_T.JPG",
                "DJI_20240510102032_0001_W.JPG",
                "DJI_20240510115959_0001_T.JPG",
                "DJI_20240510115959_0001_W.JPG",
                "DJI_20240510102033_0002_T.JPG",
            ],
            [0, 0, 1, 1, 2],
            ["T", "W", "T", "W", "T"],
        ),
    ],
    ids=["lenses", "bands", "numbers", "Sequoia", "folders", "one camera", "dashes", "dates"],
)
def test_names_that_differ_in_their_last_part_are_of_one_exposure(names, shot, camera) -> None:
    found = shots_by_name(names)
    assert found[0].tolist() == shot
    assert found[1].tolist() == camera
    order = np.random.default_rng(0).permutation(len(names))
    again = shots_by_name([pathlib.Path(names[k]) for k in order])[0]
    same = np.equal.outer(found[0], found[0])[np.ix_(order, order)]
    assert np.array_equal(np.equal.outer(again, again), same)


def test_times_within_the_limit_are_of_one_exposure_but_not_two_of_one_camera() -> None:
    time = [10.0, 10.05, 12.0, 12.15, 12.3, 14.0, 14.05]
    assert shots_by_time(time, list("ababcaa"), 0.2).tolist() == [0, 0, 1, 1, 2, 3, 4]
    assert shots_by_time(time, list("ababcaa"), 0.4).tolist() == [0, 0, 1, 1, 1, 2, 3]
    order = np.array([3, 6, 0, 5, 2, 1, 4])
    shuffled = shots_by_time(np.array(time)[order], np.array(list("ababcaa"))[order], 0.4)
    assert shuffled.tolist() == np.array([0, 0, 1, 1, 1, 2, 3])[order].tolist()


def test_a_gap_begins_another_flight() -> None:
    assert flights_by_time([5000.0, 1.0, 3.0, 5030.0, 9000.0], 60.0).tolist() == [1, 0, 0, 1, 2]
    with pytest.raises(ValueError, match=r"the time of image 1 is unknown \(2 such images\)"):
        flights_by_time([1.0, 0.0, np.nan], 60.0)


def test_columns_of_a_table_are_read_by_image(tmp_path: pathlib.Path) -> None:
    table = tmp_path / "poses.csv"
    header = "image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg"
    table.write_text(f"{header},Shot,camera\na,47,11,600,0,0,0,3,w\nb,47,11,600,0,0,0,3,t\n")
    assert stated_groups(table) == {"a": {"shot": "3", "camera": "w"}, "b": {"shot": "3", "camera": "t"}}
    table.write_text(f"{header}\na,47,11,600,0,0,0\n")
    assert stated_groups(table) == {}
    table.write_text(f"{header},shot\na,47,11,600,0,0,0,\n")
    with pytest.raises(TableError, match=r"shot.*the name is empty"):
        stated_groups(table)
