"""Replacements for parts of a service's ticks: for a law that has failed or is elsewhere, and for a lost truth."""

from collections.abc import Callable
from typing import NamedTuple

from hil.core.errors import DeviceError
from hil.core.ports import Controller, PoseSource
from hil.core.types import (
    NAN,
    NO_GAINS,
    ZERO_WHEELS,
    Applied,
    CommandMode,
    Pairs,
    PoseFix,
    Reference,
    State,
    WheelCommand,
    Wheels,
)
from hil.runtime.tick import TickParts
from hil.service.conduct import Conduct


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


class LawElsewhere:
    """A controller that returns the wheel commands of a law elsewhere while there are any, else those of ``law``."""

    def __init__(self, law: Controller, conduct: Conduct, mode: CommandMode) -> None:
        self._law = law
        self._conduct = conduct
        self._mode = mode
        self._was_elsewhere = False

    @property
    def gains(self) -> Pairs:
        """Gains of the law that is here."""
        return self._law.gains

    def reset(self, state: State, reference: Reference) -> None:
        """Reset the law that is here."""
        self._law.reset(state, reference)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick; the law that is here starts anew when it takes over."""
        if (wheels := self._conduct.wheels) is not None:
            self._was_elsewhere = True
            if self._mode is CommandMode.SPEED:
                return WheelCommand(self._mode, Wheels(*wheels), ZERO_WHEELS)
            return WheelCommand(self._mode, ZERO_WHEELS, Wheels(*wheels))
        if self._was_elsewhere:
            self._was_elsewhere = False
            self._law.reset(state, reference)
        return self._law.update(reference, state, applied, dt_s)


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
