"""The bits of a CAN frame on the bus, against a model that writes them out one by one."""

from hypothesis import example, given
from hypothesis import strategies as st

from hil.wire.can_meter import classic_bits, fd_bits
from tests.suite.can_frame_model import FD_LENGTHS, classic_frame, crc15, fd_lengths, octet_bits

# All zeros and all ones stuff most, and random bytes hardly ever.
stubborn = st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x07, 0x83, 0xC1])
octets = st.one_of(stubborn, st.integers(0, 255))
payloads = st.lists(octets, max_size=8).map(bytes)
standard = st.one_of(st.integers(0, 0x7FF), st.sampled_from([0, 0x7FF, 0x01F, 0x7E0]))
extended = st.one_of(st.integers(0, 0x1FFFFFFF), st.sampled_from([0, 0x1FFFFFFF, 0x1F]))


def test_the_model_s_crc_is_the_catalogue_s():
    assert int(crc15(octet_bits(b"123456789")), 2) == 0x059E


@given(number=standard, payload=payloads)
@example(number=0, payload=bytes(8))
@example(number=0x7FF, payload=b"\xff" * 8)
def test_a_classic_frame_is_as_long_as_its_bits_written_out(number, payload):
    assert classic_bits(number, payload) == len(classic_frame(number, payload))


@given(number=extended, payload=payloads)
def test_an_extended_frame_is_as_long_as_its_bits_written_out(number, payload):
    assert classic_bits(number, payload, extended=True) == len(classic_frame(number, payload, extended=True))


@given(number=extended, is_extended=st.booleans(), length=st.integers(0, 8))
def test_a_remote_frame_is_as_long_as_its_bits_written_out(number, is_extended, length):
    number &= 0x1FFFFFFF if is_extended else 0x7FF
    expected = len(classic_frame(number, b"", extended=is_extended, remote_length=length))
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
    expected = fd_lengths(number, payload, extended=is_extended, switched=switched)
    assert fd_bits(number, payload, extended=is_extended, switched=switched) == expected
