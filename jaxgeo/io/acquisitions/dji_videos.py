"""DJI videos (MP4, MOV) that carry their subtitles in a track of their own: a telemetry record for each frame."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from jaxgeo._checks import require_x64
from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions.dji_subtitles import acquisition_of_cues
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.acquisitions.transport_stream import LOCAL, pyav
from jaxgeo.io.errors import TableError
from jaxgeo.sensor import FrameCamera

FORM = "video of DJI"
TYPE = b"ftyp"  # of the first box of a file, after its length
STILLS = (b"heic", b"heix", b"mif1", b"msf1", b"avif")  # brands of images in such files
MARK = {b"\xfe\xff": "utf-16-be", b"\xff\xfe": "utf-16-le"}
BESIDE = (
    "Give the subtitle file (.SRT) that the drone wrote beside it, or a log of the flight: AirData's CSV has the "
    "angles of the camera."
)


class _Track(NamedTuple):
    """Subtitles of a video, (start in s, text) each, and the (width, height) of its frames, None if unknown."""

    cues: list[tuple[float, str]]
    image_size: tuple[int, int] | None


def is_video(head: bytes) -> bool:
    """Whether these first bytes are of an MP4 or MOV file (ISO 14496-12), and not of an image of that form."""
    return head[4:8] == TYPE and head[8:12] not in STILLS


def read_dji_video(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the frames of a DJI video from the subtitles in its text track (3GPP TS 26.245), as `read_dji_subtitles`.

    Only these are read, no pictures. Drones write the track where video captions are switched on. The options are
    those of `read_dji_subtitles`; the size of `cameras` must be that of the frames.

    Raises as `read_dji_subtitles`; `TableError` for a video without such a track, one that FFmpeg cannot read, and a
    camera of another size; `ImportError` without PyAV.
    """
    require_x64()
    check_regular(path, TableError)
    track = _text_track(path)
    size = track.image_size
    if cameras is not None and size is not None and (cameras.width, cameras.height) != size:
        raise TableError(
            f"{path}: the frames of this video have {size[0]} x {size[1]} pixels, the camera {cameras.width} x "
            f"{cameras.height}; give the camera for size={size[0]}x{size[1]}."
        )
    how = {"height_datum": height_datum, "takeoff_height": takeoff_height, "cameras": cameras, "camera": camera}
    facts = {} if size is None else {"image size": f"{size[0]} x {size[1]} pixels"}
    return acquisition_of_cues(path, FORM, track.cues, **how, facts=facts)


def _text_track(path: str | os.PathLike[str]) -> _Track:
    av = pyav("Videos")
    try:
        with av.open(os.fspath(path), format="mov", options=LOCAL, metadata_errors="replace") as container:
            video = container.streams.video
            codec = video[0].codec_context if video else None  # None if FFmpeg has no decoder
            size = (int(codec.width), int(codec.height)) if codec is not None else (0, 0)
            texts = [one for one in container.streams if one.type == "subtitle"]
            if not texts:
                raise TableError(f"{path}: this is a video (MP4 or MOV) without subtitles. {BESIDE}")
            cues = _cues(container, texts[0], getattr(av.stream, "Discard", None))
    except av.FFmpegError as error:
        raise TableError(
            f"{path}: FFmpeg cannot read this as a video: {error.strerror}. A recording that was not closed lacks its "
            f"index; repair it, or copy it again. {BESIDE}"
        ) from error
    if not cues:
        raise TableError(f"{path}: the subtitles of this video are empty. {BESIDE}")
    return _Track(cues, size if min(size) > 0 else None)


def _cues(container: Any, texts: Any, discard: Any) -> list[tuple[float, str]]:
    """The subtitles of a stream; the samples of others are not even read where PyAV can say so."""
    for stream in container.streams:
        if stream.index != texts.index and discard is not None:
            stream.discard = discard.all
    samples = ((packet.pts, bytes(packet)) for packet in container.demux(texts) if packet.pts is not None)
    cues = ((float(start * texts.time_base), _text(sample)) for start, sample in samples)
    return [(start, text) for start, text in cues if text.strip()]  # an empty one ends the one before


def _text(sample: bytes) -> str:
    """The text of a sample: its length in 2 bytes, then UTF-8, or UTF-16 with its mark; boxes of style follow."""
    text = sample[2 : 2 + int.from_bytes(sample[:2], "big")]
    return text[2:].decode(MARK[text[:2]], "replace") if text[:2] in MARK else text.decode("utf-8", "replace")
