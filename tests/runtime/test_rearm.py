"""A lost link or a stopped robot, brought back by the run itself: only when asked for, and nothing moves before."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.addons.report.trace import trace_decoder as decode
from hil.core.errors import BadInputError, LinkError
from hil.runtime.assembly import RunResult, run
from hil.runtime.bench import Bench
from tests.support.fault_runs import LINKS

SHORT = ("loop.duration_s=3", "expect=[]", "loop.rate_hz=200")
COMMANDS = (m.TorqueCommand, m.WheelCommand, m.TorqueFeedforward)
# The firmware's state as the rows have it.
ACTIVE = float(m.State.ACTIVE)


def cut(end_s: float) -> str:
    """The override that cuts the link at 1 s."""
    return f'fault=[{{kind="disconnect",start_s=1.0,end_s={end_s}}}]'


# The link is opened again 0.1, 0.3, 0.7 and 1.5 s after the loss.
BACK_AT_ONCE, BACK_AT_THE_SECOND, BACK_AT_THE_FOURTH = cut(1.05), cut(1.2), cut(2.0)
RESET = 'fault=[{kind="reset",target="robot",start_s=1.0}]'


def run_short(*options: str, rearm: bool = True, link: str = "memory:", trace: Path | None = None) -> RunResult:
    changes = [*SHORT, f"loop.rearm={str(rearm).lower()}", *options]
    return run("paper_circle", set=changes, mode="lockstep", link=link, trace=trace)


def sent_since_the_second_handshake(trace: Path) -> list[codec.Message]:
    sent = [x.message for x in decode.read(trace, decode.Selection.of([], 0.0, math.inf)) if x.frame.direction == "Tx"]
    last = max(i for i, x in enumerate(sent) if isinstance(x, m.HelloRequest))
    return sent[last:]


def away(result: RunResult) -> Iterator[int]:
    """The rows between the loss and ACTIVE again."""
    (recovery,) = result.metrics["recoveries"]
    t_s = result.signals["loop.t_s"]
    return (i for i in range(len(t_s)) if recovery["lost_s"] <= t_s[i] < recovery["armed_s"])


def test_without_the_key_a_lost_link_ends_the_run_and_says_what_to_set():
    result = run_short(BACK_AT_ONCE, rearm=False)
    assert isinstance(result.failure, LinkError)
    assert result.exit_code == 3
    assert "the link was cut by the fault disconnect" in str(result.failure)
    assert "set loop.rearm = true" in str(result.failure)
    assert result.metrics["recoveries"] == []


@pytest.mark.parametrize("link", LINKS)
def test_a_lost_link_is_reopened_with_back_off_and_the_run_goes_on(link):
    result = run_short(BACK_AT_THE_FOURTH, link=link)
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert recovery["lost_s"] == pytest.approx(1.0)
    assert "the link was cut by the fault disconnect" in recovery["why"]
    # 0.1 + 0.2 + 0.4 + 0.8 s of robot time, then HELLO and the way to ACTIVE.
    assert 2.5 <= recovery["armed_s"] < 2.6
    assert result.metrics["ticks"] == 600, "rows go on meanwhile"
    assert result.metrics["stopped"]
    assert result.passed
    (fault,) = result.metrics["fault"]
    assert fault["applied"] == 4, "the command that found no link, and three attempts to open it"


@pytest.mark.proves("R-ARM-4", "R-CMD-2")
def test_nothing_is_commanded_while_it_is_away_and_zeros_before_the_new_session(tmp_path):
    result = run_short(BACK_AT_THE_SECOND, trace=tmp_path / "line.log")
    signals = result.signals
    assert all(math.isnan(signals["wheel.fl.torque_command_n_m"][i]) for i in away(result))
    sent = sent_since_the_second_handshake(tmp_path / "line.log")
    heartbeats = [x for x in sent if isinstance(x, m.HostHeartbeat)]
    announced, armed = heartbeats[:2]
    assert (announced.request, armed.request) == (m.Request.IDLE, m.Request.ARM)
    assert announced.nonce == armed.nonce
    first = next(i for i, x in enumerate(sent) if isinstance(x, COMMANDS))
    assert first > sent.index(armed)
    commands = [x for x in sent if isinstance(x, COMMANDS)]
    assert not any(commands[0][:4]), "ARMED wants zeros first"
    assert {x.session for x in commands} == {armed.nonce & 0xF}


@pytest.mark.proves("R-GEN-4")
def test_the_robot_has_stopped_until_the_new_arm():
    """The truth, not what the host believes: from watchdog, ramp and run-out on it only coasts, 2 mm/s here."""
    result = run_short(BACK_AT_THE_FOURTH)
    (recovery,) = result.metrics["recoveries"]
    t_s, x_m, y_m = (result.signals[name] for name in ("loop.t_s", "truth.x_m", "truth.y_m"))
    still = (t_s > recovery["lost_s"] + 0.6) & (t_s < recovery["armed_s"])
    assert still.sum() > 100
    assert max(x_m[still]) - min(x_m[still]) < 4e-3
    assert max(y_m[still]) - min(y_m[still]) < 4e-3
    driven = t_s > recovery["armed_s"] + 0.2
    assert max(x_m[driven]) - min(x_m[driven]) > 0.01, "and then it drives again"


@pytest.mark.parametrize("lost", [BACK_AT_THE_SECOND, RESET])
def test_a_recovery_in_lockstep_repeats_exactly_on_every_link(lost):
    results = [run_short(lost, link=link) for link in (*LINKS, LINKS[0])]
    assert len({result.metrics["wire_sha256"] for result in results}) == 1
    assert len({str(result.metrics["recoveries"]) for result in results}) == 1


@pytest.mark.parametrize("held", ["", ',{kind="delay",target="command",value=0.03}'])
def test_what_was_held_back_is_no_command_of_the_new_session(tmp_path, held):
    latencies = ("link.command_latency_s=0.03", "link.feedback_latency_s=0.02")
    fault = BACK_AT_THE_SECOND.removesuffix("]") + held + "]"
    result = run_short(fault, *latencies, trace=tmp_path / "line.log")
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert recovery["armed_s"] > recovery["lost_s"] + 0.3
    commands = [x for x in sent_since_the_second_handshake(tmp_path / "line.log") if isinstance(x, COMMANDS)]
    assert len({x.session for x in commands}) == 1


def test_a_link_that_stays_away_fails_the_run_at_its_end():
    result = run_short('fault=[{kind="disconnect",start_s=1.0}]')
    assert isinstance(result.failure, LinkError)
    assert "did not come back until the end: the link was cut by the fault disconnect" in str(result.failure)
    assert result.metrics["ticks"] == 600


@pytest.mark.alone
@pytest.mark.parametrize("link", LINKS)
def test_a_lost_link_is_reopened_in_real_time_too(link):
    options = ("loop.rate_hz=100", "loop.duration_s=4", "expect=[]", "loop.rearm=true", BACK_AT_THE_SECOND)
    result = run("paper_circle", set=options, mode="realtime", link=link)
    # A busy machine may stop the robot besides, even at the end; the robot's watchdog is what such a recovery names.
    (recovery,) = [row for row in result.metrics["recoveries"] if "disconnect" in row["why"]]
    assert recovery["armed_s"] > recovery["lost_s"] + 0.3
    assert ACTIVE in result.signals["robot.state"][result.signals["loop.t_s"] >= recovery["armed_s"]]


def test_the_counts_of_a_link_go_on_across_its_loss_and_the_gap_is_no_loss_of_frames():
    result = run_short(BACK_AT_THE_SECOND)
    figures = result.metrics["link_statistics"]
    for name in ("link.sent_bytes", "link.received_bytes"):
        counts = result.signals[name]
        assert all(counts[1:] >= counts[:-1]), name
    assert figures["lost"] == {"snapshots": 0, "frames_to_host": 0, "frames_to_robot": 0}
    assert figures["rejected"] == {}
    # Commands that had no answer when the link was lost are no round trips of a second.
    assert figures["round_trip_ms"]["p99"] == pytest.approx(5.0)
    assert max(result.signals["link.rtt_ms"][10:]) == pytest.approx(5.0)


BIT_ERRORS = 'fault=[{kind="bit_errors",target="command",value=0.05,start_s=1.0,end_s=1.5}]'


def test_bus_off_is_a_lost_link_that_is_recovered_from():
    result = run_short(BIT_ERRORS, link="can:virtual/bus_off")
    assert result.failure is None
    assert any("bus-off" in row["why"] for row in result.metrics["recoveries"])
    assert result.signals["robot.state"][-1] == ACTIVE
    rejected = result.metrics["frames"]["rejected"]
    assert rejected["error_bus_off"] >= 1
    assert rejected["error_bit"] >= 256 / 8


def test_without_the_key_bus_off_ends_the_run():
    result = run_short(BIT_ERRORS, rearm=False, link="can:virtual/bus_off")
    assert isinstance(result.failure, LinkError)
    assert "bus-off" in str(result.failure)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("source", ["truth", "odometry", "fused"])
def test_a_reset_of_the_robot_is_recovered_from(source, link):
    result = run_short(RESET, f"estimator.source={source}", link=link)
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert "reset" in recovery["why"]
    after = result.signals["robot.time_s"][-1]
    assert 0.0 < after < 3.0, "the robot's clock began anew"
    jumps = abs(result.signals["pose.x_m"][1:] - result.signals["pose.x_m"][:-1])
    if source == "odometry":
        assert max(j for j in jumps if not math.isnan(j)) < 0.01, "encoders that began anew are no motion"


@pytest.mark.parametrize("resets_s", [[0.2], [0.5, 0.72]])
def test_a_reset_soon_after_power_on_is_seen_by_odometry(resets_s):
    """The robot's clock is then near to where it would be without the reset."""
    rows = ",".join(f'{{kind="reset",target="robot",start_s={at_s}}}' for at_s in resets_s)
    options = ("expect=[]", "loop.duration_s=1.5", "loop.rearm=true", "estimator.source=odometry", f"fault=[{rows}]")
    result = run("circle_speed", set=options)
    assert result.failure is None
    assert len(result.metrics["recoveries"]) == len(resets_s)
    x_m, y_m = result.signals["pose.x_m"], result.signals["pose.y_m"]
    known = ~(np.isnan(x_m) | np.isnan(y_m))
    leaps_m = np.hypot(np.diff(x_m[known]), np.diff(y_m[known]))
    assert leaps_m.max() < 0.01
    after = known & (result.signals["loop.t_s"] > result.metrics["recoveries"][-1]["armed_s"] + 0.1)
    assert (np.hypot(np.diff(x_m[after]), np.diff(y_m[after])) > 0.0).all(), "and it counts from then on"


