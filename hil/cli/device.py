"""``hil device``: the virtual robot in its own process, behind a link, with its true pose on a socket."""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hil.cli.options import LinkUrl, Mode, RobotFile, ScenarioName, Seed, Sets, load_scenario
from hil.cli.output import end_in_order, say
from hil.core.errors import BadInputError
from hil.core.subprocesses import on_signals, wait_for_end

if TYPE_CHECKING:
    from hil.robot.boards import Board
    from hil.robot.virtual import VirtualStm32
    from hil.scenario import Scenario
    from hil.wire.link import LinkUrl as Url


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
    until_eof: Annotated[bool, Option("--until-eof", help="end when stdin ends, as when the parent has ended")] = False,
) -> None:
    """Run the scenario's virtual robot in a process of its own; print one line when ready."""
    end_in_order()  # until the robot is served
    from hil.robot.boards import find_board

    changes = [*(sets or []), *([] if driver is None else [f"device.driver={driver}"])]
    resolved = load_scenario(scenario, set=changes, robot=robot, mode=mode, link=link, seed=seed)
    board = find_board(target)
    with contextlib.ExitStack() as resources:
        virtual = _robot(resolved, target, board)
        resources.callback(virtual.close)
        _serve(resolved, virtual, board, truth_port, sys.stdin.fileno() if until_eof else None, resources)


def _serve(
    scenario: "Scenario",
    robot: "VirtualStm32",
    board: "Board",
    truth_port: int,
    lifeline: int | None,
    resources: contextlib.ExitStack,
) -> None:
    """Serve the robot until SIGTERM, SIGINT or SIGHUP, or until ``lifeline``, the descriptor of a pipe, ends.

    Prints one line when the robot is ready, with its link and truth, and one for each ``[realtime]`` setting that was
    not granted. At the end it prints the last output of a foreign FMU, and a line if robot time was lost. Raises
    LinkError when the link is lost, DeviceError when the plant fails.
    """
    from hil.robot.truth_server import TruthServer
    from hil.runtime.realtime import real_time
    from hil.runtime.robots import protocol_of

    # A board on its plant's line: time passes there, with each question that comes from it.
    lockstep, protocol = scenario.loop.mode == "lockstep" or board.plant_baud is not None, protocol_of(scenario.device)
    wire, reach = _line(scenario, board).open_robot(say, lockstep=lockstep, protocol=protocol)
    resources.callback(wire.close)
    truth = TruthServer(scenario.hash, truth_port)
    resources.callback(truth.close)
    # Before robot time begins, because locking memory takes a tenth of a second.
    granted = None if scenario.loop.mode == "lockstep" else resources.enter_context(real_time(scenario.realtime))
    server = board.make_server(robot, wire, truth, lockstep=lockstep)
    truth.request_reset = server.request_reset
    truth.run_on_faults = lambda action: server.run_between_exchanges(lambda: action(robot.faults))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: server.stop())
    on_signals(lambda *_: server.stop(), "SIGHUP")
    if lifeline is not None:
        threading.Thread(target=_stop_at_the_end, args=(lifeline, server.stop), name="lifeline", daemon=True).start()
    end = "link" if board.plant_baud is None else "plant"
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


def _robot(scenario: "Scenario", target: str, board: "Board") -> "VirtualStm32":
    """Make the scenario's robot. Raises BadInputError when it cannot run in its own process."""
    from hil.robot.boards import HOST
    from hil.robot.virtual import VirtualStm32
    from hil.runtime.robots import no_lockstep, node_maker, virtual_robot

    made_of, driver = virtual_robot(scenario), scenario.device.driver
    if not scenario.device.is_makers:
        return board.open(made_of, _line(scenario, board))
    if target != HOST:
        raise BadInputError(f"--target {target} runs this project's firmware, not {driver!r}; leave --target out")
    if made_of.lockstep:
        raise no_lockstep(scenario.device.driver)
    return VirtualStm32(made_of, node_maker(scenario.device))


def _line(scenario: "Scenario", board: "Board") -> "Url":
    from hil.runtime.robots import link_of
    from hil.wire.url import parse_link

    return link_of(scenario) if board.plant_baud is None else parse_link(scenario.link.url, baud=board.plant_baud)


def _stop_at_the_end(lifeline: int, stop: Callable[[], None]) -> None:
    wait_for_end(lifeline)
    stop()
