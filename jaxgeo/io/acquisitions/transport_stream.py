"""MPEG transport streams: embedded KLV and the video size."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions.klv import UAS_LOCAL_SET, other_sets
from jaxgeo.io.errors import TableError

SYNC = 0x47  # first byte of each packet of a transport stream
PACKETS = {188: 0, 192: 4, 204: 0}  # packet size (plain, with timecode, with check bytes): offset of SYNC
HEAD = 4 * 204  # bytes needed for detection
LOCAL = {"protocol_whitelist": "file"}  # FFmpeg opens no other


class Carried(NamedTuple):
    """The KLV of a transport stream, joined, and the (width, height) of its video, None without one."""

    data: bytes
    image_size: tuple[int, int] | None


def is_transport_stream(head: bytes) -> bool:
    """Whether these first bytes are of a transport stream."""
    return any(
        len(head) > start + 3 * size and all(head[start + k * size] == SYNC for k in range(4))
        for size, start in PACKETS.items()
    )


def read_transport_stream(path: str | os.PathLike[str], stream: int | None = None) -> Carried:
    """Read the KLV of a transport stream: of its only data stream with ST 0601 packets, or of stream `stream`.

    Access unit headers (ST 1402, synchronous KLV) stay between the packets. Raises `TableError` for a file that
    cannot be demultiplexed, one without such packets and one with several such streams; `ImportError` without PyAV.
    """
    check_regular(path, TableError)
    av = pyav("Transport streams")
    try:
        with av.open(os.fspath(path), format="mpegts", options=LOCAL, metadata_errors="replace") as container:
            data = _data_streams(container)
            video = container.streams.video
            codec = video[0].codec_context if video else None  # None if FFmpeg has no decoder
            size = (int(codec.width), int(codec.height)) if codec is not None else None
    except av.FFmpegError as error:
        raise TableError(f"{path}: FFmpeg cannot read this as a transport stream: {error.strerror}.") from error
    chosen = _chosen(path, data, stream)
    return Carried(data[chosen], size if size and min(size) > 0 else None)


def _data_streams(container: Any) -> dict[int, bytes]:
    """The bytes of every data stream, by its index."""
    streams = container.streams.data
    parts: dict[int, list[bytes]] = {one.index: [] for one in streams}
    if streams:
        for packet in container.demux(streams):
            parts[packet.stream.index].append(bytes(packet))
    return {index: b"".join(pieces) for index, pieces in parts.items()}


def _chosen(path: str | os.PathLike[str], data: dict[int, bytes], stream: int | None) -> int:
    if stream is not None:
        if stream not in data:
            raise TableError(f"{path}: stream={stream} is no data stream; those are {_listed(data)}.")
        return stream
    ours = [index for index, content in data.items() if UAS_LOCAL_SET in content]
    if not ours:
        others = dict.fromkeys(words for content in data.values() for words in other_sets(content))
        held = f"they hold {' and '.join(others)}" if others else "they hold none"
        raise TableError(
            f"{path}: no packets of MISB ST 0601 in this transport stream; data streams: {_listed(data)}; {held}."
        )
    if len(ours) > 1:
        raise TableError(f"{path}: streams {_listed(ours)} hold packets of MISB ST 0601; choose one with stream=.")
    return ours[0]


def _listed(indices: Any) -> str:
    return ", ".join(str(index) for index in indices) or "none"


def pyav(read: str) -> Any:
    """The module `av`, by which something is read. Raises `ImportError`, with what to install."""
    try:
        import av
    except ImportError as error:
        raise ImportError(f"{read} are read by PyAV: pip install 'jaxgeo[video]'.") from error
    return av
