"""From a scenario to a finished run: the one place that puts the parts together."""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeVar

from hil.core.errors import DeviceError, HilError, LinkError
from hil.core.outputs import Existing, existing_files
from hil.core.percentiles import Percentiles
from hil.core.ports import Sink
from hil.core.signals import SIGNAL_NAMES
from hil.judge.allowed import allow_figures
from hil.judge.figures import RunFigures, cut_words, figure_signals
from hil.judge.measure import CommandLimits, RunSetup
from hil.judge.results import MemorySink, RunResult, Signals
from hil.judge.words import applied_words, with_page
from hil.record import Recording, Rotation, RunRecording, check_output_path, early_recorder, rotation
from hil.record.udp import UdpStream, parse_destination
from hil.references import Feasibility
from hil.robot.virtual import MakeNode, MakeRobot, new_robot
from hil.runtime.bench import NS, Bench
from hil.runtime.events import RunEvents
from hil.runtime.loop import Loop, Report
from hil.runtime.parts import PartsOf
from hil.runtime.provenance import ingredients, properties
from hil.runtime.realtime import RealTime, Wanted, real_time
from hil.runtime.robots import open_trace
from hil.scenario import Scenario, load, set_texts
from hil.scenario.laws import Laws
from hil.wire.device_lock import device_held
from hil.wire.trace import Trace
from hil.wire.url import parse_link

__all__ = ["RunResult", "check_scenario", "run", "run_scenario"]


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
    stream: str | None = None,
    force: bool = False,
    allow_motion: bool = False,
) -> RunResult:
    """Run a scenario and return its result, as ``hil run`` does; nothing is recorded unless ``record`` names a file.

    ``hil run`` records into ``runs/`` by itself, for its process ends with the run; here the result has all signals.

    ``scenario`` is a shipped name or a path; ``set`` overrides any of its keys, ``robot`` merges a robot's own file.
    ``law`` is the control law: a class, or a text as ``controller.law`` takes it.
    ``truth`` is the URL of the truth socket of a robot in another process, ``record`` an ``.rrd`` or ``.mcap``
    file, ``rotate`` when it goes on in another, as in ``1GB|10min``, ``trace`` a ``.blf``, ``.asc`` or ``.log`` file
    for what is on the wire, ``stream`` the URL ``udp://127.0.0.1:PORT`` of a program that plots JSON datagrams.
    ``force`` replaces a recording and a trace that are there already.

    Raises BadInputError for a wrong scenario or option and for a file that is there already, LinkError or DeviceError
    when the robot cannot be reached or does not arm. What fails later is in the result. A law that is stuck longer than
    ``loop.tick_limit_s`` where no exception gets to, in a sleep or in C, ends the calling process with ``os._exit(3)``,
    which runs nothing of the caller's; ``set={"loop.tick_limit_s": 0}`` has it wait for ever instead.
    """
    if law is not None:
        set = [*set_texts(set), *set_texts({"controller.law": law})]  # noqa: A001
    loaded = load(scenario, set=set, robot=robot, mode=mode, link=link, seed=seed)
    recording, traced = (Path(path) if path is not None else None for path in (record, trace))
    parts = rotation(rotate) if rotate is not None else Rotation()
    with early_recorder(recording.suffix if recording is not None else None) as make_recording:
        return run_scenario(
            loaded,
            truth=truth,
            record=recording,
            rotate=parts,
            trace=traced,
            existing=existing_files(force=force),
            stream=stream,
            allow_motion=allow_motion,
            make_recording=make_recording,
        )


MakeRecording = Callable[..., RunRecording]
"""Makes a recording from the arguments of ``Recording``."""

Watch = Callable[[Loop], AbstractContextManager[object]]


