"""Carries out the orders of a service: short ones at once, long ones in a second thread."""

import contextlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.service import logs
from hil.addons.service.messages import MOVING, STREAMED, Action, Answer, Order, Phase
from hil.addons.service.motions import check_path
from hil.addons.service.pilot import Pilot
from hil.addons.service.records import Records, finished, named_in, recording_of
from hil.core.errors import BadInputError, HilError
from hil.core.kinematics import BodyTwist
from hil.core.types import Pose
from hil.record.files import new_in_runs
from hil.record.recording import Recording, RecordingReport
from hil.references import ReferenceSource, make_reference
from hil.runtime.provenance import law_ingredients, properties
from hil.scenario import Scenario
from hil.scenario.laws import Laws, make_laws

_RECORDING = (Action.RECORD, Action.STOP_RECORDING)
_STALLED = "the service stalled while this order waited; give it again"

Result = Mapping[str, Any] | None
"""Further results of an order, by name."""


class Long(NamedTuple):
    """The rest of an order that takes longer than a tick.

    ``work`` runs in the second thread. ``then`` ends the order in the thread of the ticks: it takes the result of
    ``work``, and returns the order's.
    """

    work: Callable[[], Any]
    then: Callable[[Any], Result]


@dataclass
class OrderHandler:
    """Carries out orders, and calls ``answer`` for each.

    ``made_of`` are the ``ingredients`` of the served parts, ``signals`` the names of a row's signals, ``beside`` is an
    executor with one thread.

    Attributes:
        shutdown: whether the service was asked to end.
    """

    scenario: Scenario
    made_of: Mapping[str, str]
    signals: Sequence[str]
    pilot: Pilot
    records: Records
    answer: Callable[[Answer], None]
    beside: Executor

    def __post_init__(self) -> None:
        pilot = self.pilot
        self._under_way: list[tuple[Order, Future[Any], Long]] = []
        self._t_s = 0.0
        self._policy = self.scenario.service.when_full
        self.shutdown = False
        # Each is called with the order's arguments.
        self._actions: dict[Action, Callable[..., Result | Long]] = {
            Action.ARM: self._arm,
            Action.DISARM: pilot.disarm,
            Action.ESTOP: pilot.estop,
            Action.CLEAR: pilot.clear,
            Action.STOP: lambda: pilot.active().stop(),
            Action.TWIST: self._twist,
            Action.WHEELS: self._wheels,
            Action.GO: lambda **pose: pilot.active().go(Pose(**pose)),
            Action.TRACK: self._track,
            Action.GAINS: self._gains,
            Action.RECORD: self._record,
            Action.STOP_RECORDING: self._stop_recording,
            Action.SHUTDOWN: self._shut_down,
        }

    def handle(self, orders: Iterable[Order], t_s: float, *, stalled: bool = False) -> None:
        """Carry out orders and answer them; also answer long orders that have ended. Never waits.

        ``t_s`` is the service's time [s] of the next row. If the ticks were ``stalled`` for longer than a twist is in
        force, orders that could make the robot move are refused, both new ones and long ones under way.
        """
        self._t_s = t_s
        for order in orders:
            if order.action not in STREAMED:  # too many to log
                logs.info("order", action=order.action.value, **order.arguments)
            if stalled and order.action in MOVING:
                self._refuse(order, _STALLED)
            else:
                self._carry_out(order, partial(self._actions[order.action], **order.arguments))
        under_way, self._under_way = self._under_way, []
        for order, future, long in under_way:
            if stalled and order.action in MOVING:
                self._refuse(order, _STALLED)
            elif future.done():
                self._carry_out(order, lambda future=future, long=long: long.then(future.result()))  # type: ignore[misc]
            else:
                self._under_way.append((order, future, long))

    def end(self) -> None:
        """Wait for a recording that is being started, so that it can be finished."""
        for order, future, long in self._under_way:
            if order.action is Action.RECORD:
                with contextlib.suppress(HilError):  # nobody waits for its answer any more
                    long.then(future.result())

    def _carry_out(self, order: Order, do: Callable[[], Result | Long]) -> None:
        try:
            result = do()
        except HilError as refusal:
            self._refuse(order, str(refusal))
        except Exception as failure:  # noqa: BLE001 - no failing order may end the process, which the e-stop needs
            self._refuse(order, f"{type(failure).__name__}: {failure}")
        else:
            if isinstance(result, Long):
                self._under_way.append((order, self.beside.submit(result.work), result))
            else:
                self.answer(Answer(order.number, None, result or {}))

    def _refuse(self, order: Order, why: str) -> None:
        logs.warning("order refused", action=order.action.value, why=why)
        self.answer(Answer(order.number, why))

    def _arm(self) -> None:
        if self.records.path is not None and self.records.trouble is not None and self._policy == "stop_robot":
            raise BadInputError(
                f"the recording cannot be written ({self.records.trouble}), and service.when_full is stop_robot; make "
                "room, or end the recording"
            )
        self.pilot.arm()

    def _twist(self, vx_m_s: float, vy_m_s: float, yaw_rate_rad_s: float) -> Result:
        twist = self.pilot.active().twist(BodyTwist(vx_m_s, vy_m_s, yaw_rate_rad_s))
        return {"vx_m_s": twist.forward_m_s, "vy_m_s": twist.left_m_s, "yaw_rate_rad_s": twist.yaw_rate_rad_s}

    def _wheels(self, command: str, values: Sequence[float], sequence: int | None) -> None:
        served = self.scenario.controller.command
        if command != served:
            raise BadInputError(f"command = {command!r}: this service commands {served}; it is fixed by its scenario")
        fl, fr, rr, rl = values
        self.pilot.active().command_wheels((fl, fr, rr, rl), sequence)

    def _track(self, reference: Mapping[str, Any] | None, here: bool) -> Long:
        self.pilot.need_active()  # before the path is read, which takes long
        requests_before = self.pilot.motion_requests
        table = self.scenario.reference
        options = {"kind": table.kind, **table.options} if reference is None else dict(reference)
        kind = options.pop("kind")

        def read() -> ReferenceSource:
            path = make_reference(kind, options, self.scenario.directory)
            check_path(path, self.scenario.service)
            return path

        def follow(path: ReferenceSource) -> Result:
            if self.pilot.motion_requests != requests_before:
                raise BadInputError("another order, or another phase of the robot, came before the path was read")
            self.pilot.active().track(path, here=here)
            return {"kind": kind}

        return Long(read, follow)

    def _gains(self, gains: Mapping[str, Any]) -> Long:
        if self._is_under_way(Action.GAINS):
            raise BadInputError("the gains are being changed by another order; give this one again")

        def make() -> tuple[Scenario, Laws, Mapping[str, str]]:
            now = self.scenario.controller
            scenario = replace(self.scenario, controller=replace(now, gains={**now.gains, **gains}))
            return scenario, make_laws(scenario, scenario.directory), law_ingredients(scenario)

        def use(made: tuple[Scenario, Laws, Mapping[str, str]]) -> Result:
            scenario, laws, made_of = made
            if laws.signals != tuple(self.signals):
                raise BadInputError("these gains change what the law records; restart the service to use them")
            self.scenario = scenario
            self.made_of = {**self.made_of, **made_of}
            self.pilot.use(laws)
            return {"gains": dict(scenario.controller.gains)}

        return Long(make, use)

    def watch_recording(self) -> None:
        """Do what ``service.when_full`` says if the recording cannot be written; called 20 times a second."""
        why = self.records.watch(self._t_s)
        if why is None:
            return
        if self._policy == "stop_robot":
            if self.pilot.phase in (Phase.ARMING, Phase.ACTIVE):
                self.pilot.disarm(f"its recording cannot be written: {why}")
        elif (recording := self.records.end()) is not None:
            self.beside.submit(finished, recording)

    def _record(self, name: str | None) -> Long:
        if self._is_under_way(*_RECORDING) or self.records.path is not None:
            raise BadInputError(f"{self.records.path or 'a recording'} is being written; stop that first")
        made_of = self.made_of

        def start() -> Recording:
            table = self.scenario.service
            folder, about = Path(table.recordings), properties(self.scenario, made_of)
            if name is None:
                file = new_in_runs(self.scenario.name, ".rrd", "set service.recordings", folder)
            elif os.path.lexists(file := named_in(folder, name)):
                raise BadInputError(
                    f"recording {str(file)!r}: the file exists, and a service replaces none; choose another name"
                )
            return recording_of(about, self.signals, file, table)

        def use(recording: Recording) -> Result:
            self.records.begin(recording)
            return {"path": str(recording.path), "from_s": round(self._t_s, 6)}

        return Long(start, use)

    def _stop_recording(self) -> Long:
        recording = None if self._is_under_way(*_RECORDING) else self.records.end()
        if recording is None:
            raise BadInputError("nothing is being recorded")
        self.records.trouble = None

        def result_of(report: RecordingReport) -> Result:
            path, rows = str(report.path), report.rows_written
            return {"path": path, "rows": rows, "complete": report.complete, "error": report.error}

        return Long(partial(finished, recording), result_of)

    def _is_under_way(self, *actions: Action) -> bool:
        return any(order.action in actions for order, _, _ in self._under_way)

    def _shut_down(self) -> None:
        self.shutdown = True
