"""What stands in a tick where a law has failed: it is asked for nothing more, not even for its gains."""

from hil.core.types import NAN, NO_GAINS, Applied, Reference, State, WheelCommand
from hil.runtime.tick import Parts


class _NoLaw:
    """Never asked for a command."""

    gains = NO_GAINS

    def reset(self, state: State, reference: Reference) -> None:
        raise AssertionError("nothing is driven without a law")

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        raise AssertionError("nothing is driven without a law")


class _Silent:
    """Signals of a law that has failed: by name, without values."""

    def __init__(self, signals: tuple[str, ...]) -> None:
        self.signals = signals
        self.telemetry = (NAN,) * len(signals)


def muted(parts: Parts) -> Parts:
    """Return the parts without their law and its shadows, for a robot that is not driven until it is armed again."""
    silent = tuple(_Silent(own.signals) for own in parts.extra)
    return parts._replace(controller=_NoLaw(), shadows=None, extra=silent)
