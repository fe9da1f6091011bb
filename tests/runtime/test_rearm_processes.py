"""Unplug and replug between real processes: a serial name that goes and comes back, a CAN bus that goes down and up."""

import contextlib
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_protocol.generated.messages import State
from hil.core.errors import LinkError
from hil.robot.truth_client import TruthClient, TruthRecord
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.loop import Loop
from hil.scenario import load
from tests.support.processes import HIL, ROOT, device, environment, network_of_its_own, wait_for

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

SCENARIO = ("paper_circle", "--set", "loop.rate_hz=100")
REAL_TIME = (*SCENARIO, "--mode", "realtime")
RUN = ("--record", "none", "--json", "--set", "expect=[]")
REARM = ("--set", "loop.rearm=true")


def start_run(*options: str) -> subprocess.Popen[str]:
    command = [*HIL, "run", *RUN, *options]
    return subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> dict:
    output, errors = process.communicate(timeout=90)
    assert "Traceback" not in errors
    return json.loads(output)


def wait_until_driven(truth: str) -> None:
    """Wait until the robot of a truth socket is ACTIVE and turns its wheels; before that it must not turn them."""
    watcher = TruthClient(truth, load("paper_circle", set=["loop.rate_hz=100"]).hash, reset=False)
    with contextlib.closing(watcher):
        seen: list[TruthRecord] = []

        def is_driven() -> bool:
            watcher.poll()
            seen.extend(watcher.taken)
            return bool(seen) and seen[-1].state is State.ACTIVE and any(seen[-1].set_point_rad_s)

        wait_for(is_driven, 60.0)
    # A busy machine may have stopped the robot meanwhile, and begun another session.
    assert not [r for r in seen if r.state in (State.IDLE, State.ARMED) and any(r.set_point_rad_s)]


@pytest.mark.alone
def test_a_serial_robot_that_was_killed_and_started_again_is_armed_anew(tmp_path: Path):
    name = tmp_path / "robot"
    serial = ("--link", f"serial:pty?symlink={name}")
    blind = ("--set", "estimator.source=odometry", "--set", "loop.duration_s=10")
    with device(*REAL_TIME, *serial) as robot:
        driver = start_run(*REAL_TIME, "--link", f"serial:{name}", *blind, *REARM)
        wait_until_driven(robot.truth)
        robot.process.kill()
        robot.process.wait()
    # As udev does. Else it leads to whatever terminal gets the number next: the robot of a test beside this one.
    name.unlink()
    with device(*REAL_TIME, *serial) as robot:
        wait_until_driven(robot.truth)
        figures = finish(driver)
    assert figures["failure"] is None
    assert any("lost" in row["why"] for row in figures["recoveries"]), "beside stalls of this machine"
    assert figures["stopped"]
    assert figures["ticks"] + figures["deadline_misses"] == 1000


@pytest.mark.alone
def test_a_link_that_falls_silent_and_is_then_unplugged_holds_no_tick_up(tmp_path: Path):
    """Its TIME_SYNC is never answered, and waiting for that must not be taken for time that stands still."""
    name = tmp_path / "robot"
    changes = ["loop.rate_hz=100", "loop.duration_s=3", "expect=[]", "loop.rearm=true", "estimator.source=odometry"]
    scenario = load("paper_circle", set=[*changes, "loop.mode=realtime", f"link.url=serial:{name}"])

    with device(*REAL_TIME, "--link", f"serial:pty?symlink={name}") as robot:

        def unplug(loop: Loop) -> None:
            wait_for(lambda: loop.t_s > 0.5)
            robot.process.send_signal(signal.SIGSTOP)
            wait_for(lambda: loop.t_s > 1.0)
            robot.process.kill()

        @contextlib.contextmanager
        def watch(loop: Loop) -> Iterator[None]:
            hand = threading.Thread(target=unplug, args=(loop,))
            hand.start()
            yield
            hand.join()

        result = run_scenario(scenario, RunOptions(watch=watch))
    assert isinstance(result.failure, LinkError)
    assert "it did not come back until the end" in str(result.failure)
    assert result.metrics["ticks"] + result.metrics["deadline_misses"] == 300


NETWORK = r"""
import json, subprocess, sys, time
from tests.support.processes import HIL, device, environment, wait_for
from tests.runtime.test_rearm_processes import REAL_TIME, REARM, finish, start_run

BUS = ("--link", "can:udp_multicast/239.74.163.2")
ip = lambda *words: subprocess.run(["ip", *words], check=True)
with device(*REAL_TIME, *BUS) as robot:
    driver = start_run(*REAL_TIME, *BUS, "--truth", robot.truth, "--set", "loop.duration_s=8", *sys.argv[1:])
    from firmware_protocol.generated.messages import State
    from hil.robot.truth_client import TruthClient
    from hil.scenario import load
    watcher = TruthClient(robot.truth, load("paper_circle", set=["loop.rate_hz=100"]).hash, reset=False)
    seen = []
    def state():
        watcher.poll()
        seen.extend(watcher.taken)
        return seen[-1].state if seen else None
    wait_for(lambda: state() is State.ACTIVE)
    begun_ns = seen[-1].fix.time_ns
    wait_for(lambda: state() is State.ACTIVE and seen[-1].fix.time_ns > begun_ns + 1_000_000_000)
    ip("route", "del", "224.0.0.0/4", "dev", "lo")
    down = len(seen)
    wait_for(lambda: state() is State.IDLE)
    idle = len(seen)
    ip("route", "add", "224.0.0.0/4", "dev", "lo")
    if sys.argv[1:]:
        wait_for(lambda: state() is State.ACTIVE)
        assert all(not any(r.set_point_rad_s) for r in seen[idle:] if r.state in (State.IDLE, State.ARMED))
    figures = finish(driver)
    watcher.close()
print(json.dumps(figures))
"""


def in_a_network_of_its_own(*arguments: str) -> dict:
    command = [*network_of_its_own(), sys.executable, "-c", NETWORK, *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=180, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_can_bus_that_goes_down_and_up_is_recovered_from():
    figures = in_a_network_of_its_own(*REARM)
    assert figures["failure"] is None
    reasons = [row["why"] for row in figures["recoveries"]]
    assert any("unreachable" in why for why in reasons), "beside stalls of this machine"
    assert figures["stopped"]


def test_without_the_key_a_can_bus_that_goes_down_ends_the_run():
    figures = in_a_network_of_its_own()
    assert "set loop.rearm = true" in figures["failure"]
    assert figures["recoveries"] == []
