"""KLV packets and the items of MISB ST 0601: framing, checksums, numbers.

Held against: the examples that MISB ST 0601 and ST 1201 print of each item (`EXAMPLES`), the Python package klvdata on
three files of others (a flight of 2012 and two test packets of the standard), and the keys of other sets as jMISB's
`KlvConstants` has them (`OTHERS`).
"""

from __future__ import annotations

import math
import pathlib
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.klv_packets import KEY, length, local_set, tag_bytes, usual

from jaxgeo.io import TableError, read_acquisition
from jaxgeo.io.acquisitions.klv import MOST_WITHIN, ber_length, ber_oid, checksum, items, packets
from jaxgeo.io.acquisitions.st0601 import TAGS, decode, label

quickly = settings(deadline=None, database=None, derandomize=True, max_examples=200)
MADE = local_set(usual())


@given(st.integers(0, 65535), st.booleans())
@quickly
def test_lengths_come_back(size: int, long: bool) -> None:
    encoded = length(size, long=long)
    assert ber_length(encoded + b"rest", 0) == (size, len(encoded))


@given(st.integers(0, 2**35))
@quickly
def test_tags_come_back(tag: int) -> None:
    assert ber_oid(tag_bytes(tag) + b"\x7f", 0) == (tag, len(tag_bytes(tag)))


@pytest.mark.parametrize("raw", [b"", b"\x80", b"\x89" + bytes(9), b"\x82\x01"])
def test_what_is_no_length(raw: bytes) -> None:
    with pytest.raises(ValueError, match="length"):
        ber_length(raw, 0)


@given(st.dictionaries(st.integers(2, 5000), st.binary(max_size=200), max_size=12), st.booleans())
@quickly
def test_items_come_back(given_items: dict[int, bytes], long: bool) -> None:
    (packet,) = packets(local_set(given_items, long=long))
    assert packet.damage == ""
    assert dict(packet.items[:-1]) == given_items
    assert packet.items[-1][0] == 1


@pytest.mark.parametrize("flip", [0x01, 0x80, 0xFF])
def test_a_changed_byte_is_never_taken(flip: int) -> None:
    for place in range(len(MADE)):
        changed = bytearray(MADE)
        changed[place] ^= flip
        assert not [one for one in packets(bytes(changed)) if not one.damage], f"byte {place}"


def test_a_packet_cut_off_anywhere_is_never_taken() -> None:
    for end in range(len(MADE)):
        found = list(packets(MADE[:end]))
        assert not [one for one in found if not one.damage or one.items]
        assert len(found) == (end >= len(KEY))


def test_packets_behind_a_damaged_one_are_found() -> None:
    """Also where the length is what is damaged and reaches over the packets behind, and with other bytes between."""
    too_long, wrong = bytearray(MADE), bytearray(MADE)
    too_long[16] = 0x7F if MADE[16] != 0x7F else 0x7E
    wrong[22] ^= 1  # in the time
    stream = b"\x00\x47noise" + MADE + bytes(too_long) + MADE + b"\x00" * 5 + bytes(wrong) + MADE + MADE[:50]
    found = list(packets(stream))
    assert [one.damage == "" for one in found] == [True, False, True, False, True, False]
    assert [stream[one.offset : one.offset + 16] for one in found] == [KEY] * 6
    assert [bool(one.items) for one in found] == [True, False, True, True, True, False]  # `wrong` can be told apart
    assert "cut off" in found[-1].damage


def test_no_checksum_is_damage() -> None:
    body = b"\x03\x01A"
    (packet,) = packets(KEY + length(len(body)) + body)
    assert packet.damage == "no checksum at its end"
    assert packet.items == ((3, b"A"),)


def test_a_length_that_reaches_over_many_packets_takes_no_time() -> None:
    """Keys throughout, each with a length up to the end: looking into every one would take the square of their number.

    A packet that holds one further key in its values is still read.
    """
    start = time.perf_counter()
    count = 20_000
    found = list(packets(b"".join(KEY + b"\x83" + (20 * (count - k) - 20).to_bytes(3, "big") for k in range(count))))
    assert len(found) == count
    assert not any(one.items for one in found[: -MOST_WITHIN - 2])
    assert "reaches over the packets behind it" in found[0].damage
    assert time.perf_counter() - start < 5.0  # s
    inside = local_set(usual() | {94: KEY})
    assert [one.damage for one in packets(inside)] == [""]


