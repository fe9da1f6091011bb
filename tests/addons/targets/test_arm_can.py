"""bxCAN of the STM32F405: what the linked firmware writes to its registers, executed by Unicorn."""

import itertools
import struct

import pytest

from tests.support.protocol_cases import DBC

pytest.importorskip("unicorn", reason="no Unicorn: pip install unicorn")
pytest.importorskip("elftools", reason="no pyelftools: pip install pyelftools")

from tests.support.arm_machine import Machine
from tests.support.arm_robot import CAN, SCRATCH, machine, with_motors

MCR, MSR, TSR, RF0R, ESR, BTR, MAILBOX, FIFO, FR = 0x00, 0x04, 0x08, 0x0C, 0x18, 0x1C, 0x180, 0x1B0, 0x240
ALL_EMPTY, GIVE_UP = 7 << 26, 0x0080_8080


def test_only_the_hosts_messages_pass_the_can_filters():
    own = machine("hil", "hil_f405", "can")
    own.boot()
    words = [own.peek(CAN + FR + 4 * i) for i in range(2 * 3)]
    halves = list(itertools.chain.from_iterable((word & 0xFFFF, word >> 16) for word in words))
    assert all(half & 0x1F == 0 for half in halves), "standard data frames"
    assert {half >> 5 for half in halves} == {m.frame_id for m in DBC.values() if "HOST" in m.senders}


@pytest.mark.proves("R-CAN-1")
def test_a_can_bit_is_14_quanta_of_3_clocks():
    own = machine("hil", "hil_f405", "can")
    own.boot()
    assert own.peek(CAN + BTR) == 2 | (10 - 1) << 16 | (3 - 1) << 20


@pytest.mark.proves("R-CAN-2")
def test_a_can_frame_goes_out_as_it_is():
    own = with_motors("f405_drivers", "can")
    own.write(SCRATCH, struct.pack("<HB", 0x123, 5) + bytes([1, 2, 3, 4, 5, 99, 99, 99]))
    own.writes.clear()
    own.call("host_link_send", SCRATCH)
    box = CAN + MAILBOX + 16
    assert own.writes == [(box + 4, 5), (box + 8, 0x0403_0201), (box + 12, 5), (box, 0x123 << 21 | 1)]


@pytest.mark.parametrize("length", [0, 3, 8])
def test_a_can_frame_comes_in_as_it_is(length):
    own = with_motors("f405_drivers", "can")
    own.reactions[CAN + RF0R] = lambda _: own.poke(CAN + RF0R, 0)
    for at, value in ((RF0R, 1), (FIFO, 0x040 << 21), (FIFO + 4, length), (FIFO + 8, 0x0403_0201), (FIFO + 12, 5)):
        own.poke(CAN + at, value)
    own.call("can1_receive_interrupt")
    assert (CAN + RF0R, 1 << 5) in own.writes, "released"
    assert own.call("host_link_receive", SCRATCH) & 0xFF == 1
    assert struct.unpack("<HB", own.read(SCRATCH, 3)) == (0x040, length)
    assert own.read(SCRATCH + 3, length) == bytes([1, 2, 3, 4, 5, 0, 0, 0])[:length]


def test_a_can_length_code_above_8_is_dropped_and_counted():
    own = with_motors("f405_drivers", "can")
    own.reactions[CAN + RF0R] = lambda _: own.poke(CAN + RF0R, 0)
    own.poke(CAN + RF0R, 1)
    own.poke(CAN + FIFO + 4, 9)
    own.call("can1_receive_interrupt")
    assert own.call("host_link_receive", SCRATCH) & 0xFF == 0
    assert counters(own)["length"] == 1


def counters(own: Machine) -> dict[str, int]:
    own.write(SCRATCH, bytes(32))
    own.call("host_link_counters", SCRATCH)
    names = ("cobs", "crc", "length", "unknown_id", "overrun", "serial_lost", "can_errors", "bus_off")
    return dict(zip(names, struct.unpack("<8I", own.read(SCRATCH, 32)), strict=True))


