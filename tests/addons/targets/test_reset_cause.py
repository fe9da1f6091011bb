"""Why a robot was reset: told by a board in the emulated machine, and by the virtual robot."""

import io

import pytest

pytest.importorskip("unicorn", reason="needs the extra 'targets': pip install 'mecanum-hil[targets]'")

from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.addons.targets.machine.peripherals import Rcc
from hil.addons.targets.machine.stm32f405 import CORE_HZ
from hil.addons.targets.unicorn_board import UnicornBoard
from tests.addons.targets.test_unicorn import open_board
from tests.support.emulated_boards import Host, needs_compiler
from tests.support.wheel_rig import WheelRig

pytestmark = needs_compiler

POWER, BROWN_OUT, PIN = 1 << 27, 1 << 25, 1 << 26
SOFTWARE, INDEPENDENT, WINDOW, LOW_POWER = 1 << 28, 1 << 29, 1 << 30, 1 << 31
NOTHING = [m.HelloFaultStatus(0, 0), m.HelloFaultPlace(0, 0), m.HelloFaultAddress(0, 0)]
PVD = 1  # its interrupt
UNDEFINED_INSTRUCTION, STACKING_ERROR, PRECISE_BUS_FAULT = 1 << 16, 1 << 12, 1 << 9 | 1 << 15


def told(host: Host) -> tuple[m.ResetCause, list[codec.Message]]:
    """Return the cause in STATUS, and the pages of the fault, of a board that was just reset."""
    host.step(0, 100)
    host.say(m.HelloRequest(m.PROTOCOL_VERSION))
    pages = [host.newest(kind) for kind in (m.HelloFaultStatus, m.HelloFaultPlace, m.HelloFaultAddress)]
    status = host.newest(m.Status)
    assert isinstance(status, m.Status)
    return m.ResetCause(status.reset_cause), pages


@pytest.mark.proves("R-RESET-1", "R-RESET-4")
def test_a_board_that_is_switched_on_says_so_and_removes_the_flags():
    with open_board("can") as board:
        assert told(Host(board, "can")) == (m.ResetCause.POWER_ON, NOTHING)
        assert board.machine.rcc.read(Rcc.CSR) >> 24 & 0xFE == 0


@pytest.mark.proves("R-RESET-1", "R-RESET-2")
def test_a_board_that_its_watchdog_has_reset_says_so():
    rig = WheelRig(lockstep=True)
    with open_board("can", rig) as board:
        host = Host(board, "can")
        host.activate()
        host.step(0, 20)
        board.machine.advance(CORE_HZ // 20)  # the core stands still: nobody feeds the watchdog
        host.say(m.TimeSyncRequest(0))
        assert told(host) == (m.ResetCause.WATCHDOG, NOTHING)
        status = host.newest(m.Status)
        assert (status.state, status.nonce) == (m.State.IDLE, 0)


@pytest.mark.proves("R-RESET-1", "R-RESET-4")
@pytest.mark.parametrize(
    ("flags", "cause"),
    [
        (POWER | PIN | BROWN_OUT, m.ResetCause.POWER_ON),
        (PIN | BROWN_OUT, m.ResetCause.BROWN_OUT),
        (PIN, m.ResetCause.PIN),
        (PIN | SOFTWARE, m.ResetCause.SOFTWARE),
        (PIN | INDEPENDENT, m.ResetCause.WATCHDOG),
        (PIN | WINDOW, m.ResetCause.WATCHDOG),
        (PIN | LOW_POWER, m.ResetCause.LOW_POWER),
        (0, m.ResetCause.POWER_ON),
    ],
)
def test_each_flag_of_the_chip_has_its_cause(monkeypatch: pytest.MonkeyPatch, flags: int, cause: m.ResetCause):
    """Without any flag the emulated build takes it that it was switched on: QEMU's chip has none."""
    monkeypatch.setitem(Rcc.RESET_VALUES, Rcc.CSR, flags)
    with open_board("can") as board:
        assert told(Host(board, "can")) == (cause, NOTHING)


@pytest.mark.proves("R-RESET-3", "R-RESET-4")
@pytest.mark.parametrize("stacked", [True, False])
def test_a_processor_fault_switches_off_is_recorded_and_told_once(stacked: bool):
    rig = WheelRig(lockstep=True)
    with open_board("can", rig) as board:
        host = Host(board, "can")
        host.activate()
        tick = host.step(0, 20)
        host.say(m.WheelCommand(5.0, 5.0, 5.0, 5.0, 1, 1))
        host.step(tick, 5)
        assert rig.enabled
        cfsr = UNDEFINED_INSTRUCTION if stacked else STACKING_ERROR
        waits_at = board.machine.hard_fault(cfsr, mmfar=0x11, bfar=0x22, stacked=stacked)
        host.say(m.TimeSyncRequest(0))
        assert board.machine.resets == 1
        cause, (status, place, address) = told(host)
        assert cause is m.ResetCause.PROCESSOR_FAULT
        assert status == m.HelloFaultStatus(cfsr, 1 << 30)
        assert place.pc == (waits_at if stacked else 0)
        assert (place.lr != 0) == stacked
        assert address == m.HelloFaultAddress(0x11, 0x22)
        assert host.newest(m.Status).state == m.State.IDLE
        assert not rig.enabled
        board.machine.advance(CORE_HZ)  # the record is of one reset; the next one is the watchdog's
        host.say(m.TimeSyncRequest(0))
        assert board.machine.resets == 2
        assert told(host) == (m.ResetCause.WATCHDOG, NOTHING)


@pytest.mark.proves("R-RESET-4")
def test_a_stack_that_has_left_the_memory_is_recorded_without_a_place():
    with open_board("can") as board:
        board.machine._core._uc.reg_write(arm.UC_ARM_REG_SP, 0x2000_0010)
        board.machine.hard_fault(PRECISE_BUS_FAULT, bfar=0x1FFF_FFFC, stacked=False)
        host = Host(board, "can")
        host.say(m.TimeSyncRequest(0))
        assert told(host) == (
            m.ResetCause.PROCESSOR_FAULT,
            [
                m.HelloFaultStatus(PRECISE_BUS_FAULT, 1 << 30),
                m.HelloFaultPlace(0, 0),
                m.HelloFaultAddress(0, 0x1FFF_FFFC),
            ],
        )


@pytest.mark.parametrize("word", [0, 1, 2, 8], ids=["mark", "cause", "cfsr", "CRC"])
def test_a_damaged_record_is_none(word: int):
    """Then the reset was one by software, which is all that the chip knows of it."""
    with open_board("can") as board:
        core, place = board.machine._core, record_of(board)
        board.machine.hard_fault(UNDEFINED_INSTRUCTION)
        core.run()  # up to the reset
        good = core.read(place + 4 * word, 1)
        core._uc.mem_write(place + 4 * word, bytes([good[0] ^ 1]))
        host = Host(board, "can")
        host.say(m.TimeSyncRequest(0))
        assert told(host) == (m.ResetCause.SOFTWARE, NOTHING)


def record_of(board: UnicornBoard) -> int:
    """Return where the record of a fault lies."""
    elf = ELFFile(io.BytesIO(board._elf.read_bytes()))
    (symbol,) = elf.get_section_by_name(".symtab").get_symbol_by_name("record")
    return int(symbol["st_value"])


def test_a_supply_that_sinks_is_a_brown_out():
    with open_board("can") as board:
        board.machine.nvic.line(PVD, True)
        board.machine.nvic.line(PVD, False)
        host = Host(board, "can")
        host.say(m.TimeSyncRequest(0))
        assert told(host) == (m.ResetCause.BROWN_OUT, NOTHING)