# By the public registry of MISB, in bytes: the set, and what it is called.
OTHERS = {
    "06 0e 2b 34 02 01 01 01 0e 01 01 02 01 01 00 00": "EG 0104",
    "06 0e 2b 34 02 0b 01 01 0e 01 03 03 06 00 00 00": "ST 0903",
    "06 0e 2b 34 02 03 01 01 0e 01 03 03 1e 00 00 00": "ST 0903",
    "06 0e 2b 34 02 03 01 01 0e 01 03 03 02 00 00 00": "ST 0102",
    "06 0e 2b 34 02 01 01 01 02 08 02 00 00 00 00 00": "ST 0102",
    "06 0e 2b 34 02 0b 01 01 0e 01 03 01 02 00 00 00": "ST 0806",
    "06 0e 2b 34 02 03 01 01 0e 01 03 05 02 00 00 00": "ST 0808",
    "06 0e 2b 34 02 0b 01 01 0e 01 03 03 0d 00 00 00": "ST 1206",
}


@pytest.mark.parametrize("key", OTHERS)
def test_other_sets_are_named(tmp_path: pathlib.Path, key: str) -> None:
    path = tmp_path / "other.klv"
    path.write_bytes(bytes.fromhex(key) + b"\x04\x01\x02ab")
    with pytest.raises(TableError, match=rf"no packet of MISB ST 0601.*it holds MISB {OTHERS[key]}.*Ask its source"):
        read_acquisition(path)
    path.write_bytes(path.read_bytes() + MADE)
    assert len(read_acquisition(path)) == 1  # beside packets they do no harm


PIECES = st.sampled_from([KEY, b"\x81", b"\x01\x02", b"\xff", MADE[16:60]]) | st.binary(max_size=8)


@given(st.lists(PIECES, max_size=12))
@quickly
def test_any_bytes_can_be_searched(parts: list[bytes]) -> None:
    data = b"".join(parts)
    for one in packets(data):
        packet = data[one.offset : one.offset + one.size]
        assert packet[:16] == KEY
        assert len(packet) == one.size
        assert one.damage or checksum(packet[:-2]).to_bytes(2, "big") == dict(one.items)[1]


# Examples that the standard gives of each item: bytes, and value to the digits printed there.
EXAMPLES = {
    5: ("71c2", 159.9744), 6: ("fd3d", -0.4315251), 7: ("08b8", 3.405814), 13: ("5595b66d", 60.1768229669783),
    14: ("5b5360c4", 128.426759042045), 15: ("c221", 14190.72), 16: ("cd9c", 144.5713), 17: ("d917", 152.6436),
    18: ("724a0a20", 160.719211474396), 19: ("87f84b86", -168.792324833941), 20: ("7dc55ece", 176.865437690572),
    21: ("03830926", 68590.983298744), 22: ("1281", 722.8199), 23: ("f101a229", -10.5423886331461),
    24: ("14bc082b", 29.157890122923), 25: ("34f3", 3216.037), 96: ("00d92a", 13898.5), 103: ("2f921e", 23456.23),
    109: ("0001a0", 1.625), 112: ("1f40", 125.0), 117: ("3e90", 1.0),
}  # fmt: skip


@pytest.mark.parametrize("tag", EXAMPLES)
def test_examples_of_the_standard(tag: int) -> None:
    """Values are printed as they were before they were made a code: equal to a step of the codes."""
    code, value = bytes.fromhex(EXAMPLES[tag][0]), EXAMPLES[tag][1]
    found, next_one = (TAGS[tag].read((int.from_bytes(code, "big") + k).to_bytes(len(code), "big")) for k in (0, 1))
    assert found == pytest.approx(value, abs=1.01 * (next_one - found))


NUMBERS = [tag for tag in TAGS if isinstance(TAGS[tag].read(b""), float)]
SIGNED = (6, 7, 13, 14, 19, 23, 24, *range(26, 34), 40, 41, 50, 51, 52, 67, 68, 79, 80, *range(82, 94))


def sizes(tag: int) -> list[int]:
    def fits(size: int) -> bool:
        try:
            TAGS[tag].read(bytes(size))
        except ValueError:
            return False
        return True

    return [size for size in range(1, 10) if fits(size)]


