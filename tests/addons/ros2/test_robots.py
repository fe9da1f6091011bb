"""The two robots of a node, behind a service and simulated: orders, answers, and what they say, without ROS 2."""

import contextlib
import itertools
import queue
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from hil.addons.ros2.robot import OwnService, ServedRobot
from hil.addons.ros2.settings import Settings
from hil.addons.ros2.simulation import Simulation
from hil.addons.service.messages import Action
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError
from hil.scenario import load
from tests.support.processes import hil, wait_for
from tests.support.ros2_testbed import needs_ros


class Service:
    """A client of a service, and its WebSocket, as the test lets them answer: ``comes`` are messages or an error."""

    def __init__(self) -> None:
        self.comes: queue.Queue[Mapping[str, Any] | HilError] = queue.Queue()
        self.orders: list[tuple[int, Action, Mapping[str, Any]]] = []
        self.asked_hz: list[float] = []
        self.estops: list[Action] = []
        self.is_broken = False
        self.refusal: HilError | None = None

    @contextlib.contextmanager
    def live(self) -> Iterator["Service"]:
        yield self

    def ask_for_motion(self, rate_hz: float) -> None:
        self.asked_hz.append(rate_hz)

    def order(self, action: Action, arguments: Mapping[str, Any] | None = None) -> int:
        if arguments is None:
            self.estops.append(action)
            if self.refusal is not None:
                raise self.refusal
            return 0
        if self.is_broken:
            raise OSError("closed")
        self.orders.append((100 + len(self.orders), action, arguments))
        return self.orders[-1][0]

    def receive(self, timeout_s: float) -> Mapping[str, Any] | None:
        try:
            message = self.comes.get(timeout=0.005)
        except queue.Empty:
            return None
        if isinstance(message, HilError):
            raise message
        return message


