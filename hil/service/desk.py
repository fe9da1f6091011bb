"""Carries out the orders of a service: short ones at once, long ones in a second thread."""

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, HilError
from hil.core.kinematics import BodyTwist
from hil.core.outputs import Existing, existing_files
from hil.core.types import Pose
from hil.record import Recording
from hil.record.files import new_in_runs
from hil.references import ReferenceSource, make_reference
from hil.runtime.provenance import law_ingredients, properties
from hil.scenario import Scenario
from hil.scenario.laws import make_laws
from hil.service import logs
from hil.service.messages import MOVING, Action, Answer, Order
from hil.service.pilot import Pilot
from hil.service.records import Records, finished, recording_of

Result = Mapping[str, Any]
Then = Callable[[Any], Result]
"""Ends a long order in the thread of the ticks: takes the second thread's result, and returns the answer's."""


class Desk:
    """Carries out orders, and calls ``answer`` for each.

    ``made_of`` are the ``ingredients`` of the served parts, ``signals`` the names of a row's signals. ``reload`` loads
    the configuration again; ``beside`` is an executor with one thread.

    Attributes:
        shutdown: whether the service was asked to end.
    """

    def __init__(
        self,
        scenario: Scenario,
        made_of: Mapping[str, str],
        signals: Sequence[str],
        pilot: Pilot,
        records: Records,
        answer: Callable[[Answer], None],
        reload: Callable[[], Scenario],
        beside: Executor,
    ) -> None:
        self._scenario = scenario
        self._made_of = dict(made_of)
        self._pilot = pilot
        self._records = records
        self._answer = answer
        self._reload = reload
        self._beside = beside
        self._signals = tuple(signals)
        self._under_way: list[tuple[Order, Future[Any], Then]] = []
        self._t_s = 0.0
        self.shutdown = False
        self._actions: dict[Action, Callable[[Order], Result | None]] = {
            Action.ARM: lambda _: self._now(pilot.arm),
            Action.DISARM: lambda _: self._now(pilot.disarm),
            Action.ESTOP: lambda _: self._now(pilot.estop),
            Action.CLEAR: lambda _: self._now(pilot.clear),
            Action.STOP: lambda _: self._now(lambda: pilot.active().stop()),
            Action.TWIST: self._twist,
            Action.GO: self._go,
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
        if stalled:
            orders = self._without_moving(orders)
        for order in orders:
            if order.action is not Action.TWIST:  # twists are too many to log
                logs.info("order", action=order.action.value, **order.arguments)
            self._try(order, lambda order=order: self._actions[order.action](order))  # type: ignore[misc]
        if self._under_way:
            ended, self._under_way = self._under_way, []
            for order, future, then in ended:
                if future.done():
                    self._try(order, lambda future=future, then=then: then(future.result()))  # type: ignore[misc]
                else:
                    self._under_way.append((order, future, then))

    def _without_moving(self, orders: Iterable[Order]) -> list[Order]:
        """Refuse all orders that could make the robot move, new and under way; return the other new ones."""
        stale = [order for order, _, _ in self._under_way if order.action in MOVING]
        self._under_way = [one for one in self._under_way if one[0].action not in MOVING]
        orders = list(orders)
        for order in [*stale, *(order for order in orders if order.action in MOVING)]:
            self._refuse(order, "the service stalled while this order waited; give it again")
        return [order for order in orders if order.action not in MOVING]

    def end(self) -> None:
        """Wait for a recording that is being started, so that it can be finished."""
        for order, future, then in self._under_way:
            if order.action is Action.RECORD:
                with contextlib.suppress(HilError):  # nobody waits for its answer any more
                    then(future.result())

    def _try(self, order: Order, do: Callable[[], Result | None]) -> None:
        try:
            result = do()
        except Exception as refusal:  # noqa: BLE001 - no failing order may end the process, which the e-stop needs
            self._refuse(
                order, str(refusal) if isinstance(refusal, HilError) else f"{type(refusal).__name__}: {refusal}"
            )
        else:
            if result is not None:
                self._answer(Answer(order.number, None, result))

    def _refuse(self, order: Order, why: str) -> None:
        logs.warning("order refused", action=order.action.value, why=why)
        self._answer(Answer(order.number, why))

    def _later(self, order: Order, make: Callable[[], Any], then: Then) -> None:
        self._under_way.append((order, self._beside.submit(make), then))

    @staticmethod
    def _now(do: Callable[[], None]) -> Result:
        do()
        return {}

    def _twist(self, order: Order) -> Result:
        arguments = order.arguments
        twist = self._pilot.active().twist(
            BodyTwist(arguments["vx_m_s"], arguments["vy_m_s"], arguments["yaw_rate_rad_s"])
        )
        return {"vx_m_s": twist.forward_m_s, "vy_m_s": twist.left_m_s, "yaw_rate_rad_s": twist.yaw_rate_rad_s}

    def _go(self, order: Order) -> Result:
        arguments = order.arguments
        self._pilot.active().go(Pose(arguments["x_m"], arguments["y_m"], arguments["heading_rad"]))
        return {}

    def _track(self, order: Order) -> None:
        self._pilot.need_active()  # before a path is read in vain
        requests_before = self._pilot.motion_requests
        here, requested = bool(order.arguments["here"]), order.arguments["reference"]
        table = self._scenario.reference
        kind, options = table.kind, table.options
        if requested is not None:
            kind, options = requested["kind"], {name: value for name, value in requested.items() if name != "kind"}

        def make() -> ReferenceSource:
            path = make_reference(kind, options, self._scenario.directory)
            _try_out(path)
            return path

        def then(path: Any) -> Result:
            if self._pilot.motion_requests != requests_before:
                raise BadInputError("another order, or another phase of the robot, came before the path was read")
            self._pilot.active().track(path, here=here)
            return {"kind": kind}

        self._later(order, make, then)

    def _gains(self, order: Order) -> None:
        if self._is_under_way(Action.GAINS):
            raise BadInputError("the gains are being changed by another order; give this one again")

        def make() -> Any:
            requested, now = order.arguments["gains"], self._scenario.controller
            gains = self._reload_gains() if requested is None else {**now.gains, **requested}
            tables = replace(self._scenario, controller=replace(now, gains=gains))
            return tables, make_laws(tables, tables.directory), law_ingredients(tables)

        def then(made: Any) -> Result:
            scenario, laws, made_of = made
            if laws.signals != self._signals:
                raise BadInputError("these gains change what the law records; restart the service to use them")
            self._scenario = scenario
            self._made_of |= made_of
            self._pilot.use(laws)
            return {"gains": dict(self._scenario.controller.gains)}

        self._later(order, make, then)

    def _reload_gains(self) -> Mapping[str, Any]:
        now, new = self._scenario.controller, self._reload().controller
        if (new.law, new.command) != (now.law, now.command):
            raise BadInputError(
                f"the file has law {new.law!r} in {new.command} mode now, and {now.law!r} in {now.command} mode is "
                "served; restart the service to change that"
            )
        return new.gains

    def _record(self, order: Order) -> None:
        if self._are_records_busy or self._records.path is not None:
            raise BadInputError(f"{self._records.path or 'a recording'} is being written; stop that first")
        requested, force = order.arguments["path"], bool(order.arguments["force"])
        made_of = dict(self._made_of)

        def make() -> Recording:
            path = new_in_runs(self._scenario.name, ".rrd", "name a file") if requested is None else Path(requested)
            existing: Existing = "number" if requested is None else existing_files(force=force)
            return recording_of(properties(self._scenario, made_of), self._signals, path, existing=existing)

        def then(recording: Any) -> Result:
            self._records.begin(recording)
            return {"path": str(recording.path), "from_s": round(self._t_s, 6)}

        self._later(order, make, then)

    def _stop_recording(self, order: Order) -> None:
        recording = None if self._are_records_busy else self._records.end()
        if recording is None:
            raise BadInputError("nothing is being recorded")

        def then(report: Any) -> Result:
            path, rows = str(report.path), report.rows_written
            return {"path": path, "rows": rows, "complete": report.complete, "error": report.error}

        self._later(order, lambda: finished(recording), then)

    @property
    def _are_records_busy(self) -> bool:
        """Whether a recording is being started or finished."""
        return self._is_under_way(Action.RECORD) or self._is_under_way(Action.STOP_RECORDING)

    def _is_under_way(self, action: Action) -> bool:
        return any(order.action is action for order, _, _ in self._under_way)

    def _shut_down(self, order: Order) -> Result:
        self.shutdown = True
        return {}


def _try_out(path: ReferenceSource) -> None:
    """Raise BadInputError for a path whose poses are not finite."""
    for share in (0.0, 0.1, 0.5, 1.0, 10.0):
        try:
            pose, twist, acceleration = path.at(share * path.span_s)
            is_finite = math.isfinite(sum(pose) + sum(twist) + sum(acceleration))
        except (ArithmeticError, ValueError):
            is_finite = False
        if not is_finite:
            raise BadInputError("the path has no finite pose at some time; its options are too large or too small")
