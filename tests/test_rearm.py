"""A lost link or a stopped robot, brought back by the run itself: only when asked for, and nothing moves before."""

import math
from collections.abc import Callable, Iterator

import pytest

import hil.bench
from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.assembly import RunResult, run
from hil.bench import Bench
from hil.errors import BadInputError, LinkError
from hil.links.delay import FIRST_EXEMPT_ID
from hil.links.opening import Pair
from hil.ports import Link, Received

SHORT = ("loop.duration_s=3", "expect=[]", "loop.rate_hz=200")
COMMANDS = (m.TorqueCommand, m.WheelCommand, m.TorqueFeedforward)
# The firmware's state as the rows have it.
ACTIVE = float(m.State.ACTIVE)


class Cut:
    """A link that is cut at a number of commands and refuses so many times to open again; STEP passes."""

    def __init__(self, link: Link, at_command: int, refusals: int) -> None:
        self._link = link
        self._left = at_command
        self._refusals = refusals
        self.is_cut = False
        self.sent: list[codec.Message] = []

    def send(self, frame: Frame) -> None:
        message = codec.decode(frame)
        if isinstance(message, COMMANDS):
            self._left -= 1
            self.is_cut = self.is_cut or self._left == 0
        if self.is_cut and frame.id < FIRST_EXEMPT_ID:
            raise LinkError("the cable was pulled")
        self.sent.append(message)
        self._link.send(frame)

    def receive(self, timeout_ns: int) -> Received | None:
        while (received := self._link.receive(timeout_ns)) is not None:
            if not self.is_cut or received.frame.id >= FIRST_EXEMPT_ID:
                return received
        return None

    def reopen(self) -> None:
        self._refusals -= 1
        if self._refusals >= 0:
            raise LinkError("the cable is still out")
        self._link.reopen()
        self.is_cut = False
        self.sent.clear()

    def __getattr__(self, name: str) -> object:
        return getattr(self._link, name)


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Cut]]:
    """Cut the link of the next run; return the cut links, one a run."""

    def arrange(at_command: int, refusals: int = 0) -> list[Cut]:
        cuts: list[Cut] = []
        original = hil.bench.open_pair

        def open_pair(url: object) -> Pair:
            pair = original(url)
            cuts.append(Cut(pair.link, at_command, refusals))
            return pair._replace(link=cuts[-1])

        monkeypatch.setattr(hil.bench, "open_pair", open_pair)
        return cuts

    return arrange


def run_short(*options: str, rearm: bool = True) -> RunResult:
    return run("paper_circle", set=[*SHORT, f"loop.rearm={str(rearm).lower()}", *options])


def away(result: RunResult) -> Iterator[int]:
    """The rows between the loss and ACTIVE again."""
    (recovery,) = result.metrics["recoveries"]
    t_s = result.signals["loop.t_s"]
    return (i for i in range(len(t_s)) if recovery["lost_s"] <= t_s[i] <= recovery["armed_s"])


def test_without_the_key_a_lost_link_ends_the_run_and_says_what_to_set(cut):
    cut(200)
    result = run_short(rearm=False)
    assert isinstance(result.failure, LinkError)
    assert result.exit_code == 3
    assert "the cable was pulled" in str(result.failure)
    assert "set loop.rearm = true" in str(result.failure)
    assert result.metrics["recoveries"] == []


def test_a_lost_link_is_reopened_with_back_off_and_the_run_goes_on(cut):
    cut(200, refusals=3)
    result = run_short()
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert recovery["lost_s"] == pytest.approx(0.99)
    assert recovery["why"] == "the cable was pulled"
    # 0.1 + 0.2 + 0.4 + 0.8 s of robot time, then HELLO and the way to ACTIVE.
    assert 2.495 <= recovery["armed_s"] < 2.6
    assert result.metrics["ticks"] == 600, "rows go on meanwhile"
    assert result.metrics["stopped"]


def test_nothing_is_commanded_while_it_is_away_and_only_zeros_before_the_new_session_is_active(cut):
    cuts = cut(200, refusals=1)
    result = run_short()
    (link,) = cuts
    signals = result.signals
    assert all(math.isnan(signals["wheel.fl.torque_command_n_m"][i]) for i in away(result))
    heartbeats = [x for x in link.sent if isinstance(x, m.HostHeartbeat)]
    announced, armed = heartbeats[:2]
    assert (announced.request, armed.request) == (m.Request.IDLE, m.Request.ARM)
    assert announced.nonce == armed.nonce
    first = next(i for i, x in enumerate(link.sent) if isinstance(x, COMMANDS))
    assert first > link.sent.index(armed)
    zeros = [x for x in link.sent if isinstance(x, COMMANDS)]
    assert not any(zeros[0][:4]), "ARMED wants zeros first"
    assert {x.session for x in zeros} == {armed.nonce & 0xF}


