"""The files for an STM32 CubeMX project compile, and drive, against a stand-in for the HAL."""

import re
import shutil
import subprocess

import cffi
import pytest

from firmware_protocol import codec
from firmware_protocol.built import FIRMWARE_FLAGS as FLAGS
from firmware_protocol.built import HERE
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.generated import messages as m
from tests.support.protocol_cases import PROTOCOL

FILES = HERE / "port" / "cubemx"
STAND_IN = PROTOCOL.parent / "tests" / "firmware_protocol" / "cubemx"
ENABLE, DIRECTIONS = 0x01, 0x1E


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The files, compiled with the core: a function that loads a fresh copy."""
    cc = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if cc is None:
        pytest.skip("no C compiler on this machine: install gcc or clang")
    folder = tmp_path_factory.mktemp("cubemx")
    include = [f"-I{path}" for path in (FILES, STAND_IN, HERE / "firmware")]
    own = [FILES / "wheel_app.c", STAND_IN / "hal.c"]
    core = [*(HERE / "firmware").glob("*.c"), HERE / "generated" / "wheel_messages.c"]
    made = folder / "app.so"
    subprocess.run(list(map(str, [cc, *FLAGS, *include, "-shared", "-fPIC", "-o", made, *own, *core])), check=True)
    subprocess.run(list(map(str, [cc, *FLAGS, *include, "-c", "-o", folder / "main.o", FILES / "main.c"])), check=True)
    return made


class Board:
    """A board with this firmware, just started, and a host at its line."""

    def __init__(self, library, copy) -> None:
        shutil.copy(library, copy)  # the firmware's variables are the library's: each board has a copy of its own
        self.ffi = cffi.FFI()
        source = (STAND_IN / "hal.c").read_text()
        self.ffi.cdef(re.search(r"/\* cffi: begin \*/(.*?)/\* cffi: end \*/", source, re.DOTALL)[1])
        self.lib = self.ffi.dlopen(str(copy))
        self.framer, self.deframer = Framer(), Deframer()
        self.lib.wheel_app_start()

    def send(self, *messages) -> None:
        data = b"".join(self.framer.encode(codec.encode(message)) for message in messages)
        self.lib.bench_receive(data, len(data))

    def run(self, milliseconds: int) -> list:
        """Let time pass and return what the board says."""
        heard = []
        out = self.ffi.new("uint8_t[]", 65536)
        for _ in range(milliseconds):
            self.lib.bench_millisecond()
            for _ in range(3):
                self.lib.wheel_app_run()
                heard += self.deframer.feed(bytes(self.ffi.buffer(out, self.lib.bench_take_sent(out))))
        return [codec.decode(frame) for frame in heard]

    def activate(self) -> None:
        self.send(m.HelloRequest(1))
        hello = next(one for one in self.run(1) if isinstance(one, m.HelloParameters))
        check = hello.parameter_hash & 0xFF
        for request in (m.Request.IDLE, m.Request.ARM):
            self.send(m.HostHeartbeat(0x1231, m.SCHEMA_HASH, request, m.Mode.SPEED, check))
        self.send(m.WheelCommand(0.0, 0.0, 0.0, 0.0, 0, 1))

    def drives(self) -> bool:
        on, enabled = self.lib.bench_outputs_on() != 0, self.lib.bench_pins() & ENABLE != 0
        assert on == enabled
        return on


@pytest.fixture
def board(library, tmp_path):
    return Board(library, tmp_path / "board.so")


def test_it_starts_with_the_motors_off_and_says_hello(board):
    assert not board.drives()
    board.send(m.HelloRequest(1))
    heard = board.run(1)
    assert {type(one) for one in heard} > {m.HelloIdentity, m.HelloFirmware, m.HelloParameters, m.HelloGeometry}
    assert next(one.capabilities for one in heard if isinstance(one, m.HelloIdentity)) & 1, "motors"
    assert not board.drives()


def test_it_drives_when_commanded_and_stops_when_the_host_falls_silent(board):
    board.activate()
    board.run(1)
    assert board.drives()
    for sequence in range(1, 11):
        board.send(m.WheelCommand(2.0, -2.0, 2.0, -2.0, sequence, 1))
        board.run(5)
    assert board.lib.bench_pins() & DIRECTIONS == 0b01010, "FL and RR forward, FR and RL back"
    assert all(0 < board.lib.bench_compare(i) <= 4200 for i in range(4))
    board.run(51)
    states = {one.state for one in board.run(1500) if isinstance(one, m.Status)}
    assert states == {m.State.STOPPING, m.State.IDLE}
    assert not board.drives()


def test_step_is_refused(board):
    board.send(m.Step(1, 5))
    heard = board.run(200)
    assert not any(isinstance(one, m.StepDone) for one in heard)
    assert [one.state for one in heard if isinstance(one, m.LinkCounters)][-1] == 1, "refused, and counted"


def test_only_ticks_feed_the_watchdog(board):
    before = board.lib.bench_refreshed()
    for _ in range(10):
        board.lib.wheel_app_run()
    assert board.lib.bench_refreshed() == before
    board.run(10)
    assert board.lib.bench_refreshed() == before + 10


def test_the_line_goes_round_its_buffer_and_survives_an_overrun(board):
    for _ in range(200):
        board.send(m.HelloRequest(1))
        assert any(isinstance(one, m.HelloIdentity) for one in board.run(1))
    board.lib.bench_overrun()
    board.run(1)
    board.send(m.HelloRequest(1))
    heard = board.run(101)
    assert any(isinstance(one, m.HelloIdentity) for one in heard)
    assert [one.overrun for one in heard if isinstance(one, m.PortCounters)][-1] == 1


def test_a_frame_that_an_overrun_cut_in_two_costs_no_other(board):
    board.lib.bench_receive(b"\x05half", 5)
    board.lib.bench_overrun()
    board.run(1)
    board.send(m.HelloRequest(1))
    heard = board.run(101)
    assert any(isinstance(one, m.HelloIdentity) for one in heard)


def test_the_first_duties_are_in_force_when_the_outputs_come_on(board):
    board.activate()
    while not board.drives():
        board.lib.bench_millisecond()
        board.lib.wheel_app_run()
    assert [board.lib.bench_in_force(i) for i in range(4)] == [board.lib.bench_compare(i) for i in range(4)]


def test_late_ticks_are_made_up(board):
    before = board.lib.bench_refreshed()
    for _ in range(7):
        board.lib.bench_millisecond()
    board.lib.wheel_app_run()
    assert board.lib.bench_refreshed() == before + 7
