"""``hil probe`` finds motors without moving any."""

import json
import os
import select
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import can
import pytest

from firmware_protocol.generated.messages import SENDERS
from hil.addons.motors.probe_command import Answer, find_motors
from hil.core.errors import BadInputError
from hil.robot.driver import Found
from hil.scenario import load
from tests.support.processes import device, hil

tty = pytest.importorskip("tty", reason="pseudo-terminals need a POSIX system")
pytestmark = pytest.mark.alone  # a probe listens for so long by the wall clock
adapters = pytest.importorskip("tests.support.slcan_adapters", reason="pseudo-terminals need a POSIX system")


class Bus(NamedTuple):
    """Links of a robot and of a host to one bus, and somebody else on it."""

    robot: str
    host: str
    bystander: can.BusABC
    reader: can.BufferedReader

    def heard(self) -> list[can.Message]:
        """The frames that the bystander has received since the last call."""
        return list(iter(lambda: self.reader.get_message(0.05), None))


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bus]:
    """Three emulated slcan adapters on one bus, over real pseudo-terminals."""
    monkeypatch.setenv("CAN_CONFIG", '{"sleep_after_open": 0.0}')
    wired = adapters.SlcanBus(3)
    robot, host, _ = (f"can:slcan/{port}" for port in wired.ports)
    with can.Bus(interface="slcan", channel=wired.ports[2], bitrate=1_000_000, sleep_after_open=0.0) as bystander:
        reader = can.BufferedReader()
        notifier = can.Notifier(bystander, [reader])
        yield Bus(robot, host, bystander, reader)
        notifier.stop()
    wired.close()


def test_a_probe_finds_four_motors_asks_them_only_and_prints_a_robot_file_for_them(bus: Bus, tmp_path: Path) -> None:
    nodes = "device.motors.node_ids=[3, 4, 7, 8]"
    with device("circle_speed", "--mode", "realtime", "--driver", "odrive", "--link", bus.robot, "--set", nodes):
        done = hil("probe", bus.host)
    assert done.returncode == 0, done.stderr
    # What moves an axis or changes it: set state, modes, input, limits, gains, stop, restart (CANSimple, 0x02 to 0x1A).
    questions = {0x00, 0x01, 0x03, 0x04, 0x05, 0x09, 0x0A, 0x14, 0x15, 0x17, 0x1C, 0x1D}
    assert {message.arbitration_id & 0x1F for message in bus.heard()} <= questions
    robot = tmp_path / "robot.toml"
    robot.write_text(done.stdout)
    assert tomllib.loads(done.stdout)["device"]["motors"]["node_ids"] == [3, 4, 7, 8]
    found = load("circle_speed", robot=robot).device
    assert (found.driver, found.settings.node_ids) == ("odrive", (3, 4, 7, 8))


def test_where_strangers_speak_nobody_is_asked(bus: Bus) -> None:
    task = bus.bystander.send_periodic(can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False), 0.01)
    done = hil("probe", bus.host, "--json")
    task.stop()
    answer = json.loads(done.stdout)
    assert done.returncode == 1
    assert answer["found"] == []
    assert list(answer["strangers"]) == ["0x123"]
    assert "no motor controller was queried" in answer["not_asked"]
    assert bus.heard() == []


@pytest.mark.parametrize(("driver", "link"), [("moteus", "can:socketcan/can0"), ("odrive", "can:socketcan/can0?fd=1")])
def test_who_is_on_the_other_kind_of_bus_is_not_looked_for(driver: str, link: str) -> None:
    with pytest.raises(BadInputError, match=r"cannot be looked for over .*; see its wires in DRIVERS.md, and fd=1"):
        find_motors(link, driver)


def test_too_few_motors_are_no_robot_file() -> None:
    assert Answer("c620", "can:socketcan/can0", Found(("a C620",), None)).robot_file is None


def test_our_own_firmware_is_found_on_a_line() -> None:
    with device("circle_speed", "--mode", "realtime", "--link", "serial:pty") as robot:
        [answer] = find_motors(robot.link).answers
    assert answer.driver == "stm32"
    assert "our own firmware: firmware " in answer.found.sentences[0]


def test_our_own_robot_on_a_bus_is_asked_for_hello_alone_and_is_no_odrive(bus: Bus) -> None:
    """Its 0x081 and 0x080 look like node 4's heartbeat and version; who else is on the bus does not matter."""
    stranger = can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False)
    with device("circle_speed", "--mode", "realtime", "--link", bus.robot, "--set", "loop.rate_hz=20"):
        task = bus.bystander.send_periodic(stranger, 0.01)
        done = hil("probe", bus.host, "--json")
        task.stop()
    told = json.loads(done.stdout)
    assert [found["driver"] for found in told["found"]] == ["stm32"]
    assert told["found"][0]["known"]["robot.wheel_radius_m"] == 0.075
    assert list(told["strangers"]) == ["0x123"]
    heard = bus.heard()
    assert {message.arbitration_id for message in heard if SENDERS.get(message.arbitration_id) != "ROBOT"} == {0x700}
    assert not any(message.is_remote_frame for message in heard)


def test_the_vesc_at_a_line_is_found_and_no_robot_file_made() -> None:
    motors = "device.motors={ids=[2, 5, 7, 9], serial_id=7}"
    with device("circle_speed", "--mode", "realtime", "--driver", "vesc", "--link", "serial:pty", "--set", motors) as v:
        [answer] = find_motors(v.link, "vesc").answers
    assert "with the id 7 at the line: write that as serial_id" in answer.found.sentences[0]
    assert answer.robot_file is None


def test_what_the_motors_do_not_report_is_marked_in_the_robot_file() -> None:
    unknown = ("device.motors.pole_pairs", "device.motors.gear_ratio", "firmware.torque_constant_n_m_a")
    text = Answer("vesc", "can:socketcan/can0", Found(("four",), {"ids": [2, 5, 7, 9]}, unknown=unknown)).robot_file
    for table, note in (
        ("robot", "not measured: the paper's robot; replace before anything moves"),
        ("firmware", "cannot be asked for: torque_constant_n_m_a"),
        ("device.motors", "cannot be asked for: pole_pairs, gear_ratio; write them here, or the defaults hold"),
    ):
        assert text is not None
        assert f"# {note}\n[{table}]\n" in text


def test_a_board_that_speaks_is_the_only_one_asked_and_its_geometry_is_in_the_file(tmp_path: Path) -> None:
    sentences: list[str] = []
    with device("circle_speed", "--mode", "realtime", "--driver", "rosmaster", "--link", "serial:pty") as board:
        [answer] = find_motors(board.link, say=sentences.append).answers
    assert [sentence for sentence in sentences if sentence.startswith("asking")] == ["asking for Yahboom Rosmaster"]
    assert answer.link == board.link
    robot = tmp_path / "robot.toml"
    robot.write_text(answer.robot_file or "")
    assert load("circle_speed", robot=robot).robot.wheel_radius_m == pytest.approx(0.0325, rel=1e-3)
    assert "# not measured, except wheel_radius_m, half_length_m, half_width_m" in robot.read_text()


def test_where_bytes_come_that_nobody_understands_nothing_is_sent() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    is_over = threading.Event()

    def speak() -> None:
        while not is_over.wait(0.05):
            os.write(master, b"$GPGGA,092750.000,5321.6802,N\r\n")

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        result = find_motors(f"serial:{os.ttyname(slave)}")
    finally:
        is_over.set()
        speaker.join()
    assert result.answers == []
    assert "bytes came of unknown senders" in (result.not_queried or "")
    assert select.select([master], [], [], 0)[0] == []
    os.close(master)
    os.close(slave)
