"""The timeout of a VESC: read over both wires, near and behind, and what follows from it before anything moves."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_protocol.framing import Frame
from hil.addons.motors.vesc.vesc_frames import SET_RPM, Line, SerialFraming
from hil.core.errors import BadInputError
from hil.robot.driver import EXTENDED, Wire
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.addons.motors.test_dialect_vesc import FORWARD, ODD, WIRES, ready, rig_of
from tests.support.dialect_testbed import STILL, Rig, ramp_to

DROPPED = "a VESC takes no torque beside a speed"


def set_all(rig: Rig, timeout_ms: int = 100, brake_a: float = 5.0) -> Rig:
    """Have all four time out so."""
    for vesc in rig.node.vescs:
        vesc.timeout_ticks, vesc.timeout_brake_a = timeout_ms, brake_a
    return rig


def warnings_of(rig: Rig) -> list[str]:
    """Greet, and return what is said of the timeouts."""
    rig.greet()
    *said, last = rig.driver.warnings
    assert last.startswith(DROPPED)
    return said


def timeouts_asked_for(rig: Rig) -> list[Frame]:
    """Return the questions for an app configuration, whatever wire they went over."""
    return [frame for frame in rig.sent if frame.payload[-1:] == b"\x11" or (frame.id, frame.payload) == (17, b"")]


@pytest.mark.parametrize("version", [(5, 3), (6, 0), (6, 5)])
@pytest.mark.parametrize("wire", WIRES)
def test_a_timeout_that_is_short_with_a_brake_is_not_spoken_of(wire: Wire, version: tuple[int, int]) -> None:
    rig = set_all(rig_of(wire, ODD))
    for vesc in rig.node.vescs:
        vesc.version = version
    assert rig.driver.capabilities.watchdog == "none", "nobody has told it yet, and the guardian has to be there first"
    assert warnings_of(rig) == []
    assert rig.driver.capabilities.watchdog == "fixed"
    assert len(timeouts_asked_for(rig)) == 4
    assert rig.is_still()


@pytest.mark.parametrize(
    ("timeout_ms", "brake_a", "sentence"),
    [
        (1000, 5.0, "the timeout of the VESC 7, 30 is 1000 ms, longer than firmware.watchdog_s: its wheel"),
        (2**32 - 1, 5.0, "the timeout of the VESC 7, 30 is 4294967 s, longer than firmware.watchdog_s: its wheel"),
        (101, 5.0, "the timeout of the VESC 7, 30 is 101 ms, longer than firmware.watchdog_s: its wheel"),
        (5, 5.0, "the timeout of the VESC 7, 30 is 5 ms, no longer than the 5 ms between two commands"),
        (0, 0.0, "the timeout of the VESC 7, 30 is 0: when commands end its wheel turns on with the last one"),
        (100, 0.0, "the VESC 7, 30 brakes with no current after its timeout: when commands end its wheel rolls"),
        (100, 0.04, "the VESC 7, 30 brakes with no current after its timeout: when commands end its wheel rolls"),
        (100, -5.0, "the VESC 7, 30 brakes with no current after its timeout: when commands end its wheel rolls"),
    ],
)
@pytest.mark.parametrize("wire", WIRES)
def test_who_has_another_is_told_of_with_its_value(wire: Wire, timeout_ms: int, brake_a: float, sentence: str) -> None:
    rig = set_all(rig_of(wire, ODD))
    for place in (0, 3):  # one behind and the near one
        rig.node.vescs[place].timeout_ticks, rig.node.vescs[place].timeout_brake_a = timeout_ms, brake_a
        rig.node.vescs[place]._quiet_ticks = 2**32  # the power has been on for longer
    [said] = warnings_of(rig)
    assert said.startswith(sentence)
    assert "in VESC Tool" in said
    assert rig.driver.capabilities.watchdog == ("fixed" if 0 < timeout_ms <= 100 else "none")
    assert ("if this program is killed" in said) is (timeout_ms == 0 and wire == "can")  # else the guardian stops them


@pytest.mark.parametrize("wire", WIRES)
def test_who_does_not_tell_its_timeout_holds_nobody_up_and_is_warned_of(wire: Wire) -> None:
    """Two questions to each, one a call: at five calls a second that is less than the two seconds of a start."""
    rig = set_all(rig_of(wire))
    for vesc in rig.node.vescs:
        vesc.answers_configuration = False
    rig.step(ticks=50)  # status messages have come
    calls = 0
    while rig.driver.identity is None:
        rig.step(rig.driver.ask())
        calls += 1
    assert calls == 9
    assert len(timeouts_asked_for(rig)) == 8
    [said] = warnings_of(rig)
    killed = "this program is killed, or " if wire == "can" else ""
    assert said == (
        "the timeout of the VESC 1, 2, 3, 4 is not known: when commands end its wheel turns on for that time (by "
        "default 1 s, with 0 for ever), and then rolls if there is no brake current; so it does if "
        f"{killed}this computer loses its power, hangs, or loses the cable; keep the robot's power switch within "
        "reach, and set App Settings > General > Timeout in VESC Tool to 100 ms, with a Timeout Brake Current"
    )
    assert rig.driver.capabilities.watchdog == "none"
    rig.driver.restart()
    for vesc in rig.node.vescs:
        vesc.answers_configuration = True
    assert warnings_of(rig) == []
    assert rig.driver.capabilities.watchdog == "fixed"


def test_who_is_asked_for_its_timeout_is_missing_until_it_told() -> None:
    rig = rig_of("can")
    rig.node.vescs[2].answers_configuration = False
    for _ in range(4):
        rig.step(rig.driver.ask())
    assert rig.driver.missing.startswith("no app configuration from the VESC 3 yet, which has its timeout")


@pytest.mark.parametrize("told", [99, 3])
@pytest.mark.parametrize("wire", WIRES)
def test_a_configuration_of_another_id_is_not_believed_nor_taken_for_that_ones(wire: Wire, told: int) -> None:
    rig = set_all(rig_of(wire))
    rig.node.vescs[1].configured_number = told
    rig.node.vescs[2].timeout_ticks = 0
    unknown, endless = warnings_of(rig)
    assert unknown.startswith("the timeout of the VESC 2 is not known")
    assert endless.startswith("the timeout of the VESC 3 is 0")
    assert rig.driver.capabilities.watchdog == "none"


@pytest.mark.parametrize("wire", WIRES)
def test_a_timeout_that_nobody_asked_for_is_not_believed(wire: Wire) -> None:
    """It comes while the robot drives, and of before a restart: too late to be of who is there now."""
    rig = set_all(rig_of(wire))
    rig.greet()
    told = [frame for frame in rig.heard if (frame.id if wire == "serial" else frame.id >> 8 & 0xFF) in (5, 6, 7, 17)]
    set_all(rig, 0)
    rig.driver.restart()
    for frame in told:
        rig.driver.feed(frame, rig.now_ns)
    rig.greet()
    rig.arm()
    rig.drive(0.1, lambda _t: (STILL, STILL))
    for frame in told:
        rig.driver.feed(frame, rig.now_ns)
    assert rig.driver.capabilities.watchdog == "none"
    assert rig.driver.warnings[0].startswith("the timeout of the VESC 1, 2, 3, 4 is 0")


@pytest.mark.parametrize("lost", [None, 1])
def test_late_answers_of_a_line_are_of_whose_values_stand_beside_them(lost: int | None) -> None:
    """Those of VESC 1 come when 2 is asked, and before its own; without its values nobody knows whose a version is."""
    rig = set_all(rig_of("serial"))
    for vesc in rig.node.vescs:
        vesc.hardware = b"of %d" % vesc.number
    for _ in range(3):
        for frame in rig.driver.ask():
            rig.node.feed(SerialFraming().encode(frame))
    late = SerialFraming().feed(rig.node.take_bytes())
    assert [frame.id for frame in late] == [0, 50, 17] * 2
    for place, frame in enumerate(late):
        if place != lost:
            rig.driver.feed(frame, 0)
    found = [channel.version and channel.version.hardware for channel in rig.driver._channels]  # type: ignore[attr-defined]
    assert found == (["of 1", "of 2", None, None] if lost is None else [None] * 4)
    rig.greet()
    assert [channel.version.hardware for channel in rig.driver._channels] == [  # type: ignore[attr-defined]
        f"of {vesc.number}" for vesc in rig.node.vescs
    ]


@pytest.mark.parametrize("lost", [0, 1, 37, 38, 39, -2, -1])
def test_a_part_that_is_lost_is_asked_for_again(lost: int) -> None:
    """Of the answer's 37 parts of 7 bytes, those of 6 that follow, and the end."""
    rig = set_all(rig_of("can"))
    asked = rig.driver.ask()
    for frame in asked:
        rig.node.receive(frame)
    told = [frame for frame in rig.node.take_frames() if frame.id >> 8 & 0xFF in (5, 6, 7)][-42:]
    assert [frame.id >> 8 & 0xFF for frame in told] == [5] * 37 + [6] * 4 + [7]
    del told[lost]
    for frame in told:
        rig.driver.feed(frame, 0)
    assert warnings_of(rig) == []
    assert len(timeouts_asked_for(rig)) == 4  # and the one of which a part was lost