@pytest.mark.parametrize("tag", SIGNED)
def test_errors_and_out_of_range_are_no_numbers(tag: int) -> None:
    (size,) = sizes(tag)
    lowest = b"\x80" + bytes(size - 1)
    assert math.isnan(TAGS[tag].read(lowest))
    bound = TAGS[tag].read(b"\x7f" + b"\xff" * (size - 1))
    assert TAGS[tag].read(lowest[:-1] + b"\x01") == -bound
    assert bound in (20.0, 50.0, 90.0, 180.0, 0.075, 327.0)
    assert TAGS[tag].read(bytes(size)) == 0.0


@pytest.mark.parametrize("tag", NUMBERS)
def test_numbers_of_no_bytes_and_of_too_many(tag: int) -> None:
    assert math.isnan(TAGS[tag].read(b""))
    raw = bytes(9)
    assert decode(((tag, raw),)) == {tag: raw}  # kept, but no number


@pytest.mark.parametrize("tag", NUMBERS)
def test_numbers_grow_with_their_code(tag: int) -> None:
    """Over the upper half of the codes of signed and of mapped floating numbers there is nothing, or the negative."""
    size = sizes(tag)[-1] if len(sizes(tag)) == 1 else 3
    codes = [k * (256**size - 1) // 32 // 2 for k in range(32)]
    values = [TAGS[tag].read(code.to_bytes(size, "big")) for code in codes]
    known = [value for value in values if not math.isnan(value)]
    assert known == sorted(known)
    assert len(known) > 4
    assert known[0] < known[-1] or size == 1


@given(st.floats(-900.0, 40_000.0), st.integers(2, 8))
@quickly
def test_mapped_floating_numbers_come_back(value: float, size: int) -> None:
    """ST 1201: of a span of 40,900, below 2**16, whose zero is a code, codes step by 2**16 / 2**(8 size - 1)."""
    step = 2.0 ** (16 - (8 * size - 1))
    code = math.floor((value + 900.0) / step)
    found = TAGS[104].read(code.to_bytes(size, "big"))
    assert value - max(step, 1e-10) <= found <= value + 1e-10


@pytest.mark.parametrize("raw", ["c80000", "e80000", "900000", "ffffff", "800000"])
def test_special_values_of_mapped_floating_numbers(raw: str) -> None:
    assert math.isnan(TAGS[104].read(bytes.fromhex(raw)))


def test_what_is_not_known_is_kept() -> None:
    found = decode(items(tag_bytes(200) + b"\x02ab" + b"\x30\x01\x05" + b"\x0b\x04EO\x00\x00" + b"\x0b\x03EON"))
    assert found == {200: b"ab", 48: b"\x05", 11: "EON"}
    assert label(200) == "Tag 200"
    assert label(13) == "Sensor Latitude (deg)"


REAL = ["Cheyenne.bin", "DynamicConstantMISMMSPacketData.bin", "DynamicOnlyMISMMSPacketData.bin"]


@pytest.mark.parametrize("name", REAL)
def test_real_packets_read_as_by_klvdata(jaxgeo_test_data: pathlib.Path, name: str) -> None:
    klvdata = pytest.importorskip("klvdata")
    path = jaxgeo_test_data / "telemetry_klv" / name
    ours = list(packets(path.read_bytes()))
    with open(path, "rb") as file:
        theirs = list(klvdata.StreamParser(file))
    assert len(ours) == len(theirs)
    compared = 0
    for one, other in zip(ours, theirs, strict=True):
        values, elements = decode(one.items), {key[0]: element for key, element in other.items.items()}
        assert sorted(values) == sorted(elements)
        for tag, value in values.items():
            if isinstance(value, float):
                span = abs(value) + 1.0
                assert value == pytest.approx(float(elements[tag].value), abs=1e-12 * span), tag
                compared += 1
            elif isinstance(value, str):
                assert value == str(elements[tag].value), tag
        assert values[2] == pytest.approx(1e6 * elements[2].value.value.timestamp(), abs=1.0)  # us
    assert compared >= 16 * len(ours)


def test_checksums_of_real_packets(jaxgeo_test_data: pathlib.Path) -> None:
    """That of one of the standard packets is wrong as published."""
    damaged = {
        name: sum(bool(one.damage) for one in packets((jaxgeo_test_data / "telemetry_klv" / name).read_bytes()))
        for name in REAL
    }
    assert damaged == dict(zip(REAL, (0, 1, 0), strict=True))
