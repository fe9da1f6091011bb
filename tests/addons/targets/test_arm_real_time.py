"""A hardware-in-the-loop build in real time: the firmware as linked, a host at one line and a plant at the other."""

import dataclasses
import itertools

import pytest

from firmware_protocol import codec
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.generated import messages as m
from firmware_protocol.plant_port import Drive, PlantFramer, PlantPort, Sense

pytest.importorskip("unicorn", reason="no Unicorn: pip install unicorn")
pytest.importorskip("elftools", reason="no pyelftools: pip install pyelftools")

from tests.support.arm_firmwares import firmware
from tests.support.arm_machine import USARTS, Machine

HOST, PLANT = USARTS[0], USARTS[1]
FLASH_CR, IWDG_KR = 0x4002_3C10, 0x4000_3000


@pytest.fixture
def elf():
    return firmware("hil", "hil_f405", "serial").elf


class Bench:
    """A board on a bench, with its two lines."""

    def __init__(self, elf, plugged_in: bool = True) -> None:
        self.machine = Machine(elf)
        self.plugged_in = False
        self.drives: list[Drive | None] = []
        self.plant = PlantPort(self._body)
        self.framer, self.deframer = Framer(), Deframer()
        self.heard: list = []
        self.asked = 0
        self.machine.reactions[PLANT + 4] = self._hear
        self.machine.boot()
        self.plugged_in = plugged_in

    def _hear(self, byte: int) -> None:
        """Take a byte for the plant, which answers at once."""
        self.asked += byte == 0
        if self.plugged_in:
            self.machine.arrived[PLANT] += self.plant.feed(bytes([byte]))

    def _body(self, drive: Drive | None) -> Sense:
        self.drives.append(drive)
        return Sense(0, (0,) * 4, (0.0,) * 4, (0.0,) * 3, (0.0, 0.0, 9.81), 24.0, 0.0, (25.0,) * 4)

    def send(self, message) -> None:
        self.machine.arrived[HOST] += self.framer.encode(codec.encode(message))

    def run_until(self, done, milliseconds: int = 3000) -> None:
        """Go on until ``done()``; a bench that does not get there fails."""
        for _ in range(milliseconds):
            self.machine.run(1)
            self.heard += [codec.decode(f) for f in self.deframer.feed(bytes(self.machine.sent[HOST]))]
            self.machine.sent[HOST].clear()
            if done():
                return
        pytest.fail("it did not get there")

    def ticks(self) -> list[int]:
        return [one.time_us // 1000 for one in self.heard if isinstance(one, m.Tick)]

    def states(self) -> list[tuple[m.State, m.Fault]]:
        return [(one.state, one.fault) for one in self.heard if isinstance(one, m.Status)]


@pytest.mark.proves("R-PORT-3")
def test_each_tick_goes_through_the_plant_once(elf):
    bench = Bench(elf)
    bench.run_until(lambda: len(bench.ticks()) >= 10)
    assert bench.ticks()[:10] == list(range(0, 50, 5))
    assert bench.drives[0] is None, "the first values, before any drive"
    driven = list(itertools.dropwhile(lambda drive: drive is None, bench.drives))
    assert [drive.tick for drive in driven] == list(range(len(driven)))
    assert {drive.enabled for drive in driven} == {False}


@pytest.mark.proves("R-PORT-3")
def test_an_answer_for_another_tick_is_ignored(elf):
    """One comes before each right one; its counts are never told."""

    class Confused(Bench):
        def _body(self, drive: Drive | None) -> Sense:
            right = super()._body(drive)
            tick = 0 if drive is None else drive.tick + 1
            for wrong in {(tick + 1) % 2**32, (tick - 1) % 2**32}:
                answer = dataclasses.replace(right, tick=wrong, count=(999,) * 4)
                self.machine.arrived[PLANT] += PlantFramer().encode(answer)
            return right

    bench = Confused(elf)
    bench.run_until(lambda: len(bench.ticks()) >= 4)
    assert bench.ticks()[:4] == [0, 5, 10, 15]
    assert {one for one in bench.heard if isinstance(one, m.Encoders)} == {m.Encoders(0, 0, 0, 0)}


def test_robot_time_keeps_up_with_the_clock(elf):
    bench = Bench(elf)
    bench.run_until(lambda: bool(bench.ticks()))
    began, tick = bench.machine.uptime_ms, bench.ticks()[-1]
    bench.run_until(lambda: bench.ticks()[-1] >= tick + 100)
    assert 95 <= bench.machine.uptime_ms - began <= 115


def test_step_is_refused_without_lockstep(elf):
    bench = Bench(elf)
    bench.send(m.Step(0, 5))
    bench.run_until(lambda: sum(isinstance(one, m.LinkCounters) for one in bench.heard) == 2)
    assert not any(isinstance(one, m.StepDone) for one in bench.heard)
    assert [one.state for one in bench.heard if isinstance(one, m.LinkCounters)][-1] == 1


@pytest.mark.proves("R-PORT-4", "R-PORT-6")
def test_a_plant_that_falls_silent_is_asked_again_and_then_a_fault_until_it_is_back(elf):
    bench = Bench(elf)
    bench.run_until(lambda: len(bench.ticks()) >= 3)
    bench.plugged_in = False
    asked, began = bench.asked, bench.machine.uptime_ms
    bench.run_until(lambda: (m.State.FAULT, m.Fault.SENSOR) in bench.states())
    assert 1990 <= bench.machine.uptime_ms - began <= 2050
    assert 150 <= bench.asked - asked <= 250, "every 10 ms"
    ticks = bench.ticks()[-1]
    bench.run_until(lambda: bench.ticks()[-1] >= ticks + 20)  # the robot still ticks, and can be asked
    bench.plugged_in = True
    moved = len(bench.drives)
    bench.run_until(lambda: len(bench.drives) > moved + 5)
    assert bench.states()[-1][0] == m.State.FAULT, "latched"
    bench.send(m.HostHeartbeat(0x1231, m.SCHEMA_HASH, m.Request.CLEAR, m.Mode.SPEED, 0))
    bench.run_until(lambda: bench.states()[-1] == (m.State.IDLE, m.Fault.NONE))


def test_a_board_without_its_plant_faults_and_answers(elf):
    bench = Bench(elf, plugged_in=False)
    bench.send(m.HelloRequest(1))
    bench.run_until(lambda: any(isinstance(one, m.HelloIdentity) for one in bench.heard), milliseconds=10)
    bench.run_until(lambda: (m.State.FAULT, m.Fault.SENSOR) in bench.states())
    bench.send(m.HelloRequest(1))
    bench.run_until(lambda: sum(isinstance(one, m.HelloIdentity) for one in bench.heard) == 2)
    hello = next(one for one in bench.heard if isinstance(one, m.HelloIdentity))
    assert hello.capabilities & 3 == 0, "neither motors nor lockstep"


def late(bench: Bench, name: str) -> int:
    return bench.machine.peek(bench.machine.symbols["own"] + bench.machine.member("robot", name))


def test_late_ticks_are_made_up_and_counted(elf):
    bench = Bench(elf)
    bench.run_until(lambda: len(bench.ticks()) >= 3)
    began, tick = bench.machine.uptime_ms, bench.ticks()[-1]
    bench.plugged_in = False
    bench.machine.run(40)
    bench.plugged_in = True
    bench.run_until(lambda: bench.ticks()[-1] >= tick + 200)
    assert 195 <= bench.machine.uptime_ms - began <= 215, "robot time is where the clock is"
    assert late(bench, "ticks_late") >= 35
    assert late(bench, "ticks_lost") == 0


def test_a_plant_that_was_away_for_longer_does_not_make_robot_time_race(elf):
    bench = Bench(elf)
    bench.run_until(lambda: len(bench.ticks()) >= 3)
    bench.plugged_in = False
    bench.machine.run(500)
    bench.plugged_in = True
    tick, began = bench.ticks()[-1], bench.machine.uptime_ms
    bench.run_until(lambda: bench.machine.uptime_ms >= began + 200)
    assert 190 <= bench.ticks()[-1] - tick <= 275, "what was waited for is lost, but for the last of it"
    assert late(bench, "ticks_lost") >= 400


def test_a_stream_of_stores_leaves_time_for_ticks(elf):
    """Each one takes a millisecond here, as programming does; the watchdog is fed by ticks only."""
    bench = Bench(elf)
    bench.run_until(lambda: len(bench.ticks()) >= 3)
    machine = bench.machine
    machine.reactions[FLASH_CR] = lambda value: machine.skip(1) if value == 1 | 2 << 8 else None
    stores = b"".join(
        bench.framer.encode(codec.encode(m.ParameterRequest(0, m.Operation.STORE, i, 0))) for i in range(40)
    )
    machine.arrived[HOST] += stores
    machine.writes.clear()
    bench.run_until(lambda: sum(isinstance(one, m.ParameterResponse) for one in bench.heard) == 40)
    between, most = 0, 0
    for address, value in machine.writes:
        between = 0 if (address, value) == (IWDG_KR, 0xAAAA) else between + ((address, value) == (FLASH_CR, 1 | 2 << 8))
        most = max(most, between)
    assert most == 2, "one record, in two parts"
