"""What the faults of a link have in common: the scenario's time, and a row with its chance and its account."""

import random
from collections.abc import Sequence

from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.faults.kind import FaultRow, generators
from hil.faults.kinds import DIRECTIONS
from hil.wire.delay import NowNs


class ScenarioTime:
    """The scenario's time [ns], counted on a clock from the first ACTIVE tick; there is none before ``begin``."""

    def __init__(self, clock: NowNs) -> None:
        self._clock = clock
        self._origin_ns: int | None = None

    def begin(self, origin_ns: int) -> None:
        """Say when, on the clock, the scenario's time began."""
        self._origin_ns = origin_ns

    def now_ns(self) -> int | None:
        """Return the scenario's time, or None before it has begun."""
        return None if self._origin_ns is None else self._clock.now_ns() - self._origin_ns

    def on_clock_ns(self, t_ns: int) -> int:
        """Return a time of the scenario as the clock has it."""
        return t_ns + (self._origin_ns or 0)


class LinkFault:
    """A row that acts on a link, with its own chance; ``applied`` counts how often it did something."""

    def __init__(self, row: FaultRow, chance: random.Random, protocol: LinkProtocol) -> None:
        self._names = protocol.names
        self.kind = row.kind
        self.row = row
        self.chance = chance
        self.applied = 0
        self._direction = row.target if row.target in DIRECTIONS else None
        self._message = None if row.target in (*DIRECTIONS, "link") else row.target

    def concerns(self, direction: str, number: int | None) -> bool:
        """Tell whether the row means frames of this direction and id; an id that is not known is of no message."""
        if self._message is not None:
            return number is not None and self._names.get(number) == self._message
        return self._direction in (None, direction)

    def strikes(self) -> bool:
        """Tell, by chance, whether a frame is hit, and count it."""
        if self.chance.random() >= self.row.value:
            return False
        self.applied += 1
        return True

    def due(self, t_ns: int) -> int:
        """Return how often a babble speaks now, to keep its rate since its window began; they are counted.

        What it still owed at the end of the window is never said.
        """
        row = self.row
        if not row.is_in_force(t_ns):
            return 0
        new = max(0, int((t_ns - row.start_ns) * 1e-9 * row.value) - self.applied)
        self.applied += new
        return new


def link_faults(rows: Sequence[FaultRow], seed: int, protocol: LinkProtocol = WHEEL_DBC) -> list[LinkFault]:
    """Give every row its chance and its account."""
    return [LinkFault(row, chance, protocol) for row, chance in zip(rows, generators(rows, seed), strict=True)]
