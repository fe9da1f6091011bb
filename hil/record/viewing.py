"""What viewers show of a recording besides its data, as an add-on brings it: entry points of the group ``hil.viewer``.

Without the add-on every row, event and property is recorded all the same, and viewers choose their own layout. The
parts by name: ``drawing`` makes a ``Drawing``, ``frames`` makes ``Frames``, ``live`` makes a ``LiveServer``, and
``window`` opens a viewer on the run that is served on a port.
"""

import pkgutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from hil.core.extensions import Extensions

if TYPE_CHECKING:
    from hil.record.mcap_file import Definition
    from hil.record.ring import Rows

_PARTS = Extensions("hil.viewer")
NO_DRAWING = "without the add-on hil.addons.report the recording has no layout: viewers choose their own"


class Drawing(Protocol):
    """What rerun's viewer shows of a run: made from rerun's stream, signals, properties, and whether it is live, when
    there are no rows. ``blueprint`` is the layout before the first row.
    """

    blueprint: Any

    def describe(self) -> None:
        """Log what does not change."""

    def rows(self, rows: "Rows") -> None:
        """Draw rows of shape (n, signals)."""

    def event(self, t_s: float, level: str, text: str) -> None:
        """Show an event; ``level`` is one of rerun's."""

    def finish(self, summary: Mapping[str, Any] | None, next_part: int | None) -> None:
        """Show the run's summary; None if it was killed, or goes on in file ``next_part``."""


MakeDrawing = Callable[[Any, Sequence[str], Mapping[str, str], bool], Drawing]


class Frames(Protocol):
    """Messages of ROS 2 in an MCAP file by which viewers draw the robot; ``topics`` has the type on each topic."""

    topics: "Mapping[str, Definition]"

    def begin(self, zero_unix_ns: int) -> "Iterator[tuple[str, int, bytes]]":
        """Yield topic, Unix time [ns] and message, for the beginning of the file; ``zero_unix_ns`` is t = 0."""

    def messages(self, rows: "Rows", zero_unix_ns: int) -> "Iterator[tuple[str, int, bytes]]":
        """Yield topic, Unix time [ns] and message, for rows of shape (n, signals)."""


MakeFrames = Callable[[Sequence[str], Mapping[str, Any]], Frames | None]
"""Takes the signals and the scenario's values; returns None where they lack something."""


class LiveServer(Protocol):
    """Serves live viewers: made from port, recording_id, signals and properties. Raises OSError for a port in use;
    ``error`` is why it has ended, or None.
    """

    error: str | None

    def rows(self, rows: "Rows") -> None:
        """Serve rows of shape (n, signals). Never waits."""

    def event(self, t_s: float, level: str, text: str) -> None:
        """Serve a line of the event log."""

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Serve the run's summary; all is served until ``close``."""

    def close(self) -> None:
        """Stop serving."""


def places() -> dict[str, str]:
    """Return ``package.module:name`` of each installed part; a recorder gets these and does not search itself."""
    return {point.name: point.value for point in (*_PARTS.registered(), *_PARTS.ours.values())}


def part(name: str, among: Mapping[str, str] | None = None) -> Any:
    """Import and return a part, one of ``places`` by default; None if it is not installed."""
    place = (places() if among is None else among).get(name)
    return None if place is None else pkgutil.resolve_name(place)


def check_live(port: int) -> None:
    """Raise BadInputError if the part that serves live viewers on this port is missing."""
    _PARTS.find("live", f"live port {port}")


def live_hint(port: int) -> str:
    """Return a sentence that tells the user how to watch the current run."""
    return f"live view: run 'hil live --port {port}' on this machine; with --web in a browser"
