"""The calls of a tick from Python: as the library's own, and CPython's exceptions for what is no argument of theirs."""

import sys
import tracemalloc

import pytest

from firmware_protocol.fast_calls import fast_calls
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from tests.client_rig import new_client, sent

FOUR = (1.0, -2.0, 3, 4.5)


def test_a_command_takes_numbers_of_any_kind() -> None:
    client = new_client()
    assert fast_calls().command(client.address, FOUR, (0, 0, 0, True), 0) == 1
    assert sent(client) == [m.TorqueFeedforward(0, 0, 0, 1, 1, 1), m.WheelCommand(*FOUR, 1, 1)]


@pytest.mark.parametrize(
    ("wrong", "error"),
    [((1.0, 2.0), IndexError), (("a",) * 4, TypeError), ([1.0] * 4, SystemError), (None, SystemError)],
)
@pytest.mark.parametrize("place", [1, 2])
def test_what_is_no_tuple_of_four_numbers_raises_and_sends_nothing(wrong: object, error: type, place: int) -> None:
    client = new_client()
    arguments = [client.address, FOUR, FOUR, 0]
    arguments[place] = wrong
    with pytest.raises(error):
        fast_calls().command(*arguments)
    assert sent(client) == []


def test_a_time_that_is_no_int_raises() -> None:
    client, calls = new_client(), fast_calls()
    for call in (
        lambda: calls.poll(client.address, None),
        lambda: calls.command(client.address, FOUR, FOUR, "now"),
        lambda: calls.step(0, 0, client.address, None, 0),
        lambda: calls.poll(client.address, 1 << 70),
    ):
        with pytest.raises((TypeError, OverflowError)):
            call()
    assert not client.view.out_bytes


def test_a_thousand_snapshots_leave_no_object_behind() -> None:
    client = new_client()
    before = client.snapshot()
    for _ in range(1000):
        assert repr(client.snapshot()) == repr(before)
    assert before[:2] == (0, 0)
    assert len(before[8]) == len(before[9]) == 4


@pytest.mark.parametrize("wrong", [None, "a", bytearray(3), 3])
def test_what_is_no_bytes_raises(wrong: object) -> None:
    client, calls = new_client(), fast_calls()
    for call in (
        lambda: calls.take(client.address, wrong, 0, 0),
        lambda: calls.exchange(0, 0, client.address, wrong),
        lambda: calls.split(wrong, 0x300),
    ):
        with pytest.raises(TypeError):
            call()


def test_a_number_that_is_no_int_raises() -> None:
    client, calls = new_client(), fast_calls()
    for call in (
        lambda: calls.ask(client.address, None),
        lambda: calls.take(client.address, b"", None, 0),
        lambda: calls.take(client.address, b"", 0, "now"),
        lambda: calls.split(b"", None),
    ):
        with pytest.raises(TypeError):
            call()
    assert not client.view.out_bytes


def test_a_thousand_splits_leave_no_object_behind() -> None:
    packed = pack([Frame(0x100, bytes(8)), Frame(0x300, b"")])
    before = sys.getrefcount(packed)
    tracemalloc.start()
    for _ in range(1000):
        assert fast_calls().split(packed, 0x300) == (packed[:11], packed[11:])
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sys.getrefcount(packed) == before
    assert kept_bytes < 10_000
