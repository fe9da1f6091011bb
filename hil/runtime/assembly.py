"""From a scenario to a finished run: prepare, open, drive, report."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hil.core.errors import BadInputError, DeviceError, HilError, LinkError, OverdueError
from hil.core.ports import Sink
from hil.core.signals import Signals
from hil.judge.claims import signals_of
from hil.judge.figures import RunFigures, figure_signals
from hil.judge.measure import CommandLimits, RunSetup
from hil.judge.memory_sink import MemorySink
from hil.judge.result import RunResult
from hil.references import Feasibility
from hil.runtime.bench import NS, Bench
from hil.runtime.events import EventLog, RunEvents
from hil.runtime.loop import Loop, Report
from hil.runtime.report import close_recording, close_unfinished, is_cut, judge
from hil.runtime.robots import link_of
from hil.runtime.row import DIFFERENCE_SIGNALS
from hil.runtime.run_options import RunOptions
from hil.runtime.run_parts import RunParts
from hil.runtime.unexplained import Rejections
from hil.scenario import Scenario, load, set_texts
from hil.wire.url import parse_link

if TYPE_CHECKING:
    # Only of a run that is recorded or traced.
    from hil.core.outputs import Existing
    from hil.record.journal import Journal
    from hil.record.recording import RunRecording
    from hil.runtime.realtime import RealTime
    from hil.wire.trace import Trace

__all__ = ["RunOptions", "RunResult", "check_scenario", "run", "run_scenario"]

T = TypeVar("T")


def run(
    scenario: str | Path,
    *,
    set: Mapping[str, object] | Sequence[str] = (),  # noqa: A002 - the name of the option
    law: str | type | None = None,
    robot: str | Path | None = None,
    mode: str | None = None,
    link: str | None = None,
    seed: int | None = None,
    truth: str | None = None,
    record: str | Path | None = None,
    rotate: str | None = None,
    trace: str | Path | None = None,
    force: bool = False,
    allow_motion: bool = False,
    lenient: bool = False,
) -> RunResult:
    """Run a scenario, as ``hil run`` does, and return its result.

    The result holds all signals. Unlike ``hil run``, it records only into a file that ``record`` names.

    ``scenario`` is a shipped name or a path; ``set`` overrides any of its keys, ``robot`` merges a robot's own file.
    ``law`` is the control law: a class, or a text as ``controller.law`` takes it. ``truth`` is the URL of the truth
    socket of a robot in another process. ``record`` is an ``.rrd`` or ``.mcap`` file; ``rotate`` is the size or
    duration after which the recording continues in a new file, as in ``1GB``. ``trace`` is a ``.blf``, ``.asc``
    or ``.log`` file for the frames on the wire. ``force`` replaces an existing recording or trace. ``lenient`` judges
    by ``[[expect]]`` alone.

    Raises BadInputError for a wrong scenario or option and for an output file that exists already, LinkError or
    DeviceError when the robot cannot be reached or does not arm. Later failures are in the result. A law that takes
    longer than ``loop.tick_limit_s`` and cannot be interrupted by an exception (in a sleep or in C) ends the calling
    process with ``os._exit(3)``: no ``finally`` or exit handler of the caller runs. ``set={"loop.tick_limit_s": 0}``
    removes the limit.
    """
    if law is not None:
        set = [*set_texts(set), *set_texts({"controller.law": law})]  # noqa: A001
    loaded = load(scenario, set=set, robot=robot, mode=mode, link=link, seed=seed)
    recording, traced = (Path(path) if path is not None else None for path in (record, trace))
    with contextlib.ExitStack() as resources:
        recorded: dict[str, Any] = {}
        if rotate is not None:
            from hil.record.files import rotation

            recorded["rotate"] = rotation(rotate)
        if recording is not None:
            from hil.record.recording import early_recorder

            recorded["make_recording"] = resources.enter_context(early_recorder(recording.suffix))
        options = RunOptions(
            truth=truth,
            record=recording,
            trace=traced,
            existing="replace" if force else "refuse",
            allow_motion=allow_motion,
            lenient=lenient,
            **recorded,
        )
        return run_scenario(loaded, options)


def run_scenario(scenario: Scenario, options: RunOptions = RunOptions()) -> RunResult:  # noqa: B008 -- immutable
    """Run a scenario that was loaded. Raises as ``run``."""
    run = _Run(scenario, options)
    with contextlib.ExitStack() as resources:
        run.open(resources)
        report, granted = run.drive()
        return run.report(report, granted)


def check_scenario(scenario: Scenario) -> Feasibility:
    """Make the parts of a run without a robot; return the wheel speeds and torques that the reference demands.

    Raises BadInputError when the law or the reference rejects its options.
    """
    return RunParts(scenario).feasibility()


class _Run:
    """One run. The constructor prepares it; then ``open``, ``drive`` and ``report`` are called in this order."""

    def __init__(self, scenario: Scenario, options: RunOptions) -> None:
        self._scenario = scenario
        self._options = options
        self._trace_existing: Existing = "refuse" if options.existing == "number" else options.existing
        if options.instrument is not None and options.allow_motion:
            raise BadInputError("a run whose parts are changed moves no real motors; leave allow_motion out")
        for what, path, existing in (
            ("recording", options.record, options.existing),
            ("trace", options.trace, self._trace_existing),
        ):
            if path is not None:
                from hil.record.files import check_output_path

                check_output_path(what, path, existing)
        self._parts = RunParts(scenario)
        self._ingredients: dict[str, Any] = {}
        if options.is_recorded:
            from hil.runtime.provenance import ingredients

            self._ingredients = ingredients(scenario)
        self._feasibility = self._parts.feasibility()
        self._is_lockstep = scenario.loop.mode == "lockstep"
        self._warn(self._feasibility.sentences)
        self._trace: Trace | None = None
        self._journal = self._make_journal()
        self._recording: RunRecording | None = None

    def open(self, resources: contextlib.ExitStack) -> None:
        """Open the robot and the outputs, and make the loop. Raises as ``run``."""
        scenario, options, laws = self._scenario, self._options, self._parts.laws
        url = parse_link(scenario.link.url)
        if url.device_name() is not None and options.replayed is None:
            from hil.wire.device_lock import device_held

            resources.enter_context(device_held(url, f"hil run {scenario.name}"))
        if options.trace is not None:
            self._trace = resources.enter_context(self._open_trace(options.trace))
        bench = Bench(
            scenario,
            options.truth,
            allow_motion=options.allow_motion,
            trace=self._trace,
            make_node=options.make_node,
            make_robot=options.make_robot,
            instrument=options.instrument,
            replayed=options.replayed,
            journal=self._journal,
            signals=laws.signals,
        )
        self._bench = resources.enter_context(bench)
        # First the robot, then the recorder: a failed connection leaves no empty recording behind.
        robot = self._reach(bench.connect)
        self._warn(bench.warnings)
        if options.is_recorded:
            self._recording = resources.enter_context(self._open_recording())
            if self._journal is not None:
                self._journal.begin(self._recording.event)
            self._recording.event(0.0, "info", f"robot: {robot.describe()}")
            self._recording.event(0.0, "info", f"link: {bench.device.describe_link()}")
            for sentence in (*self._feasibility.sentences, *bench.warnings):
                self._recording.event(0.0, "warning", sentence)
        self._loop = self._make_loop()

    def _make_journal(self) -> "Journal | None":
        options = self._options
        if options.record is None or options.replayed is not None or not self._scenario.record.frames:
            return None
        from hil.record.journal import Journal

        return Journal()

    def _open_trace(self, path: Path) -> "Trace":
        from hil.wire.trace import Trace

        url, existing = link_of(self._scenario), self._trace_existing
        fd = url.wire == "can_fd"
        return Trace(path, blocking=self._is_lockstep, fd=fd, switched=url.is_switched, existing=existing)

    def _open_recording(self) -> "RunRecording":
        from hil.record import viewing
        from hil.record.recording import Recording
        from hil.runtime.provenance import properties

        options = self._options
        if "drawing" not in viewing.places():
            self._warn([viewing.NO_DRAWING])
        # Pass only options that are set: another package's ``make_recording`` need not know the others.
        further: dict[str, Any] = {"rotation": options.rotate} if options.rotate is not None else {}
        if options.existing != "refuse":
            further["existing"] = options.existing
        if self._is_lockstep and options.live_port is None:
            further["wait"] = False  # only simulated time passes before the recorder is ready
        instrumented = {} if options.instrument is None else options.instrument.properties
        make_recording = options.make_recording or Recording
        return make_recording(
            options.record,
            properties=properties(self._scenario, {**self._ingredients, **instrumented}),
            blocking=self._is_lockstep,
            live_port=options.live_port,
            signals=self._parts.laws.signals,
            **further,
        )

    def _make_loop(self) -> Loop:
        scenario, robot = self._scenario, self._scenario.robot
        names = self._names()
        limits = CommandLimits(robot.speed_limit_rad_s, robot.torque_limit_n_m)
        figures = RunFigures(RunSetup(scenario.firmware.torque_constant_n_m_a, limits), names)
        self._memory = MemorySink(names, figures, keep=self._options.keep_signals)
        self._log = EventLog(None if self._recording is None else self._recording.event)
        note = self._log.note
        self._events = RunEvents(scenario, names, note, self._memory.newest, self._bench.plant_output)
        faults = [table.row for table in scenario.fault]
        watches = any(row.stops is not None for row in scenario.expect)
        self._rejections = Rejections(self._bench.device, faults, self._parts.timing, names, watches=watches)
        sinks: list[Sink | None] = [self._memory, self._recording, self._journal]
        sinks += [sink for sink in (self._events, self._rejections) if sink.needs_rows]
        parts = self._parts.make(self._bench, [sink for sink in sinks if sink is not None], note)
        if (instrument := self._options.instrument) is not None:
            parts = instrument.parts(scenario, parts)
        return Loop(
            parts._replace(signals=names),
            scenario.controller.mode,
            self._parts.timing,
            faults=faults,
            rearm=scenario.loop.rearm,
            watches=watches,
            warn=self._options.warn,
            tick_limit_s=scenario.loop.tick_limit_s,
            last_words=self._end_stuck,
        )

    def _names(self) -> Sequence[str]:
        """Return the names of the signals in a row: when only this run reads the rows, those that it reads.

        All are in it where computing one can fail (a failure must be noticed), and with a fault that acts on a signal.
        """
        scenario, laws, options = self._scenario, self._parts.laws, self._options
        is_read = options.keep_signals or options.is_recorded
        if is_read or laws.signals_may_fail or self._bench.faults.signals is not None:
            return laws.signals
        judged = {name for row in scenario.expect for name in signals_of(row)}
        own = {*MemorySink.needs, *RunEvents.needs, *Rejections.needs, *DIFFERENCE_SIGNALS}
        read = figure_signals() | judged | own
        return [name for name in laws.signals if name in read]

    def _end_stuck(self, sentence: str) -> None:
        """Stop the robot and close the files, in another thread: a law that does not return blocks the main one."""
        with contextlib.suppress(HilError):
            self._bench.device.close()
        if self._trace is not None:
            self._trace.finish()
        if self._recording is not None:
            t_s = self._loop.t_s
            results = list(self._events.finish(t_s, is_cut=True).values())
            close_unfinished(self._recording, t_s, OverdueError(sentence), results)
        if self._options.on_stuck is not None:
            self._options.on_stuck(sentence)

    def drive(self) -> "tuple[Report, RealTime | None]":
        """Arm the robot and run the loop; return its report, and the granted real-time settings (None in lockstep)."""
        scenario, bench = self._scenario, self._bench
        # After all other processes were started, which would inherit the processors; before arming, because locking
        # memory takes time.
        taken: AbstractContextManager[RealTime | None] = contextlib.nullcontext()
        if not self._is_lockstep:
            from hil.runtime.realtime import real_time

            taken = real_time(scenario.realtime, bench.robot_threads)
        with taken as granted:
            origin_ns = self._reach(lambda: bench.device.start(bench.clock, scenario.loop.period_ns))
            bench.begin(origin_ns)
            self._rejections.begin()
            watch = self._options.watch or contextlib.nullcontext
            with watch(self._loop):
                return self._loop.run(origin_ns, round(scenario.loop.duration_s * NS)), granted

    def report(self, report: Report, granted: "RealTime | None") -> RunResult:
        """Stop the robot, compute the figures, and finish the trace and the recording."""
        scenario, loop = self._scenario, self._loop
        report = report._replace(failure=self._bench.stop_robot() or report.failure)
        results = self._events.finish(loop.t_s, is_cut=is_cut(scenario, loop, report))
        is_lenient, rejections = self._options.lenient, self._rejections.counts()
        run = judge(scenario, self._bench, self._memory, loop, report, results, rejections, lenient=is_lenient)
        run = replace(
            run,
            realtime=None if granted is None else granted.figures(),
            reference={"kind": scenario.reference.kind, **self._feasibility.figures()},
            trace=None if self._trace is None else self._trace.finish(),
        )
        linger = self._options.linger
        if self._journal is not None:
            self._journal.flush()
        if self._recording is not None:
            run = close_recording(self._recording, loop.t_s, scenario.allow, run, keep_live=linger is not None)
        if linger is not None:
            linger()
        run = replace(run, events=self._log.events)
        return RunResult(scenario, run, Signals(self._memory.signals()), report.failure)

    def _warn(self, sentences: Sequence[str]) -> None:
        if self._options.warn is not None:
            for sentence in sentences:
                self._options.warn(sentence)

    def _reach(self, step: Callable[[], T]) -> T:
        """Take a step towards ACTIVE. If the robot in this process has failed, raise its failure in place of ours."""
        try:
            return step()
        except (DeviceError, LinkError) as error:
            failure = self._bench.stop_robot()
            if self._recording is not None:
                close_unfinished(self._recording, 0.0, failure or error)
            if failure is not None:
                raise failure from None
            raise
