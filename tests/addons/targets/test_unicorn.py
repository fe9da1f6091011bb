"""The ARM binary in Unicorn: the host library bit for bit, with the chip's own flash, watchdog and bus-off besides."""

import contextlib
import struct
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framer import Framer
from firmware_protocol.generated import messages as m
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS
from hil.addons.targets.machine.peripherals import Timer
from hil.core.errors import DeviceError
from tests.support.arm_programs import compile_program
from tests.support.emulated_boards import Host, converse, firmware, needs_compiler, needs_unicorn, plant_of, stored
from tests.support.examples import share_of_examples
from tests.support.processes import wait_for
from tests.support.wheel_rig import PARAMETERS, WheelRig

pytestmark = [needs_compiler, needs_unicorn]

CORE_HZ = 168_000_000
RAMP_S = list(PARAMETERS).index("ramp_s")
SYNC = codec.encode(m.TimeSyncRequest(1))
LINKS = pytest.mark.parametrize("link", ["serial", "can"])


@contextlib.contextmanager
def open_board(link: str, rig: WheelRig | None = None):
    """A board in front of a rig, which lives as long."""
    from hil.addons.targets.unicorn_board import UnicornBoard

    rig = WheelRig(lockstep=True) if rig is None else rig
    with UnicornBoard(firmware(link), *plant_of(rig), stored()) as board:
        yield board


@pytest.mark.proves("R-GEN-9", "R-STEP-5")
@LINKS
def test_every_frame_is_the_host_librarys(link: str):
    """Hello, arming, driving, feedforward, refusals, time-out, emergency stop: on ARM as here, twice."""
    rig = WheelRig(lockstep=True)
    library = Host(rig.node, link)
    converse(library, 7, 80)
    assert len(library.heard) > 500
    for _ in range(2):
        with open_board(link) as board:
            host = Host(board, link)
            converse(host, 7, 80)
            assert host.without_identity() == library.without_identity()
            assert board.machine.resets == 0
            assert board.look().state is m.State.ESTOP


def test_both_drive_their_plants_alike():
    one, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    converse(Host(one.node, "can"), 3, 60)
    with open_board("can", other) as board:
        converse(Host(board, "can"), 3, 60)
    assert other.angle_rad == one.angle_rad
    assert any(abs(angle) > 1.0 for angle in one.angle_rad)


@share_of_examples(0.15)
@given(st.lists(st.binary(max_size=60), max_size=6))
def test_no_bytes_stop_the_board_or_move_a_wheel(noise: list[bytes]):
    rig, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    library = Host(other.node, "serial")
    with open_board("serial", rig) as board:
        host = Host(board, "serial")
        for speaker in (library, host):
            for piece in noise:
                speaker.say_bytes(piece)
            speaker.say_bytes(b"\0")
            speaker.step(0, 120)
        assert host.heard == library.heard
    assert rig.angle_rad == [0.0] * 4


def restart(board, host: Host) -> None:
    """Reset the chip as a debugger does. The frame that arrives meanwhile is lost."""
    board.machine.nvic.write(0xD0C, 0x05FA0004)
    host.say(m.TimeSyncRequest(0))


def parameter(host: Host, index: int) -> float:
    host.say(m.ParameterRequest(index, m.Operation.READ, 9, 0))
    answer = host.newest(m.ParameterResponse)
    assert isinstance(answer, m.ParameterResponse)
    return float(struct.unpack("<f", struct.pack("<I", answer.value))[0])


@pytest.mark.proves("R-PAR-5", "R-PAR-13")
@LINKS
def test_stored_parameters_survive_a_reset_and_a_torn_record_does_not_count(link: str):
    """A STORE appends a record to the flash; one that a power cut left without its mark is as if it had not been."""
    with open_board(link) as board:
        host = Host(board, link)
        bits = struct.unpack("<I", struct.pack("<f", 0.4))[0]
        host.say(m.ParameterRequest(RAMP_S, m.Operation.WRITE, 1, bits))
        host.say(m.ParameterRequest(0, m.Operation.STORE, 2, 0))
        assert host.newest(m.ParameterResponse).result == m.Result.OK
        assert board.stored() not in (None, stored())
        restart(board, host)
        assert parameter(host, RAMP_S) == pytest.approx(0.4)
        board.machine.flash.load(PARAMETER_ADDRESS + 128 + 120, b"\xff" * 8)
        assert board.stored() == stored()
        restart(board, host)
        assert parameter(host, RAMP_S) == pytest.approx(0.2)
        assert board.machine.resets == 2


