"""What a session with motor controllers needs of whoever stops the robot when this process dies or hangs."""

from typing import NamedTuple, Protocol

from hil.drivers.port import Dialect, Driver
from hil.wire.link import LinkUrl


class HostWatch(Protocol):
    """Watches this process from the arming of the robot until its wheels rest. No call waits for anything."""

    @property
    def warning(self) -> str | None:
        """The sentence that says, before anything moves, what is not covered; None where there is nothing to say."""

    def begin(self) -> bool:
        """Ask to be watched, before the robot is armed; tell whether that is confirmed. To be called until it is.

        Raises DeviceError where it is refused or cannot be.
        """

    @property
    def failure(self) -> str | None:
        """Why the robot must not be driven on: it was stopped for our silence, or nobody watches. Ends with ``begin``.

        As a sentence; None while all is well.
        """

    def beat(self) -> None:
        """Say that a command, or a step of a stop, went out just now."""

    def hold(self) -> None:
        """Say that no command will come for a while, and the robot has its stop. Our death is still watched for."""

    def rest(self) -> None:
        """Say that the wheels rest: nothing is to be stopped until ``begin``."""

    def release(self) -> None:
        """Part with it, when the link is closed: unless all rests, it then stops the robot. May be called twice."""


class Unwatched(NamedTuple):
    """Nobody watches: a robot in this process, one that stops by itself, or a link that takes no second process."""

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
    """Return who stops motors elsewhere if this process dies, or is silent for so long: a process, where they need one.

    ``priority`` is this process's own in real time. Raises DeviceError when the other process does not start.
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
