"""The FMU as a simulator: the pilot of a service in lockstep with firmware and plant, in a thread of this process.

Simulated time starts at 0 and passes as fast as the real-time factor asks for, or as it can. It stands still while the
simulation is paused; orders are taken then too.
"""

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from typing import Any, NamedTuple

from hil.core.errors import HilError
from hil.core.signals import LoopSignals
from hil.core.types import NAN, Pose, PoseFix
from hil.runtime.bench import Bench
from hil.runtime.parts import RunParts
from hil.runtime.provenance import ingredients
from hil.runtime.realtime import RealTime
from hil.runtime.sampling import Sampling
from hil.scenario import Scenario
from hil.service.desk import Desk
from hil.service.feed import MotionFeed
from hil.service.messages import Action, Answer, Motion, Order, Status, Task
from hil.service.pilot import Pilot
from hil.service.records import Records
from hil.service.ros2.robot import Answered, Hear
from hil.service.status import bench_status

_STATUS_S = 0.05
_IDLE_S = 0.05
_MOST_BEHIND_S = 0.1  # of wall-clock time; a simulation that is slower does not try to catch up


class Pace(NamedTuple):
    """How simulated time passes.

    ``factor`` is simulated seconds a second. While a law elsewhere commands the wheels, time waits up to
    ``wait_for_wheels_s`` seconds a tick for its next command. ``rate_hz`` is how often the motion is said.
    """

    factor: float
    wait_for_wheels_s: float
    rate_hz: float


class Simulation:
    """A Robot that is simulated. ``load_at`` loads the scenario with a start pose, or with its own for None.

    ``on_time`` is called with the simulated time [ns] after each tick, before the motion of that tick is said.

    Attributes:
        truth: the newest motion; None before the first.
    """

    takes_all = True

    def __init__(
        self, load_at: Callable[[Pose | None], Scenario], start: Pose | None, pace: Pace, on_time: Callable[[int], None]
    ) -> None:
        self._load_at = load_at
        self._start = start
        self._scenario = load_at(start)
        self._pace = pace
        self._on_time = on_time
        self._changed = threading.Condition()
        self._orders: list[Order] = []
        self._open: dict[int, Answered] = {}
        self._numbers = itertools.count(1)
        self._is_paused = False
        self._steps = 0
        self._begin_again = False
        self._time_ns = 0
        self._ends = False
        self._failure: HilError | None = None
        self._hear: Hear = lambda _: None
        self._wheels_came = False
        self.truth: Motion | None = None
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    # What other threads call

    def start(self, hear: Hear) -> None:
        """As ``Robot``."""
        self._hear = hear
        self._thread.start()

    def order(self, action: Action, arguments: Mapping[str, Any], answered: Answered) -> None:
        """As ``Robot``."""
        with self._changed:
            number = next(self._numbers)
            self._open[number] = answered
            self._orders.append(Order(number, action, dict(arguments)))
            self._wheels_came = self._wheels_came or action is Action.WHEELS
            self._changed.notify_all()

    def now_ns(self) -> int:
        """As ``Robot``."""
        return self._time_ns

    def failure(self) -> HilError | None:
        """As ``Robot``."""
        return self._failure

    def close(self) -> None:
        """As ``Robot``: end the simulation."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def is_paused(self) -> bool:
        """Whether time stands still, unless a step is under way."""
        return self._is_paused

    def pause(self, *, paused: bool) -> None:
        """Let time stand still, or pass."""
        with self._changed:
            self._is_paused, self._steps = paused, 0
            self._changed.notify_all()

    def step(self, ticks: int) -> None:
        """Let a paused simulation do so many ticks, and wait until they are done."""
        with self._changed:
            self._steps = ticks
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._steps or self._ends or not self._is_paused)

    def reset(self, pose: Pose | None = None, *, keep_time: bool = False) -> None:
        """Start anew with the robot at rest and disarmed: at a pose, or at the one of the beginning.

        Time starts at 0 again, unless it is kept. Raises BadInputError when the plant cannot start there.
        """
        scenario = self._load_at(pose if pose is not None else self._start)
        with self._changed:
            self._scenario, self._begin_again = scenario, True
            self._time_ns = self._time_ns if keep_time else 0
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._begin_again or self._ends)

    # The thread of the simulation

    def _run(self) -> None:
        try:
            while not self._ends:
                with _Session(self._scenario, self._answer) as session:
                    with self._changed:
                        self._begin_again = False
                        self._changed.notify_all()
                    self._simulate(session, self._time_ns)
        except HilError as error:
            self._failure = error
        finally:
            with self._changed:
                self._ends, self._steps, self._begin_again = True, 0, False
                self._changed.notify_all()

    def _simulate(self, session: "_Session", begin_ns: int) -> None:
        """Do ticks until the simulation ends or begins anew. ``begin_ns`` is the time of the session's tick 0."""
        period_ns = session.period_ns
        period_s = period_ns * 1e-9 / self._pace.factor
        due_s = time.perf_counter()
        said_ns = -1
        every = max(1, round(1e9 / period_ns / self._pace.rate_hz))
        while (number := self._next(session)) is not None:
            fix = session.tick()
            with self._changed:
                if self._begin_again:
                    return
                self._time_ns = now_ns = begin_ns + number * period_ns
            self._on_time(now_ns)
            if number % every == 0:
                self._wheels_came = False  # one that comes from here on answers this motion
                self.truth = session.feed.at(now_ns * 1e-9, fix)
                self._hear({"motion": {one.name: getattr(self.truth, one.name) for one in fields(Motion)}})
            if said_ns < 0 or now_ns - said_ns >= _STATUS_S * 1e9:
                said_ns = now_ns
                self._hear({"status": session.status(now_ns * 1e-9)})
            with self._changed:
                if self._steps:
                    self._steps -= 1
                    self._changed.notify_all()
            if self._pace.wait_for_wheels_s and number % every == 0 and session.pilot.conduct.task is Task.WHEELS:
                with self._changed:
                    self._changed.wait_for(self._may_go_on, self._pace.wait_for_wheels_s)
            due_s += period_s
            if (left_s := due_s - time.perf_counter()) > 0.0:
                time.sleep(left_s)
            elif left_s < -_MOST_BEHIND_S:
                due_s = time.perf_counter()

    def _may_go_on(self) -> bool:
        return self._wheels_came or self._ends or self._begin_again

    def _next(self, session: "_Session") -> int | None:
        """Take orders, wait while paused, and return the next tick; None when the session is over."""
        while True:
            with self._changed:
                orders, self._orders = self._orders, []
                if self._ends or self._begin_again:
                    self._orders = orders
                    return None
                waits = self._is_paused and not self._steps
                if waits and not orders:
                    self._changed.wait(_IDLE_S)
            session.desk.handle(orders, session.number * session.period_ns * 1e-9)
            if not waits:
                return session.number
            self._on_time(self._time_ns)  # for who joins while time stands still

    def _answer(self, answer: Answer) -> None:
        with self._changed:
            answered = self._open.pop(answer.number, None)
        if answered is not None:
            answered(answer.refused)