def test_bus_off_disarms_and_is_counted_and_the_bus_comes_back():
    with open_board("can") as board:
        host = Host(board, "can")
        host.activate()
        tick = host.step(0, 20)
        assert board.look().state is m.State.ACTIVE
        board.machine.can.fail(256)
        spoken = len(host.heard)
        host.say(m.TimeSyncRequest(1))
        assert len(host.heard) == spoken, "off the bus nothing is heard"
        board.machine.advance(CORE_HZ // 100)
        tick = host.step(tick, 5)
        assert board.look().state is not m.State.ACTIVE
        host.step(tick, 400)
        assert host.newest(m.PortCounters).bus_off == 1
        assert board.look().state is m.State.IDLE


@pytest.mark.proves("R-RESET-2")
@LINKS
def test_firmware_that_hangs_is_reset_by_its_watchdog_and_disarmed(link: str):
    """The core stands still for 50 ms while the chip's clocks go on: nobody feeds the watchdog."""
    rig = WheelRig(lockstep=True)
    with open_board(link, rig) as board:
        host = Host(board, link)
        host.activate()
        host.step(0, 20)
        assert rig.enabled
        board.machine.advance(CORE_HZ // 20)
        host.say(m.TimeSyncRequest(0))
        host.step(0, 5)
        assert board.machine.resets == 1
        assert board.look().state is m.State.IDLE
        assert not rig.enabled


def test_a_bus_on_which_nobody_acknowledges_is_waited_for_without_a_reset():
    """Time stands still in lockstep: what the robot has to say waits for its host, and nothing of it is lost."""
    with open_board("can") as board, open_board("can") as undisturbed:
        host, expected = Host(board, "can"), Host(undisturbed, "can")
        for one in (host, expected):
            one.activate()
            one.heard.clear()
        board.machine.can.acknowledge(False)
        host.say(m.Step(0, 100))
        expected.say(m.Step(0, 100))
        assert host.heard == []
        for _ in range(90):  # three times the watchdog's limit
            board.machine.advance(CORE_HZ // 1000)
            board.machine.run()
        assert board.machine.resets == 0
        board.machine.can.acknowledge(True)
        host.say(m.Step(100, 0))
        assert host.heard[: len(expected.heard)] == expected.heard


@pytest.mark.parametrize(("link", "pins"), [("serial", {"A2", "A3", "A9", "A10"}), ("can", {"A2", "A3", "B8", "B9"})])
def test_only_the_pins_of_its_two_lines_are_configured(link: str, pins: set[str]):
    with open_board(link) as board:
        converse(Host(board, link), 1, 20)
        fresh = [type(port)(port.name) for port in board.machine.gpio]
        changed = {
            f"{port.name[-1]}{pin}"
            for port, before in zip(board.machine.gpio, fresh, strict=True)
            for pin in range(16)
            if port.mode(pin) != before.mode(pin)
        }
        assert changed == pins
        assert all(timer.read(Timer.CR1) == 0 for timer in board.machine.timer.values())


@LINKS
def test_what_arrives_while_the_chip_is_in_reset_is_counted_as_missed(link: str):
    with open_board(link) as board:
        host = Host(board, link)
        host.say(m.TimeSyncRequest(0))
        assert board.look().rejected["missed"] == 0
        board.machine.advance(CORE_HZ)  # the watchdog bites
        host.say(m.TimeSyncRequest(1))
        assert board.machine.resets == 1
        assert board.look().rejected["missed"] == (1 if link == "can" else len(Framer().encode(SYNC)))


def test_a_board_that_is_interrupted_while_it_boots_is_closed(monkeypatch: pytest.MonkeyPatch):
    from hil.addons.targets.emulated_board import EmulatedBoard

    def interrupted(_board: EmulatedBoard, _data: bytes) -> bytes:
        raise KeyboardInterrupt

    guards = [thread for thread in threading.enumerate() if thread.name == "runaway guard"]
    monkeypatch.setattr(EmulatedBoard, "feed_plant", interrupted)
    with pytest.raises(KeyboardInterrupt), open_board("can"):
        pytest.fail("it booted without its plant")
    wait_for(lambda: not any(t.name == "runaway guard" and t not in guards for t in threading.enumerate()))


def test_a_plant_that_fails_is_told_and_time_stands_still():
    rig = WheelRig(lockstep=True)
    with open_board("can", rig) as board:
        host = Host(board, "can")
        tick = host.step(0, 5)
        assert not board.look().plant_failed
        rig.fail = True
        spoken = len(host.heard)
        host.step(tick, 5)
        assert board.look().plant_failed
        assert len(host.heard) == spoken


def test_what_the_chip_cannot_do_ends_the_board_with_a_sentence(tmp_path: Path):
    from hil.addons.targets.unicorn_board import UnicornBoard

    wild = compile_program(tmp_path, "int main(void) { REGISTER(0x40012000) = 1; for (;;) WAIT(); }")
    rig = WheelRig(lockstep=True)
    with pytest.raises(
        DeviceError,
        match=r"^the emulated board stopped: .* 0x40012000, which .*; at 0x\w+ \(main .*\) \(firmware program\.elf\)$",
    ):
        UnicornBoard(wild, *plant_of(rig), None)


def test_an_emulated_board_has_no_real_time():
    with open_board("can") as board, pytest.raises(DeviceError, match="use --mode lockstep"):
        board.run(1)
