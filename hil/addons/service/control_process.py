"""``hil serve``: the control process. It runs the ticks, owns link, robot and recording, and starts the API process."""

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.addons.service import logs
from hil.addons.service.api_child import ApiChild
from hil.addons.service.messages import Action, Answer, ApiConfig, Limits, LogStyle, Phase, Status
from hil.addons.service.orders import OrderHandler
from hil.addons.service.pilot import Pilot
from hil.addons.service.records import Records, named_in, recording_of
from hil.addons.service.status import MotionFeed, bench_status
from hil.addons.service.systemd import Notifier
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError
from hil.core.ports import PoseSource
from hil.core.signals import LoopSignals
from hil.core.subprocesses import on_signals
from hil.core.tick_watch import TickWatch
from hil.core.types import NAN, PoseFix
from hil.plant.child_output import log_lines
from hil.record.viewing import live_hint
from hil.runtime.bench import Bench
from hil.runtime.lateness import Lateness
from hil.runtime.provenance import ingredients, properties
from hil.runtime.realtime import RealTime, real_time
from hil.runtime.run_parts import RunParts
from hil.runtime.sampling import Sampling
from hil.scenario import Scenario
from hil.wire.device_lock import device_held
from hil.wire.reopening import BackOff, OpeningBeside
from hil.wire.url import parse_link

_OTHERS = 0o007
_STATUS_HZ = 20
_FARTHEST_M = 1000.0  # limit for target poses; beyond it a float32 loses millimetres
_POLL_S = 0.02
_ENDING_LIMIT_S = 7.0  # longer than the pilot waits for a robot to stop


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """The options of ``hil serve`` besides the configuration.

    ``record`` is the name of a file to record to from the start, numbered if it exists. ``live_port`` serves viewers.
    The API's token is in ``token_file``, those of further clients in ``clients_file``; ``audit`` is the file of the
    audit log. ``truth`` is the URL of a virtual robot's truth socket. ``log`` is the log's format.
    """

    record: str | None = None
    live_port: int | None = None
    token_file: str | None = None
    clients_file: str | None = None
    audit: str | None = None
    truth: str | None = None
    allow_motion: bool = False
    log: LogStyle = "text"


class _Ending:
    """Counts signals to end: the first ends the service gently, a second one at once, unless it is a SIGHUP."""

    def __init__(self) -> None:
        self.requests = 0
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self)
        on_signals(self, "SIGHUP")  # the window in which the service was started was closed

    def __call__(self, number: int, _frame: object) -> None:
        # Kernel and shell both send SIGHUP when a window is closed, so a second signal of this kind is not counted.
        if not self.requests or number in (signal.SIGTERM, signal.SIGINT):
            self.requests += 1
        logs.info("signal to end", signal=signal.Signals(number).name)


def serve(scenario: Scenario, options: ServeOptions) -> None:
    """Serve a scenario's robot until a signal or an order to shut down; then stop it, disarm it and return.

    Raises BadInputError for a bad configuration, LinkError when another process has the device, DeviceError when a
    robot in this process has failed.
    """
    if scenario.loop.mode == "lockstep":
        raise BadInputError("a service runs in real time; leave loop.mode out, or set it to 'realtime'")
    parts = RunParts(scenario)
    ending = _Ending()
    # Clients give orders to record, and a machine has several users: no file is for them. The group's part is the
    # umask's: 022 lets a lab's group read, 002 write, 077 neither.
    os.umask(os.umask(_OTHERS) | _OTHERS)
    with contextlib.ExitStack() as resources:
        resources.enter_context(device_held(parse_link(scenario.link.url), f"hil serve {scenario.name}"))
        notifier = Notifier()
        resources.callback(notifier.close)
        made_of = ingredients(scenario)
        about = properties(scenario, made_of)
        signals, live, table = parts.laws.signals, None, scenario.service
        if options.live_port is not None:
            live = resources.enter_context(recording_of(about, signals, None, table, options.live_port))
            logs.info("live view", hint=live_hint(options.live_port))
        records = Records(live)
        if options.record is not None:
            file = named_in(Path(table.recordings), options.record)
            records.begin(recording_of(about, signals, file, table))
        resources.callback(records.finish)
        robot, command = scenario.robot, scenario.controller.command
        wheel = robot.speed_limit_rad_s if command == "speed" else robot.torque_limit_n_m
        limits = Limits(table.speed_m_s, table.yaw_rate_rad_s, _FARTHEST_M, wheel, table.twist_timeout_s)
        files = {name: getattr(options, name) for name in ("token_file", "clients_file", "audit")}
        api = ApiChild(ApiConfig(scenario.name, scenario.link.url, limits, table.port, **files, log=options.log))
        resources.callback(api.close)
        _Service(scenario, made_of, options, parts, records, api, notifier, ending).run()
        notifier.stopping()
        logs.info("service ends")


