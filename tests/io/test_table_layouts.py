"""Tables as other programs save them: separators, decimal commas, comments and encodings, the same in every reader.

Held against: what Excel and LibreOffice save (semicolons and decimal commas in German and French, "Unicode text" in
UTF-16 with tabs, `sep=;`), and against the headers of Metashape, RealityCapture and MicMac, which are comments.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from jaxgeo.io import TableError, read_gcp_list, read_image_points, read_navigation, read_orientations
from jaxgeo.io.tables import read_shots

POSE = "lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg"
TABLES = {  # what is read, with commas between columns and points in decimals; names hold letters beyond ASCII
    "shots": (f"name,{POSE},u,v\nFjäll 1,36.3,-84.25,900.5,30.0,20.5,-0.5,10.5,20.25\nB,36.4,-84.5,901.0,31,2,1,1,2\n"),
    "navigation": f"time_s,{POSE},näme\n0.5,36.3,-84.25,900.5,30.0,20.5,-0.5,x\n1.5,36.3001,-84.25,901.0,31.5,2,1,y\n",
    "orientations": f"image,{POSE}\nFjäll.JPG,36.3,-84.25,900.5,30.0,20.5,-0.5\nB.JPG,36.4,-84.5,901.0,31.5,2,1\n",
    "image points": "image,point,u,v\nFjäll.JPG,p1,10.5,20.25\nB.JPG,p2,1.5,2\n",
}


def of_shots(path: pathlib.Path) -> Any:
    return read_shots(path, ()).numbers


def of_orientations(path: pathlib.Path) -> Any:
    found = read_orientations(path, height_datum="ellipsoid")
    return found.names.tolist(), found.pose


def of_points(path: pathlib.Path) -> Any:
    found = read_image_points(path)
    return found.image.tolist(), found.point.tolist(), found.uv


READERS: dict[str, Callable[[pathlib.Path], Any]] = {
    "shots": of_shots,
    "navigation": lambda path: read_navigation(path, height_datum="ellipsoid", longest_gap=5.0),
    "orientations": of_orientations,
    "image points": of_points,
}
LAYOUTS: dict[str, Callable[[str], bytes]] = {
    "semicolons": lambda text: text.replace(",", ";").encode(),
    "tabs": lambda text: text.replace(",", "\t").encode(),
    "bars": lambda text: text.replace(",", "|").encode(),
    "white space": lambda text: text.replace(" ", "_").replace(",", "   ").encode(),
    "decimal commas": lambda text: text.replace(",", ";").replace(".J", "J").replace(".", ",").encode(),
    "decimal commas, tabs": lambda text: text.replace(",", "\t").replace(".J", "J").replace(".", ",").encode(),
    "Excel's sep": lambda text: ("sep=;\r\n" + text.replace(",", ";")).encode(),
    "comments": lambda text: ("# made by me, today; so\n\n#\n" + text.replace("\n", "\n# more\n", 1)).encode(),
    "header in a comment": lambda text: ("# a title\n#" + text).encode(),
    "lines of Windows": lambda text: text.replace("\n", "\r\n").encode(),
    "lines of old Macs": lambda text: text.replace("\n", "\r").encode(),
    "blank lines": lambda text: ("\n\n" + text.replace("\n", "\n\n")).encode(),
    "mark of UTF-8": lambda text: text.encode("utf-8-sig"),
    "UTF-16": lambda text: text.replace(",", "\t").encode("utf-16"),
    "UTF-16 without a mark": lambda text: text.encode("utf-16-le"),
    "Windows 1252": lambda text: text.encode("cp1252"),
}


def plain(found: Any) -> list[Any]:
    return [np.asarray(leaf).tolist() for leaf in jax.tree.leaves(found) if not isinstance(leaf, str)]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("reader", READERS)
def test_every_layout_gives_the_same_numbers(tmp_path: pathlib.Path, reader: str, layout: str) -> None:
    text = TABLES[reader]
    (tmp_path / "plain.csv").write_text(text, encoding="utf-8")
    (tmp_path / "laid_out.csv").write_bytes(LAYOUTS[layout](text))
    expected, found = (READERS[reader](tmp_path / name) for name in ("plain.csv", "laid_out.csv"))
    assert plain(found) == plain(expected)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_names_keep_their_letters(tmp_path: pathlib.Path, encoding: str) -> None:
    path = tmp_path / "eo.csv"
    path.write_bytes(TABLES["orientations"].encode(encoding))
    assert of_orientations(path)[0] == ["Fjäll.JPG", "B.JPG"]


def test_control_points_are_read_in_any_encoding_and_with_decimal_commas(tmp_path: pathlib.Path) -> None:
    text = "WGS84 UTM 51N\n292710.5\t2731048.25 186.4 10.5 20.5 Fjäll.JPG a\n292711.5 2731048 186.5 1 2 B.JPG b\n"
    path = tmp_path / "gcp.txt"
    path.write_text(text, encoding="utf-8")
    expected = read_gcp_list(path, height_datum="ellipsoid")
    for encoding in ("utf-16", "cp1252"):
        path.write_bytes(text.replace(".J", "J").replace(".", ",").encode(encoding))
        found = read_gcp_list(path, height_datum="ellipsoid")
        np.testing.assert_array_equal(found.position.lat, expected.position.lat)
        np.testing.assert_array_equal(found.points.uv, expected.points.uv)
        assert found.points.image.tolist() == ["FjällJPG", "BJPG"]


HEADER, ROW = TABLES["orientations"].splitlines()[:2]
REFUSED = {
    "commas between and in numbers": (f"{HEADER}\n{ROW.replace('.', ',')}\n", ["decimals are written with commas"]),
    "both signs": (f"{HEADER}\n{ROW}\n".replace(",", ";").replace("900.5", "900,5"), ["'900,5' is not a number"]),
    "thousands": (f"{HEADER}\n{ROW}\n".replace(",", ";").replace("900.5", "1,900.5"), ["'1,900.5' is not a number"]),
    "quoted": (f"{HEADER}\n{ROW}\n".replace("900.5", '"900,5"'), ["row 2, column height_m: '900,5'", "semicolons"]),
    "a row that may be a comment": (f"{HEADER}\n#{ROW}\n{ROW}\n", ["row 2: it begins with #"]),
    "only comments": ("# a\n# b\n", ["all that is there are comments"]),
    "open quotes": (f'{HEADER}\n"{ROW}\n', ["not a table"]),
    "empty": (" \n", ["is empty"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_told_is_refused_with_the_reason(tmp_path: pathlib.Path, case: str) -> None:
    text, words = REFUSED[case]
    path = tmp_path / "eo.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(TableError) as refusal:
        read_orientations(path, height_datum="ellipsoid")
    assert "\n" not in str(refusal.value)
    for word in (str(path), *words):
        assert word in str(refusal.value)


@pytest.mark.parametrize("content", [b"\x00\x01\x02" * 50, b"\x89PNG\r\n\x1a\n", b"a,b\n1,\x81\n"])
@pytest.mark.parametrize("read", [of_shots, of_orientations, of_points])
def test_what_is_no_text_is_refused(tmp_path: pathlib.Path, read: Any, content: bytes) -> None:
    path = tmp_path / "eo.csv"
    path.write_bytes(content)
    with pytest.raises(TableError, match="not a text file"):
        read(path)


def test_a_name_that_begins_with_a_hash_is_read_in_quotes(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "eo.csv"
    path.write_text(f'{HEADER}\n"#{ROW.replace(",", chr(34) + ",", 1)}\n', encoding="utf-8")
    assert of_orientations(path)[0] == ["#Fjäll.JPG"]


UNKNOWN = ["", "nan", "NaN", "n/a", "null", "-", "-9999", "-9999.0", "-32768"]


@pytest.mark.parametrize("written", UNKNOWN)
def test_what_is_written_where_nothing_is_known_is_no_number(tmp_path: pathlib.Path, written: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(TABLES["shots"].replace("30.0", written), encoding="utf-8")
    found = read_shots(path, ())
    assert np.isnan(found.numbers["heading_deg"][0])
    assert found.rows[0]["heading_deg"] == "nan"
    path.write_text(TABLES["orientations"].replace("30.0", written), encoding="utf-8")
    with pytest.raises(TableError, match="column heading_deg: unknown"):
        read_orientations(path, height_datum="ellipsoid")


def test_latitude_and_longitude_zero_are_no_position(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "table.csv"
    zero = {name: TABLES[name].replace("36.3,-84.25", "0.0,0") for name in ("shots", "orientations", "navigation")}
    path.write_text(zero["shots"], encoding="utf-8")
    found = read_shots(path, ())
    assert np.isnan(found.numbers["lat_deg"][0])
    assert found.rows[0]["lon_deg"] == "nan"
    for name in ("orientations", "navigation"):
        path.write_text(zero[name], encoding="utf-8")
        with pytest.raises(TableError, match="row 2, column lat_deg: latitude and longitude are zero"):
            READERS[name](path)
