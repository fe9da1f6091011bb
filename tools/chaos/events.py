"""Possible events: each is a function that does it, waits, undoes it, and returns a short text on it."""

import contextlib
import http.client
import json
import os
import random
import resource
import signal
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import psutil

from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import LENGTHS
from hil.addons.service.discovery import running
from hil.addons.service.messages import Action
from hil.core.errors import HilError
from tools.chaos.judge import Judge
from tools.chaos.world import World

Event = Callable[[World, Judge, random.Random], str | None]
"""Returns the words for what it did, or None where there was nothing to do it to."""

_TWIST = ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
_ARGUMENTS = (*_TWIST, "x_m", "y_m", "heading_rad", "reference", "gains", "here", "name")
_ODD: tuple[Any, ...] = (None, -1, 1e308, float("nan"), 2**70, True, [], {}, [[]])
_ODD += ("", "x" * 5000, "../../x", "../x.rrd", "a\x00.rrd", "\x1b[2J")


def kill_service(world: World, judge: Judge, rng: random.Random) -> str:
    """Kill the control process; start it again later, as systemd would."""
    world.service.kill()
    world.service.wait()
    judge.must_stand = True
    time.sleep(rng.uniform(0.2, 3.0))
    judge.must_stand = False
    world.start_service()
    return "kill service"


def stop_service(world: World, judge: Judge, rng: random.Random) -> str:
    """Stop the control process for a while, and let it go on."""
    with _stopped(psutil.Process(world.service.pid)):
        judge.must_stand = True
        time.sleep(rng.choice([0.05, 0.15, 0.4, 1.0, 3.0]))
        judge.must_stand = False
    return "stop service"


