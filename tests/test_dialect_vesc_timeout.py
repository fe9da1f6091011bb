"""The timeout of a VESC: read over both wires, near and behind, and what follows from it before anything moves."""

import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from firmware_protocol.framing import Frame
from hil.assembly import run_scenario
from hil.bench import Bench
from hil.dialects.port import EXTENDED, Wire
from hil.scenario import load
from tests.dialect_testbed import STILL, Rig, ramp_to
from tests.test_dialect_vesc import FORWARD, ODD, WIRES, ready, rig_of

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
    assert warnings_of(rig) == []
    assert rig.driver.capabilities.watchdog == "fixed"
    assert len(timeouts_asked_for(rig)) == 4
    assert rig.is_still()


@pytest.mark.parametrize(
    ("timeout_ms", "brake_a", "sentence"),
    [
        (1000, 5.0, "the timeout of the VESC 7, 30 is 1000 ms, longer than firmware.watchdog_s: so long"),
        (101, 5.0, "the timeout of the VESC 7, 30 is 101 ms, longer than firmware.watchdog_s: so long"),
        (5, 5.0, "the timeout of the VESC 7, 30 is 5 ms, no longer than the 5 ms between two commands"),
        (0, 0.0, "the timeout of the VESC 7, 30 is 0: when commands end its wheel turns on with the newest one"),
        (100, 0.0, "the VESC 7, 30 brakes with no current after its timeout: when commands end its wheel rolls"),
    ],
)
@pytest.mark.parametrize("wire", WIRES)
def test_who_has_another_is_told_of_with_its_value(wire: Wire, timeout_ms: int, brake_a: float, sentence: str) -> None:
    rig = set_all(rig_of(wire, ODD))
    for place in (0, 3):  # one behind and the near one
        rig.node.vescs[place].timeout_ticks, rig.node.vescs[place].timeout_brake_a = timeout_ms, brake_a
    [said] = warnings_of(rig)
    assert said.startswith(sentence)
    assert "in VESC Tool" in said
    assert rig.driver.capabilities.watchdog == ("fixed" if timeout_ms else "none")


@pytest.mark.parametrize("wire", WIRES)
def test_who_does_not_tell_its_timeout_holds_nobody_up_and_is_warned_of(wire: Wire) -> None:
    """Two questions to each, one a call: at five calls a second that is less than the two seconds of a start."""
    rig = set_all(rig_of(wire))
    for vesc in rig.node.vescs:
        vesc.tells_configuration = False
    rig.step(ticks=50)  # status messages have come
    calls = 0
    while rig.driver.identity is None:
        rig.step(rig.driver.ask())
        calls += 1
    assert calls == 9
    assert len(timeouts_asked_for(rig)) == 8
    [said] = warnings_of(rig)
    assert said.startswith("the timeout of the VESC 1, 2, 3, 4 is not known")
    assert rig.driver.capabilities.watchdog == "none"
    rig.driver.restart()
    assert rig.driver.capabilities.watchdog == "fixed"
    for vesc in rig.node.vescs:
        vesc.tells_configuration = True
    assert warnings_of(rig) == []


def test_who_is_asked_for_its_timeout_is_missing_until_it_told() -> None:
    rig = rig_of("can")
    rig.node.vescs[2].tells_configuration = False
    for _ in range(4):
        rig.step(rig.driver.ask())
    assert rig.driver.missing.startswith("no app configuration of the VESC 3 yet, which tells its timeout")


@pytest.mark.parametrize("wire", WIRES)
def test_a_configuration_of_another_id_is_not_believed(wire: Wire) -> None:
    rig = set_all(rig_of(wire))
    rig.node.vescs[1].told_number = 99
    said = warnings_of(rig)
    assert said[0].startswith("the timeout of the VESC 2 is not known")
    assert said[1].startswith("the app configuration that the VESC 2 tells is that of the id 99, and not believed")
    assert len(said) == 2
    assert rig.driver.capabilities.watchdog == "none"


@pytest.mark.parametrize("wire", WIRES)
def test_one_whose_timeout_is_not_known_and_does_not_run_out_may_have_none(wire: Wire) -> None:
    rig = set_all(rig_of(wire))
    dark, known = rig.node.vescs[1], rig.node.vescs[2]
    dark.tells_configuration, dark.timeout_ticks = False, 0
    known.command("current", 0)  # by another of its apps
    rig.node.vescs[3].knows_status = False
    unknown, runs_on, commanded = warnings_of(rig)
    assert unknown.startswith("the timeout of the VESC 2 is not known")
    assert runs_on.startswith("the timeout of the VESC 2 has not run out")
    assert commanded.startswith("the VESC 3 was commanded just now")
    said = rig.driver.warnings
    rig.arm()
    rig.drive(0.1, lambda _t: (STILL, STILL))
    assert rig.driver.warnings == said  # that those that are commanded have not timed out says nothing


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
    assert all(abs(one) < 0.1 * abs(two) for one, two in zip(braked.speeds(), rolling.speeds(), strict=True))


def test_a_session_begins_after_what_another_program_has_said() -> None:
    """A VESC takes ``03 02 00`` for the begin of 512 bytes, and what was said to it next for those."""
    rig = rig_of("serial")
    rig.node.feed(bytes.fromhex("7b0302004d"))
    rig.step(rig.driver.ask())
    assert rig.driver._channels[0].version is not None  # type: ignore[attr-defined]
    assert rig.is_still()
    assert not rig.node.is_driving


@pytest.mark.parametrize("suffix", ["blf", "asc", "log"])
def test_a_configuration_is_whole_in_a_trace_in_pieces(tmp_path: Path, suffix: str) -> None:
    changes = {"device.driver": "vesc", "loop.duration_s": 0.05, "loop.rate_hz": 200, "expect": []}
    scenario = load("circle_speed", mode="lockstep", link="memory:", set=changes)
    trace = tmp_path / f"line.{suffix}"
    assert run_scenario(scenario, trace=trace).failure is None
    with can.LogReader(trace) as messages:
        told = [bytes(one.data) for one in messages if one.arbitration_id == 17 and one.is_rx]
    assert [len(piece) for piece in told] == [64, 64, 64, 64, 22] * 4


@pytest.fixture
def port() -> Iterator[tuple[str, Rig]]:
    """A pseudo-terminal with VESCs behind it, in real time or thereabouts."""
    pty = pytest.importorskip("hil.links.pty", reason="pseudo-terminals need a POSIX system")
    line, rig, over = pty.PtyStream(), rig_of("serial"), threading.Event()

    def serve() -> None:
        while not over.is_set():
            rig.node.feed(line.read(1_000_000))
            rig.node.run(1)
            line.write(rig.node.take_bytes())

    thread = threading.Thread(target=serve)
    thread.start()
    yield line.port, rig
    over.set()
    thread.join()
    line.close()


@pytest.mark.alone
@pytest.mark.parametrize("timeout_ms", [0, 1000])
def test_a_guardian_comes_as_soon_as_a_timeout_of_0_is_told(port: tuple[str, Rig], timeout_ms: int) -> None:
    name, rig = port
    rig.node.vescs[2].timeout_ticks = timeout_ms
    changes = {"device.driver": "vesc", "estimator.source": "odometry", "expect": []}
    scenario = load("circle_speed", mode="realtime", link=f"serial:{name}", set=changes)
    with Bench(scenario, None, allow_motion=True) as bench:
        assert bench._guardian is None
        bench.connect()
        assert (bench._guardian is not None) is (timeout_ms == 0)
        if (guardian := bench._guardian) is not None:
            assert guardian.is_watching
    assert guardian is None or not guardian.is_watching
