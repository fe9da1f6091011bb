"""What the session with motors tells of frames that it cannot use, counted by hand; and of numbers it never sends."""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.addons.motors.motor_stop import MotorLine
from hil.core.errors import BadInputError
from hil.core.ports import EXTENDED, REMOTE, Received
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand, Wheels
from hil.robot.link_times import PollAge
from hil.runtime.bench import Bench
from hil.scenario import load

S = 1_000_000_000
MISSING = "nothing received from the X 2; check power"
PERIOD_NS = 10_000_000


class Line:
    """The link and the driver of a line: frames of a time, each not used for a reason."""

    def __init__(self) -> None:
        self.arrived: list[tuple[Frame, str, int]] = []
        self.why = ""
        self.bad: dict[str, int] = {}

    def receive(self, _timeout_ns: int) -> Received | None:
        if not self.arrived:
            return None
        frame, self.why, stamp_ns = self.arrived.pop(0)
        return Received((frame,), stamp_ns)

    def feed(self, _frame: Frame, _stamp_ns: int) -> str:
        return self.why

    def rejected(self) -> dict[str, int]:
        return self.bad


def told(arrived: Sequence[tuple[int, str, int]], now_ns: int = 3 * S, **bad: int) -> str:
    """Return what is told of identifiers that came at a time and were not used for a reason."""
    line: Any = Line()
    line.arrived, line.bad = [(Frame(number, b""), why, stamp_ns) for number, why, stamp_ns in arrived], bad
    motors = MotorLine(line, line, PollAge(), is_lockstep=True)
    clock: Any = None
    motors.take(clock)
    assert motors.received == len(arrived)
    return motors.explain(MISSING, now_ns)


@pytest.mark.parametrize(
    ("arrived", "words"),
    [
        ([], MISSING),
        ([(0x123, "", 2 * S)], f"{MISSING}; other identifiers were received: 0x123"),
        (
            [(0x301 + n, "", 2 * S) for n in range(6)],
            f"{MISSING}; other identifiers were received: 0x301, 0x302, 0x303, 0x304 and 2 more",
        ),
        (
            [(EXTENDED | 0x1234, "7 bytes, expected 8", 2 * S), *[(REMOTE | 0x20, "7 bytes, expected 8", 2 * S)] * 3],
            "nothing received from the X 2, but frames that do not fit: 7 bytes, expected 8 (4 of 0x00001234, 0x020); "
            "correct the controllers' settings, or device.motors",
        ),
        (
            [(0x11, "short", 2 * S), (0x12, "long", 2 * S), (0x11, "long", 2 * S), (0x13, "", 2 * S)],
            "nothing received from the X 2, but frames that do not fit: short (1 of 0x011), long (2 of 0x012, 0x011); "
            "correct the controllers' settings, or device.motors",
        ),
        (
            [(0x11, "short", S), (0x12, "", S - 1)],
            "nothing received from the X 2, but frames that do not fit: short (1",
        ),
        ([(0x11, "short", S - 1), (0x12, "", S)], f"{MISSING}; other identifiers were received: 0x012"),
        ([(0x11, "short", S - 1)] * 2, MISSING),
    ],
    ids=["nothing", "another", "many others", "does not fit", "two reasons", "of 2 s ago", "older", "all older"],
)
def test_frames_that_are_not_used_are_told_by_reason_and_identifier(
    arrived: list[tuple[int, str, int]], words: str
) -> None:
    assert told(arrived).startswith(words)
    assert told(arrived).count(";") == words.count(";") or words.endswith("(1")


def test_of_a_bus_full_of_strangers_so_many_are_told_that_reasons_have_room() -> None:
    strangers = [(n, "", 2 * S) for n in range(100)]
    assert told(strangers).endswith(": 0x000, 0x001, 0x002, 0x003 and 28 more")
    misfits = [(n, "short", 2 * S) for n in range(200, 300)]
    assert "short (32 of 0x0c8, 0x0c9, 0x0ca, 0x0cb and 28 more)" in told([*strangers, *misfits])
    assert "short (65 of 0x0c8, 0x0c9, 0x0ca, 0x0cb and 60 more)" in told([*misfits, misfits[0]])


def test_what_is_no_frame_is_told_where_nothing_else_came() -> None:
    assert told([], crc=3, stray=0, length=2) == f"{MISSING}; what arrived is no frame (crc 3, length 2)"
    assert "no frame" not in told([(0x123, "", 2 * S)], crc=3)


@pytest.mark.parametrize("mode", ["speed", "torque"])
def test_a_number_that_is_none_is_never_sent(mode: str) -> None:
    sets = {"loop.rate_hz": 100, "device.driver": "c620", "controller.command": mode}
    with Bench(load("circle_speed", mode="lockstep", set=sets), None, allow_motion=True) as bench:
        bench.connect()
        bench.device.start(bench.clock, PERIOD_NS)
        bad = Wheels(0.0, math.nan, 0.0, 0.0)
        speeds, torques = (bad, ZERO_WHEELS) if mode == "speed" else (ZERO_WHEELS, bad)
        command = WheelCommand(CommandMode[mode.upper()], speeds, torques)
        with pytest.raises(ValueError, match=r"^speeds .* rad/s, torques .* N·m: expected finite numbers$"):
            bench.device.send(command)


def test_controllers_are_asked_for_their_state_every_20_ms_once_they_are_known_and_anew_after_a_restart() -> None:
    asked: list[Frame] = []
    question = [Frame(0x21, b"a"), Frame(0x22, b"b")]
    line: Any = SimpleNamespace(send=asked.append)
    driver: Any = SimpleNamespace(identity=None, ask=lambda: question)
    motors = MotorLine(line, driver, PollAge(), is_lockstep=True)
    motors.ask_state(5)
    assert asked == [], "nobody is known yet"
    for _ in range(2):
        driver.identity = None
        assert not motors.identify(7)
        assert [asked.pop(0) for _ in range(2)] == question
        assert not motors.identify(8)
        motors.ask_state(S)
        assert asked == [], "it is asked who it is, and not for its state"
        driver.identity = "an X"
        assert motors.identify(8)
        assert motors.info is not None
        for now_ms, is_due in ((1000, True), (1019, False), (1020, True)):
            motors.ask_state(now_ms * 1_000_000)
            assert asked == (question if is_due else [])
            asked.clear()
        motors.restart(7)
        motors.ask_state(S)
        assert asked == []
    assert motors.sent == 2 * 4 * 2 - 4
    driver.identity = "a Y"
    with pytest.raises(
        BadInputError, match=r"another robot answers on the link: a Y; the run began with an X; plug in"
    ):
        motors.identify(9)