def kill_child(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Kill the recorder, the API, the guardian or the viewer."""
    role, process = _child(world, rng)
    if process is None:
        return None
    process.kill()
    time.sleep(rng.uniform(0.0, 1.0))
    return f"kill {role}"


def stop_child(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Stop the recorder, the API, the guardian or the viewer for a while."""
    role, process = _child(world, rng)
    if process is None:
        return None
    with _stopped(process):
        time.sleep(rng.choice([0.1, 0.5, 2.0, 6.0]))
    return f"stop {role}"


def stop_robot(world: World, judge: Judge, rng: random.Random) -> str:
    """Stop the robot's process, as a board that hangs."""
    with _stopped(psutil.Process(world.robot.pid)):
        judge.robot_sleeps = True
        time.sleep(rng.choice([0.05, 0.3, 1.5]))
    time.sleep(0.5)
    judge.robot_sleeps = False
    return "stop robot"


def kill_robot(world: World, judge: Judge, rng: random.Random) -> str:
    """Kill the robot's process and start it again, as a board that is unplugged, or was reset."""
    judge.robot_sleeps = True
    world.kill_robot()
    time.sleep(rng.uniform(0.0, 2.0))
    world.start_robot()
    judge.robot_sleeps = False
    return "kill robot"


def kill_viewer(world: World, judge: Judge, rng: random.Random) -> str:
    """Start a viewer, or kill the one that is there."""
    if world.viewer is None or world.viewer.poll() is not None:
        world.start_viewer()
        return "start viewer"
    world.kill_viewer()
    return "kill viewer"


def full_disk(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Let no file of the recorder grow for a while."""
    recorders = world.processes().get("recorder", [])
    if not recorders:
        return None
    for process in recorders:
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
    time.sleep(rng.uniform(0.5, 4.0))
    for process in recorders:
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    return "full disk"


def step_clock(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Set the service's time of day forward or back."""
    if not world.moves_time:
        return None
    by_s = rng.choice([-86_400.0, -60.0, 60.0, 86_400.0, 3e8])
    world.step_clock(by_s)
    time.sleep(rng.uniform(0.5, 2.0))
    world.step_clock(0.0)
    return f"step clock by {by_s:g} s"


def bad_line(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Lose frames, deliver them late, or cut the line."""
    line = world.line
    if line is None:
        return None
    what = rng.choice(["lose", "late", "cut"])
    if what == "lose":
        line.loss = rng.choice([0.05, 0.3, 0.9])
    elif what == "late":
        line.late_s = rng.choice([0.01, 0.08, 0.5])
    else:
        line.is_cut = True
    time.sleep(rng.uniform(0.2, 3.0))
    line.mend()
    return f"{what} frames"


def flood_line(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Put noise on the line, and well-formed frames of somebody who does not know the session."""
    if world.line is None:
        return None
    framer = Framer()
    for _ in range(rng.randrange(1, 60)):
        data = rng.randbytes(rng.randrange(1, 200))
        if rng.random() < 0.7:
            number = rng.choice(sorted(LENGTHS))
            data = framer.encode(Frame(number, rng.randbytes(LENGTHS[number])))
        world.line.flood(data)
        time.sleep(rng.uniform(0.0, 0.01))
    return "flood line"


def malformed_orders(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Give orders with odd values, names and bytes."""
    client = world.client()
    if client is None:
        return None
    for _ in range(rng.randrange(5, 40)):
        names = rng.sample(_ARGUMENTS, rng.randrange(5))
        action = rng.choice([one for one in Action if one not in (Action.SHUTDOWN, Action.STOP_RECORDING)])
        # Refused, or the service is away; what it does with it is judged by the truth.
        with contextlib.suppress(HilError, ValueError):
            client.order(action, {name: rng.choice(_ODD) for name in names})
    return "malformed orders"


def flood_api(world: World, judge: Judge, rng: random.Random) -> str | None:
    """Open connections that say nothing or half of something, and ask for much at once; then ask for the status."""
    port = _api_port(world)
    if port is None:
        return None
    halves = []
    for _ in range(rng.randrange(20, 150)):
        with contextlib.suppress(OSError):
            one = socket.create_connection(("127.0.0.1", port), 0.5)
            one.sendall(
                rng.choice([b"", b"GET /v1/st", b"POST /v1/arm HTTP/1.1\r\nHost: x\r\nContent-Le", b"\x00" * 99])
            )
            halves.append(one)
    for _ in range(rng.randrange(100)):
        with contextlib.suppress(OSError, http.client.HTTPException):
            asking = http.client.HTTPConnection("127.0.0.1", port, timeout=0.5)
            asking.request("POST", "/v1/twist", json.dumps({"vx_m_s": 1.0}), {"Authorization": "Bearer wrong"})
            asking.getresponse().read()
            asking.close()
    time.sleep(rng.uniform(0.0, 1.0))
    for one in halves:
        one.close()
    return "flood API"


EVENTS: Mapping[Event, int] = {
    kill_service: 2,
    stop_service: 3,
    kill_child: 4,
    stop_child: 3,
    stop_robot: 1,
    kill_robot: 1,
    kill_viewer: 1,
    full_disk: 2,
    step_clock: 2,
    bad_line: 5,
    flood_line: 3,
    malformed_orders: 2,
    flood_api: 2,
}
"""How often each happens, in shares."""


def give_order(world: World, judge: Judge, rng: random.Random) -> None:
    """Do the next thing that a user does, whatever happens to the service: arm, drive, clear."""
    status, client = judge.status(), world.client()
    if status is None or client is None:
        return
    with contextlib.suppress(HilError):  # refused, or away: the user asks again
        client.order(*_next_order(status["phase"], rng))


def _next_order(phase: str, rng: random.Random) -> tuple[Action, Mapping[str, Any]]:
    if phase in ("fault", "estop"):
        return Action.CLEAR, {}
    if phase != "active":
        return Action.ARM, {}
    what = rng.random()
    if what < 0.5:
        return Action.TWIST, {name: rng.uniform(-0.5, 0.5) for name in _TWIST}
    if what < 0.75:
        return Action.TRACK, {"here": True, "reference": {"kind": "circle", "radius_m": 0.5, "period_s": 8.0}}
    if what < 0.95:
        return Action.GO, {"x_m": rng.uniform(-2, 2), "y_m": rng.uniform(-2, 2), "heading_rad": rng.uniform(-3, 3)}
    return rng.choice([Action.DISARM, Action.ESTOP, Action.STOP]), {}


def _child(world: World, rng: random.Random) -> tuple[str, psutil.Process | None]:
    found = world.processes()
    roles = sorted(role for role in found if role in ("recorder", "api", "guardian", "viewer"))
    if not roles:
        return "", None
    role = rng.choice(roles)
    return role, rng.choice(sorted(found[role], key=lambda one: one.pid))


def _api_port(world: World) -> int | None:
    found = running()
    return found[0].port if found else None


@contextlib.contextmanager
def _stopped(process: psutil.Process) -> Iterator[None]:
    """Stop a process, and let it go on afterwards. One that has ended already is left alone."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGCONT)
