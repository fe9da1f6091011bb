"""Warnings about the timeouts of VESCs. Nothing but the timeouts stops the wheels when commands end."""

from collections.abc import Callable, Iterable, Mapping

from hil.drivers.port import RobotFacts, chosen
from hil.drivers.vesc.channel import Channel
from hil.drivers.vesc.frames import MIN_CURRENT_A, Timeout

_WHERE = "App Settings > General > Timeout in VESC Tool"
_END = "when commands end"
_SECONDS_FROM_S = 10.0


def has_timeout(channel: Channel, robot: RobotFacts) -> bool:
    """Return whether the VESC is known to release or brake its wheel within ``watchdog_s`` after the last command."""
    return channel.timeout is not None and 0.0 < channel.timeout.timeout_s <= robot.watchdog_s


def timeout_warnings(by_id: Mapping[int, Channel], robot: RobotFacts) -> Iterable[str]:
    """Yield a sentence for each problem with the timeouts, with the ids concerned."""
    required = f"{robot.watchdog_s * 1e3:g} ms"
    yield from _unknown(by_id, robot, required)
    if endless := _with(by_id, lambda timeout: timeout.timeout_s == 0.0):
        yield (
            f"the timeout of the VESC {endless} is 0: {_END} its wheel turns on with the last one, and nothing stops "
            f"it if {_failures(robot)}; keep the robot's power switch within reach, and set {_WHERE} to {required}"
        )
    for timeout_s in sorted({channel.timeout.timeout_s for channel in by_id.values() if channel.timeout is not None}):
        same = [one.timeout is not None and one.timeout.timeout_s == timeout_s for one in by_id.values()]
        vescs = chosen(by_id, same)
        if timeout_s > robot.watchdog_s:
            yield (
                f"the timeout of the VESC {vescs} is {_words(timeout_s)}, longer than firmware.watchdog_s: its wheel "
                f"turns on for that time {_END}; set {_WHERE} to {required}"
            )
        elif 0.0 < timeout_s <= robot.period_s:
            yield (
                f"the timeout of the VESC {vescs} is {_words(timeout_s)}, no longer than the "
                f"{robot.period_s * 1e3:g} ms between two commands: it runs out between them, and its wheel jerks; "
                f"set {_WHERE} to {required}"
            )
    if rolling := _with(by_id, lambda timeout: timeout.timeout_s > 0.0 and timeout.brake_current_a < MIN_CURRENT_A):
        yield (
            f"the VESC {rolling} brakes with no current after its timeout: {_END} its wheel rolls; set Timeout Brake "
            "Current, beside the Timeout in VESC Tool"
        )
    if commanded := chosen(by_id, (_ends(one) and one.is_running for one in by_id.values())):
        yield (
            f"the VESC {commanded} was commanded just now, as its timeout has not run out: by a run that has ended, or "
            "by another of its apps, which would command it beside this program; or its power has just come on"
        )


def _ends(channel: Channel) -> bool:
    return channel.timeout is not None and channel.timeout.timeout_s > 0.0


def _words(timeout_s: float) -> str:
    return f"{timeout_s:.0f} s" if timeout_s >= _SECONDS_FROM_S else f"{timeout_s * 1e3:g} ms"


def _failures(robot: RobotFacts) -> str:
    """Return the failures in which only a timeout stops the wheels. On a serial line the guardian outlives the run."""
    killed = "" if robot.wire == "serial" else "this program is killed, or "
    return f"{killed}this computer loses its power, hangs, or loses the cable"


def _unknown(by_id: Mapping[int, Channel], robot: RobotFacts, required: str) -> Iterable[str]:
    unknown = [channel.timeout is None for channel in by_id.values()]
    if not any(unknown):
        return
    yield (
        f"the timeout of the VESC {chosen(by_id, unknown)} is not known: {_END} its wheel turns on for that time (by "
        "default 1 s, with 0 for ever), and then rolls if there is no brake current; so it does if "
        f"{_failures(robot)}; keep the robot's power switch within reach, and set {_WHERE} to {required}, with a "
        "Timeout Brake Current"
    )
    for vesc, channel in by_id.items():
        if channel.timeout is None and channel.foreign_id is not None:
            yield (
                f"the app configuration from the VESC {vesc} contains the id {channel.foreign_id}, and is ignored: two "
                "VESCs may have the same id, or this driver does not know the layout of its firmware"
            )
    if running := chosen(by_id, (one.timeout is None and one.is_running for one in by_id.values())):
        yield (
            f"the timeout of the VESC {running} has not run out: it was commanded just now, by this program or by one "
            f"of its apps; or its power has just come on; or its timeout is 0, and then its wheel turns on {_END}"
        )


def _with(by_id: Mapping[int, Channel], is_such: Callable[[Timeout], bool]) -> str:
    return chosen(by_id, (one.timeout is not None and is_such(one.timeout) for one in by_id.values()))