def test_the_robot_has_stopped_until_the_new_arm(cut):
    """The truth, not what the host believes: from watchdog, ramp and run-out on it only coasts, 2 mm/s here."""
    cut(200, refusals=3)
    result = run_short()
    (recovery,) = result.metrics["recoveries"]
    t_s, x_m, y_m = (result.signals[name] for name in ("loop.t_s", "truth.x_m", "truth.y_m"))
    still = (t_s > recovery["lost_s"] + 0.6) & (t_s < recovery["armed_s"])
    assert still.sum() > 100
    assert max(x_m[still]) - min(x_m[still]) < 4e-3
    assert max(y_m[still]) - min(y_m[still]) < 4e-3
    driven = t_s > recovery["armed_s"] + 0.2
    assert max(x_m[driven]) - min(x_m[driven]) > 0.01, "and then it drives again"


def test_a_recovery_in_lockstep_repeats_exactly(cut):
    cut(200, refusals=2)
    first, again = run_short(), run_short()
    assert first.metrics["wire_sha256"] == again.metrics["wire_sha256"]
    assert first.metrics["recoveries"] == again.metrics["recoveries"]


def test_latencies_hold_no_command_of_the_old_session(cut):
    cuts = cut(200, refusals=1)
    result = run_short("link.command_latency_s=0.03", "link.feedback_latency_s=0.02")
    assert result.failure is None
    sessions = {x.session for x in cuts[0].sent if isinstance(x, COMMANDS)}
    assert len(sessions) == 1


def test_a_link_that_stays_away_fails_the_run_at_its_end(cut):
    cut(200, refusals=1000)
    result = run_short()
    assert isinstance(result.failure, LinkError)
    assert "did not come back until the end: the cable is still out" in str(result.failure)
    assert result.metrics["ticks"] == 600


MUTE = 'fault=[{kind="mute",target="TORQUE_COMMAND",start_s=1.0,end_s=1.5}]'


def test_a_robot_that_its_watchdog_stopped_is_armed_anew():
    result = run_short(MUTE)
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert "COMMAND_TIMEOUT" in recovery["why"]
    states = [result.signals["robot.state"][i] for i in away(result)]
    assert {float(m.State.STOPPING), float(m.State.IDLE), float(m.State.ARMED)} <= set(states)
    assert states[-1] == ACTIVE


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

            def counted(command: object) -> None:
                left[0] -= 1
                if left[0] == 0:
                    what(bench)
                send(command)

            bench.device.send = counted
            return info

        monkeypatch.setattr(Bench, "connect", connect)

    return arrange


@pytest.mark.parametrize("source", ["truth", "odometry"])
def test_a_reset_of_the_robot_is_recovered_from(at_command, source):
    at_command(200, lambda bench: bench._robot.power_cycle())
    result = run_short(f"estimator.source={source}")
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    assert "reset" in recovery["why"]
    after = result.signals["robot.time_s"][-1]
    assert 0.0 < after < 3.0, "the robot's clock began anew"
    jumps = abs(result.signals["pose.x_m"][1:] - result.signals["pose.x_m"][:-1])
    if source == "odometry":
        assert max(j for j in jumps if not math.isnan(j)) < 0.01, "encoders that began anew are no motion"


def test_an_e_stop_is_not_recovered_from(at_command):
    """Whoever pressed it decides when the robot may move again."""
    at_command(200, lambda bench: bench.device._link.send(codec.encode(m.Estop(0, 0))))
    result = run_short()
    assert "it is ESTOP because of" in str(result.failure)
    assert "rearm" not in str(result.failure)
    assert result.exit_code == 3
    assert result.metrics["recoveries"] == []


def test_another_robot_on_the_link_is_refused(at_command):
    def exchange(bench: Bench) -> None:
        robot = bench._robot
        robot._made_of = robot._made_of._replace(firmware=robot._made_of.firmware | {"speed_kp_n_m_s_rad": 1.0})
        robot.power_cycle()

    at_command(200, exchange)
    result = run_short()
    assert isinstance(result.failure, BadInputError)
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
