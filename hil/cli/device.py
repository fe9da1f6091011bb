"""``hil device``: the virtual robot in its own process, behind a link, with its true pose on a socket."""

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hil.cli.options import Force, LinkUrl, Mode, RobotFile, ScenarioName, Seed, Sets, TraceFile, load_scenario
from hil.cli.output import end_in_order, say
from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError
from hil.core.outputs import existing_files
from hil.core.subprocesses import on_signals, wait_for_end

BOARD = "board"
"""The value of --target for a real board."""

if TYPE_CHECKING:
    from hil.robot.virtual import VirtualStm32
    from hil.scenario import Scenario
    from hil.wire.link import LinkUrl as Url
    from hil.wire.trace import Trace


def device(
    scenario: ScenarioName,
    link: LinkUrl = None,
    mode: Mode = None,
    robot: RobotFile = None,
    truth_port: Annotated[int, Option(metavar="PORT", help="for the truth; 0 takes a free one", min=0, max=65535)] = 0,
    target: Annotated[
        str,
        Option(
            metavar="host|qemu|unicorn|board",
            help="where the firmware runs; of a real board --link is the plant's line",
        ),
    ] = "host",
    driver: Annotated[str | None, Option(metavar="NAME", help="as --set device.driver=NAME")] = None,
    seed: Seed = None,
    sets: Sets = None,
    trace: TraceFile = None,
    force: Force = False,
    until_eof: Annotated[bool, Option("--until-eof", help="end when stdin ends, as when the parent has ended")] = False,
) -> None:
    """Run the scenario's virtual robot in a process of its own; print one line when ready."""
    end_in_order()  # until the robot is served
    from hil.record import check_output_path
    from hil.runtime.robots import open_trace

    changes = [*(sets or []), *([] if driver is None else [f"device.driver={driver}"])]
    resolved = load_scenario(scenario, set=changes, robot=robot, mode=mode, link=link, seed=seed)
    existing = existing_files(force=force)
    if trace is not None:
        check_output_path("trace", trace, existing)
    with contextlib.ExitStack() as resources:
        if trace is not None and target == BOARD:
            raise BadInputError(
                "--trace with --target board: its line carries no messages of the bus; trace in hil run"
            )
        virtual = _robot(resolved, target)
        resources.callback(virtual.close)
        file = None if trace is None else resources.enter_context(open_trace(resolved, trace, existing))
        _serve(resolved, virtual, target, truth_port, file, sys.stdin.fileno() if until_eof else None, resources)


def _serve(
    scenario: "Scenario",
    robot: "VirtualStm32",
    target: str,
    truth_port: int,
    trace: "Trace | None",
    lifeline: int | None,
    resources: contextlib.ExitStack,
) -> None:
    """Serve the robot until SIGTERM, SIGINT or SIGHUP, or until ``lifeline``, the descriptor of a pipe, ends.

    Prints one line when the robot is ready, with its link and truth, and one for each setting of ``[realtime]`` that
    was not granted; at the end the last output of a foreign FMU, and a line if robot time was lost or the trace is
    incomplete. Raises LinkError when the link is lost, DeviceError when the plant fails.
    """
    from hil.core.clock import WallClock
    from hil.robot.targets.robot import open_server
    from hil.robot.truth_server import TruthServer
    from hil.runtime.realtime import real_time
    from hil.runtime.robots import protocol_of
    from hil.wire.trace import TracedWire

    # A board on its plant's line: time passes there, with each question that comes from it.
    lockstep, protocol = scenario.loop.mode == "lockstep" or target == BOARD, protocol_of(scenario.device)
    wire, reach = _line(scenario, target).open_robot(say, lockstep=lockstep, protocol=protocol)
    resources.callback(wire.close)
    if trace is not None:
        clock = _RobotTime(robot) if lockstep else WallClock()
        trace.begin(time.time_ns() - clock.now_ns())
        wire = TracedWire(wire, trace, clock.now_ns, protocol)
    truth = TruthServer(scenario.hash, truth_port)
    resources.callback(truth.close)
    # Before robot time begins, because locking memory takes a tenth of a second.
    granted = None if scenario.loop.mode == "lockstep" else resources.enter_context(real_time(scenario.realtime))
    server = open_server(robot, wire, truth, lockstep=lockstep)
    truth.request_reset = server.request_reset
    truth.run_on_faults = server.run_on_faults
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: server.stop())
    on_signals(lambda *_: server.stop(), "SIGHUP")
    if lifeline is not None:
        threading.Thread(target=_stop_at_the_end, args=(lifeline, server.stop), name="lifeline", daemon=True).start()
    end = "plant" if target == BOARD else "link"
    say(f"ready {end}={reach} truth={truth.url} mode={scenario.loop.mode} scenario={scenario.name}")
    for sentence in granted.figures()["refused"].values() if granted is not None else ():
        say(f"not granted: {sentence}")
    try:
        server.serve()
    finally:
        for line in robot.output.end() if robot.output is not None else ():
            say(f"the plant says: {line}")
        if server.slipped_ticks:
            say(f"this machine stalled: the robot lost {server.slipped_ticks} ms of its time")
        if trace is not None and (trouble := trace.finish().trouble()) is not None:
            say(trouble)


def _robot(scenario: "Scenario", target: str) -> "VirtualStm32":
    """Make the scenario's robot. Raises BadInputError when it cannot run in its own process."""
    from hil.robot.targets.board import open_board
    from hil.robot.targets.robot import open_target
    from hil.robot.virtual import VirtualStm32
    from hil.runtime.mutation.mutation import mutation
    from hil.runtime.robots import no_lockstep, node_maker, virtual_robot

    made_of, driver = mutation().made_of(virtual_robot(scenario)), scenario.device.driver
    if not scenario.device.is_makers:
        url = _line(scenario, target)
        return open_board(made_of, url) if target == BOARD else open_target(target, made_of, url)
    if target != "host":
        raise BadInputError(f"--target {target} runs this project's firmware, not {driver!r}; leave --target out")
    if made_of.lockstep:
        raise no_lockstep(scenario.device.driver)
    return VirtualStm32(made_of, node_maker(scenario.device))


def _line(scenario: "Scenario", target: str) -> "Url":
    """Return the link that the robot is behind, or that a board's plant port is."""
    from firmware_protocol.plant_port import BAUD
    from hil.runtime.robots import link_of
    from hil.wire.url import parse_link

    return parse_link(scenario.link.url, baud=BAUD) if target == BOARD else link_of(scenario)


class _RobotTime:
    """The clock of a robot in lockstep; it continues when a power cycle sets the robot's own time to 0."""

    def __init__(self, robot: "VirtualStm32") -> None:
        self._robot = robot
        self._base = 0
        self._last = 0

    def now_ns(self) -> int:
        tick = self._robot.node.look().tick
        if tick < self._last:
            self._base += self._last
        self._last = tick
        return (self._base + tick) * TICK_NS


def _stop_at_the_end(lifeline: int, stop: Callable[[], None]) -> None:
    wait_for_end(lifeline)
    stop()
