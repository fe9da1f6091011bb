"""The controller here, the virtual robot in another process, a serial line between them."""

import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_protocol.generated.messages import State
from hil.core.errors import BadInputError, DeviceError
from hil.judge.recorded import review
from hil.record.reader import read
from hil.robot.truth_client import TruthClient, TruthRecord
from hil.scenario import load
from tests.support.processes import HIL, Device, device, environment, hil, hil_process, run_json, wait_for

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

RATE = ("--set", "loop.rate_hz=200")


def run_against(robot: Device) -> list[str]:
    """The arguments of a real-time run against a robot in another process."""
    return ["run", "paper_circle", "--mode", "realtime", "--link", robot.link, "--truth", robot.truth, *RATE]


def test_lockstep_in_two_processes_gives_the_bytes_of_one(tmp_path: Path):
    options = ("--mode", "lockstep", "--set", "loop.duration_s=6", "--set", "expect=[]", *RATE)
    name = tmp_path / "robot"
    with device("paper_circle", "--mode", "lockstep", *RATE, "--link", f"serial:pty?symlink={name}") as robot:
        assert robot.link == f"serial:{name}"
        there = ("--link", robot.link, "--truth", robot.truth, "--record", "none")
        first = run_json("paper_circle", *options, *there)
        again = run_json("paper_circle", *options, *there)
    one = run_json("paper_circle", *options, "--record", "none")
    assert one["wire_sha256"] == first["wire_sha256"] == again["wire_sha256"]
    assert one["steady_rms_m"] == first["steady_rms_m"] == again["steady_rms_m"]
    assert first["steady_rms_m"] < 0.003
    assert not name.is_symlink(), "the robot takes its name away when it ends"
    assert robot.process.returncode == 0


@pytest.mark.alone
def test_real_time_in_two_processes_tracks_the_circle():
    with device("paper_circle", "--mode", "realtime", "--link", "serial:pty") as robot:
        there = ("--link", robot.link, "--truth", robot.truth, "--record", "none")
        # On a machine that stalls the watchdog may stop the robot, rightly.
        short = ("--set", "loop.duration_s=6", "--set", "expect=[]", "--set", "loop.rearm=true")
        figures = run_json("paper_circle", "--mode", "realtime", *there, *short, by=hil_process)
    assert figures["failure"] is None
    assert figures["steady_rms_m"] < 0.003
    assert figures["realtime_factor"] == pytest.approx(1.0, abs=0.02)


@pytest.mark.alone
def test_killed_controller_leaves_stopped_wheels_and_a_recording_that_opens(tmp_path: Path):
    """SIGKILL in mid-run: the set point is zero within watchdog and ramp of robot time."""
    recording = tmp_path / "run.rrd"
    scenario = load("paper_circle", set=["loop.rate_hz=200"])
    with device("paper_circle", "--mode", "realtime", "--link", "serial:pty", *RATE) as robot:
        controller = subprocess.Popen(
            [*HIL, *run_against(robot), "--record", str(recording)],
            env=environment(),
        )
        watcher = TruthClient(robot.truth, scenario.hash, reset=False)
        seen: list[TruthRecord] = []

        def newest() -> TruthRecord:
            watcher.poll()
            seen.extend(watcher.taken)
            return seen[-1]

        wait_for(watcher.poll)
        seen.extend(watcher.taken)
        wait_for(lambda: newest().state is State.ACTIVE and max(map(abs, seen[-1].set_point_rad_s)) > 3.0)
        begun_ns = seen[-1].fix.time_ns
        wait_for(lambda: newest().fix.time_ns > begun_ns + 1_500_000_000)
        controller.send_signal(signal.SIGKILL)
        controller.wait()
        wait_for(lambda: newest().state is State.IDLE)
        watcher.close()
    # In robot time, by the firmware's own count since the last command: never ACTIVE beyond the watchdog, and no set
    # point left beyond watchdog and ramp. Each record is one; how this machine stalled between them does not matter.
    watchdog_ms, ramp_ms = scenario.firmware.watchdog_s * 1e3, scenario.firmware.ramp_s * 1e3
    after = [r for r in seen if r.fix.time_ns > begun_ns]
    assert {State.ACTIVE, State.STOPPING, State.IDLE} == {r.state for r in after}
    assert all(r.command_age_ms < watchdog_ms for r in after if r.state is State.ACTIVE)
    assert all(not any(r.set_point_rad_s) for r in after if r.command_age_ms >= watchdog_ms + ramp_ms)
    assert any(any(r.set_point_rad_s) for r in after if r.state is State.STOPPING)
    assert math.hypot(seen[-1].fix.twist.vx_m_s, seen[-1].fix.twist.vy_m_s) < 0.05
    run = wait_for(lambda: finished(recording))
    assert len(run.signals["loop.t_s"]) > 200
    figures = review(recording)
    assert figures["passed"] is None
    assert "did not come to its end" in figures["reasons"]["passed"]