class _LastingTruth:
    """A PoseSource that returns None once it was lost, instead of raising. ``lost`` is called once with the cause.

    It is not reconnected: a virtual robot that was restarted has its truth at another address.
    """

    def __init__(self, source: PoseSource, lost: Callable[[str], None]) -> None:
        self._source: PoseSource | None = source
        self._lost = lost

    def poll(self) -> PoseFix | None:
        """Return the newest fix, or None when there is none."""
        if self._source is None:
            return None
        try:
            return self._source.poll()
        except DeviceError as error:
            self.close()
            self._lost(str(error))
            return None

    def close(self) -> None:
        """Release the source."""
        if self._source is not None:
            self._source.close()
            self._source = None


@dataclass
class _Service:
    """The control process between its start and its end."""

    scenario: Scenario
    made_of: Mapping[str, str]
    options: ServeOptions
    parts: RunParts
    records: Records
    api: ApiChild
    notifier: Notifier
    ending: _Ending

    def __post_init__(self) -> None:
        self._ticks = self._deadline_misses = 0
        self._lateness = Lateness()
        self._t_s = 0.0
        self._estop_pending = False
        self._phase = Phase.AWAY
        self._bench: Bench | None = None

    def run(self) -> None:
        """Serve until the end."""
        with contextlib.ExitStack() as resources:
            self.notifier.ready()
            bench = self._open_bench(resources)
            if bench is None:
                return
            beside = resources.enter_context(ThreadPoolExecutor(1, "beside"))
            beside.submit(time.monotonic).result()  # starts the thread before this one gets real-time priority
            pilot = self._pilot(bench)
            if self._estop_pending:
                pilot.estop()
            signals = self.parts.laws.signals
            handler = OrderHandler(self.scenario, self.made_of, signals, pilot, self.records, self.api.send, beside)
            resources.callback(handler.end)
            resources.callback(bench.device.disarm)
            if (output := bench.plant_output) is not None:
                resources.callback(lambda: log_lines(output.end(), self._t_s, self.records.note))
            watch = TickWatch(self.scenario.loop.tick_limit_s, lambda: self._t_s, self._last_words)
            with real_time(self.scenario.realtime, bench.robot_threads) as granted, watch:
                self._loop(bench, pilot, handler, granted, watch)

    def _open_bench(self, resources: contextlib.ExitStack) -> Bench | None:
        """Open link and robot, and retry while that fails; None when the service should end first."""
        waits = BackOff()
        why = "its link is being opened"
        while True:
            opening = OpeningBeside(self._opened)
            try:
                while (bench := opening.result(_POLL_S)) is None:
                    if not self._attend(why):
                        opening.abandon()
                        return None
            except LinkError as error:
                why = str(error)
                logs.warning("link cannot be opened", why=why)
            else:
                return resources.enter_context(bench)
            until_ns = time.monotonic_ns() + waits.next_ns()
            while time.monotonic_ns() < until_ns:
                if not self._attend(why):
                    return None
                time.sleep(_POLL_S)

    def _opened(self) -> Bench:
        options = self.options
        signals = self.parts.laws.signals
        self._bench = Bench(self.scenario, options.truth, allow_motion=options.allow_motion, signals=signals)
        if self._bench.uncommissioned is not None:
            logs.warning("robot not commissioned", why=self._bench.uncommissioned)
        return self._bench

    def _attend(self, why: str) -> bool:
        """Answer the orders that have come while the robot is away; return False when the service should end."""
        for order in self.api.orders():
            can_do = order.action in (Action.ESTOP, Action.SHUTDOWN)
            self.api.send(Answer(order.number, None if can_do else f"the robot is away: {why}"))
            if order.action is Action.SHUTDOWN:
                return False
            self._estop_pending = self._estop_pending or order.action is Action.ESTOP
        self._send_status(link=self.scenario.link.url, why=why)
        self.notifier.beat(time.monotonic_ns())
        return not self.ending.requests

    def _pilot(self, bench: Bench) -> Pilot:
        made = self.parts.make(bench, [self.records], self.records.note)
        if made.truth is not None:
            lost = "; a state estimate that uses it is unknown from now on: restart the service to have it again"
            made = made._replace(
                truth=_LastingTruth(made.truth, lambda why: self.records.note(self._t_s, "error", why + lost))
            )
        return Pilot(made, self.scenario.controller.mode, self.parts.timing, self.scenario.service)

    def _loop(self, bench: Bench, pilot: Pilot, handler: OrderHandler, granted: RealTime, watch: TickWatch) -> None:
        timing, clock = self.parts.timing, bench.clock
        sampling = Sampling(clock, bench.device, pilot.parts.truth, timing)
        origin_ns = clock.now_ns()
        number = sampling.begin(origin_ns)
        bench.begin(origin_ns)
        every = max(1, round(1e9 / _STATUS_HZ / timing.period_ns))
        stall_ns = self.scenario.service.twist_timeout_s * 1e9
        tick_us = NAN
        feed = MotionFeed(self.scenario, pilot)
        polled_ns = time.perf_counter_ns()
        for _ in self._until_stopped(pilot, handler):
            try:
                late_ns = sampling.wait(number)
            except HilError as error:
                pilot.lose(error)
                continue  # waits for the same tick again; the failed input was removed from the link
            begin_ns = time.perf_counter_ns()
            orders = self.api.orders()
            # Orders that waited while this process stalled, wherever in this loop, are out of date.
            stalled = time.perf_counter_ns() - polled_ns > stall_ns
            polled_ns = begin_ns
            t_s = max(number, 0) * timing.period_ns * 1e-9
            handler.handle(orders, t_s, stalled=stalled)
            if not self.api.alive and pilot.phase in (Phase.ARMING, Phase.ACTIVE):
                pilot.disarm("the API process ended or hangs, so that no order could have stopped the robot")
            if number >= 0:
                self._ticks += 1
                self._lateness.add(late_ns)
                self._t_s = t_s
                now = LoopSignals(t_s, number, late_ns * 1e-3, tick_us, self._deadline_misses)
                watch.turn += 1
                fix = sampling.fix_of(number)
                pilot.tick(now, fix)
                if (motion := feed.motion(self.api.motion_hz, number, fix)) is not None:
                    self.api.send(motion)
                watch.turn += 1
            if pilot.phase is not self._phase or number % every == 0:
                handler.watch_recording()
                self._report(pilot, bench, granted)
            self.notifier.beat(begin_ns)
            tick_us = (time.perf_counter_ns() - begin_ns) * 1e-3
            following = sampling.following(number)
            self._deadline_misses += max(0, following - max(number, -1) - 1)
            number = following

    def _until_stopped(self, pilot: Pilot, handler: OrderHandler) -> Iterator[None]:
        """Yield until the service should end and its robot is disarmed, or until the time for that is over."""
        limit_s = None
        while True:
            if limit_s is None and (self.ending.requests or handler.shutdown):
                pilot.disarm()
                limit_s = time.monotonic() + _ENDING_LIMIT_S
            if limit_s is not None:
                pending = pilot.emergency.pending and pilot.phase is not Phase.AWAY
                if pilot.phase not in (Phase.ARMING, Phase.ACTIVE, Phase.STOPPING) and not pending:
                    return
                if self.ending.requests > 1:
                    logs.warning("second signal to end; the robot's watchdog stops it")
                    return
                if time.monotonic() > limit_s:
                    logs.error("robot did not come to rest in time; its watchdog stops it")
                    return
            yield

    def _last_words(self, sentence: str) -> None:
        """Close the robot's link and the recording before this process is ended because of a stuck law."""
        assert self._bench is not None
        with contextlib.suppress(HilError):
            self._bench.device.close()
        self.records.note(self._t_s, "error", sentence)
        self.records.finish()

    def _send_status(self, **values: Any) -> None:
        """Send the service's status; ``values`` are those that depend on the robot."""
        law, path = self.scenario.controller, self.records.path
        self.api.send(
            Status(
                time_unix_s=time.time(),
                scenario=self.scenario.name,
                law=law.law,
                command=law.command,
                recording=None if path is None else str(path),
                recording_trouble=self.records.trouble,
                rows_dropped=self.records.rows_dropped,
                rows_lost=self.records.rows_lost,
                ticks=self._ticks,
                deadline_misses=self._deadline_misses,
                lateness_us=self._lateness.percentiles_us(),
                **values,
            )
        )

    def _report(self, pilot: Pilot, bench: Bench, granted: RealTime) -> None:
        """Send the status, log the plant's output, and report a new phase to log, recording and systemd."""
        self._send_status(**bench_status(pilot, bench, granted))
        if bench.plant_output:
            log_lines(bench.plant_output.new_lines(), self._t_s, self.records.note)
        if pilot.phase is self._phase:
            return
        self._phase = pilot.phase
        is_bad = pilot.phase in (Phase.AWAY, Phase.FAULT, Phase.ESTOP) or pilot.why is not None
        sentence = f"the robot is {pilot.phase}" + (f": {pilot.why}" if pilot.why is not None else "")
        level = "warning" if is_bad else "info"
        self.records.note(self._t_s, level, sentence, "phase", phase=pilot.phase.value, why=pilot.why)
        self.notifier.status(sentence)
