"""What has to be said of the timeouts of VESCs, which are all that stops the wheels when commands end."""

from collections.abc import Callable, Iterable, Mapping

from hil.drivers.port import RobotFacts, chosen
from hil.drivers.vesc.channel import Channel
from hil.drivers.vesc.frames import LEAST_CURRENT_A, Timeout

_WHERE = "App Settings > General > Timeout in VESC Tool"
_END = "when commands end"
_SECONDS_FROM_S = 10.0


def has_timeout(channel: Channel, robot: RobotFacts) -> bool:
    """Whether its wheel is known to be let go or braked within ``watchdog_s`` when commands end."""
    return channel.timeout is not None and 0.0 < channel.timeout.timeout_s <= robot.watchdog_s


def timeout_warnings(by_id: Mapping[int, Channel], robot: RobotFacts) -> Iterable[str]:
    """Yield what is wrong with them, with the ids; nothing where all are good."""
    wanted_ms = f"{robot.watchdog_s * 1e3:g} ms"
    yield from _unknown(by_id, robot, wanted_ms)
    if endless := _with(by_id, lambda timeout: timeout.timeout_s == 0.0):
        yield (
            f"the timeout of the VESC {endless} is 0: {_END} its wheel turns on with the newest one, so that nothing "
            f"stops it if {_deaths(robot)}; keep the robot's power switch within reach, and set {_WHERE} to {wanted_ms}"
        )
    for timeout_s in sorted({channel.timeout.timeout_s for channel in by_id.values() if channel.timeout is not None}):
        same = [one.timeout is not None and one.timeout.timeout_s == timeout_s for one in by_id.values()]
        vescs = chosen(by_id, same)
        if timeout_s > robot.watchdog_s:
            yield (
                f"the timeout of the VESC {vescs} is {_words(timeout_s)}, longer than firmware.watchdog_s: so long "
                f"its wheel goes on {_END}; set {_WHERE} to {wanted_ms}"
            )
        elif 0.0 < timeout_s <= robot.period_s:
            yield (
                f"the timeout of the VESC {vescs} is {_words(timeout_s)}, no longer than the "
                f"{robot.period_s * 1e3:g} ms between two commands: it runs out between them, and its wheel jerks; "
                f"set {_WHERE} to {wanted_ms}"
            )
    if rolling := _with(by_id, lambda timeout: timeout.timeout_s > 0.0 and timeout.brake_current_a < LEAST_CURRENT_A):
        yield (
            f"the VESC {rolling} brakes with no current after its timeout: {_END} its wheel rolls; set Timeout Brake "
            "Current, beside the Timeout in VESC Tool"
        )
    if strangers := chosen(by_id, (_ends(one) and one.runs_on for one in by_id.values())):
        yield (
            f"the VESC {strangers} was commanded just now, for its timeout has not run out: by a run that has ended, "
            "or by another of its apps, which would go on beside this program; or its power has just come on"
        )


def _ends(channel: Channel) -> bool:
    return channel.timeout is not None and channel.timeout.timeout_s > 0.0


def _words(timeout_s: float) -> str:
    return f"{timeout_s:.0f} s" if timeout_s >= _SECONDS_FROM_S else f"{timeout_s * 1e3:g} ms"


def _deaths(robot: RobotFacts) -> str:
    """Return what only a timeout stops the wheels after; over a line the guardian does when this program is killed."""
    killed = "" if robot.wire == "serial" else "this program is killed, or "
    return f"{killed}this computer loses its power, hangs, or loses the cable"


def _unknown(by_id: Mapping[int, Channel], robot: RobotFacts, wanted_ms: str) -> Iterable[str]:
    unknown = [channel.timeout is None for channel in by_id.values()]
    if not any(unknown):
        return
    yield (
        f"the timeout of the VESC {chosen(by_id, unknown)} is not known: {_END} its wheel goes on for that time, 1 s "
        "as delivered and for ever with 0, and then rolls where there is no brake current, also if "
        f"{_deaths(robot)}; keep the robot's power switch within reach, and set {_WHERE} to {wanted_ms}, with a "
        "Timeout Brake Current"
    )
    for vesc, channel in by_id.items():
        if channel.timeout is None and channel.strange_id is not None:
            yield (
                f"the app configuration that the VESC {vesc} tells is that of the id {channel.strange_id}, and not "
                "believed: two may have one id, or its firmware lays it out in a way that this driver does not know"
            )
    if running := chosen(by_id, (one.timeout is None and one.runs_on for one in by_id.values())):
        yield (
            f"the timeout of the VESC {running} has not run out: it was commanded just now, by us or by another app of "
            f"it, or its power has just come on, or its timeout is 0, and then its wheel turns on {_END}"
        )


def _with(by_id: Mapping[int, Channel], is_such: Callable[[Timeout], bool]) -> str:
    return chosen(by_id, (one.timeout is not None and is_such(one.timeout) for one in by_id.values()))
