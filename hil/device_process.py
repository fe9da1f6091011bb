"""``hil device``: the virtual robot as a process of its own, behind a link, with its truth on a socket."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable

from hil.bench import virtual_robot
from hil.devices.targets.robot import open_server, open_target
from hil.devices.truth import TruthServer
from hil.links.opening import open_robot
from hil.links.url import parse_link
from hil.scenario import Scenario


def serve(
    scenario: Scenario,
    truth_port: int,
    say: Callable[[str], None],
    target: str = "host",
    lifeline: int | None = None,
) -> None:
    """Serve the scenario's virtual robot until SIGTERM or SIGINT; ``target`` says what its firmware runs on.

    With a ``lifeline``, the descriptor of a pipe, it ends with that too: when whoever held the other end is gone.

    ``say`` gets one line when the robot is ready: how to reach it; and one at the end if this machine's stalls cost
    robot time. Raises BadInputError when a part cannot be made, LinkError when the link is lost, DeviceError when the
    plant fails.
    """
    with contextlib.ExitStack() as resources:
        url = parse_link(scenario.link.url)
        robot = open_target(target, virtual_robot(scenario), url)
        resources.callback(robot.close)
        wire, reach = open_robot(url)
        resources.callback(wire.close)
        truth = TruthServer(scenario.hash, truth_port)
        resources.callback(truth.close)
        server = open_server(robot, wire, truth, lockstep=scenario.loop.mode == "lockstep")
        truth.request_reset = server.request_reset
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: server.stop())
        if lifeline is not None:
            threading.Thread(
                target=_stop_at_the_end, args=(lifeline, server.stop), name="lifeline", daemon=True
            ).start()
        say(f"ready link={reach} truth={truth.url} mode={scenario.loop.mode} scenario={scenario.name}")
        try:
            server.serve()
        finally:
            if server.slipped_ticks:
                say(f"this machine stalled: the robot lost {server.slipped_ticks} ms of its time")


def _stop_at_the_end(lifeline: int, stop: Callable[[], None]) -> None:
    # Not through a buffered reader: its lock, held by this thread, would be fatal when the interpreter ends.
    while os.read(lifeline, 4096):
        pass
    stop()