class _Session:
    """Firmware, plant, pilot and desk from one start of the plant to the next."""

    def __init__(self, scenario: Scenario, answer: Callable[[Answer], None]) -> None:
        self._scenario = scenario
        self._resources = contextlib.ExitStack()
        with contextlib.ExitStack() as resources:
            made = RunParts(scenario)
            signals = made.laws.signals
            self._bench = bench = resources.enter_context(Bench(scenario, None, allow_motion=False, signals=signals))
            records = Records(None)
            parts = made.make(bench, [], records.note)
            self.pilot = Pilot(parts, scenario.controller.mode, made.timing, scenario.service)
            beside = resources.enter_context(ThreadPoolExecutor(1, "beside"))
            self.desk = Desk(
                scenario, ingredients(scenario), signals, self.pilot, records, answer, lambda: scenario, beside
            )
            self.feed = MotionFeed(scenario, self.pilot)
            self._sampling = Sampling(bench.clock, bench.device, bench.truth, made.timing)
            self.period_ns = made.timing.period_ns
            origin_ns = bench.clock.now_ns()
            self.number = self._sampling.begin(origin_ns)
            bench.begin(origin_ns)
            self._resources = resources.pop_all()

    def tick(self) -> PoseFix | None:
        """Let one period pass and do its tick; return the truth. Raises the error that ended the robot for good."""
        number = self.number
        while True:
            try:
                self._sampling.wait(number)
                break
            except HilError as error:
                self.pilot.lose(error)
        self.number += 1
        fix = self._sampling.fix_of(number)
        if number >= 0:
            self.pilot.tick(LoopSignals(number * self.period_ns * 1e-9, number, 0.0, NAN, 0), fix)
        return fix

    def status(self, now_s: float) -> dict[str, Any]:
        """Return the status by the names of ``Status``."""
        scenario = self._scenario
        status = Status(
            time_unix_s=now_s,
            scenario=scenario.name,
            law=scenario.controller.law,
            command=scenario.controller.command,
            ticks=self.number,
            **bench_status(self.pilot, self._bench, RealTime(())),
        )
        return {one.name: getattr(status, one.name) for one in fields(Status)}

    def __enter__(self) -> "_Session":
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()


def start_at(pose: Pose | None) -> list[str]:
    """Return what starts the shipped plant at a pose, as --set takes it; nothing for None."""
    values = {} if pose is None else pose._asdict()
    return [f"plant.start.start_{name}={value!r}" for name, value in values.items()]
