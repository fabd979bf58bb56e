"""Files that were not copied to their end: refused in a line that says so.

Held against: what a card or a disk leaves of a file that was not written to its end: blocks of zero bytes, or nothing.
"""

from __future__ import annotations

import pathlib

import pytest

from jaxgeo.io import TableError, read_acquisition, read_acquisitions

ROW = b"image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg\na,43.7,4.6,1800,350,30,-1.5\n"
DAMAGED = {
    "zero bytes": (bytes(4096), "the file has only zero bytes: copy it again"),
    "blanks": (b"\xef\xbb\xbf\r\n \r\n", "the file has only blanks: copy it again"),
    "zeros after text": (ROW + bytes(512), f"it is text up to byte {len(ROW)}, and zero bytes from there"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_was_not_copied_whole(tmp_path: pathlib.Path, name: str) -> None:
    content, words = DAMAGED[name]
    path, sound = tmp_path / "table.csv", tmp_path / "sound.csv"
    path.write_bytes(content)
    sound.write_bytes(ROW)
    with pytest.raises(TableError, match=words) as refusal:
        read_acquisition(path, height_datum=0.0)
    assert "\n" not in str(refusal.value)
    found = read_acquisitions([path, sound], height_datum=0.0)
    assert [one.path for one in found.unread] == [str(path)]
    assert [one.path for one in found.parts] == [str(sound)]
