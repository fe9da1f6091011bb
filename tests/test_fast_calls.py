"""The calls of a tick from Python: as the library's own, and CPython's exceptions for what is no argument of theirs."""

import pytest

from firmware_protocol.fast_calls import fast_calls
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
