"""The FMU as a simulator: the pilot of a service in lockstep with firmware and plant, in a thread of this process.

Simulated time starts at 0 and passes as fast as the real-time factor asks for, or as it can.
"""

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from hil.addons.ros2.robot import Answered, Hear
from hil.addons.ros2.settings import Settings
from hil.addons.service.messages import Action, Answer, Order, Status, Task, to_line
from hil.addons.service.orders import OrderHandler
from hil.addons.service.pilot import Pilot
from hil.addons.service.records import Records
from hil.addons.service.status import MotionFeed, bench_status
from hil.core.errors import HilError
from hil.core.signals import LoopSignals
from hil.core.types import NAN
from hil.runtime.bench import Bench
from hil.runtime.provenance import ingredients
from hil.runtime.realtime import RealTime
from hil.runtime.run_parts import RunParts
from hil.runtime.sampling import Sampling
from hil.scenario import Scenario

_STATUS_S = 0.05
_MOST_BEHIND_S = 0.1  # of wall-clock time; a simulation that is slower does not try to catch up


class Simulation:
    """A robot that is simulated. ``settings`` say how its time passes, and how often its motion is said.

    ``on_time`` is called with the simulated time [ns] after each tick, before the motion of that tick is said.
    """

    def __init__(self, scenario: Scenario, settings: Settings, on_time: Callable[[int], None]) -> None:
        self._scenario = scenario
        self._settings = settings
        self._on_time = on_time
        self._changed = threading.Condition()
        self._orders: list[Order] = []
        self._open: dict[int, Answered] = {}
        self._numbers = itertools.count(1)
        self._time_ns = 0
        self._ends = False
        self._failure: HilError | None = None
        self._hear: Hear = lambda _: None
        self._wheels_came = False
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    # What other threads call

    def start(self, hear: Hear) -> None:
        """Begin to simulate, and to say how the robot is."""
        self._hear = hear
        self._thread.start()

    def order(self, action: Action, arguments: Mapping[str, Any], answered: Answered) -> None:
        """Give an order, without waiting; ``answered`` is called in the thread of the simulation."""
        with self._changed:
            number = next(self._numbers)
            self._open[number] = answered
            self._orders.append(Order(number, action, dict(arguments)))
            self._wheels_came = self._wheels_came or action is Action.WHEELS
            self._changed.notify_all()

    def now_ns(self) -> int:
        """Return the simulated time [ns]."""
        return self._time_ns

    def failure(self) -> HilError | None:
        """Return the error that ended the simulation, or None."""
        return self._failure

    def close(self) -> None:
        """End the simulation."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()

    # The thread of the simulation

    def _run(self) -> None:
        try:
            with contextlib.ExitStack() as resources:
                self._simulate(resources)
        except HilError as error:
            self._failure = error

    def _simulate(self, resources: contextlib.ExitStack) -> None:
        """Do ticks until the simulation ends. Raises the error that ended the robot for good."""
        scenario, made = self._scenario, RunParts(self._scenario)
        signals, timing = made.laws.signals, made.timing
        bench = resources.enter_context(Bench(scenario, None, allow_motion=False, signals=signals))
        records = Records(None)
        pilot = Pilot(made.make(bench, [], records.note), scenario.controller.mode, timing, scenario.service)
        beside = resources.enter_context(ThreadPoolExecutor(1, "beside"))
        handler = OrderHandler(scenario, ingredients(scenario), signals, pilot, records, self._answer, beside)
        feed = MotionFeed(scenario, pilot)
        sampling = Sampling(bench.clock, bench.device, bench.truth, timing)
        period_ns = timing.period_ns
        origin_ns = bench.clock.now_ns()
        first = sampling.begin(origin_ns)
        bench.begin(origin_ns)
        due_s, said_ns = time.perf_counter(), -1
        every = max(1, round(1e9 / period_ns / self._settings.publish_rate_hz))
        for number in itertools.count(first):
            handler.handle(self._taken(), number * period_ns * 1e-9)
            if self._ends:
                return
            _wait(sampling, number, pilot)
            fix = sampling.fix_of(number)
            if number >= 0:
                pilot.tick(LoopSignals(number * period_ns * 1e-9, number, 0.0, NAN, 0), fix)
            self._time_ns = now_ns = number * period_ns
            self._on_time(now_ns)
            if number % every == 0:
                self._wheels_came = False  # one that comes from here on answers this motion
                self._hear(to_line(feed.at(now_ns * 1e-9, fix)))
            if said_ns < 0 or now_ns - said_ns >= _STATUS_S * 1e9:
                said_ns = now_ns
                self._hear(to_line(self._status(number, now_ns * 1e-9, pilot, bench)))
            if self._settings.wait_for_wheels_s and number % every == 0 and pilot.tasks.task is Task.WHEELS:
                with self._changed:
                    self._changed.wait_for(lambda: self._wheels_came or self._ends, self._settings.wait_for_wheels_s)
            due_s += period_ns * 1e-9 / self._settings.real_time_factor
            if (left_s := due_s - time.perf_counter()) > 0.0:
                time.sleep(left_s)
            elif left_s < -_MOST_BEHIND_S:
                due_s = time.perf_counter()

    def _taken(self) -> list[Order]:
        with self._changed:
            orders, self._orders = self._orders, []
        return orders

    def _status(self, number: int, now_s: float, pilot: Pilot, bench: Bench) -> Status:
        scenario = self._scenario
        return Status(
            time_unix_s=now_s,
            scenario=scenario.name,
            law=scenario.controller.law,
            command=scenario.controller.command,
            ticks=number + 1,
            **bench_status(pilot, bench, RealTime(())),
        )

    def _answer(self, answer: Answer) -> None:
        with self._changed:
            answered = self._open.pop(answer.number, None)
        if answered is not None:
            answered(answer.refused)


def _wait(sampling: Sampling, number: int, pilot: Pilot) -> None:
    """Let time pass to a tick; a failed input was removed from the link, and the same tick is waited for again."""
    while True:
        try:
            sampling.wait(number)
        except HilError as error:
            pilot.lose(error)
        else:
            return