def test_a_served_robot_takes_answers_by_their_numbers_and_refuses_what_it_cannot_send(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hil.addons.ros2.robot._AGAIN_S", 0.01)
    service, heard = Service(), queue.Queue[Any]()
    robot = ServedRobot(service, 50.0, None)  # type: ignore[arg-type]
    outcomes: dict[str, str | None] = {}

    def order(name: str, action: Action = Action.TWIST) -> None:
        robot.order(action, {"name": name}, lambda refused: outcomes.update({name: refused}))

    order("early")
    assert outcomes == {"early": "the service is not connected yet"}
    robot.start(heard.put)
    wait_for(lambda: service.asked_hz == [50.0])
    wait_for(lambda: order("one") or service.orders)
    order("two", Action.ARM)
    assert [given[1] for given in service.orders][-2:] == [Action.TWIST, Action.ARM]
    second = service.orders[-1][0]
    service.comes.put({"answer": {"number": second, "refused": "not now"}})
    service.comes.put({"answer": {"number": 7, "refused": None}})  # of nobody
    service.comes.put({"answer": {"number": second - 1, "refused": None}})
    service.comes.put({"motion": {"sequence": 1}})
    assert heard.get(timeout=30.0) == {"motion": {"sequence": 1}}
    assert (outcomes["two"], outcomes["one"]) == ("not now", None)
    order("open")
    service.comes.put(LinkError("the line was cut"))
    assert heard.get(timeout=30.0) == {"lost": "the line was cut"}
    assert outcomes["open"] == "the line was cut"
    wait_for(lambda: service.asked_hz == [50.0, 50.0])
    service.is_broken = True
    wait_for(lambda: order("broken") or "could not be sent" in str(outcomes["broken"]))
    assert outcomes["broken"] == "the order could not be sent: closed"
    order("stop", Action.ESTOP)
    wait_for(lambda: "stop" in outcomes)
    assert (outcomes["stop"], service.estops) == (None, [Action.ESTOP]), "it needs no WebSocket"
    service.refusal = DeviceError("refused: no")
    order("again", Action.ESTOP)
    wait_for(lambda: "again" in outcomes)
    assert outcomes["again"] == "refused: no"
    assert robot.failure() is None
    robot.close()
    order("late")
    assert outcomes["late"] == "the node is ending"


def test_a_call_that_hangs_does_not_keep_the_process_of_the_node_alive() -> None:
    hangs, may_end = threading.Event(), threading.Event()

    class Hanging(Service):
        def order(self, action: Action, arguments: Mapping[str, Any] | None = None) -> int:
            hangs.set()
            may_end.wait(10.0)
            return super().order(action, arguments)

        def receive(self, timeout_s: float) -> None:
            may_end.wait(10.0)

    before = set(threading.enumerate())
    robot = ServedRobot(Hanging(), 50.0, None)  # type: ignore[arg-type]
    answered = threading.Event()
    robot.order(Action.ESTOP, {}, lambda _: answered.set())
    assert hangs.wait(10.0)
    robot.start(lambda _: None)
    begun = set(threading.enumerate()) - before
    assert sorted((thread.name, thread.daemon) for thread in begun) == [("e-stop", True), ("service", True)]
    may_end.set()
    assert answered.wait(10.0)
    robot.close()


SIMULATED = load("circle_speed", set={"loop.mode": "lockstep", "loop.rate_hz": 100})
QUICK = Settings(real_time_factor=1000.0, publish_rate_hz=25.0)


class Simulated:
    """A simulation, with all that it said: ``times_ns`` of its ticks, ``motions``, ``statuses``."""

    def __init__(self, settings: Settings, scenario: Any = SIMULATED) -> None:
        self.times_ns: list[int] = []
        self.motions: list[Mapping[str, Any]] = []
        self.statuses: list[Mapping[str, Any]] = []
        self.simulation = Simulation(scenario, settings, self.times_ns.append)
        self.enough = threading.Event()

    def hear(self, message: Mapping[str, Any]) -> None:
        if "motion" in message:
            assert message["motion"]["time_unix_s"] == self.times_ns[-1] * 1e-9
            self.motions.append(message["motion"])
        else:
            self.statuses.append(message["status"])

    def phase(self) -> str | None:
        return self.statuses[-1]["phase"] if self.statuses else None

    def order(self, action: Action, **arguments: Any) -> str | None:
        answers = queue.Queue[str | None]()
        self.simulation.order(action, arguments, answers.put)
        return answers.get(timeout=30.0)


def test_a_simulation_says_each_tick_s_time_and_its_motion_and_status_at_their_rates() -> None:
    simulated = Simulated(QUICK)
    simulated.simulation.start(simulated.hear)
    wait_for(lambda: simulated.phase() == "disarmed")
    assert simulated.order(Action.ARM) is None
    refused = simulated.order(Action.ARM)
    assert str(refused).startswith("the robot is arm") or "the robot is active" in str(refused)
    wait_for(lambda: simulated.phase() == "active")
    assert simulated.order(Action.WHEELS, command="speed", values=[1.0, 2.0, 3.0, 4.0], sequence=7) is None
    wait_for(lambda: any(motion["sequence"] == 7 for motion in simulated.motions))
    simulated.simulation.close()
    assert simulated.simulation.failure() is None
    assert simulated.simulation.now_ns() == simulated.times_ns[-1]
    period_ns = 10_000_000
    first = simulated.times_ns[0]
    assert first <= 0
    assert simulated.times_ns == list(range(first, simulated.times_ns[-1] + 1, period_ns))
    told = [round(motion["time_unix_s"] * 100) for motion in simulated.motions]
    assert told == [number for number in range(first // period_ns, told[-1] + 1) if number % 4 == 0]
    statuses = [round(status["time_unix_s"] * 100) for status in simulated.statuses]
    assert statuses[0] == first // period_ns
    assert {later - one for one, later in itertools.pairwise(statuses[1:])} == {5}
    assert [status["ticks"] for status in simulated.statuses] == [number + 1 for number in statuses]
    last = simulated.statuses[-1]
    assert (last["scenario"], last["law"], last["command"]) == ("circle_speed", "dsc", "speed")
    assert last["realtime"] == {}


def test_a_simulation_waits_at_each_motion_for_the_wheels_that_answer_it() -> None:
    simulated = Simulated(Settings(real_time_factor=1000.0, publish_rate_hz=25.0, wait_for_wheels_s=30.0))
    simulation, waits = simulated.simulation, threading.Event()
    heard: queue.Queue[Mapping[str, Any]] = queue.Queue()

    def hear(message: Mapping[str, Any]) -> None:
        simulated.hear(message)
        if "motion" in message:
            heard.put(message["motion"])

    simulation.start(hear)
    wait_for(lambda: simulated.phase() == "disarmed")
    assert simulated.order(Action.ARM) is None, "it waits for nobody before wheels were commanded"
    wait_for(lambda: simulated.phase() == "active")
    wheels = {"command": "speed", "values": [1.0, 2.0, 3.0, 4.0]}
    assert simulated.order(Action.WHEELS, **wheels, sequence=0) is None
    while heard.get(timeout=20.0)["sequence"] != 0:
        pass
    for sequence in range(1, 4):
        ticks = len(simulated.times_ns)
        assert not waits.wait(0.01)
        assert len(simulated.times_ns) == ticks, "no tick passes before the answer"
        answers = queue.Queue[str | None]()
        simulation.order(Action.STOP if sequence == 9 else Action.WHEELS, wheels | {"sequence": sequence}, answers.put)
        assert answers.get(timeout=20.0) is None
        motion = heard.get(timeout=20.0)
        assert (motion["sequence"], len(simulated.times_ns)) == (sequence, ticks + 4)
    simulation.close()
    assert simulation.failure() is None


def test_a_simulation_that_cannot_begin_says_why() -> None:
    simulated = Simulated(QUICK, load("circle_speed", set={"plant.start.mass_kg": -1.0}))
    simulated.simulation.start(simulated.hear)
    assert "mass_kg" in str(wait_for(simulated.simulation.failure))
    simulated.simulation.close()
    Simulated(QUICK).simulation.close()  # one that was never started


def test_a_service_of_the_nodes_own_that_ends_or_is_never_ready_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.addons.ros2.robot._END_S", 0.01)
    command = ["sh", "-c", "exit 3"]
    monkeypatch.setattr("hil.addons.ros2.robot.module_command", lambda *_: command)
    with OwnService([]) as own, pytest.raises(DeviceError) as ended:
        own.client()
    assert str(ended.value) == "hil serve ended with exit code 3; what it said is above"
    command[2] = "exit 2"
    with OwnService([]) as own, pytest.raises(BadInputError, match="hil serve ended with exit code 2; what"):
        own.client()
    command[2] = "exec sleep 60"
    monkeypatch.setattr("hil.addons.ros2.robot._READY_S", 0.02)
    with pytest.raises(LinkError) as never, OwnService([]) as own:
        own.client()
    assert str(never.value) == "the service was not ready within 0.02 s; see its log above"
    assert own.failure() is not None, "it is not left behind"


class Own:
    """A service of the node's own that starts nothing."""

    def __init__(self, words: list[str]) -> None:
        self.words = words

    def client(self) -> str:
        return "of its own"

    def __enter__(self) -> "Own":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""


CONFIG = "circle_speed"
SET = ("--set", "loop.rate_hz=100")


@needs_ros
@pytest.mark.parametrize(
    ("words", "taken"),
    [
        (("--mode", "lockstep"), ("simulated", [])),
        (("--mode", "lockstep", "--ros-args", "-r", "a:=b"), ("simulated", ["--ros-args", "-r", "a:=b"])),
        (("--mode", "lockstep", "--port", "8771"), ("found", (None, 8771, None))),
        (("--mode", "lockstep", "--url", "http://127.0.0.1:1"), ("found", ("http://127.0.0.1:1", None, None))),
        (("--mode", "lockstep", "--link", "serial:/dev/none"), ("own", [CONFIG, "--link", "serial:/dev/none"])),
        (("--mode", "realtime"), ("own", [CONFIG])),
        (
            ("--mode", "realtime", *SET, "--truth", "tcp://127.0.0.1:1", "--allow-motion"),
            ("own", [CONFIG, *SET, "--truth", "tcp://127.0.0.1:1", "--allow-motion"]),
        ),
    ],
)
def test_only_in_lockstep_within_this_process_a_node_is_a_simulator(
    words: tuple[str, ...], taken: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hil.addons.ros2 import node

    took: list[Any] = []

    def served(_scenario: Any, service: Any, _ros: Any) -> None:
        own, client = service()
        took.append(("own", own.words) if own is not None else ("found", client))

    monkeypatch.setattr(node, "run_simulated", lambda _scenario, ros: took.append(("simulated", ros)))
    monkeypatch.setattr(node, "run_served", served)
    monkeypatch.setattr("hil.addons.ros2.robot.OwnService", Own)
    monkeypatch.setattr("hil.addons.service.client.find", lambda *which: which)
    done = hil("ros2", CONFIG, *words)
    assert (done.returncode, took) == (0, [taken]), done.stderr


@needs_ros
def test_a_simulation_needs_no_truth_of_elsewhere() -> None:
    done = hil("ros2", CONFIG, "--mode", "lockstep", "--truth", "tcp://127.0.0.1:1")
    assert (done.returncode, "--truth tcp://127.0.0.1:1: a simulation in this process knows" in done.stderr) == (
        2,
        True,
    )
