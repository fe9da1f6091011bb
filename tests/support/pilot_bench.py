"""A pilot with a virtual robot in lockstep: robot time passes as it is asked to, and all repeats exactly."""

import contextlib
from collections.abc import Iterator
from typing import Any, Self

from hil.addons.service.messages import Phase
from hil.addons.service.pilot import Pilot
from hil.core.errors import HilError
from hil.core.signals import SIGNAL_NAMES, LoopSignals
from hil.runtime.bench import Bench
from hil.runtime.run_parts import RunParts
from hil.runtime.sampling import Sampling
from hil.scenario import ServiceTable, load

OPTIONS = ServiceTable()


class PilotBench:
    """A pilot on a bench. ``rows`` are those of the ticks so far, ``phases`` what it has been through."""

    def __init__(self, scenario: str = "circle_speed", options: ServiceTable = OPTIONS, **overrides: Any) -> None:
        loaded = load(scenario, set={"loop.mode": "lockstep", "loop.rate_hz": 100, **overrides})
        self.made = RunParts(loaded)
        self.rows: list[list[float]] = []
        self.notes: list[str] = []
        self._resources = contextlib.ExitStack()
        self.bench = self._resources.enter_context(
            Bench(loaded, None, allow_motion=False, signals=self.made.laws.signals)
        )
        parts = self.made.make(self.bench, [self], lambda _t_s, _level, text: self.notes.append(text))
        self.pilot = Pilot(parts, loaded.controller.mode, self.made.timing, options)
        self._sampling = Sampling(parts.clock, parts.device, parts.truth, self.made.timing)
        origin_ns = parts.clock.now_ns()
        self._number = self._sampling.begin(origin_ns)
        self.bench.begin(origin_ns)
        self.phases = [self.pilot.phase]

    def put(self, row: bytes) -> None:
        self.rows.append(memoryview(row).cast("d").tolist())

    def run(self, time_s: float) -> None:
        """Let robot time pass."""
        period_s = self.made.timing.period_ns * 1e-9
        for _ in range(round(time_s / period_s)):
            self._wait()
            if self._number >= 0:
                now = LoopSignals(self._number * period_s, self._number, 0.0, 0.0, 0)
                self.pilot.tick(now, self._sampling.fix_of(self._number))
                if self.pilot.phase is not self.phases[-1]:
                    self.phases.append(self.pilot.phase)
            self._number = self._sampling.following(self._number)

    def run_until(self, phase: Phase, limit_s: float = 6.0) -> None:
        """Let robot time pass until the pilot is in a phase."""
        for _ in range(round(limit_s / (self.made.timing.period_ns * 1e-9))):
            if self.pilot.phase is phase:
                return
            self.run(self.made.timing.period_ns * 1e-9)
        raise AssertionError(f"still {self.pilot.phase} after {limit_s} s: {self.pilot.why}")

    def stand_still(self, time_s: float) -> None:
        """Let robot time pass without any ticks of the pilot, as if its process were stopped."""
        self._number += round(time_s / (self.made.timing.period_ns * 1e-9))
        self._wait()

    def _wait(self) -> None:
        while True:
            try:
                self._sampling.wait(self._number)
            except HilError as error:
                self.pilot.lose(error)
            else:
                return

    def armed(self) -> Self:
        """Arm, and wait until the robot is ACTIVE."""
        self.run_until(Phase.DISARMED)
        self.pilot.arm()
        self.run_until(Phase.ACTIVE)
        return self

    def last(self, signal: str) -> float:
        """Return a signal's value in the newest row."""
        return self.rows[-1][SIGNAL_NAMES.index(signal)]

    def series(self, signal: str) -> list[float]:
        """Return a signal's values in all rows."""
        place = SIGNAL_NAMES.index(signal)
        return [row[place] for row in self.rows]

    def pairs(self, one: str, other: str) -> list[tuple[float, float]]:
        """Return the values of two signals in all rows."""
        return list(zip(self.series(one), self.series(other), strict=True))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()


@contextlib.contextmanager
def armed_pilot(**overrides: Any) -> Iterator[PilotBench]:
    """Yield a pilot whose robot is ACTIVE and held."""
    with PilotBench(**overrides) as bench:
        yield bench.armed()
