"""``hil probe`` finds motors without moving any; ``hil jog`` turns one wheel, and says whether it was the right one."""

import json
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from hil.errors import BadInputError
from hil.jog import jog
from hil.probe import Answer
from hil.scenario import load
from tests.processes import HIL, device, environment, hil

GROUP = "239.74.163.91"
BUS = f"can:udp_multicast/{GROUP}"
ROBOT = ("circle_speed", "--mode", "realtime", "--dialect", "c620", "--link", BUS, "--set", "loop.rate_hz=200")


@pytest.fixture
def bystander() -> Iterator[can.BusABC]:
    with can.Bus(interface="udp_multicast", channel=GROUP) as bus:
        yield bus


def typed(text: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*HIL, "jog", *arguments],
        input=text,
        capture_output=True,
        text=True,
        timeout=60,
        env=environment(),
        check=False,
    )


def test_a_probe_finds_four_motors_prints_a_robot_file_for_them_and_sends_nothing(
    bystander: can.BusABC, tmp_path: Path
) -> None:
    with device(*ROBOT, "--set", "device.motors.ids=[3,4,7,8]"):
        done = hil("probe", BUS)
        heard = {message.arbitration_id for message in iter(lambda: bystander.recv(0), None)}
    assert done.returncode == 0, done.stderr
    assert "# a C620 or C610 with the id 7" in done.stdout
    assert heard == {0x203, 0x204, 0x207, 0x208}
    robot = tmp_path / "robot.toml"
    robot.write_text(done.stdout)
    assert tomllib.loads(done.stdout)["device"]["motors"] == {"ids": [3, 4, 7, 8]}
    found = load("circle_speed", robot=robot).device
    assert (found.driver, found.settings.ids) == ("c620", (3, 4, 7, 8))


def test_where_strangers_speak_nobody_is_asked(bystander: can.BusABC) -> None:
    task = bystander.send_periodic(can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False), 0.01)
    done = hil("probe", BUS, "--json")
    task.stop()
    answer = json.loads(done.stdout)
    assert done.returncode == 1
    assert answer["found"] == []
    assert list(answer["strangers"]) == ["0x123"]
    assert "nobody was asked" in answer["not_asked"]
    assert {message.arbitration_id for message in iter(lambda: bystander.recv(0), None)} <= {0x123}


def test_too_few_motors_are_no_robot_file() -> None:
    assert Answer("c620", BUS, ("a C620",), None).robot_file is None


def test_our_own_firmware_is_found_too() -> None:
    with device("circle_speed", "--mode", "realtime", "--link", "serial:pty") as robot:
        done = hil("probe", robot.link, "--json")
    [found] = json.loads(done.stdout)["found"]
    assert found["driver"] == "stm32"
    assert "our own firmware: firmware " in found["what"][0]


def test_nothing_is_sent_before_the_wheels_name_was_typed(bystander: can.BusABC) -> None:
    done = typed(
        "yes\n", "circle_speed", "fl", "--link", BUS, "--set", "device.driver=c620", "--set", "loop.mode=realtime"
    )
    assert done.returncode == 2
    assert "'fl' was not typed; nothing was sent" in done.stderr
    assert bystander.recv(0) is None


def test_a_wheel_is_turned_and_the_others_are_not() -> None:
    done = typed("rr\n", "circle_speed", "rr", "--json", "--link", "can:virtual/jog", "--set", "device.driver=c620")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    turned = told["turned_rad"]
    assert turned["rr"] > 2 * max(abs(turned[name]) for name in ("fl", "fr", "rl"))
    assert told["verdict"].startswith("the sensor of rr followed")


@pytest.mark.parametrize(
    ("wheel", "speed", "seconds", "sentence"),
    [
        ("fm", 1.0, 3.0, "expected one of fl, fr, rr, rl"),
        ("fl", 9.0, 3.0, "expected one of at most 3 either way"),
        ("fl", 0.0, 3.0, "not zero"),
        ("fl", 1.0, 60.0, "expected more than 1, at most 10"),
    ],
)
def test_a_jog_beyond_its_limits_is_refused(wheel: str, speed: float, seconds: float, sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        jog(load("circle_speed"), wheel, speed, seconds)