def run_scenario(
    scenario: Scenario,
    *,
    truth: str | None = None,
    record: Path | None = None,
    rotate: Rotation = Rotation(),  # noqa: B008 -- immutable
    trace: Path | None = None,
    existing: Existing = "refuse",
    live_port: int | None = None,
    stream: str | None = None,
    allow_motion: bool = False,
    watch: Watch | None = None,
    warn: Callable[[str], None] | None = None,
    linger: Callable[[], None] | None = None,
    on_stuck: Callable[[str], None] | None = None,
    make_node: MakeNode | None = None,
    make_robot: MakeRobot = new_robot,
    make_recording: MakeRecording = Recording,
    keep_signals: bool = True,
) -> RunResult:
    """Run a scenario that was loaded. Raises as ``run``.

    ``existing`` says what is done where ``record`` is there already; a ``trace`` is never numbered, but refused.
    ``live_port`` serves live viewers on 127.0.0.1. ``watch`` is entered with the loop while it runs; ``warn`` is
    called before anything is opened with each sentence on what the robot will not be able to follow, and with what the
    robot itself warns of once it is known, before it is armed; ``linger`` is called when all is done and recorded,
    while the viewers are still served. ``on_stuck`` is called with a sentence, in a thread of its own, before a law
    that is stuck in a tick where no exception gets to ends this process (``hil.core.tick_watch``). ``make_robot`` makes
    a robot in this process, ``make_node`` its firmware, ``make_recording`` the recording. Without ``keep_signals`` the
    result has none, and memory does not grow with the length of the run; extra signals are then asked for only where
    somebody else reads them.
    """
    trace_existing: Existing = "refuse" if existing == "number" else existing
    if record is not None:
        check_output_path("recording", record, existing)
    if trace is not None:
        check_output_path("trace", trace, trace_existing)
    destination = parse_destination(stream) if stream is not None else None
    parts = PartsOf(scenario)
    made_of = ingredients(scenario) if record is not None or live_port is not None else {}
    laws, demands = parts.laws, parts.demands()
    if warn is not None:
        for sentence in demands.sentences:
            warn(sentence)
    blocking = scenario.loop.mode == "lockstep"
    with contextlib.ExitStack() as resources:
        resources.enter_context(device_held(parse_link(scenario.link.url), f"hil run {scenario.name}"))
        tracing = resources.enter_context(open_trace(scenario, trace, trace_existing)) if trace is not None else None
        bench = resources.enter_context(
            Bench(
                scenario,
                truth,
                allow_motion=allow_motion,
                trace=tracing,
                make_node=make_node,
                make_robot=make_robot,
                signals=laws.signals,
            )
        )
        # First the robot, then the recorder: a robot that is not there leaves no empty recording behind.
        robot = _reach(bench, bench.connect)
        if warn is not None:
            for sentence in bench.device.warnings:
                warn(sentence)
        all_are_read = keep_signals or record is not None or live_port is not None or destination is not None
        names = laws.signals if all_are_read else _read_by_the_run(scenario, laws)
        memory = MemorySink(names, RunFigures(_setup(scenario), names), keep=keep_signals)
        recording: RunRecording | None = None
        if record is not None or live_port is not None:
            options: dict[str, Any] = {"rotation": rotate} if any(rotate) else {}
            if existing != "refuse":
                options["existing"] = existing
            recording = resources.enter_context(
                make_recording(
                    record,
                    properties=properties(scenario, made_of),
                    blocking=blocking,
                    live_port=live_port,
                    signals=laws.signals,
                    **options,
                )
            )
            recording.event(0.0, "info", f"robot: {robot.describe()}")
            recording.event(0.0, "info", f"link: {bench.device.describe_link()}")
            for sentence in (*demands.sentences, *bench.device.warnings):
                recording.event(0.0, "warning", sentence)
        streaming: UdpStream | None = None
        if destination is not None:
            streaming = resources.enter_context(UdpStream(destination, signals=laws.signals, blocking=blocking))
        note = recording.event if recording is not None else _unheard
        events = RunEvents(scenario, names, note, bench.said)
        sinks: list[Sink] = [sink for sink in (memory, recording, streaming, events) if sink is not None]
        made = parts.make(bench, sinks, note)
        if names is SIGNAL_NAMES:
            made = made._replace(extra=())
        faults = [table.row for table in scenario.fault]

        def last_words(sentence: str) -> None:
            """Do what cannot be left undone when the law holds the thread that would do it at the end of the run."""
            with contextlib.suppress(HilError):
                bench.device.close()
            if tracing is not None:
                tracing.finish()
            if recording is not None:
                recording.event(loop.t_s, "error", sentence)
                outcomes = events.finish(loop.t_s, is_cut=True)
                recording.finish(with_page({"passed": False, "failure": sentence, "expect": outcomes}))
            if on_stuck is not None:
                on_stuck(sentence)

        loop = Loop(
            made,
            scenario.controller.mode,
            parts.timing,
            faults=faults,
            rearm=scenario.loop.rearm,
            warn=warn,
            tick_limit_s=scenario.loop.tick_limit_s,
            last_words=last_words,
        )
        # Behind all other processes, which inherit the processors, and before the robot arms: locking takes its time.
        with _real_time(scenario, bench) as granted:
            origin_ns = _reach(bench, lambda: bench.device.start(bench.clock, scenario.loop.period_ns))
            bench.begin(origin_ns)
            with watch(loop) if watch is not None else contextlib.nullcontext():
                report = loop.run(origin_ns, round(scenario.loop.duration_s * NS))
        failure = bench.stop_robot() or report.failure
        is_cut = failure is not None and loop.t_s < scenario.loop.duration_s - 2.0 / scenario.loop.rate_hz
        outcomes = events.finish(loop.t_s, is_cut=is_cut)
        metrics = _figures(scenario, bench, memory, report, failure, loop, outcomes, is_cut=is_cut)
        metrics["realtime"] = None if granted is None else granted.figures()
        metrics["shadows"] = [] if laws.shadows is None else laws.shadows.figures()
        metrics["reference"] = {"kind": scenario.reference.kind, **demands.figures()}
        if tracing is not None:
            metrics["trace"] = _finished(tracing)
        if streaming is not None:
            metrics["streamed"] = streaming.finish()
        if recording is not None:
            _note_events(recording, loop, metrics)
            _close_recording(recording, metrics, keep_live=linger is not None)
            if linger is not None:
                linger()
    return RunResult(scenario, metrics, Signals(memory.signals()), failure)


