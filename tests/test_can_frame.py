"""What a CAN frame takes on the bus, against a model that writes the frame out bit by bit."""

from hypothesis import example, given
from hypothesis import strategies as st

from hil.wire.can_frame import classic_bits, fd_bits

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
ENDING = "1" + "01" + "1111111" + "111"  # CRC delimiter, acknowledgement, end of frame, intermission

# All zeros and all ones stuff most, and random bytes hardly ever.
stubborn = st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x07, 0x83, 0xC1])
octets = st.one_of(stubborn, st.integers(0, 255))
payloads = st.lists(octets, max_size=8).map(bytes)
standard = st.one_of(st.integers(0, 0x7FF), st.sampled_from([0, 0x7FF, 0x01F, 0x7E0]))
extended = st.one_of(st.integers(0, 0x1FFFFFFF), st.sampled_from([0, 0x1FFFFFFF, 0x1F]))


def crc15(bits: str) -> str:
    """Polynomial division on the whole number at once: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1."""
    divisor = int("1100010110011001", 2)
    rest = int(bits + "0" * 15, 2)
    while rest.bit_length() > 15:
        rest ^= divisor << (rest.bit_length() - 16)
    return f"{rest:015b}"


def stuffed(bits: str, *, at_end: bool) -> str:
    """What a transmitter puts on the bus: after five bits alike, stuff bits counted, one of the other kind."""
    out = ""
    for place, bit in enumerate(bits):
        out += bit
        if out[-5:] in ("00000", "11111") and (at_end or place + 1 < len(bits)):
            out += "10"[int(bit)]
    return out


def octet_bits(payload: bytes) -> str:
    return "".join(f"{byte:08b}" for byte in payload)


def classic_frame(number, payload, is_extended, remote_length):
    remote = "0" if remote_length is None else "1"
    length = len(payload) if remote_length is None else remote_length
    identifier = f"{number:029b}" if is_extended else f"{number:011b}"
    if is_extended:
        head = "0" + identifier[:11] + "1" + "1" + identifier[11:] + remote + "00"
    else:
        head = "0" + identifier + remote + "0" + "0"
    body = head + f"{length:04b}" + octet_bits(payload)
    return stuffed(body + crc15(body), at_end=True) + ENDING


def test_the_model_s_crc_is_the_catalogue_s():
    assert int(crc15(octet_bits(b"123456789")), 2) == 0x059E


@given(number=standard, payload=payloads)
@example(number=0, payload=bytes(8))
@example(number=0x7FF, payload=b"\xff" * 8)
def test_a_classic_frame_is_as_long_as_its_bits_written_out(number, payload):
    assert classic_bits(number, payload) == len(classic_frame(number, payload, False, None))


@given(number=extended, payload=payloads)
def test_an_extended_frame_is_as_long_as_its_bits_written_out(number, payload):
    assert classic_bits(number, payload, extended=True) == len(classic_frame(number, payload, True, None))


@given(number=extended, is_extended=st.booleans(), length=st.integers(0, 8))
def test_a_remote_frame_is_as_long_as_its_bits_written_out(number, is_extended, length):
    number &= 0x1FFFFFFF if is_extended else 0x7FF
    expected = len(classic_frame(number, b"", is_extended, length))
    assert classic_bits(number, b"", extended=is_extended, remote_length=length) == expected


@given(number=standard, payload=payloads)
def test_a_classic_frame_lies_between_no_stuff_bit_and_the_most_there_can_be(number, payload):
    plain = 47 + 8 * len(payload)
    assert plain <= classic_bits(number, payload) <= plain + (33 + 8 * len(payload)) // 4


@given(
    number=extended,
    is_extended=st.booleans(),
    payload=st.sampled_from(FD_LENGTHS).flatmap(lambda n: st.lists(octets, min_size=n, max_size=n)).map(bytes),
    switched=st.booleans(),
)
@example(number=0x1F, is_extended=False, payload=b"\x1f", switched=True)
def test_an_fd_frame_is_as_long_as_its_bits_written_out(number, is_extended, payload, switched):
    number &= 0x1FFFFFFF if is_extended else 0x7FF
    identifier = f"{number:029b}" if is_extended else f"{number:011b}"
    ide = "11" + identifier[11:] + "0" if is_extended else "00"
    arbitration = "0" + identifier[:11] + ide + "1" + "0" + str(int(switched))
    body = arbitration + "0" + f"{FD_LENGTHS.index(len(payload)):04b}" + octet_bits(payload)
    crc_field = "x" * (4 + (17 if len(payload) <= 16 else 21))
    fixed = "".join("s" + crc_field[i : i + 4] for i in range(0, len(crc_field), 4))
    # A stuff bit that follows the switch belongs to the phase that it is in.
    slow = len(stuffed(arbitration, at_end=False)) + len(ENDING) - 1
    total = len(stuffed(body, at_end=False)) + len(fixed) + len(ENDING)
    nominal, data = fd_bits(number, payload, extended=is_extended, switched=switched)
    assert nominal + data == total
    assert nominal == (slow if switched else total)
