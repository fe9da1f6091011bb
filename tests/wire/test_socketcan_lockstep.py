"""The controller and the virtual robot as two processes on a kernel's CAN bus, at 1 kHz in lockstep."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_protocol.codec import Message
from firmware_protocol.generated import messages as m
from hil.addons.report.trace import trace_decoder as decode
from tests.support.processes import Device, device, run_json
from tests.support.socketcan_bus import DBC, FIRST_HELLO_ID, Onlooker, foreign_traffic, wire_sha256

pytestmark = pytest.mark.socketcan

LOCKSTEP = ("paper_circle", "--mode", "lockstep")
SHORT = (*LOCKSTEP, "--set", "loop.duration_s=0.2", "--set", "expect=[]", "--record", "none")


def there(robot: Device) -> tuple[str, ...]:
    return ("--link", robot.link, "--truth", robot.truth)


@pytest.fixture(scope="module")
def in_memory() -> str:
    """The hash of the same run without a bus."""
    return run_json(*SHORT)["wire_sha256"]


@pytest.fixture(scope="module")
def robot() -> Iterator[Device]:
    with device(*LOCKSTEP, "--link", "can:socketcan/vcan0") as ready:
        yield ready


def check_bus(onlooker: Onlooker, expected_sha256: str, *, is_fd: bool) -> None:
    """The frames on the bus match the run's report bit for bit; cantools can read and write all of them."""
    frames = onlooker.take()
    assert {frame.is_fd for frame in frames} == {is_fd}
    assert wire_sha256(frames) == expected_sha256
    for frame in set(frames):
        message = DBC.get_message_by_frame_id(frame.can_id)
        signals = message.decode(frame.payload, scaling=False)
        assert message.encode(signals, scaling=False, strict=False) == frame.payload


def test_lockstep_over_classic_can_gives_the_bytes_of_memory(robot: Device, in_memory: str):
    onlooker = Onlooker("vcan0")
    assert run_json(*SHORT, *there(robot))["wire_sha256"] == in_memory
    check_bus(onlooker, in_memory, is_fd=False)
    onlooker.close()


def test_lockstep_over_can_fd_gives_the_bytes_of_memory(in_memory: str):
    onlooker = Onlooker("vcan1")
    with device(*LOCKSTEP, "--link", "can:socketcan/vcan1?fd=1&data_bitrate=4000000") as robot:
        assert run_json(*SHORT, *there(robot))["wire_sha256"] == in_memory
    check_bus(onlooker, in_memory, is_fd=True)
    onlooker.close()


def run_traced(path: Path, *options: str) -> tuple[dict, list[tuple[str, Message]]]:
    """Run, and return the messages in both directions, except HELLO and STEP, which may be repeated, and counters."""
    figures = run_json(*SHORT, "--trace", path, *options)
    read = decode.read(path, decode.Selection.of([], 0.0, math.inf))
    said = [
        (one.frame.direction, one.message)
        for one in read
        if one.message is not None and one.frame.number < FIRST_HELLO_ID
    ]
    unlike = (m.Step, m.StepDone, m.LinkCounters, m.PortCounters)
    return figures, [(direction, message) for direction, message in said if not isinstance(message, unlike)]


def test_foreign_traffic_changes_nothing_that_is_said_and_is_counted(robot: Device, tmp_path: Path):
    _, alone = run_traced(tmp_path / "memory.log")
    with foreign_traffic("vcan0") as other:
        figures, among_others = run_traced(tmp_path / "bus.log", *there(robot))
        other.terminate()
        output, _ = other.communicate(timeout=30)
    sent = json.loads(output)
    assert min(sent.values()) > 100
    assert among_others == alone
    # Frames of other identifiers may be kept away by the kernel's filter; ours with a wrong length cannot be.
    assert 0 < figures["frames"]["rejected"]["length"] <= sent["short_command"] + sent["short_tick"]