def test_parts_of_two_that_are_mixed_are_asked_for_again() -> None:
    rig = set_all(rig_of("can"))
    for vesc in (1, 2):
        rig.node.receive(Frame(EXTENDED | 0x0800 | vesc, b"\xfd\x00\x11"))
    told = [frame for frame in rig.node.take_frames() if frame.id >> 8 & 0xFF in (5, 6, 7)]
    half = len(told) // 2
    for pair in zip(told[:half], told[half:], strict=True):
        for frame in pair:
            rig.driver.feed(frame, 0)
    assert not any(channel.timeout for channel in rig.driver._channels)  # type: ignore[attr-defined]
    assert warnings_of(rig) == []


@pytest.mark.parametrize("wire", WIRES)
def test_after_the_timeout_its_current_brakes(wire: Wire) -> None:
    braked, rolling = (set_all(ready(wire), 100, current_a) for current_a in (5.0, 0.0))
    for rig in (braked, rolling):
        rig.drive(0.6, ramp_to(FORWARD))
        rig.step(ticks=400)
    assert not rolling.node.is_driving
    assert not braked.node.is_driving  # nobody's command does it
    assert all(abs(one) < 0.1 * abs(two) for one, two in zip(braked.speeds(), rolling.speeds(), strict=True))


def test_a_late_answer_of_another_on_the_bus_is_not_that_of_who_is_asked() -> None:
    rig = set_all(rig_of("can"))
    first, second = rig.node.vescs[:2]
    first.answers_configuration = second.answers_configuration = False
    for _ in range(2):
        rig.step(rig.driver.ask())
    assert timeouts_asked_for(rig)[-1].id & 0xFF == second.number
    first.answers_configuration = second.answers_configuration = True
    rig.node.receive(timeouts_asked_for(rig)[0])
    rig.step()
    assert warnings_of(rig) == []