def _read_by_the_run(scenario: Scenario, laws: Laws) -> Sequence[str]:
    """Return the signals of a run whose rows nobody reads but the run itself.

    Extra ones are among them where the scenario names one, or where only who asks learns that they fail.
    """
    named = {row.signal for row in scenario.expect} | {table.row.target for table in scenario.fault} | figure_signals()
    is_asked = laws.extra_may_fail or any(name in named for own in laws.extra for name in own.signals)
    return laws.signals if is_asked else SIGNAL_NAMES


def check_scenario(scenario: Scenario) -> Feasibility:
    """Make what a run of the scenario needs, without any robot; return what its reference asks of the wheels.

    Raises BadInputError for what the law or the reference refuse.
    """
    return PartsOf(scenario).demands()


def _real_time(scenario: Scenario, bench: Bench) -> AbstractContextManager[RealTime | None]:
    """Return what takes ``[realtime]``, for the controller and for a robot in this process; in lockstep nothing."""
    if scenario.loop.mode == "lockstep":
        return contextlib.nullcontext()
    return real_time(Wanted(**dict(scenario.realtime)), bench.robot_threads)


T = TypeVar("T")


def _reach(bench: Bench, step: Callable[[], T]) -> T:
    """Take a step towards ACTIVE. When it fails because the robot in this process did, say that instead."""
    try:
        return step()
    except (DeviceError, LinkError):
        if (failure := bench.stop_robot()) is not None:
            raise failure from None
        raise


def _unheard(_t_s: float, _level: str, _text: str) -> None:
    """Take a line of the event log of a run that keeps none."""


def _setup(scenario: Scenario) -> RunSetup:
    limits = CommandLimits(scenario.robot.speed_limit_rad_s, scenario.robot.torque_limit_n_m)
    return RunSetup(scenario.firmware.torque_constant_n_m_a, limits)