def test_a_link_lost_while_the_first_feedback_is_on_its_way_is_recovered_from():
    result = run_short('fault=[{kind="disconnect",start_s=0.0,end_s=0.2}]', "link.feedback_latency_s=0.02")
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert recovery["lost_s"] == 0.0
    assert (result.metrics["ticks"], result.metrics["deadline_misses"]) == (600, 0)


def test_the_clock_of_a_robot_that_was_reset_is_read_anew():
    clock = run_short(RESET).metrics["link_statistics"]["clock"]
    assert clock["steps"] == 1
    assert clock["offset_us"] < -0.9e6, "it began more than 1 s after the run's"
    assert clock["drift_ppm"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.alone
def test_a_reset_in_real_time_is_recovered_from():
    options = ("loop.rate_hz=100", "loop.duration_s=3", "expect=[]", "loop.rearm=true", RESET)
    result = run("paper_circle", set=options, mode="realtime", link="serial:pty")
    assert result.metrics["recoveries"]
    assert result.signals["robot.time_s"][-1] < 3.0, "the robot's clock began anew"


def test_another_reset_before_the_robot_is_back_begins_the_recovery_again():
    twice = RESET.removesuffix("]") + ',{kind="reset",target="robot",start_s=1.2}]'
    result = run_short(twice)
    assert result.failure is None
    assert [row["applied"] for row in result.metrics["fault"]] == [1, 1]
    assert result.signals["robot.state"][-1] == ACTIVE


MUTE = 'fault=[{kind="mute",target="TORQUE_COMMAND",start_s=1.0,end_s=1.5}]'


def test_a_robot_that_its_watchdog_stopped_is_armed_anew():
    result = run_short(MUTE)
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert "COMMAND_TIMEOUT" in recovery["why"]
    states = [result.signals["robot.state"][i] for i in away(result)]
    assert {float(m.State.STOPPING), float(m.State.IDLE), float(m.State.ARMED)} <= set(states)
    assert result.signals["robot.state"][-1] == ACTIVE


def test_without_the_key_a_stopped_robot_ends_the_run_and_says_what_to_set():
    result = run_short(MUTE, rearm=False)
    assert result.exit_code == 3
    assert "COMMAND_TIMEOUT; to reconnect and arm anew in such a case, set loop.rearm = true" in str(result.failure)


@pytest.fixture
def at_command(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, Callable[[Bench], None]], None]:
    """Do something to the bench at a number of commands."""

    def arrange(number: int, what: Callable[[Bench], None]) -> None:
        original = Bench.connect

        def connect(bench: Bench) -> object:
            info = original(bench)
            send, left = bench.device.send, [number]

            def counted(command: object) -> int:
                left[0] -= 1
                if left[0] == 0:
                    what(bench)
                return send(command)

            bench.device.send = counted
            return info

        monkeypatch.setattr(Bench, "connect", connect)

    return arrange


