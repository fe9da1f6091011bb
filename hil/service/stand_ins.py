"""Replacements for parts of a service's ticks: for a law that has failed, and for a lost source of truth."""

from collections.abc import Callable
from typing import NamedTuple

from hil.core.errors import DeviceError
from hil.core.ports import PoseSource
from hil.core.types import NAN, NO_GAINS, Applied, PoseFix, Reference, State, WheelCommand
from hil.runtime.tick import TickParts


class LastingTruth:
    """A PoseSource that returns None once it was lost, instead of raising. ``lost`` is called once with the cause.

    It is not reconnected: a virtual robot that was restarted has its truth at another address.
    """

    def __init__(self, source: PoseSource, lost: Callable[[str], None]) -> None:
        self._source: PoseSource | None = source
        self._lost = lost

    def poll(self) -> PoseFix | None:
        """Return the newest fix, or None when there is none."""
        if self._source is None:
            return None
        try:
            return self._source.poll()
        except DeviceError as error:
            self.close()
            self._lost(str(error))
            return None

    def close(self) -> None:
        """Release the source."""
        if self._source is not None:
            self._source.close()
            self._source = None


class _NoLaw:
    """Replaces a law that has failed; it is never asked for a command."""

    gains = NO_GAINS

    def reset(self, state: State, reference: Reference) -> None:
        raise AssertionError("nothing is driven without a law")

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        raise AssertionError("nothing is driven without a law")


class _NoSignals(NamedTuple):
    """Replaces the own signals of a law that has failed: the same names, NaN for each."""

    signals: tuple[str, ...]
    telemetry: tuple[float, ...]


def without_law(parts: TickParts) -> TickParts:
    """Return the parts without their law and shadows, for a robot that is not driven until it is armed again."""
    silent = tuple(_NoSignals(tuple(own.signals), (NAN,) * len(own.signals)) for own in parts.extra)
    return parts._replace(controller=_NoLaw(), shadows=None, extra=silent)
