"""The watch that stops the robot when this process dies or hangs, as a session with motor controllers uses it."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the guardian's process imports this module, and starts in half the time without these
    from hil.drivers.port import Dialect, Driver
    from hil.wire.link import LinkUrl


class HostWatch:
    """Watches this process from the arming of the robot until its wheels rest. No call waits for anything.

    This class itself watches nothing. It serves for a robot in this process, for one that stops by itself, and for one
    whose link a second process cannot use.
    """

    def __init__(self, warning: str | None = None) -> None:
        self._warning = warning

    @property
    def warning(self) -> str | None:
        """A warning, shown before anything moves, that says what is not covered; None if there is none."""
        return self._warning

    def begin(self) -> bool:
        """Ask for the watch, before the robot is armed; return whether it is confirmed. Call this until it is.

        Raises DeviceError when the watch is refused or impossible.
        """
        return True

    @property
    def failure(self) -> str | None:
        """Why the robot must not be driven further: it was stopped because of our silence, or the watch has failed.

        None if neither is so. ``begin`` clears it.
        """
        return None

    def beat(self) -> None:
        """Report that a command or a step of a stop was just sent."""

    def hold(self) -> None:
        """Report that the stop was sent and no command follows for a while. Our death is still watched for."""

    def rest(self) -> None:
        """Report that the wheels rest: nothing has to be stopped until ``begin``."""

    def release(self) -> None:
        """End the watch, after the link was closed; unless the wheels rest, it stops the robot. May be called twice."""


def watch_over(made: "Dialect", driver: "Driver", url: "LinkUrl", silence_s: float, priority: int) -> HostWatch:
    """Return the watch over motors elsewhere; a guardian process if they have no watchdog and a serial line.

    ``silence_s`` is the silence after which it stops them; ``priority`` is this process's real-time priority, 0 for
    none. Raises DeviceError when the guardian does not start.
    """
    if driver.capabilities.watchdog != "none":
        return HostWatch()
    if url.serial_port is None or made.make_framing is None:
        return HostWatch(
            "nothing that is known to us stops the robot if this program dies or hangs: a guardian process watches "
            "over serial lines alone; keep a switch that cuts the motors' power within reach"
        )
    from hil.drivers.guardian import Guardian  # a thread and a process: not for every run

    framing = made.make_framing()
    stop = b"".join(framing.encode(frame) for frame in driver.last_stop())
    return Guardian(*url.serial_port, stop, silence_s=silence_s, priority=priority)