def finished(recording: Path):
    """The recorder ends by itself when the run was killed; until then the file may hold nothing yet."""
    try:
        run = read(recording)
    except BadInputError:
        return None
    return run if len(run.signals.get("loop.t_s", ())) > 200 else None


@pytest.mark.alone
def test_sigterm_stops_the_robot_and_closes_the_recording(tmp_path: Path):
    recording = tmp_path / "run.rrd"
    scenario = load("paper_circle", set=["loop.rate_hz=200"])
    with device("paper_circle", "--mode", "realtime", "--link", "serial:pty", *RATE) as robot:
        controller = subprocess.Popen(
            [*HIL, *run_against(robot), "--record", str(recording)],
            env=environment(),
            stderr=subprocess.PIPE,
            text=True,
        )
        watcher = TruthClient(robot.truth, scenario.hash, reset=False)

        def state():
            watcher.poll()
            return watcher.newest.state if watcher.newest else None

        wait_for(lambda: state() is State.ACTIVE)
        begun_ns = watcher.newest.fix.time_ns
        wait_for(lambda: state() is State.ACTIVE and watcher.newest.fix.time_ns > begun_ns + 300_000_000)
        controller.terminate()
        _, errors = controller.communicate(timeout=30)
        assert controller.returncode == 130
        assert errors == f"hil: interrupted; the robot was told to stop; recorded until then: {recording}\n"
        assert state() is State.IDLE
        watcher.close()
    assert len(read(recording).signals["loop.t_s"]) > 0


def test_an_abandoned_lockstep_robot_is_put_back_to_its_start():
    """Its host was killed: time stands still, so only silence tells that nobody drives it any more."""
    lockstep = ("paper_circle", "--mode", "lockstep")
    with device(*lockstep, "--link", "serial:pty") as robot:
        there = ("--link", robot.link, "--truth", robot.truth, "--record", "none")
        controller = subprocess.Popen([*HIL, "run", *lockstep, *there], env=environment())
        watcher = TruthClient(robot.truth, load("paper_circle").hash, reset=False)
        wait_for(lambda: watcher.poll() and watcher.newest.state is State.ACTIVE)
        controller.kill()
        controller.wait()
        watcher.close()
        again = wait_for(lambda: run if (run := hil("run", *lockstep, *there, "--json")).returncode == 0 else None)
    assert '"passed": true' in again.stdout


@pytest.mark.alone
def test_lost_robot_ends_the_run_with_exit_code_3():
    with device("paper_circle", "--mode", "realtime", "--link", "serial:pty", *RATE) as robot:
        controller = subprocess.Popen(
            [*HIL, *run_against(robot), "--record", "none", "--json"],
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        scenario = load("paper_circle", set=["loop.rate_hz=200"])
        watcher = TruthClient(robot.truth, scenario.hash, reset=False)
        wait_for(lambda: watcher.poll() and max(map(abs, watcher.newest.set_point_rad_s)) > 3.0)
        robot.process.kill()
        output, errors = controller.communicate(timeout=30)
        watcher.close()
    assert controller.returncode == 3
    assert "lost" in errors or "closed" in errors
    assert "Traceback" not in errors
    assert '"passed": false' in output


def test_both_must_run_the_same_scenario():
    with device("paper_circle", "--link", "serial:pty") as robot:
        there = ("--link", robot.link, "--truth", robot.truth, "--record", "none")
        other = hil("run", "paper_circle", *there, "--set", "firmware.speed_kp_n_m_s_rad=1.0")
        assert other.returncode == 3
        assert "another scenario" in other.stderr
        without_truth = hil(
            *("run", "paper_circle", "--link", robot.link, "--record", "none", "--set", "estimator.source=odometry"),
            *("--set", "firmware.speed_kp_n_m_s_rad=1.0"),
        )
        assert without_truth.returncode == 2
        assert "start both from the same scenario" in without_truth.stderr
        real_time = hil("run", "paper_circle", *there, "--mode", "realtime")
        assert real_time.returncode == 2
        assert "same --mode" in real_time.stderr


def test_without_truth_the_truth_figures_are_null_with_a_reason():
    short = ("--set", "loop.duration_s=1", "--set", "expect=[]", "--set", "estimator.source=odometry")
    with device("paper_circle", "--link", "serial:pty") as robot:
        figures = run_json("paper_circle", "--link", robot.link, "--record", "none", *short)
    assert figures["passed"]
    assert figures["tracked_s"] is None
    assert "no ground truth" in figures["reasons"]["tracked_s"]


def test_truth_socket_refuses_what_it_does_not_understand():
    with device("paper_circle", "--link", "serial:pty") as robot:
        with pytest.raises(DeviceError, match="another scenario"):
            TruthClient(robot.truth, "0" * 64, reset=False)
        port = int(robot.truth.rpartition(":")[2])
        taken = hil("device", "paper_circle", "--link", "serial:pty", "--truth-port", str(port))
        assert taken.returncode == 2
        assert f"truth port {port} cannot be opened" in taken.stderr
