"""The watch that stops the robot when this process dies or hangs, as a session with motor controllers uses it."""

from typing import NamedTuple, Protocol

from hil.drivers.port import Dialect, Driver
from hil.wire.link import LinkUrl


class HostWatch(Protocol):
    """Watches this process from the arming of the robot until its wheels rest. No call waits for anything."""

    @property
    def warning(self) -> str | None:
        """A warning, shown before anything moves, that says what is not covered; None if there is none."""

    def begin(self) -> bool:
        """Ask to be watched, before the robot is armed; return whether that is confirmed. Call it until it is.

        Raises DeviceError when the watch is refused or impossible.
        """

    @property
    def failure(self) -> str | None:
        """Why the robot must not be driven further: it was stopped because of our silence, or the watch has failed.

        None if neither is so. ``begin`` clears it.
        """

    def beat(self) -> None:
        """Report that a command or a step of a stop was just sent."""

    def hold(self) -> None:
        """Report that the stop was sent and no command follows for a while. Our death is still watched for."""

    def rest(self) -> None:
        """Report that the wheels rest: nothing has to be stopped until ``begin``."""

    def release(self) -> None:
        """End the watch, after the link was closed; unless the wheels rest, it stops the robot. May be called twice."""


class Unwatched(NamedTuple):
    """No watch: the robot is in this process, stops by itself, or its link cannot be used by a second process."""

    warning: str | None = None
    failure: None = None

    def begin(self) -> bool:
        return True

    def beat(self) -> None:
        pass

    def hold(self) -> None:
        pass

    def rest(self) -> None:
        pass

    def release(self) -> None:
        pass


def watch_over(made: Dialect, driver: Driver, url: LinkUrl, silence_s: float, priority: int) -> HostWatch:
    """Return the watch over motors elsewhere; a guardian process if they have no watchdog and a serial line.

    ``silence_s`` is the silence after which it stops them; ``priority`` is this process's real-time priority, 0 for
    none. Raises DeviceError when the guardian does not start.
    """
    if driver.capabilities.watchdog != "none":
        return Unwatched()
    if url.serial_port is None or made.make_framing is None:
        return Unwatched(
            "nothing that is known to us stops the robot if this program dies or hangs: a guardian process watches "
            "over serial lines alone; keep a switch that cuts the motors' power within reach"
        )
    from hil.drivers.guardian import Guardian  # a thread and a process: not for every run

    framing = made.make_framing()
    stop = b"".join(framing.encode(frame) for frame in driver.last_stop())
    return Guardian(*url.serial_port, stop, silence_s=silence_s, priority=priority)
