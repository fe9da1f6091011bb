"""Robots with motors of other makers as processes of their own, in real time: over pseudo-terminals and slcan."""

import itertools
import json
import math
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.robot.truth_client import TruthClient
from hil.scenario import load
from tests.support.processes import HIL, Device, device, environment, hil_process, is_running, run_json, wait_for

pytestmark = pytest.mark.alone

REAL = ("circle_speed", "--mode", "realtime", "--set", "loop.rate_hz=100", "--set", "plant.start.battery_voltage_v=24")
ROSMASTER = (*REAL[:-1], "plant.start.battery_voltage_v=12")  # what its board has is 12 V


def short(driver: str, robot: Device, *changes: str) -> tuple[str, ...]:
    return (
        *("--set", f"device.driver={driver}", "--link", robot.link, "--truth", robot.truth, "--allow-motion"),
        *("--set", "loop.duration_s=1.5", "--set", "loop.rearm=true", "--set", "expect=[]", "--record", "none"),
        *(word for change in changes for word in ("--set", change)),
    )


@pytest.fixture
def slcan(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Give the ports of two emulated adapters on one bus."""
    adapters = pytest.importorskip("tests.support.slcan_adapters", reason="pseudo-terminals need a POSIX system")
    monkeypatch.setenv("CAN_CONFIG", '{"sleep_after_open": 0.0}')
    bus = adapters.SlcanBus(2)
    yield bus.ports
    bus.close()


def assert_drove(figures: dict[str, Any]) -> None:
    assert figures["failure"] is None
    assert figures["stopped"]
    assert figures["ticks"] > 100


def test_a_base_that_takes_twists_is_driven_over_a_pseudo_terminal() -> None:
    """A fault of its plant begins by the plant's clock, and not by ours."""
    push = 'fault=[{kind="push",target="force_x_n",start_s=0.2,end_s=0.3,value=1.0}]'
    with device(*ROSMASTER, "--driver", "rosmaster", "--link", "serial:pty") as robot:
        figures = run_json(*ROSMASTER, *short("rosmaster", robot, push), by=hil_process)
    assert_drove(figures)
    assert figures["fault"][0]["applied"] == 100


def test_four_vescs_behind_one_line_are_driven_over_a_pseudo_terminal() -> None:
    with device(*REAL, "--driver", "vesc", "--link", "serial:pty") as robot:
        assert_drove(run_json(*REAL, *short("vesc", robot), by=hil_process))


def test_odrives_are_driven_over_slcan(slcan: list[str]) -> None:
    with device(*REAL, "--driver", "odrive", "--link", f"can:slcan/{slcan[0]}") as robot:
        there = robot._replace(link=f"can:slcan/{slcan[1]}")
        assert_drove(run_json(*REAL, *short("odrive", there), by=hil_process))


def children_of(pid: int) -> set[int]:
    return {int(word) for word in subprocess.run(["pgrep", "-P", str(pid)], capture_output=True).stdout.split()}


def speed_m_s(watcher: TruthClient) -> float:
    """Return how fast the robot's centre goes, 0 before anything is known of it."""
    watcher.poll()
    twist = watcher.newest.fix.twist if watcher.newest is not None else None
    return 0.0 if twist is None else math.hypot(twist.vx_m_s, twist.vy_m_s)


def test_a_base_without_a_watchdog_is_stopped_when_the_host_is_killed(tmp_path: Path) -> None:
    """The guardian does it: the firmware would drive on for ever. Then it ends, and so does the recorder."""
    with device(*ROSMASTER, "--driver", "rosmaster", "--link", "serial:pty") as robot:
        long = *short("rosmaster", robot, "loop.duration_s=60"), "--record", str(tmp_path / "run.mcap")
        host = subprocess.Popen([*HIL, "run", *ROSMASTER, *long], env=environment())
        scenario = load("circle_speed", set=[ROSMASTER[-1], "loop.rate_hz=100", "device.driver=rosmaster"])
        watcher = TruthClient(robot.truth, scenario.hash, reset=False)

        wait_for(lambda: speed_m_s(watcher) > 0.2)
        children = children_of(host.pid)
        assert len(children) >= 2
        host.kill()
        host.wait()
        wait_for(lambda: speed_m_s(watcher) < 0.01)
        watcher.close()
        # The guardian says the stop a few times, to whatever the port's name then is: the port has to stay until then.
        wait_for(lambda: not any(map(is_running, children)))


def test_a_base_without_a_watchdog_is_stopped_when_the_host_hangs_and_the_host_then_ends() -> None:
    """It is stopped for long enough to have the guardian, and not itself, stop the base; then it has to know."""
    with device(*ROSMASTER, "--driver", "rosmaster", "--link", "serial:pty") as robot:
        long = short("rosmaster", robot, "loop.duration_s=60", "loop.rearm=false")
        host = subprocess.Popen(
            [*HIL, "run", *ROSMASTER, *long, "--json"],
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        scenario = load("circle_speed", set=[ROSMASTER[-1], "loop.rate_hz=100", "device.driver=rosmaster"])
        watcher = TruthClient(robot.truth, scenario.hash, reset=False)
        wait_for(lambda: speed_m_s(watcher) > 0.2)
        host.send_signal(signal.SIGSTOP)
        wait_for(lambda: speed_m_s(watcher) < 0.01)
        watcher.close()
        host.send_signal(signal.SIGCONT)
        said, words = host.communicate(timeout=30)
        assert host.returncode == 3
        assert "no command has come from the host for 0.3 s; the guardian has sent the stop" in words
        assert "if both are killed or stopped together" in words
        figures = json.loads(said)
        assert "the guardian stops the robot after 0.3 s of silence" in figures["failure"]


def test_vescs_as_delivered_are_braked_when_the_host_is_killed() -> None:
    """Their timeout would let them roll, at less than 0.5 m/s² on this circle; the brake makes it 4."""
    with device(*REAL, "--driver", "vesc", "--link", "serial:pty") as robot:
        host = subprocess.Popen([*HIL, "run", *REAL, *short("vesc", robot, "loop.duration_s=60")], env=environment())
        scenario = load("circle_speed", set=[*REAL[4::2], "device.driver=vesc"])
        watcher = TruthClient(robot.truth, scenario.hash, reset=False)
        wait_for(lambda: speed_m_s(watcher) > 0.2)
        children = children_of(host.pid)
        host.kill()
        host.wait()
        seen: list[tuple[int, float]] = []

        def rests() -> bool:
            speed = speed_m_s(watcher)
            assert watcher.newest is not None
            seen.append((watcher.newest.fix.time_ns, speed))
            return speed < 0.01

        wait_for(rests)
        watcher.close()
        slowing = [(a[1] - b[1]) / (b[0] - a[0]) * 1e9 for a, b in itertools.pairwise(seen) if b[0] > a[0]]
        assert max(slowing) > 1.0
        wait_for(lambda: not any(map(is_running, children)))
