"""Videos of DJI with their subtitles inside: the same exposures as from the subtitles beside them.

Held against: files of FFmpeg's muxer; the layout of ISO 14496-12 and 3GPP TS 26.245, written box by box.
"""

from __future__ import annotations

import json
import pathlib
import struct
import sys
from collections.abc import Callable

import numpy as np
import pytest
from support.command_runner import CliRunner
from support.video_files import muxed_video, texts_in, written_video

from jaxgeo import FrameCamera
from jaxgeo.cli import app
from jaxgeo.io import TableError, read_acquisition
from jaxgeo.io.acquisitions.usual_errors import with_usual_errors
from tests.io.test_by_time import numbers, video

av = pytest.importorskip("av")
SRT = video(dated=True)
STYLE = struct.pack(">I4sH", 10, b"styl", 0)


def cues(text: str) -> list[tuple[float, str]]:
    """(start in s, text) of each subtitle of `test_by_time.video`."""
    blocks = [block.split("\n", 2) for block in text.strip().split("\n\n")]
    return [(float(times.split(" ")[0].split(":")[2].replace(",", ".")), words) for _, times, words in blocks]


def made(path: pathlib.Path) -> None:
    muxed_video(path, cues(SRT))


WRITTEN: dict[str, Callable[[pathlib.Path], object]] = {
    "by FFmpeg": made,
    "by the layout": lambda path: path.write_bytes(written_video(cues(SRT))),
    "with styles": lambda path: path.write_bytes(written_video(cues(SRT), style=STYLE)),
    "with a damaged name": lambda path: path.write_bytes(
        written_video(cues(SRT)).replace(b"DJI.Subtitle", b"DJI.\xff\x80btitle")
    ),
    "UTF-16": lambda path: path.write_bytes(written_video(cues(SRT), encoding="utf-16")),
}


@pytest.mark.parametrize("how", WRITTEN)
@pytest.mark.parametrize("dated", [True, False], ids=["by the drone's clock", "by the video"])
def test_a_video_gives_the_exposures_of_its_subtitles(tmp_path, how: str, dated: bool, monkeypatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "SRT", video(dated=dated))
    WRITTEN[how](path := tmp_path / "DJI_0001.MP4")
    (beside := tmp_path / "DJI_0001.SRT").write_text(SRT, encoding="utf-8")
    ours, theirs = (read_acquisition(one, height_datum=12.0) for one in (path, beside))
    assert ours.form == "video of DJI"
    np.testing.assert_array_equal(numbers(ours), numbers(theirs))
    assert (ours.names.tolist(), ours.start) == (["1", "2", "3", "4"], theirs.start)
    assert with_usual_errors(ours).assumed == with_usual_errors(theirs).assumed
    moments = (read_acquisition(one, height_datum=12.0, times=["0:02.5", "9"]) for one in (path, beside))
    np.testing.assert_array_equal(*map(numbers, moments))


def test_the_muxer_wrote_what_the_layout_says(tmp_path) -> None:
    made(path := tmp_path / "clip.mp4")
    assert [text for text in texts_in(path.read_bytes()) if text] == [words for _, words in cues(SRT)]


def test_frames_have_the_size_of_the_camera(tmp_path) -> None:
    made(path := tmp_path / "clip.mp4")
    assert read_acquisition(path, height_datum=0.0).facts["image size"] == "64 x 48 pixels"
    camera = FrameCamera.from_pixels(focal_px=60.0, width=64, height=48)
    assert read_acquisition(path, height_datum=0.0, camera=camera).sensor is not None
    other = FrameCamera.from_pixels(focal_px=60.0, width=128, height=96)
    with pytest.raises(TableError, match=r"have 64 x 48 pixels, the camera 128 x 96; .* size=64x48"):
        read_acquisition(path, height_datum=0.0, camera=other)


def test_only_the_text_track_is_read(tmp_path) -> None:
    """Pictures of a video are gigabytes: bytes of theirs that are damaged are no matter."""
    made(path := tmp_path / "clip.mp4")
    data = bytearray(path.read_bytes())
    first = data.index(b"[latitude")
    begin = data.index(b"mdat") + 4
    assert first - begin > 300  # pictures of two seconds
    data[begin : first - 64] = b"\xff" * (first - 64 - begin)
    path.write_bytes(data)
    assert len(read_acquisition(path, height_datum=0.0)) == 4


REFUSED: dict[str, tuple[Callable[[pathlib.Path], object], str]] = {
    "no text": (lambda path: muxed_video(path, cues(SRT), text=False), r"without subtitles\. Give the subtitle file"),
    "not closed": (
        lambda path: path.write_bytes(struct.pack(">I4s4sI4s", 20, b"ftyp", b"isom", 512, b"isom") + b"\0" * 99),
        r"FFmpeg cannot read this as a video: .* lacks its index",
    ),
    "empty texts": (lambda path: path.write_bytes(written_video([(0.0, " "), (1.0, "")])), "are empty"),
    "no angles": (
        lambda path: path.write_bytes(written_video([(0.0, "GPS(11.0,47.0,16)")])),
        "no angles of the camera",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_video_without_telemetry_is_refused(tmp_path, what: str) -> None:
    make, words = REFUSED[what]
    make(path := tmp_path / "DJI_0001.MP4")
    with pytest.raises(TableError, match=words):
        read_acquisition(path, height_datum=0.0)
    result = CliRunner().invoke(app, ["inspect", str(path), "--camera-datum", "0"])
    assert result.exit_code == 2
    assert str(path) in result.stderr


def test_without_pyav_it_says_what_to_install(tmp_path, monkeypatch) -> None:
    made(path := tmp_path / "clip.mp4")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"Videos are read by PyAV: pip install 'jaxgeo\[video\]'"):
        read_acquisition(path, height_datum=0.0)


def test_the_command_line_takes_a_moment_of_a_video(tmp_path) -> None:
    made(path := tmp_path / "DJI_0001.MP4")
    result = CliRunner().invoke(app, ["inspect", str(path), "--camera-datum", "0", "--time", "0:02.5", "--json"])
    assert result.exit_code == 0, result.output
    assert [row["name"] for row in json.loads(result.stdout)["exposures"]] == ["00:00:02.5"]
