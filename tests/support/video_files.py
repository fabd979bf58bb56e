"""MP4 files with a text track: by FFmpeg's muxer, and box by box from the published layout; a plain reader of them."""

from __future__ import annotations

import fractions
import pathlib
import struct
from collections.abc import Iterator, Sequence

Cues = Sequence[tuple[float, str]]  # start in s, text
TICKS = 1000  # a second
RATE = 30
HANDLERS = (b"text", b"sbtl", b"subt")
STYLES = (
    b"[Script Info]\nScriptType: v4.00+\n\n[V4+ Styles]\nFormat: Name, Fontname\nStyle: Default,Arial\n\n[Events]\n"
)


def muxed_video(path: pathlib.Path, cues: Cues, size: tuple[int, int] = (64, 48), text: bool = True) -> None:
    """A video of FFmpeg's, of black frames, one tenth of a second longer than its last cue; without its text track."""
    import av

    with av.open(str(path), "w", format="mp4") as container:
        video = container.add_stream("mpeg4", rate=RATE)
        video.width, video.height, video.pix_fmt = *size, "yuv420p"
        if text:
            texts = container.add_stream("mov_text")
            texts.time_base = fractions.Fraction(1, TICKS)
            texts.codec_context.subtitle_header = STYLES
        for number in range(round(RATE * (cues[-1][0] + 0.1))):
            frame = av.VideoFrame(*size, "yuv420p")
            frame.pts = number
            container.mux(video.encode(frame))
        container.mux(video.encode())
        for start, words in cues if text else ():
            packet = av.Packet(_sample(words.encode()))
            packet.stream, packet.time_base, packet.duration = texts, texts.time_base, TICKS // RATE
            packet.pts = packet.dts = round(TICKS * start)
            container.mux(packet)


def written_video(cues: Cues, *, encoding: str = "utf-8", style: bytes = b"") -> bytes:
    """A movie with a text track only, by ISO 14496-12 and 3GPP TS 26.245, with empty samples between the cues."""
    samples, lasting, at = [], [], 0
    for start, words in cues:
        if round(TICKS * start) > at:
            samples.append(_sample(b""))
            lasting.append(round(TICKS * start) - at)
        samples.append(_sample(words.encode(encoding)) + style)
        lasting.append(TICKS // RATE)
        at = round(TICKS * start) + TICKS // RATE
    kind = _box(b"ftyp", b"isom" + struct.pack(">I", 512) + b"isomiso2")
    data = _box(b"mdat", b"".join(samples))
    return kind + data + _box(b"moov", _header(b"mvhd", sum(lasting)) + _track(samples, lasting, len(kind) + 8))


def texts_in(data: bytes) -> Iterator[str]:
    """The texts of all text tracks, read by walking the boxes."""
    for name, track in _walk(_only(data, b"moov")):
        table = _only(track, b"mdia", b"minf", b"stbl")
        is_text = _only(track, b"mdia", b"hdlr")[8:12] in HANDLERS or _only(table, b"stsd")[12:16] == b"tx3g"
        if name == b"trak" and is_text:
            each, count = struct.unpack(">II", _only(table, b"stsz")[4:12])
            sizes = [each] * min(count, 9999) if each else _numbers(_only(table, b"stsz")[12:])[:count]
            chunks = _numbers(_only(table, b"stco")[8:])
            runs = _numbers(_only(table, b"stsc")[8:])
            per_chunk = dict(zip(runs[::3], runs[1::3], strict=False))
            held = 0
            for number, offset in enumerate(chunks, start=1):
                held = per_chunk.get(number, held)
                for size in sizes[:held]:
                    length = int.from_bytes(data[offset : offset + 2], "big")
                    yield data[offset + 2 : offset + min(size, 2 + length)].decode("utf-8", "replace")
                    offset += size
                sizes = sizes[held:]


def _walk(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while len(data) - at >= 8:
        size = int.from_bytes(data[at : at + 4], "big") or len(data) - at
        if size < 8:
            return
        yield data[at + 4 : at + 8], data[at + 8 : at + size]
        at += size


def _only(data: bytes, *names: bytes) -> bytes:
    for name in names:
        data = next((body for found, body in _walk(data) if found == name), b"\0" * 12)
    return data


def _numbers(data: bytes) -> list[int]:
    return list(struct.unpack(f">{len(data) // 4}I", data[: len(data) // 4 * 4]))


def _sample(text: bytes) -> bytes:
    return struct.pack(">H", len(text)) + text


def _box(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", 8 + len(body)) + name + body


def _full(name: bytes, body: bytes, flags: int = 0) -> bytes:
    return _box(name, struct.pack(">I", flags) + body)


def _table(name: bytes, entries: Sequence[Sequence[int]]) -> bytes:
    numbers = [one for entry in entries for one in entry]
    return _full(name, struct.pack(f">{1 + len(numbers)}I", len(entries), *numbers))


def _header(name: bytes, duration: int) -> bytes:
    """Header of the movie (`mvhd`), 100 bytes."""
    unit = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)
    return _full(name, struct.pack(">4IIH10x", 0, 0, TICKS, duration, 0x10000, 0x100) + unit + struct.pack(">24xI", 2))


def _track(samples: Sequence[bytes], lasting: Sequence[int], offset: int) -> bytes:
    unit = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)
    head = struct.pack(">5I8x4H", 0, 0, 1, 0, sum(lasting), 0, 0, 0, 0) + unit + struct.pack(">II", 640 << 16, 60 << 16)
    entry = struct.pack(">6xHIbb4B4H2H2B4B", 1, 0, 1, -1, 0, 0, 0, 0, 0, 0, 60, 640, 0, 0, 1, 18, 255, 255, 255, 255)
    fonts = _box(b"ftab", struct.pack(">HHB", 1, 1, 5) + b"Serif")
    table = (
        _full(b"stsd", struct.pack(">I", 1) + _box(b"tx3g", entry + fonts))
        + _table(b"stts", [(1, one) for one in lasting])
        + _table(b"stsc", [(1, len(samples), 1)])
        + _full(b"stsz", struct.pack(f">II{len(samples)}I", 0, len(samples), *map(len, samples)))
        + _table(b"stco", [(offset,)])
    )
    beside = _box(b"dinf", _full(b"dref", struct.pack(">I", 1) + _full(b"url ", b"", 1)))
    media = (
        _full(b"mdhd", struct.pack(">4IHH", 0, 0, TICKS, sum(lasting), 0x55C4, 0))
        + _full(b"hdlr", struct.pack(">I4s12x", 0, b"text") + b"DJI.Subtitle\0")
        + _box(b"minf", _full(b"nmhd", b"") + beside + _box(b"stbl", table))
    )
    return _box(b"trak", _full(b"tkhd", head, 7) + _box(b"mdia", media))