@pytest.mark.proves("R-STATE-10")
def test_an_e_stop_is_not_recovered_from(at_command):
    """Whoever pressed it decides when the robot may move again."""
    at_command(200, lambda bench: bench.device._link.send(codec.encode(m.Estop(0, 0))))
    result = run_short()
    assert "it is ESTOP because of" in str(result.failure)
    assert "rearm" not in str(result.failure)
    assert result.exit_code == 3
    assert result.metrics["recoveries"] == []


def test_another_robot_on_the_link_is_refused_and_left_alone(at_command, tmp_path):
    def exchange(bench: Bench) -> None:
        robot = bench.local.robot
        robot._made_of = robot._made_of._replace(firmware=robot._made_of.firmware | {"speed_kp_n_m_s_rad": 1.0})
        robot.power_cycle()

    at_command(200, exchange)
    result = run_short(trace=tmp_path / "line.log")
    assert isinstance(result.failure, BadInputError)
    since = sent_since_the_second_handshake(tmp_path / "line.log")
    assert {type(x) for x in since} <= {m.HelloRequest, m.Step, m.TimeSyncRequest}
    assert not result.metrics["stopped"]
    assert "are not the scenario's [firmware]" in str(result.failure)
    assert result.metrics["recoveries"] == []


@pytest.mark.parametrize("reset_s", [0.25, 0.255, 0.3])  # of the last it comes back rolling against its commands
def test_a_robot_that_is_reset_while_its_link_is_cut_comes_back(reset_s) -> None:
    cut = '{kind = "disconnect", start_s = 0.25, end_s = 0.35}'
    reset = f'{{kind = "reset", target = "robot", start_s = {reset_s}}}'
    result = run("circle_speed", set=[*SHORT, "loop.duration_s=1.3", "loop.rearm=true", f"fault=[{cut}, {reset}]"])
    assert result.failure is None
    assert result.passed
    assert len(result.metrics["recoveries"]) == 1
