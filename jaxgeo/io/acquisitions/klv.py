"""KLV: keys, lengths and values in a stream of bytes (SMPTE ST 336), as the local sets of MISB ST 0601 use them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

UAS_LOCAL_SET = bytes.fromhex("060e2b34020b01010e01030101000000")
CHECKSUM_ITEM = b"\x01\x02"  # tag and length of the checksum, which is the last item
LONGEST_NUMBER = 8  # bytes of a length or a tag; more is noise

Items = tuple[tuple[int, bytes], ...]


class Packet(NamedTuple):
    """A local set: where its key starts and how many bytes it takes, its (tag, value) pairs, and what is wrong with it.

    `damage` is "" for a packet whose checksum is right. A damaged one has items only if all of them can be told apart.
    """

    offset: int
    size: int
    items: Items
    damage: str


class _Unreadable(ValueError):
    """Bytes that are no length, no tag or no item."""


def packets(data: bytes) -> Iterator[Packet]:
    """The local sets in a stream of bytes, in order, damaged ones too; what lies between them is passed over.

    After a damaged packet, whose length may be what is wrong, the search goes on behind its key.
    """
    offset = data.find(UAS_LOCAL_SET)
    while offset >= 0:
        packet = _packet(data, offset)
        yield packet
        offset = data.find(UAS_LOCAL_SET, offset + (len(UAS_LOCAL_SET) if packet.damage else packet.size))


def checksum(data: bytes) -> int:
    """The 16-bit sum of ST 0601, of a packet from its key to the checksum's length: bytes in turn high and low."""
    values = np.frombuffer(data, np.uint8)
    return (256 * int(values[0::2].sum(dtype=np.int64)) + int(values[1::2].sum(dtype=np.int64))) & 0xFFFF


def ber_length(data: bytes, at: int) -> tuple[int, int]:
    """(length, where it ends) of a length in BER, short or long form. Raises `ValueError` for what is none."""
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
    """(tag, where it ends) of a tag in BER-OID: seven bits a byte, the eighth says that more follow."""
    tag = 0
    for end in range(at + 1, min(at + LONGEST_NUMBER, len(data)) + 1):
        tag = tag << 7 | data[end - 1] & 0x7F
        if data[end - 1] < 0x80:
            return tag, end
    raise _Unreadable("a tag that does not end")


def items(data: bytes) -> Items:
    """The (tag, value) pairs that a local set holds. Raises `ValueError` where they do not fill it exactly."""
    found: list[tuple[int, bytes]] = []
    at = 0
    while at < len(data):
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
    damage = _wrong_checksum(data[offset:end])
    try:
        return Packet(offset, end - offset, items(data[start:end]), damage)
    except _Unreadable as error:
        return Packet(offset, end - offset, (), damage or str(error))


def _wrong_checksum(packet: bytes) -> str:
    if packet[-4:-2] != CHECKSUM_ITEM:
        return "no checksum at its end"
    stated, found = int.from_bytes(packet[-2:], "big"), checksum(packet[:-2])
    return "" if stated == found else f"its checksum is 0x{stated:04x}, its bytes give 0x{found:04x}"