def test_bus_off_is_counted_once_and_stops_what_was_armed():
    own = with_motors("f405_drivers", "can")
    state = own.symbols["own"] + own.member("wheel_node", "state")
    assert own.read(state, 1) == b"\x01", "IDLE"
    own.write(state, b"\x03")
    own.poke(CAN + ESR, 1 << 2)
    own.writes.clear()
    own.call("can1_status_interrupt")
    assert own.writes[0] == (CAN + MSR, 1 << 2), "before it looks: an error in between is another interrupt"
    own.call("can1_status_interrupt")
    assert (CAN + TSR, GIVE_UP) in own.writes, "what waits in the mailboxes is given up"
    assert counters(own)["bus_off"] == 1
    own.call("robot_serve", own.symbols["own"])
    assert own.read(state, 1) == b"\x04", "STOPPING"
    own.poke(CAN + ESR, 0)
    own.call("robot_serve", own.symbols["own"])
    own.poke(CAN + ESR, 1 << 2)
    own.call("can1_status_interrupt")
    assert counters(own)["bus_off"] == 2


def test_bus_off_is_seen_without_its_interrupt_too():
    own = with_motors("f405_drivers", "can")
    assert own.call("host_link_went_down") & 0xFF == 0
    own.poke(CAN + ESR, 1 << 2)
    assert [own.call("host_link_went_down") & 0xFF for _ in range(2)] == [1, 0], "told once"


def send(own: Machine) -> list[int]:
    """Send a frame and return the addresses that were written for it."""
    own.write(SCRATCH, struct.pack("<HB8s", 0x123, 8, bytes(8)))
    own.writes.clear()
    own.call("host_link_send", SCRATCH)
    return [address for address, _ in own.writes]


def test_nothing_is_kept_to_be_said_when_the_bus_is_back():
    own = with_motors("f405_drivers", "can")
    own.poke(CAN + TSR, 0)  # a full controller
    for _ in range(5):
        assert send(own) == []
    own.poke(CAN + ESR, 1 << 2)
    own.call("can1_status_interrupt")
    own.poke(CAN + TSR, ALL_EMPTY)
    assert send(own) == [], "off the bus a frame is taken and thrown away"
    own.poke(CAN + ESR, 0)
    own.writes.clear()
    own.call("host_link_went_down")
    assert (CAN + TSR, GIVE_UP) in own.writes
    own.poke(CAN + TSR, ALL_EMPTY)
    assert send(own) == [CAN + MAILBOX + at for at in (4, 8, 12, 0)], "this one and none before it"


def test_what_nobody_acknowledges_is_given_up_after_a_tenth_of_a_second():
    own = with_motors("f405_drivers", "can")
    own.poke(CAN + TSR, ALL_EMPTY)
    own.run(2)
    own.poke(CAN + TSR, 0)  # all three mailboxes wait
    began = own.uptime_ms
    given_up = []
    own.reactions[CAN + TSR] = lambda value: given_up.append(own.uptime_ms - began) if value == GIVE_UP else None
    own.run(150)
    own.reactions.pop(CAN + TSR)
    assert 99 <= given_up[0] <= 102


def test_a_controller_that_does_not_answer_stays_silent():
    own = machine("hil", "hil_f405", "can")
    own.reactions[CAN + MCR] = lambda _: None  # never in initialization mode
    own.boot()
    own.run(50)
    written = {address for address, _ in own.writes if CAN <= address < CAN + 0x400}
    assert CAN + BTR not in written
    assert own.peek(CAN + MCR) & 1, "asked for that mode, it sends nothing"


def test_can_errors_are_counted():
    own = with_motors("f405_drivers", "can")
    for code in (0, 1, 3, 6, 7):  # none, stuff, acknowledgement, CRC, none since the last look
        own.poke(CAN + ESR, code << 4)
        own.call("can1_status_interrupt")
    assert counters(own)["can_errors"] == 3