def _figures(
    scenario: Scenario,
    bench: Bench,
    memory: MemorySink,
    report: Report,
    failure: HilError | None,
    loop: Loop,
    outcomes: list[dict[str, Any]],
    *,
    is_cut: bool,
) -> dict[str, Any]:
    figures, reasons = memory.figures(cut_words(loop.t_s, scenario.loop.duration_s) if is_cut else None)
    applied: list[dict[str, Any]] = [
        {"kind": row.kind, "target": row.target, "text": row.words, "applied": count, "counts": row.counts}
        | {"start_s": row.start_s, "end_s": row.end_s if math.isfinite(row.end_s) else None, "value": row.value}
        for row, count in zip(scenario.fault, bench.faults.applied(), strict=True)
    ]
    held = all(outcome["passed"] for outcome in outcomes)
    # A fault that never happened proves nothing.
    faulted = all(row["applied"] for row in applied)
    # Neither does a run in which the law gave no number and the robot was held still.
    lawful = loop.commands_refused == 0
    allow = allow_figures(scenario.allow, report.counted, report.ticks)
    allowed = all(row["passed"] for row in allow)
    realtime_factor = report.robot_s / report.wall_s if report.ticks else None
    if realtime_factor is None:
        reasons["realtime_factor"] = "the run has no ticks"
    pose_fixes = loop.pose_fixes()
    if pose_fixes is None:
        reasons["pose_fixes"] = f"{scenario.estimator.source!r} takes none"
    device = bench.device
    return {
        "passed": failure is None and held and faulted and lawful and allowed,
        "scenario": scenario.name,
        "law": scenario.controller.law,
        "mode": scenario.loop.mode,
        "link": scenario.link.url,
        "seed": scenario.loop.seed,
        **figures,
        "lateness_us": loop.lateness.figures(),
        "deadline_misses": report.deadline_misses,  # the rows do not know of those after the last one
        "realtime_factor": realtime_factor,
        "frames": {"sent": device.sent, "received": device.received, "rejected": device.rejected()},
        "link_statistics": _link_statistics(bench, memory.feedback_age_ms()),
        "pose_fixes": pose_fixes,
        "wire_sha256": device.wire_sha256(),
        "stopped": report.stopped,
        "commands_refused": loop.commands_refused,
        **{name: count.all for name, count in report.counted.items()},
        "allow": allow,
        "recoveries": [recovered._asdict() for recovered in report.recoveries],
        "robot_slipped_ticks": bench.slipped_ticks,
        "expect": outcomes,
        "fault": applied,
        "failure": str(failure) if failure is not None else None,
        "recording": None,
        "reasons": reasons | {"recording": "no recording was asked for"},
    }


_NO_VALUE = {
    "load": "memory has no bit rate",
    "foreign": "a line between two has no third",
    "frames_to_host": "frames carry no count of their own here",
    "frames_to_robot": "frames carry no count of their own here",
    "feedback_age_ms": "the run has no ticks",
    "round_trip_ms": "no feedback said that a command of the run was in force",
    "clock": "the robot answered no TIME_SYNC_REQUEST",
}


def _link_statistics(bench: Bench, age_ms: Percentiles | None) -> dict[str, Any]:
    """Return what became of the link (hil/wire/STATISTICS.md); for a figure that is None, ``reasons`` tells why."""
    device, wire = bench.device, bench.wire
    rejected = device.rejected()
    counted = wire.counts_frames
    lost = {
        "snapshots": device.snapshots_lost,
        "frames_to_host": rejected.pop("lost", 0) if counted else None,
        "frames_to_robot": rejected.pop("robot_serial_lost", 0) if counted else None,
    }
    figures = {
        **wire.figures(),
        "lost": lost,
        "rejected": rejected,
        "feedback_age_ms": None if age_ms is None else age_ms._asdict(),
        "round_trip_ms": device.round_trip.figures(),
        "clock": device.clock_sync.figures(),
    }
    missing = [name for name, value in (figures | lost).items() if value is None]
    return figures | {"reasons": {name: _NO_VALUE[name] for name in missing}}


def _finished(trace: Trace) -> dict[str, Any]:
    report = trace.finish()
    return {
        "path": str(report.path),
        "frames": report.frames,
        "dropped": report.dropped,
        "lost": report.lost,
        "trouble": report.trouble(),
    }


def _note_events(recording: RunRecording, loop: Loop, metrics: Mapping[str, Any]) -> None:
    """Put into the event log what is only known when the run is over; what happened in it has been told then."""
    for row in metrics["fault"]:
        recording.event(loop.t_s, "info" if row["applied"] else "error", f"fault: {applied_words(row)}")
    if (trace := metrics.get("trace")) is not None and trace["trouble"] is not None:
        recording.event(loop.t_s, "warning", trace["trouble"])
    if metrics["failure"] is not None:
        recording.event(loop.t_s, "error", metrics["failure"])


def _close_recording(recording: RunRecording, metrics: dict[str, Any], *, keep_live: bool) -> None:
    """Finish the recording with the figures in it, and say in them what became of it."""
    if recording.path is not None:
        metrics["recording"] = str(recording.path)
        del metrics["reasons"]["recording"]
    report = recording.finish(with_page(metrics), keep_live=keep_live)
    metrics["recorded"] = {
        "rows": report.rows_written,
        "dropped": report.rows_dropped,
        "lost": report.rows_lost,
        "events_lost": report.events_lost,
        "error": report.error,
        "restarts": report.restarts,
        "troubles": list(report.troubles),
        "parts": [str(path) for path in report.parts],
    }