# A VESC whose reader waits for the rest of a packet

BEGIN_OF_512_BYTES = bytes.fromhex("030200")


def out_of_step(rig: Rig) -> Rig:
    """Have the near one wait for the rest of a packet, with the last commands of a session in what it has of it."""
    wire: Line = rig.driver._wire  # type: ignore[attr-defined]
    rig.node.feed(BEGIN_OF_512_BYTES)
    for vesc in rig.node.vescs:
        rig.node.feed(SerialFraming().encode(wire.setting(SET_RPM, vesc.number, 400.0)))
    return rig


@pytest.mark.parametrize("settings", [{}, ODD])
@pytest.mark.parametrize("timeout_ms", [0, 1000])
def test_nothing_that_a_reader_held_drives_a_wheel_at_the_start(timeout_ms: int, settings: Mapping[str, Any]) -> None:
    rig = set_all(rig_of("serial", settings), timeout_ms)
    rig.step(ticks=1100)
    out_of_step(rig)
    calls = 0
    while rig.driver.identity is None:
        rig.step(rig.driver.ask())
        calls += 1
        assert not rig.node.is_driving
    assert calls < 9  # of the ten that a start waits
    assert rig.is_still()
    rig.arm()


def test_who_answers_is_sent_nothing_but_questions_and_who_does_not_gets_stops_once() -> None:
    def stops(frames: list[Frame]) -> int:
        return sum(frame.id == 6 or frame.payload[1:2] == b"\6" for frame in frames)

    rig = rig_of("serial")
    rig.greet()
    assert stops(rig.sent) == 0
    rig.driver.restart()
    for session in (1, 2):
        silent = [frame for _ in range(50) for frame in rig.driver.ask()]
        assert stops(silent) == 48, session
        rig.driver.restart()
    bus = rig_of("can")
    assert not any(frame.id >> 8 & 0xFF != 8 for _ in range(50) for frame in bus.driver.ask())


@pytest.mark.parametrize("held", ["", "0301", "030200"])
def test_the_guardians_stop_brakes_to_rest_whatever_a_reader_waits_for(held: str) -> None:
    """At 19200 baud, where one wheel brakes before the others: let go, they would roll for ever on this plant."""
    rig = set_all(ready("serial"), 0)
    rig.drive(0.6, ramp_to(FORWARD))
    stop = b"".join(map(SerialFraming().encode, rig.driver.last_stop()))
    rig.node.feed(bytes.fromhex(held))
    for at in range(0, len(stop), 2):
        rig.node.feed(stop[at : at + 2])
        rig.step(ticks=1)
    rig.step(ticks=300)
    assert rig.is_still()


def test_one_on_a_line_that_says_its_version_alone_is_named_and_not_the_next_one() -> None:
    rig = rig_of("serial")
    old = rig.node.vescs[2]
    old.version, process = (3, 38), old.process
    old.process = lambda message, reply: process(message, reply) if message[0] == 0 else None
    with pytest.raises(BadInputError, match=r"VESC 3 has the firmware 3\.38"):
        rig.greet()


@pytest.mark.parametrize("suffix", ["blf", "asc", "log"])
def test_a_configuration_is_whole_in_a_trace_in_pieces(tmp_path: Path, suffix: str) -> None:
    changes = {"device.driver": "vesc", "loop.duration_s": 0.05, "loop.rate_hz": 200, "expect": []}
    scenario = load("circle_speed", mode="lockstep", link="memory:", set=changes)
    trace = tmp_path / f"line.{suffix}"
    assert run_scenario(scenario, RunOptions(trace=trace)).failure is None
    with can.LogReader(trace) as messages:
        told = [bytes(one.data) for one in messages if one.arbitration_id == 17 and one.is_rx]
    assert [len(piece) for piece in told] == [64, 64, 64, 64, 22] * 4
