"""KLV parser: keys, lengths and values in a byte stream (SMPTE ST 336), as in MISB ST 0601 local sets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxgeo.io.limits import PACKET_ITEMS

UAS_LOCAL_SET = bytes.fromhex("060e2b34020b01010e01030101000000")
# Keys of other sets in video streams, by the SMPTE registry and the MISB standards.
OTHER_SETS = {
    bytes.fromhex("060e2b34020101010e01010201010000"): "MISB EG 0104, the universal set that ST 0601 has replaced",
    bytes.fromhex("060e2b34020b01010e01030306000000"): "MISB ST 0903, moving targets (VMTI)",
    bytes.fromhex("060e2b34020301010e0103031e000000"): "MISB ST 0903, tracks (VTrack)",
    bytes.fromhex("060e2b34020301010e01030302000000"): "MISB ST 0102, security metadata",
    bytes.fromhex("060e2b34020101010208020000000000"): "MISB ST 0102, security metadata (universal set)",
    bytes.fromhex("060e2b34020b01010e01030102000000"): "MISB ST 0806, remote video terminals",
    bytes.fromhex("060e2b34020301010e01030502000000"): "MISB ST 0808, ancillary text",
    bytes.fromhex("060e2b34020b01010e0103030d000000"): "MISB ST 1206, SAR motion imagery",
}
LEADING = UAS_LOCAL_SET[:4]  # of every key
MOST_WITHIN = 2  # further keys that a packet may span; with more it is not parsed
CHECKSUM_ITEM = b"\x01\x02"  # tag and length of the checksum, which is the last item
LONGEST_NUMBER = 8  # bytes of a length or a tag; more is noise

Items = tuple[tuple[int, bytes], ...]


class Packet(NamedTuple):
    """A local set: the offset of its key and its size in bytes, its (tag, value) pairs, and its damage.

    `damage` is "" for a packet with a correct checksum. A damaged one has items only if all of them can be separated.
    """

    offset: int
    size: int
    items: Items
    damage: str


class _Unreadable(ValueError):
    """Bytes that are not a valid length, tag or item."""


def packets(data: bytes) -> Iterator[Packet]:
    """The local sets in a byte stream, in order, including damaged ones; other bytes are skipped.

    After a damaged packet, whose length may be wrong, the search continues right after its key.
    """
    offset = data.find(UAS_LOCAL_SET)
    while offset >= 0:
        packet = _packet(data, offset)
        yield packet
        offset = data.find(UAS_LOCAL_SET, offset + (len(UAS_LOCAL_SET) if packet.damage else packet.size))


def other_sets(data: bytes) -> dict[str, int]:
    """Sets in a byte stream other than ST 0601, by name, with the offset of the first of each, in order."""
    places = {words: data.find(key) for key, words in OTHER_SETS.items()}
    return {words: at for words, at in sorted(places.items(), key=lambda item: item[1]) if at >= 0}


def checksum(data: bytes) -> int:
    """The 16-bit sum of ST 0601 over a packet up to the checksum's length: bytes alternate between high and low."""
    values = np.frombuffer(data, np.uint8)
    return (256 * int(values[0::2].sum(dtype=np.int64)) + int(values[1::2].sum(dtype=np.int64))) & 0xFFFF


def ber_length(data: bytes, at: int) -> tuple[int, int]:
    """(length, end offset) of a BER length, short or long form. Raises `ValueError` if invalid."""
    if at >= len(data):
        raise _Unreadable("cut off before its length")
    first, at = data[at], at + 1
    if first < 0x80:
        return first, at
    size = first & 0x7F
    if not 0 < size <= LONGEST_NUMBER:
        raise _Unreadable(f"a length of {size} bytes is none that ST 336 allows here")
    if at + size > len(data):
        raise _Unreadable("cut off in its length")
    return int.from_bytes(data[at : at + size], "big"), at + size


def ber_oid(data: bytes, at: int) -> tuple[int, int]:
    """(tag, end offset) of a BER-OID tag: seven bits a byte, the eighth marks continuation."""
    tag = 0
    for end in range(at + 1, min(at + LONGEST_NUMBER, len(data)) + 1):
        tag = tag << 7 | data[end - 1] & 0x7F
        if data[end - 1] < 0x80:
            return tag, end
    raise _Unreadable("a tag that does not end")


def items(data: bytes) -> Items:
    """The (tag, value) pairs of a local set. Raises `ValueError` if they do not fill it exactly."""
    found: list[tuple[int, bytes]] = []
    at = 0
    while at < len(data):
        if len(found) == PACKET_ITEMS.most:
            raise _Unreadable(f"it has more than {PACKET_ITEMS.most} {PACKET_ITEMS.what} ({PACKET_ITEMS.name})")
        tag, at = ber_oid(data, at)
        length, at = ber_length(data, at)
        if at + length > len(data):
            raise _Unreadable(f"tag {tag} is longer than the packet")
        found.append((tag, data[at : at + length]))
        at += length
    return tuple(found)


def _packet(data: bytes, offset: int) -> Packet:
    try:
        length, start = ber_length(data, offset + len(UAS_LOCAL_SET))
    except _Unreadable as error:
        return Packet(offset, len(UAS_LOCAL_SET), (), str(error))
    end = start + length
    if end > len(data):
        return Packet(offset, len(data) - offset, (), f"cut off: {len(data) - start} of {length} bytes are there")
    if _reaches_over(data, start, end):
        return Packet(offset, end - offset, (), f"its length of {length} bytes reaches over the packets behind it")
    damage = _wrong_checksum(data[offset:end])
    if damage and data.find(UAS_LOCAL_SET, start, end) >= 0:  # wrong length: parse the same bytes only once
        return Packet(offset, end - offset, (), damage)
    try:
        return Packet(offset, end - offset, items(data[start:end]), damage)
    except _Unreadable as error:
        return Packet(offset, end - offset, (), damage or str(error))


def _reaches_over(data: bytes, start: int, end: int) -> bool:
    """Whether a packet spans several further keys: parsing all such would take quadratic time."""
    for _ in range(MOST_WITHIN + 1):
        start = data.find(UAS_LOCAL_SET, start, end) + 1
        if not start:
            return False
    return True


def _wrong_checksum(packet: bytes) -> str:
    if packet[-4:-2] != CHECKSUM_ITEM:
        return "no checksum at its end"
    stated, found = int.from_bytes(packet[-2:], "big"), checksum(packet[:-2])
    return "" if stated == found else f"its checksum is 0x{stated:04x}, its bytes give 0x{found:04x}"
